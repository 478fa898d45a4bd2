# SPDX-License-Identifier: GPL-3.0-or-later
"""The renders that `python -m benchmarks fingerprints` takes: a built-in scene, settings, passes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from engine.render.film import PASS_NAMES

#: What a guided render shows of its guiding.
GUIDED_PASSES = ("Combined", "Sample Count", "Variance", "Candidate Count", "Guiding Benefit")


@dataclass(frozen=True)
class FingerprintCase:
    """One small render.

    Attributes
    ----------
    scene : str
        A built-in scene.
    settings : mapping
        Of `RenderSettings`, apart from `threads` and `deterministic`.
    passes : sequence of str
        Of `render.film.PASS_NAMES`.
    sequence : sequence of float [frames]
        Not empty: one field is trained on these frames and each of them is rendered by it, without motion blur.
    threads : sequence of int
        Numbers of threads that must give the same pictures.
    """

    name: str
    scene: str
    settings: Mapping[str, Any] = field(default_factory=dict, hash=False)
    passes: Sequence[str] = ("Combined",)
    sequence: Sequence[float] = ()
    threads: Sequence[int] = (1, 2)


def _unguided(name: str, scene: str, samples: int = 8, **settings: Any) -> FingerprintCase:
    return FingerprintCase(name, scene, {"samples": samples, **settings})


def _guided(name: str, scene: str, method: str, samples: int = 48, **settings: Any) -> FingerprintCase:
    """A guided render that nothing but its settings keeps from being guided to the end."""
    settings = {"samples": samples, "guiding_method": method, "guiding_trial": False, **settings}
    return FingerprintCase(name, scene, settings, GUIDED_PASSES)


def _network(name: str, scene: str, method: str, samples: int = 16, **settings: Any) -> FingerprintCase:
    """A variant of a network: its training takes seconds, so it lasts for few iterations and is done once."""
    return replace(_guided(name, scene, method, samples, **settings), threads=(2,))


def _tried(name: str, scene: str, method: str, samples: int = 48) -> FingerprintCase:
    """A guided render that is compared with unguided samples, and may give guiding up."""
    return _guided(name, scene, method, samples, guiding_trial=True)


#: The scene with diffuse, glossy and glass things that most methods render, indirect light for the most part; and one
#: in which guiding wins its trial.
ROOM, WON = "evening-room", "fail-dark-bright"
FIXED: Mapping[str, Any] = {"candidate_allocation": "FIXED", "candidate_count": 3}

CASES: dict[str, FingerprintCase] = {
    case.name: case
    for case in (
        # Unguided: light, shapes, materials, textures, cameras.
        FingerprintCase("passes", ROOM, {"samples": 16}, PASS_NAMES),
        *(
            _unguided(f"scene-{scene}", scene)
            for scene in (
                "alpha-cards", "attributes", "backfacing", "bump", "camera-border", "camera-border-crop",
                "camera-clipping", "camera-depth-of-field-blades", "camera-ortho-depth-of-field", "camera-panorama",
                "camera-pixel-aspect", "camera-shift", "color-nodes", "curves", "diffuse-rough", "emissive-mesh",
                "emissive-one-sided", "emissive-textured", "film-exposure", "glass-multi-ggx", "glass-rough",
                "glass-smooth", "glossy-anisotropic-uv", "glossy-beckmann", "instanced", "layer-weight",
                "light-area-disk", "light-area-ellipse", "light-area-rectangle", "light-area-spread", "light-nodes",
                "light-point", "light-point-soft", "light-spot-blend", "light-spot-scaled", "light-sun",
                "light-sun-soft", "light-temperature", "light-visibility", "low-poly", "low-poly-glass", "many-lamps",
                "many-lights", "math-nodes", "mix-shader", "modifiers", "normal-map", "principled-alpha",
                "principled-anisotropic", "principled-coat", "principled-everything", "principled-metal-tint",
                "principled-sheen", "principled-transmission-half", "procedural", "procedural-noise",
                "procedural-voronoi", "refraction-rough", "refraction-smooth", "textured", "textured-color-spaces",
                "textured-projections", "transforms", "translucent", "transparent", "visibility", "world-camera-only",
                "world-color", "world-image-sun", "world-mirror-ball",
            )
        ),
        _unguided("film-transparent", "visibility", film_transparent=True),
        _unguided("film-box", "emissive-mesh", pixel_filter="BOX", filter_width=1.0),
        _unguided("film-gaussian", "emissive-mesh", pixel_filter="GAUSSIAN", filter_width=3.0),
        _unguided("clamp-direct", "light-point-soft", clamp_direct=0.3),
        _unguided("clamp-indirect", "fail-fireflies", clamp_indirect=0.5),
        _unguided("filter-glossy-off", ROOM, filter_glossy=0.0),
        _unguided("filter-glossy-strong", ROOM, filter_glossy=5.0),
        _unguided("caustics-off", "torus-in-glass", use_caustics_reflective=False, use_caustics_refractive=False),
        _unguided("caustics-reflective", ROOM, use_caustics_refractive=False),
        _unguided("light-sampling-off", "emissive-mesh", use_nee=False),
        _unguided("light-threshold", "many-lamps", light_sampling_threshold=0.2),
        _unguided("roulette-off", "principled-everything", use_russian_roulette=False),
        _unguided("roulette-late", "principled-everything", min_light_bounces=4, min_transparent_bounces=4),
        _unguided("bounces-few", ROOM, max_bounces=3, diffuse_bounces=1, glossy_bounces=1, transmission_bounces=2),
        _unguided("transparent-few", "alpha-cards", transparent_max_bounces=2),
        _unguided("seed", "emissive-mesh", seed=7),
        # Unguided: wavelengths and motion.
        _unguided("spectral", "spectral-panes", spectral="ON"),
        _unguided("spectral-auto", "spectral-prism"),
        _unguided("spectral-plain", "principled-everything", spectral="ON"),
        _unguided("spectral-off", "spectral-panes", spectral="OFF"),
        *(
            _unguided(scene, scene)
            for scene in (
                "motion-camera", "motion-deform", "motion-emitter", "motion-flight", "motion-instances",
                "motion-rolling", "motion-start-curve", "motion-zoom",
            )
        ),
        # Every method; AUTO and VMM have cases of their own.
        *(
            _guided(f"method-{method.lower()}", ROOM, method)
            for method in ("VMM", "SDTREE", "SDTREE_VARIANCE", "NPM", "NPM_PRODUCT", "NASG", "FLOW", "VMM_RIS",
                           "TABLE_RIS", "NEURAL_RIS")
        ),
        _unguided("method-off", ROOM, 48),
        _tried("trial-vmm-lost", ROOM, "VMM"),
        _tried("trial-vmm-won", WON, "VMM", 159),
        _tried("trial-npm", ROOM, "NPM", 31),
        _tried("auto-lost", ROOM, "AUTO"),
        _tried("auto-won", WON, "AUTO"),
        _tried("auto-short", ROOM, "AUTO", 8),
        # Light so uneven that finer methods are tried and taken.
        _guided("auto-rungs", "spectral-lanterns", "AUTO", 319, spectral="OFF"),
        _guided("vmm-stage", "principled-everything", "VMM"),
        _guided("vmm-environment", "world-image-sun", "VMM"),
        _guided("vmm-glass", "torus-in-glass", "VMM"),
        _guided("vmm-transparent", "alpha-cards", "VMM", 24),
        _guided("vmm-lamps", "many-lamps", "VMM", 24),
        _guided("vmm-probability-given", ROOM, "VMM", 24, learn_guiding_probability=False, guiding_probability=0.7),
        _guided("vmm-uniform-weights", ROOM, "VMM", 24, sample_weighting="UNIFORM"),
        _guided("vmm-light-sampling-off", "emissive-mesh", "VMM", 24, use_nee=False),
        _guided("vmm-clamped", ROOM, "VMM", 24, clamp_direct=1.0, clamp_indirect=0.5),
        _guided("mis-compensation-vmm", ROOM, "VMM", mis_compensation=True),
        _guided("mis-compensation-sdtree", ROOM, "SDTREE", mis_compensation=True),
        # Resampling.
        _guided("fixed-vmm-ris", ROOM, "VMM_RIS", **FIXED),
        _guided("fixed-table-ris", ROOM, "TABLE_RIS", **FIXED),
        _guided("fixed-neural-ris", ROOM, "NEURAL_RIS", **FIXED),
        _network("fixed-neural-ris-paper", ROOM, "NEURAL_RIS", network_size="PAPER", **FIXED),
        _network("allocated-neural-ris", "spectral-lanterns", "NEURAL_RIS", 48, spectral="OFF"),
        _guided("grey-table-ris", ROOM, "TABLE_RIS", ris_target="SCALAR", defensive_alpha=0.2),
        _guided("sdtree-table-ris", ROOM, "TABLE_RIS", source_field="SDTREE"),
        _network("npm-neural-ris", ROOM, "NEURAL_RIS", source_field="NPM", **FIXED),
        *(
            _guided(f"cache-{method}-{kind}".lower(), ROOM, method, radiance_cache=kind)
            for method in ("OFF", "VMM")
            for kind in ("FAST", "CONVERGING")
        ),
        # Neural mixtures.
        _network("nasg-radiance", ROOM, "NASG", mixture_target="RADIANCE"),
        _network("nasg-cosine", ROOM, "NASG", mixture_target="COSINE"),
        _network("nasg-sg", ROOM, "NASG", mixture_lobes="SG"),
        _network("npm-nasg-lobes", ROOM, "NPM", mixture_lobes="NASG"),
        _network("npm-paper", ROOM, "NPM", mixture_preset="PAPER"),
        _network("npm-official", ROOM, "NPM", mixture_preset="OFFICIAL"),
        _network("nasg-paper", ROOM, "NASG", mixture_preset="PAPER"),
        _network("nasg-selection", ROOM, "NASG", network_selection=True),
        _network("npm-selection", ROOM, "NPM", network_selection=True),
        # Wavelengths.
        _guided("spectral-vmm", "spectral-panes", "VMM", spectral="ON"),
        _guided("spectral-table-ris", "spectral-panes", "TABLE_RIS", 24, spectral="ON"),
        _network("spectral-neural-ris", "spectral-panes", "NEURAL_RIS", spectral="ON", **FIXED),
        _network("spectral-npm-frequency", "spectral-panes", "NPM", spectral="ON", u_dimension="WAVELENGTH",
                mixture_u="FREQUENCY"),
        _network("spectral-npm-strata", "spectral-panes", "NPM", 32, spectral="ON", mixture_u="PLANES", strata=4),
        # Motion.
        _guided("motion-vmm", "blur-lamp", "VMM"),
        _network("motion-npm-frequency", "blur-lamp", "NPM", mixture_u="FREQUENCY"),
        _network("motion-npm-planes", "blur-lamp", "NPM", mixture_u="PLANES"),
        _network("motion-npm-hash4d", "blur-lamp", "NPM", mixture_u="HASH4D"),
        _network("motion-neural-ris-planes", "blur-lamp", "NEURAL_RIS", network_u="PLANES", **FIXED),
        _network("motion-nasg-strata", "blur-lamp", "NASG", 32, mixture_u="PLANES", strata=4),
        FingerprintCase(
            "sequence", "blur-lamp", {"samples": 16, "guiding_method": "NPM", "mixture_u": "PLANES"}, GUIDED_PASSES,
            sequence=(9.0, 11.0),
        ),
    )
}  # fmt: skip
