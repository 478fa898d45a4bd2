# SPDX-License-Identifier: GPL-3.0-or-later
"""Who renders: Cycles without and with path guiding or Fast GI, and NEURALGUIDE by guiding method.

All get the light paths, filter, clamps and roulette rule of the scene's Cycles settings, no persistent data, the same
threads; a noise threshold only where the budget has one. None is denoised but those with DENOISED behind their name: by
Open Image Denoise, as well as it can, with albedo and normal.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any

#: Samples asked for where only time is to stop a render.
UNLIMITED_SAMPLES = 1 << 20

#: What NEURALGUIDE is measured against.
CYCLES_RIVALS = ("cycles", "cycles-guided")

#: Behind the name of any rival: its picture is denoised.
DENOISED = "+oidn"

#: Names of ours that stand for a guiding method with settings of its own.
VARIANTS: dict[str, dict[str, Any]] = {
    "OFF-SPECTRAL": {"guiding_method": "OFF", "spectral": "ON"},
    "VMM-SPECTRAL": {"guiding_method": "VMM", "spectral": "ON"},
    "OFF-LIGHTS": {"guiding_method": "OFF", "light_selection": "LEARNED"},
    "AUTO-TREE": {"guiding_method": "AUTO", "light_selection": "TREE"},
    "OFF-FAST": {"guiding_method": "OFF", "radiance_cache": "FAST"},
    "OFF-CONVERGING": {"guiding_method": "OFF", "radiance_cache": "CONVERGING"},
    "AUTO-FAST": {"guiding_method": "AUTO", "radiance_cache": "FAST"},
    # What scenes have without a setting of their own.
    "AUTO-AUTO": {"guiding_method": "AUTO", "radiance_cache": "AUTO", "caustics": "AUTO"},
    "AUTO-CONVERGING": {"guiding_method": "AUTO", "radiance_cache": "CONVERGING"},
    "NASG-RADIANCE": {"guiding_method": "NASG", "mixture_target": "RADIANCE"},
    "NASG-COSINE": {"guiding_method": "NASG", "mixture_target": "COSINE"},
    "NASG-SG": {"guiding_method": "NASG", "mixture_lobes": "SG"},
    "NPM-FREQUENCY": {"guiding_method": "NPM", "mixture_u": "FREQUENCY"},
    "NPM-PLANES": {"guiding_method": "NPM", "mixture_u": "PLANES"},
    "NPM-HASH4D": {"guiding_method": "NPM", "mixture_u": "HASH4D"},
    "NPM-STRATA": {"guiding_method": "NPM", "mixture_u": "PLANES", "strata": 8},
    "NEURAL_RIS-NONE": {"guiding_method": "NEURAL_RIS", "network_u": "NONE"},
    "NEURAL_RIS-FREQUENCY": {"guiding_method": "NEURAL_RIS", "network_u": "FREQUENCY"},
    "NEURAL_RIS-PLANES": {"guiding_method": "NEURAL_RIS", "network_u": "PLANES"},
    "NASG-FREQUENCY": {"guiding_method": "NASG", "mixture_u": "FREQUENCY"},
    "NASG-PLANES": {"guiding_method": "NASG", "mixture_u": "PLANES"},
    "NASG-HASH4D": {"guiding_method": "NASG", "mixture_u": "HASH4D"},
    "NASG-STRATA": {"guiding_method": "NASG", "mixture_u": "PLANES", "strata": 8},
}


@dataclass(frozen=True)
class Budget:
    """When a render stops: after `samples` per pixel, or after `seconds` of tracing if that is not 0.

    With a `noise_threshold` above 0 pixels stop sooner, as Cycles' setting of the name says.
    """

    samples: int = 64
    seconds: float = 0.0
    noise_threshold: float = 0.0

    def __str__(self) -> str:
        limit = f"{self.seconds:g}s" if self.seconds else f"{self.samples}spp"
        return f"{limit}_noise{self.noise_threshold:g}" if self.noise_threshold else limit


@dataclass(frozen=True)
class Measurement:
    """What a renderer says of itself after a render.

    render_seconds : float
        Tracing, and denoising.
    compile_seconds : float
        Loading or compiling kernels.
    samples : float
        Mean samples per pixel rendered.
    first_image : float
        When the first picture was shown, by `time.monotonic`; nan if the renderer does not tell.
    """

    render_seconds: float
    compile_seconds: float = 0.0
    samples: float = 0.0
    rays: dict[str, int] | None = None
    details: dict[str, Any] | None = None
    first_image: float = math.nan


@dataclass(frozen=True)
class Rival:
    """A renderer by name.

    configure : callable (scene, budget, seed, threads)
    measure : callable (scene, exr header, budget, wall_seconds, largest sample seen) -> Measurement
    settings : what it is told beside what its name says and the scene's Cycles settings, as in `RenderSettings`
    """

    name: str
    is_ours: bool
    configure: Callable[[Any, Budget, int, int], None]
    measure: Callable[[Any, dict[str, Any], Budget, float, int], Measurement]
    settings: dict[str, Any] = field(default_factory=dict)


#: Custom property of a scene: whether it wants Fast GI by itself.
_OWN_FAST_GI = "benchmarks_own_fast_gi"


def is_denoised(name: str) -> bool:
    """Whether the rival called `name` denoises its picture."""
    return name.endswith(DENOISED)


def denoised_label(name: str) -> str:
    """What tables say of that."""
    return "yes" if is_denoised(name) else "no"


def _denoise(scene: Any) -> None:
    """Cycles' settings of denoising, which ours follows: its defaults, which give the best picture."""
    cycles = scene.cycles
    cycles.use_denoising, cycles.denoiser, cycles.denoising_use_gpu = True, "OPENIMAGEDENOISE", False
    cycles.denoising_input_passes, cycles.denoising_prefilter = "RGB_ALBEDO_NORMAL", "ACCURATE"
    cycles.denoising_quality = "HIGH"
    for layer in scene.view_layers:
        layer.cycles.use_denoising = True


