# SPDX-License-Identifier: GPL-3.0-or-later
"""`neuralguide` of scenes, materials and view layers: what a user may choose, under the names scripts depend on."""

from __future__ import annotations

import zlib
from typing import Any

import bpy
from bpy.props import BoolProperty, EnumProperty, FloatProperty, IntProperty, PointerProperty

from engine.settings import MAX_CANDIDATES, MAX_SAMPLES, MAX_STRATA, RenderSettings

from .shared_settings import SHARED_SETTINGS, setting_value, thread_count

#: Where Cycles has the same setting, its default: ours count where the Cycles add-on is off.
_DEFAULTS = RenderSettings(guiding_method="AUTO", samples=4096, clamp_indirect=10.0)
_INT32_MAX = 2**31 - 1

# The engine validates in `RenderSettings`; the ranges here only keep the sliders sensible.


#: Sources of directions besides the mixture field.
_OTHER_SOURCES = (
    ("SDTREE", "SD-Tree", "Learn a tree of space and directions"),
    ("SDTREE_VARIANCE", "SD-Tree, Variance-Aware", "Learn a tree for the least variance"),
    ("NPM", "Neural Mixtures", "Train a network for lobes of incident light"),
    ("NPM_PRODUCT", "Neural Mixtures, Product", "Train a network for light times the material"),
    ("NASG", "Neural Anisotropic Mixtures", "Train a larger network for stretched lobes"),
    ("FLOW", "Neural Flow", "Train a network for any shape; far too slow but for comparisons"),
)


class NeuralGuideSceneSettings(bpy.types.PropertyGroup):
    """Settings of a render, one to one with `engine.settings.RenderSettings` unless noted.

    Those that Cycles has too count only where they are set, or where the scene does not follow Cycles
    (`addon.shared_settings`).
    """

    # Not the engine's: `addon.shared_settings` looks at it.
    use_cycles_settings: BoolProperty(  # type: ignore[valid-type]
        name="Use Cycles' Settings",
        description="Samples, light paths, film and what else Cycles has too are those of the scene's Cycles settings."
        " Off: NeuralGuide has settings of its own, which Cycles does not see",
        default=True,
    )
    samples: IntProperty(  # type: ignore[valid-type]
        name="Samples",
        description="Paths traced for every pixel",
        min=0,
        max=MAX_SAMPLES,
        default=_DEFAULTS.samples,
    )
    time_limit: FloatProperty(  # type: ignore[valid-type]
        name="Time Limit",
        description="Stop after this many seconds, even if samples are left (0 = no limit)",
        min=0.0,
        default=_DEFAULTS.time_limit,
        step=100,
        unit="TIME_ABSOLUTE",
    )
    seed: IntProperty(  # type: ignore[valid-type]
        name="Seed",
        description="The same seed gives the same image, noise included",
        min=0,
        max=_INT32_MAX,
        default=_DEFAULTS.seed,
    )
    use_animated_seed: BoolProperty(  # type: ignore[valid-type]
        name="Animate Seed",
        description="Use another seed in every frame, so that noise does not stand still in an animation",
        default=False,
    )
    max_bounces: IntProperty(  # type: ignore[valid-type]
        name="Total", description="Most bounces of a path", min=0, max=1024, default=_DEFAULTS.max_bounces
    )
    diffuse_bounces: IntProperty(  # type: ignore[valid-type]
        name="Diffuse", description="Most diffuse bounces", min=0, max=1024, default=_DEFAULTS.diffuse_bounces
    )
    glossy_bounces: IntProperty(  # type: ignore[valid-type]
        name="Glossy", description="Most glossy bounces", min=0, max=1024, default=_DEFAULTS.glossy_bounces
    )
    transmission_bounces: IntProperty(  # type: ignore[valid-type]
        name="Transmission",
        description="Most bounces through refractive surfaces",
        min=0,
        max=1024,
        default=_DEFAULTS.transmission_bounces,
    )
    transparent_max_bounces: IntProperty(  # type: ignore[valid-type]
        name="Transparent",
        description="Most transparent surfaces a ray passes straight through",
        min=0,
        max=1024,
        default=_DEFAULTS.transparent_max_bounces,
    )
    min_light_bounces: IntProperty(  # type: ignore[valid-type]
        name="Min Light Bounces",
        description="Russian roulette leaves this many bounces alone",
        min=0,
        max=1024,
        default=_DEFAULTS.min_light_bounces,
    )
    min_transparent_bounces: IntProperty(  # type: ignore[valid-type]
        name="Min Transparent Bounces",
        description="Russian roulette leaves this many transparent surfaces alone",
        min=0,
        max=1024,
        default=_DEFAULTS.min_transparent_bounces,
    )
    guiding_method: EnumProperty(  # type: ignore[valid-type]
        name="Guiding",
        description="How directions are chosen where light is hard to find",
        items=(
            ("AUTO", "Automatic", "Learn what pays in the scene, and render by that"),
            ("OFF", "Off", "Sample materials and lights only"),
            ("VMM", "Mixtures", "Learn lobes of incident light, and draw from them or from the material"),
            *_OTHER_SOURCES,
            ("VMM_RIS", "Mixtures, Resampled", "Weigh several directions by the learned lobes times the material"),
            ("TABLE_RIS", "Tables, Resampled", "Weigh several directions by learned tables times the material"),
            ("NEURAL_RIS", "Neural, Resampled", "Weigh several directions by a neural network times the material"),
        ),
        default=_DEFAULTS.guiding_method,
    )
    guiding_probability: FloatProperty(  # type: ignore[valid-type]
        name="Guiding Probability",
        description="Share of directions that the learned lobes propose; the material proposes the others",
        min=0.0,
        max=0.95,
        default=_DEFAULTS.guiding_probability,
    )
    learn_guiding_probability: BoolProperty(  # type: ignore[valid-type]
        name="Learn Probability",
        description="Learn the share by region, none where the lobes do not pay; off: the same everywhere",
        default=_DEFAULTS.learn_guiding_probability,
    )
    guiding_trial: BoolProperty(  # type: ignore[valid-type]
        name="Trial",
        description="Render a few samples without guiding too, and go on without it where it does not pay",
        default=_DEFAULTS.guiding_trial,
    )
    candidate_allocation: EnumProperty(  # type: ignore[valid-type]
        name="Candidates",
        description="How many directions are weighed at each surface",
        items=(
            ("ORCA", "Optimized", "As many as pay for themselves there"),
            ("FIXED", "Fixed", "The same number everywhere"),
        ),
        default=_DEFAULTS.candidate_allocation,
    )
    candidate_count: IntProperty(  # type: ignore[valid-type]
        name="Candidate Count",
        description="Directions weighed at each surface; resampled mixtures always use it",
        min=1,
        max=MAX_CANDIDATES,
        default=_DEFAULTS.candidate_count,
    )
    defensive_alpha: FloatProperty(  # type: ignore[valid-type]
        name="Trust",
        description="Share of the choice that goes by what was learned; the rest keeps mistakes of it bounded",
        min=0.0,
        max=0.99,
        default=_DEFAULTS.defensive_alpha,
    )
    ris_target: EnumProperty(  # type: ignore[valid-type]
        name="Target",
        description="Whether directions are weighed by colour",
        items=(("COLOR", "Color", "By colour channel"), ("SCALAR", "Gray", "By mean values, for comparisons")),
        default=_DEFAULTS.ris_target,
    )
    orca_error: EnumProperty(  # type: ignore[valid-type]
        name="Error",
        description="Which error the number of candidates is chosen to reduce",
        items=(
            ("RELATIVE", "Relative", "Relative to the pixel's brightness"),
            ("ABSOLUTE", "Absolute", "The plain error, for comparisons"),
        ),
        default=_DEFAULTS.orca_error,
    )
    network_size: EnumProperty(  # type: ignore[valid-type]
        name="Network",
        description="Size of the radiance network",
        items=(
            ("COMPACT", "Compact", "What a processor can train while it renders"),
            ("PAPER", "Large", "The sizes of the paper, which want a GPU for training"),
        ),
        default=_DEFAULTS.network_size,
    )
    source_field: EnumProperty(  # type: ignore[valid-type]
        name="Source",
        description="What the directions are drawn from that are resampled",
        items=(
            ("VMM", "Mixtures", "Learn lobes of incident light"),
            *_OTHER_SOURCES,
        ),
        default=_DEFAULTS.source_field,
    )
    mixture_target: EnumProperty(  # type: ignore[valid-type]
        name="Target",
        description="What anisotropic neural mixtures are proportional to",
        items=(
            ("RADIANCE", "Light", "Incident light"),
            ("COSINE", "Light and Cosine", "Incident light times the cosine"),
            ("PRODUCT", "Product", "Incident light times the material"),
        ),
        default=_DEFAULTS.mixture_target,
    )
    mixture_lobes: EnumProperty(  # type: ignore[valid-type]
        name="Lobes",
        description="Lobes of neural mixtures",
        items=(
            ("OWN", "Own", "Those of the method"),
            ("VMF", "Round", "Von Mises-Fisher"),
            ("NASG", "Stretched", "Normalized anisotropic spherical Gaussians"),
            ("SG", "Round, More", "Fourteen spherical Gaussians"),
        ),
        default=_DEFAULTS.mixture_lobes,
    )
    mixture_preset: EnumProperty(  # type: ignore[valid-type]
        name="Preset",
        description="Sizes and training of neural mixtures",
        items=(
            ("PAPER", "Paper", "As published"),
            ("OFFICIAL", "Program", "As in the authors' program"),
            ("COMPACT", "Compact", "Without grids, for renders of few samples"),
        ),
        default=_DEFAULTS.mixture_preset,
    )
    u_dimension: EnumProperty(  # type: ignore[valid-type]
        name="Fourth Dimension",
        description="What networks may know of a path besides where it is",
        items=(
            ("NONE", "None", "The place alone"),
            ("AUTO", "Automatic", "The time where something moves, else the wavelength where a material disperses"),
            ("TIME", "Time", "The time, where something moves while the shutter is open"),
            ("WAVELENGTH", "Wavelength", "The wavelength, where a material disperses"),
        ),
        default=_DEFAULTS.u_dimension,
    )
    network_u: EnumProperty(  # type: ignore[valid-type]
        name="Network's Encoding",
        description="How the network that weighs candidates sees the fourth dimension",
        items=(
            ("AUTO", "Automatic", "The wavelength by frequencies, the time not at all: what has been found to pay"),
            ("NONE", "None", "Not at all: one radiance for all times and wavelengths"),
            ("FREQUENCY", "Frequencies", "By sines and cosines"),
            ("PLANES", "Planes", "By learned planes over each coordinate and the fourth"),
        ),
        default=_DEFAULTS.network_u,
    )
    mixture_u: EnumProperty(  # type: ignore[valid-type]
        name="Mixture's Encoding",
        description="How a neural mixture sees the fourth dimension",
        items=(
            ("NONE", "None", "Not at all: one mixture for all times and wavelengths"),
            ("FREQUENCY", "Frequencies", "By sines and cosines: cheap, and enough where little changes"),
            ("PLANES", "Planes", "By learned planes over each coordinate and the fourth"),
            ("HASH4D", "4D Grids", "By learned grids over all four, hashed"),
        ),
        default=_DEFAULTS.mixture_u,
    )
    strata: IntProperty(  # type: ignore[valid-type]
        name="Strata",
        description="Render the shutter, or the wavelengths, in so many parts, one after the other, and let a neural"
        " mixture learn each from the last. For long renders where the light changes fast; 0 or 1 turn it off, others"
        " become a power of two",
        min=0,
        max=MAX_STRATA,
        default=_DEFAULTS.strata,
    )
    # Not the engine's: `addon.sequence` trains for a whole animation.
    sequence_field: BoolProperty(  # type: ignore[valid-type]
        name="Sequence Field",
        description="Train a neural mixture once for all frames from the scene's first to its last one, when the first"
        " of them is rendered, instead of anew in every frame. It tells the frames apart by the Mixture's Encoding",
        default=False,
    )
    sequence_samples: IntProperty(  # type: ignore[valid-type]
        name="Sequence Samples",
        description="Paths traced for every pixel (of large pictures: of a smaller copy) to train the field, of all"
        " frames together: up to 32 spread over the sequence. They are no part of any picture",
        min=1,
        max=MAX_SAMPLES,
        soft_max=4096,
        default=256,
    )
    network_selection: BoolProperty(  # type: ignore[valid-type]
        name="Network's Share",
        description="Let a neural mixture learn how often to guide, instead of a share by region",
        default=_DEFAULTS.network_selection,
    )
    mis_compensation: BoolProperty(  # type: ignore[valid-type]
        name="MIS Compensation",
        description="Learn what sampling the material leaves over",
        default=_DEFAULTS.mis_compensation,
    )
    sample_weighting: EnumProperty(  # type: ignore[valid-type]
        name="Sample Weighting",
        description="How samples from before much was learned count",
        items=(
            ("ITERATION", "Later More", "Early samples count less"),
            ("UNIFORM", "Equal", "All samples count the same"),
        ),
        default=_DEFAULTS.sample_weighting,
    )
    radiance_cache: BoolProperty(  # type: ignore[valid-type]
        name="Radiance Cache",
        description=(
            "Biased: end paths at the first rough surface with the light that was learned, less noise but blotches. "
            "With TABLE_RIS and NEURAL_RIS"
        ),
        default=_DEFAULTS.radiance_cache,
    )
    training_share: FloatProperty(  # type: ignore[valid-type]
        name="Training Share",
        description="Share of the processors' time that training the network may take",
        min=0.01,
        max=1.0,
        default=_DEFAULTS.training_share,
    )
    deterministic: BoolProperty(  # type: ignore[valid-type]
        name="Deterministic",
        description="The same image every time: rendering waits for the training of the network",
        default=_DEFAULTS.deterministic,
    )
    spectral: EnumProperty(  # type: ignore[valid-type]
        name="Spectral",
        description="Whether light has wavelengths, or red, green and blue",
        items=(
            ("AUTO", "Automatic", "Where a material disperses light"),
            ("ON", "On", "In every scene"),
            ("OFF", "Off", "Never: what disperses light does not"),
        ),
        default=_DEFAULTS.spectral,
    )
    use_nee: BoolProperty(  # type: ignore[valid-type]
        name="Sample Lights",
        description="Next-event estimation: send a ray to a light from every hit. Off only for experiments",
        default=_DEFAULTS.use_nee,
    )
    use_russian_roulette: BoolProperty(  # type: ignore[valid-type]
        name="Russian Roulette",
        description="End dim paths early, at random. Off only for experiments",
        default=_DEFAULTS.use_russian_roulette,
    )
    light_sampling_threshold: FloatProperty(  # type: ignore[valid-type]
        name="Light Threshold",
        description="Skip, at random, light samples dimmer than this (0 = skip none)",
        min=0.0,
        max=1.0,
        precision=4,
        default=_DEFAULTS.light_sampling_threshold,
    )
    use_caustics_reflective: BoolProperty(  # type: ignore[valid-type]
        name="Reflective Caustics",
        description="Follow light from diffuse surfaces over glossy reflections",
        default=_DEFAULTS.use_caustics_reflective,
    )
    use_caustics_refractive: BoolProperty(  # type: ignore[valid-type]
        name="Refractive Caustics",
        description="Follow light from diffuse surfaces through refractions",
        default=_DEFAULTS.use_caustics_refractive,
    )
    filter_glossy: FloatProperty(  # type: ignore[valid-type]
        name="Filter Glossy",
        description="Blur glossy surfaces seen by blurry bounces, to lower noise (0 = off)",
        min=0.0,
        max=10.0,
        default=_DEFAULTS.filter_glossy,
    )
    clamp_direct: FloatProperty(  # type: ignore[valid-type]
        name="Clamp Direct",
        description="Most light a sample may carry straight from a light (0 = off). Loses energy",
        min=0.0,
        default=_DEFAULTS.clamp_direct,
    )
    clamp_indirect: FloatProperty(  # type: ignore[valid-type]
        name="Clamp Indirect",
        description="Most light a sample may carry after a bounce (0 = off). Loses energy",
        min=0.0,
        default=_DEFAULTS.clamp_indirect,
    )
    pixel_filter: EnumProperty(  # type: ignore[valid-type]
        name="Pixel Filter",
        items=(
            ("BOX", "Box", "One pixel, no overlap"),
            ("GAUSSIAN", "Gaussian", "Soft"),
            ("BLACKMAN_HARRIS", "Blackman-Harris", "Sharp without ringing"),
        ),
        default=_DEFAULTS.pixel_filter,
    )
    filter_width: FloatProperty(  # type: ignore[valid-type]
        name="Width",
        description="Width of the pixel filter",
        min=0.01,
        max=10.0,
        default=_DEFAULTS.filter_width,
        subtype="PIXEL",
    )
    film_transparent: BoolProperty(  # type: ignore[valid-type]
        name="Transparent",
        description="Leave the background out of the picture; alpha says where it was",
        default=_DEFAULTS.film_transparent,
    )
    film_exposure: FloatProperty(  # type: ignore[valid-type]
        name="Exposure",
        description="Brightness of the film: multiplies every colour pass",
        min=0.0,
        soft_max=10.0,
        default=1.0,
    )
    threads: IntProperty(  # type: ignore[valid-type]
        name="Threads",
        description="Threads to render with (0 = Blender's own number)",
        min=0,
        max=1024,
        default=_DEFAULTS.threads,
    )