def _wants_fast_gi(scene: Any) -> bool:
    """Whether the scene itself wants Fast GI, which an earlier rival may have changed."""
    if _OWN_FAST_GI not in scene:
        scene[_OWN_FAST_GI] = scene.cycles.use_fast_gi
    return bool(scene[_OWN_FAST_GI])


def _configure_common(scene: Any, budget: Budget, seed: int, threads: int) -> None:
    cycles = scene.cycles
    cycles.samples = UNLIMITED_SAMPLES if budget.seconds else budget.samples
    cycles.time_limit = budget.seconds
    cycles.seed, cycles.use_animated_seed = seed, False
    cycles.use_denoising = False
    cycles.use_fast_gi = _wants_fast_gi(scene)
    cycles.use_adaptive_sampling = budget.noise_threshold > 0.0
    cycles.adaptive_threshold, cycles.adaptive_min_samples = budget.noise_threshold, 0
    render = scene.render
    render.threads_mode = "FIXED"
    render.threads = threads
    render.use_persistent_data = False
    render.use_compositing = render.use_sequencer = False
    render.use_single_layer = True
    for layer in scene.view_layers:
        layer.samples = 0
        layer.cycles.pass_debug_sample_count = budget.noise_threshold > 0.0


#: Cycles' rivals, by name: whether it guides, and whether it ends paths in ambient occlusion.
CYCLES: dict[str, tuple[bool, bool]] = {
    "cycles": (False, False), "cycles-guided": (True, False), "cycles-fast-gi": (False, True),
}  # fmt: skip


def _configure_cycles(is_guided: bool, is_fast: bool) -> Callable[[Any, Budget, int, int], None]:
    def configure(scene: Any, budget: Budget, seed: int, threads: int) -> None:
        _configure_common(scene, budget, seed, threads)
        scene.render.engine = "CYCLES"
        scene.cycles.device = "CPU"
        scene.cycles.use_guiding = is_guided
        # As Blender has it: behind the first bounce the world's light stands for the rest.
        scene.cycles.use_fast_gi = is_fast or _wants_fast_gi(scene)

    return configure


def human_seconds(text: str) -> float:
    """Seconds of Cycles' [HH:]MM:SS.ss.

    Raises
    ------
    ValueError
        If it is none.
    """
    if not re.fullmatch(r"(\d+:){1,2}\d+\.\d+", text):
        raise ValueError(f"not a duration: {text!r}")
    seconds = 0.0
    for part in text.split(":"):
        seconds = 60.0 * seconds + float(part)
    return seconds


def _measure_cycles(
    scene: Any, header: dict[str, Any], budget: Budget, wall_seconds: float, samples_seen: int
) -> Measurement:
    """Cycles stamps its own clock into the file: render_time is tracing without synchronisation and BVH, to 10 ms."""

    def stamp(field: str) -> float:
        for key, value in header.items():
            if str(key).startswith("cycles.") and str(key).endswith(field):
                return human_seconds(str(value))
        raise ValueError(f"Cycles left no {field} in the file's metadata")

    # With a noise threshold the mean is in the pass: `render_once` puts it there.
    samples = float(samples_seen) if budget.seconds or budget.noise_threshold else float(budget.samples)
    details = {"synchronization_seconds": stamp(".synchronization_time")}
    return Measurement(max(stamp(".render_time"), 0.005), samples=samples, details=details)