def _material_changed(settings: bpy.types.PropertyGroup, _context: bpy.types.Context) -> None:
    """Have Blender copy the material for the render anew, which it does not by itself for properties of add-ons."""
    settings.id_data.update_tag()


class NeuralGuideMaterialSettings(bpy.types.PropertyGroup):
    """What Blender's materials do not say; `addon.dispersion` tells what the engine makes of it."""

    dispersion: EnumProperty(  # type: ignore[valid-type]
        name="Dispersion",
        description="How refraction depends on the wavelength. The nodes' IOR is that of yellow light, 587.6 nm",
        items=(
            ("NONE", "None", "All wavelengths are refracted alike"),
            ("ABBE", "Abbe Number", "As makers of glass state it"),
            ("CAUCHY", "Cauchy", "By coefficients of A + B / wavelength²"),
        ),
        default="NONE",
        update=_material_changed,
    )
    abbe_number: FloatProperty(  # type: ignore[valid-type]
        name="Abbe Number",
        description="Low is strong: flint glass 30, diamond 55, water 56, crown glass 64",
        min=1.0,
        soft_min=10.0,
        soft_max=100.0,
        default=59.0,
        update=_material_changed,
    )
    cauchy_a: FloatProperty(  # type: ignore[valid-type]
        name="A",
        description="Index for very long wavelengths. With B it gives the strength; the IOR remains the nodes'",
        min=1.0,
        soft_max=3.0,
        precision=4,
        default=1.5046,
        update=_material_changed,
    )
    cauchy_b: FloatProperty(  # type: ignore[valid-type]
        name="B",
        description="Square micrometres",
        min=0.0,
        soft_max=0.05,
        precision=5,
        default=0.0042,
        update=_material_changed,
    )