def _configure_ours(settings: Mapping[str, Any]) -> Callable[[Any, Budget, int, int], None]:
    varied = {name for variant in VARIANTS.values() for name in variant}

    def configure(scene: Any, budget: Budget, seed: int, threads: int) -> None:
        import addon
        from addon.declared_settings import setting_owner
        from addon.shared_settings import SHARED_SETTINGS

        addon.register()
        _configure_common(scene, budget, seed, threads)
        scene.render.engine = "NEURALGUIDE"
        scene.neuralguide.use_cycles_settings = True
        # What a file has of ours gives way to Cycles'. And rivals take turns on one scene: a variant must not leave
        # its settings to the next.
        for name in {*SHARED_SETTINGS, "threads", *varied} - settings.keys():
            setting_owner(scene, name).property_unset(name)
        for layer in scene.view_layers:
            layer.neuralguide.use_pass_sample_count = budget.noise_threshold > 0.0
        # Each render for itself.
        scene.neuralguide.keep_learned, scene.neuralguide.field_path = False, ""
        for name, value in settings.items():
            setattr(setting_owner(scene, name), name, value)

    return configure


def _measure_ours(
    scene: Any, header: dict[str, Any], budget: Budget, wall_seconds: float, samples_seen: int
) -> Measurement:
    from addon.engine import outcomes

    outcome = outcomes[-1]
    if outcome.status != "FINISHED":
        raise RuntimeError(f"NEURALGUIDE {outcome.status.lower()}: {outcome.message}")
    report = outcome.report
    details = {
        "build_seconds": report.build_seconds,
        "ended_by": report.ended_by,
        "denoise_seconds": report.denoise_seconds,
        "stage_seconds": dict(report.stage_seconds),
        "reject_count": report.reject_count,
        "guiding": list(report.guiding.lines),
        "learning": {name: value for name, value in asdict(report.guiding).items() if name != "lines"},
        "notices": [f"{n.subject}: {n.problem}; {n.fallback}" for n in report.notices],
    }
    return Measurement(
        report.render_seconds + report.denoise_seconds,
        report.prepare_seconds,
        report.sample_count,
        dict(report.rays),
        details,
        outcome.first_image,
    )


def _denoised(rival: Rival) -> Rival:
    def configure(scene: Any, budget: Budget, seed: int, threads: int) -> None:
        rival.configure(scene, budget, seed, threads)
        _denoise(scene)

    return replace(rival, name=rival.name + DENOISED, configure=configure)


def find_rival(name: str, settings: Mapping[str, Any] | None = None) -> Rival:
    """The rival called `name`: one of Cycles', a guiding method of ours such as 'OFF', or a variant; with DENOISED
    behind it, denoised.

    Parameters
    ----------
    name : str
    settings : mapping, optional
        Settings of ours by their names in `engine.settings.RenderSettings`; they override the scene's Cycles settings.

    Raises
    ------
    ValueError
        Naming those there are; or saying which settings make no sense.
    """
    from engine.methods import METHODS
    from engine.settings import RenderSettings

    if is_denoised(name):
        return _denoised(find_rival(name.removesuffix(DENOISED), settings))
    settings = dict(settings or {})
    if name in CYCLES:
        if settings:
            raise ValueError(f"{name} has no {', '.join(settings)}: leave it out, or those")
        return Rival(name, False, _configure_cycles(*CYCLES[name]), _measure_cycles)
    if name not in METHODS and name not in VARIANTS:
        known = (*CYCLES, *METHODS, *VARIANTS)
        raise ValueError(f"no rival {name!r}; there are: {', '.join(known)}, and each with {DENOISED}")
    settings |= VARIANTS.get(name, {})
    # Scenes may have another default.
    chosen = {"guiding_method": name, "radiance_cache": "OFF", "caustics": "PATHS"} | settings
    unknown = chosen.keys() - RenderSettings.__dataclass_fields__.keys()
    if unknown:
        raise ValueError(f"no setting {', '.join(sorted(unknown))}")
    RenderSettings(**chosen)
    return Rival(name, True, _configure_ours(chosen), _measure_ours, settings)