class NeuralGuideViewLayerSettings(bpy.types.PropertyGroup):
    """Passes of a view layer that Blender itself has no switch for."""

    use_pass_albedo: BoolProperty(  # type: ignore[valid-type]
        name="Albedo", description="Share of light the first surface reflects or transmits, by channel"
    )
    use_pass_sample_count: BoolProperty(  # type: ignore[valid-type]
        name="Sample Count", description="Paths that were traced for each pixel"
    )
    use_pass_variance: BoolProperty(  # type: ignore[valid-type]
        name="Variance", description="Variance of the pixel's mean, by channel: how noisy it still is"
    )
    use_pass_candidate_count: BoolProperty(  # type: ignore[valid-type]
        name="Candidate Count", description="Directions that guiding weighed at the first surface (0 = not guided)"
    )
    use_pass_guiding_benefit: BoolProperty(  # type: ignore[valid-type]
        name="Guiding Benefit",
        description="How much noisier light at the first surface would be without guiding, estimated (1 = not guided)",
    )


def render_settings(scene: bpy.types.Scene) -> RenderSettings:
    """What the engine is told for the scene's current frame.

    Raises
    ------
    ValueError
        Naming the setting that makes no sense and what to choose instead.
    """
    ours = scene.neuralguide
    values: dict[str, Any] = {
        name: setting_value(scene, name) if name in SHARED_SETTINGS else getattr(ours, name)
        for name in RenderSettings.__dataclass_fields__
    }
    if setting_value(scene, "use_animated_seed"):
        values["seed"] = zlib.crc32(f"{scene.frame_current} {values['seed']}".encode()) & _INT32_MAX
    values["threads"] = thread_count(scene)
    return RenderSettings(**values)


_classes = (NeuralGuideSceneSettings, NeuralGuideMaterialSettings, NeuralGuideViewLayerSettings)


def register() -> None:
    """Add the settings to scenes, materials and view layers."""
    for cls in _classes:
        bpy.utils.register_class(cls)
    bpy.types.Scene.neuralguide = PointerProperty(type=NeuralGuideSceneSettings)
    bpy.types.Material.neuralguide = PointerProperty(type=NeuralGuideMaterialSettings)
    bpy.types.ViewLayer.neuralguide = PointerProperty(type=NeuralGuideViewLayerSettings)


def unregister() -> None:
    """Take them away; what a file holds stays in it."""
    del bpy.types.ViewLayer.neuralguide
    del bpy.types.Material.neuralguide
    del bpy.types.Scene.neuralguide
    for cls in reversed(_classes):
        bpy.utils.unregister_class(cls)
