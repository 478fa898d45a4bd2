# SPDX-License-Identifier: GPL-3.0-or-later
"""What a user may choose: each setting is declared once, as a field of `RenderSettings`.

Default, limits, choices and sentence are said there and nowhere else. The check of values, Blender's properties and
panels, the command line and docs/settings.md come from the declarations (`SETTINGS`).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, fields, replace
from typing import Any, NamedTuple, TypeVar

from engine.accuracy import ACCURACIES, MEASURED
from engine.methods import METHODS, SOURCES, TRAINED_PREDICTORS, TRAINING_DEVICES, Method, rungs_of
from engine.setting_choices import CAUSTICS, DENOISING_PASSES, DENOISING_QUALITIES, PREFILTERS, SPECTRAL

#: Sections of settings for experiments.
EXPERIMENT_SECTIONS = ("Learning", "Candidates", "Neural Mixtures", "Time and Wavelengths", "Paths")
#: Most parts of u that a render goes through one by one.
MAX_STRATA = 64
#: Most candidates of a vertex.
MAX_CANDIDATES = 32
#: Samples a pixel from which on AUTO guides: of fewer, too many are spent on learning
#: (docs/decisions/trial-and-choice.md).
LEAST_GUIDED_SAMPLES = 16
#: More samples than this overflow the sampler's index.
MAX_SAMPLES = 1 << 24
#: Largest seed: Blender's integers have 32 bits with a sign.
MAX_SEED = 2**31 - 1
#: Blender holds floats as float32, so that a limit comes back changed by up to this share.
_FLOAT32_ROUNDING = 1e-7
_FLOAT32_MAX = float.fromhex("0x1.fffffep+127")

_T = TypeVar("_T", bool, int, float, str)


class Choice(NamedTuple):
    """A value of a setting that has names for values; files hold its place among the choices, so new ones go last."""

    name: str
    label: str
    sentence: str



def _choices(facts: Iterable[tuple[str, str, str]]) -> tuple[Choice, ...]:
    return tuple(Choice(*one) for one in facts)


@dataclass(frozen=True)
class Setting:
    """What there is to know of a setting.

    Attributes
    ----------
    name : str
        In `RenderSettings`, and in `scene.neuralguide` or `scene.neuralguide.experiment`.
    default : bool, int, float or str
        Default of a program, and of a scene unless `scene_default` says otherwise. Its type is the setting's.
    label : str
        As panels show it.
    sentence : str
        For users, without a full stop at its end, as Blender wants descriptions.
    section : str
        Panel and heading under which it is found; those of `EXPERIMENT_SECTIONS` hold what is for experiments.
    scene_default : bool, int, float or str, optional
        Default of a scene in Blender. Where Cycles has the setting it is Cycles' default.
    minimum, maximum : float, optional
        Limits, themselves allowed.
    scene_minimum : float, optional
        Where a scene may hold less than `minimum`, so that a render names the value instead of changing it.
    choices : tuple of Choice
        All values, of a str.
    unit : str
        's' or 'pixels', '' without.
    """

    name: str
    default: Any
    label: str
    sentence: str
    section: str
    scene_default: Any = None
    minimum: float | None = None
    maximum: float | None = None
    scene_minimum: float | None = None
    choices: tuple[Choice, ...] = ()
    unit: str = ""

    def check(self, value: Any) -> None:
        """Raise where `value` is none that the setting may have.

        Raises
        ------
        ValueError
            Naming the setting and what to choose.
        """
        if self.choices:
            if value not in _names(self.choices):
                raise ValueError(f"{self.name} {value!r}: choose one of {', '.join(_names(self.choices))}")
            return
        low = None if self.minimum is None else self.minimum - _FLOAT32_ROUNDING * abs(self.minimum)
        high = None if self.maximum is None else self.maximum + _FLOAT32_ROUNDING * abs(self.maximum)
        # So written that NaN fails.
        if not ((low is None or value >= low) and (high is None or value <= high)):
            raise ValueError(f"{self.name} is {value}: choose {self.limits}")
        # Blender makes infinity the largest float32.
        if isinstance(value, float) and not abs(value) < _FLOAT32_MAX:
            raise ValueError(f"{self.name} is {value}: choose a finite number, {self.limits}")

    @property
    def is_experiment(self) -> bool:
        """Whether it is for experiments rather than for users."""
        return self.section in EXPERIMENT_SECTIONS

    @property
    def limits(self) -> str:
        """The limits in words, '' where there are none."""
        if self.minimum is None:
            return ""
        return f"{self.minimum} or more" if self.maximum is None else f"{self.minimum} to {self.maximum}"


def _names(choices: tuple[Choice, ...]) -> tuple[str, ...]:
    return tuple(choice.name for choice in choices)


def _declare(default: _T, label: str, sentence: str, section: str, **facts: Any) -> _T:
    """A field of `RenderSettings`, with what `Setting` knows of it."""
    return field(default=default, metadata={"label": label, "sentence": sentence, "section": section} | facts)


_SOURCE_CHOICES = tuple(Choice(source.name, source.label, source.sentence) for source in SOURCES.values())
_METHOD_CHOICES = tuple(Choice(method.name, method.label, method.sentence) for method in METHODS.values())

_U_ENCODING_CHOICES = (
    Choice("NONE", "None", "Not at all: one mixture for all times and wavelengths"),
    Choice("FREQUENCY", "Frequencies", "By sines and cosines: cheap, and enough where little changes"),
    Choice("PLANES", "Planes", "By learned planes over each coordinate and the fourth"),
    Choice("HASH4D", "4D Grids", "By learned grids over all four, hashed"),
)
#: How a neural mixture sees u.
U_ENCODINGS = _names(_U_ENCODING_CHOICES)

_NETWORK_U_CHOICES = (
    # What has been found to pay: docs/decisions/time-and-wavelengths.md.
    Choice("AUTO", "Automatic", "The wavelength by frequencies, the time not at all: what has been found to pay"),
    Choice("NONE", "None", "Not at all: one radiance for all times and wavelengths"),
    Choice("FREQUENCY", "Frequencies", "By sines and cosines"),
    Choice("PLANES", "Planes", "By learned planes over each coordinate and the fourth"),
)
#: The same of the network that weighs candidates.
NETWORK_U_ENCODINGS = _names(_NETWORK_U_CHOICES)

_WEIGHTING_CHOICES = (
    Choice("ITERATION", "Later More", "Early samples count less"),
    Choice("UNIFORM", "Equal", "All samples count the same"),
)
SAMPLE_WEIGHTINGS = _names(_WEIGHTING_CHOICES)

#: Cycles' limits of bounces.
_BOUNCES = {"minimum": 0, "maximum": 1024}


@dataclass(frozen=True)
class RenderSettings:
    """Settings of one render; validated on construction.

    Raises
    ------
    ValueError
        Naming the setting and what to do.
    """

    samples: int = _declare(
        128, "Samples",
        "Paths traced for every pixel. A view layer's own number counts first, as Cycles' Layer Samples says",
        "Sampling", scene_default=4096, minimum=1, maximum=MAX_SAMPLES, scene_minimum=0,
    )
    use_adaptive_sampling: bool = _declare(
        False, "Noise Threshold", "Stop sampling pixels whose noise is below a threshold, before they have all samples",
        "Sampling", scene_default=True,
    )
    adaptive_threshold: float = _declare(
        0.01, "Threshold",
        "Noise that a pixel may be left with: lower is cleaner and takes longer (0 = by the number of samples)",
        "Sampling", minimum=0, maximum=1,
    )
    adaptive_min_samples: int = _declare(
        0, "Min Samples", "Samples that every pixel gets, however little noise it seems to have (0 = by the threshold)",
        "Sampling", minimum=0, maximum=4096,
    )
    time_limit: float = _declare(
        0.0, "Time Limit", "Stop after this many seconds, even if samples are left (0 = no limit)", "Sampling",
        minimum=0, unit="s",
    )
    guiding_method: str = _declare(
        "OFF", "Guiding", "How directions are chosen where light is hard to find", "Guiding", scene_default="AUTO",
        choices=_METHOD_CHOICES,
    )
    radiance_cache: str = _declare(
        "OFF", "Accuracy",
        "Whether paths end early with the light that was learned. Rooms have several times less noise in the same time",
        "Guiding", scene_default="AUTO", choices=_choices(ACCURACIES),
    )
    caustics: str = _declare(
        "PATHS", "Caustics", "How light is found that lamps send through glass and over mirrors onto other surfaces",
        "Sampling", scene_default="AUTO", choices=_choices(CAUSTICS),
    )
    spectral: str = _declare(
        "AUTO", "Spectral", "Whether light has wavelengths, or red, green and blue", "Sampling",
        choices=_choices(SPECTRAL),
    )
    use_denoising: bool = _declare(
        False, "Denoise",
        "Take the noise out of the finished picture. The picture as it was sampled is the pass Noisy Image",
        "Denoising", scene_default=True,
    )
    denoising_input_passes: str = _declare(
        "RGB_ALBEDO_NORMAL", "Passes", "What the denoiser tells detail from noise by, besides the picture",
        "Denoising", choices=_choices(DENOISING_PASSES),
    )
    denoising_prefilter: str = _declare(
        "ACCURATE", "Prefilter", "What is done with albedo and normal, which have noise too", "Denoising",
        choices=_choices(PREFILTERS),
    )
    denoising_quality: str = _declare(
        "HIGH", "Quality", "How much time the denoiser takes", "Denoising",
        choices=_choices(DENOISING_QUALITIES),
    )
    denoised_threshold: float = _declare(
        0.0, "Denoised Noise",
        "Stop once the denoised picture errs by less than this, as estimated: root mean square over the picture, where "
        "1 is from black to white on the screen. 0.01 is good, 0.005 hard to tell from clean (0 = off)",
        "Denoising", minimum=0, maximum=1,
    )
    guiding_trial: bool = _declare(
        True, "Trial", "Compare a few unguided samples with guided ones, and stop guiding where it does not pay",
        "Trial and Training",
    )
    training_share: float = _declare(
        0.25, "Training Share", "Share of the processors' time that training a network may take",
        "Trial and Training", minimum=0.01, maximum=1,
    )
    training_device: str = _declare(
        "AUTO", "Training Device", "What trains networks; a deterministic render always takes the processor",
        "Trial and Training", choices=tuple(Choice(*facts) for facts in TRAINING_DEVICES),
    )
    deterministic: bool = _declare(
        False, "Deterministic",
        "The same image every time: rendering waits for the training of networks and does not read the clock",
        "Trial and Training",
    )
    light_sampling_threshold: float = _declare(
        0.01, "Light Threshold", "Skip, at random, light samples dimmer than this (0 = skip none)", "Lights", minimum=0,
        maximum=1,
    )
    light_selection: str = _declare(
        "AUTO", "Choose By", "Which of many lights a surface samples", "Lights",
        choices=(
            Choice("AUTO", "Automatic", "Learned visibility where guiding is on, else the light tree"),
            Choice("TREE", "Light Tree", "Where lights are, how bright and how they face. Nothing is learned"),
            Choice(
                "LEARNED", "Learned Visibility",
                "Which lights have reached a place so far, else the light tree. With any guiding, off too",
            ),
        ),
    )
    seed: int = _declare(
        0, "Seed", "The same seed gives the same image, noise included", "Advanced", minimum=0, maximum=MAX_SEED,
    )
    min_light_bounces: int = _declare(
        0, "Min Light Bounces", "Russian roulette leaves this many bounces alone", "Advanced", **_BOUNCES,
    )
    min_transparent_bounces: int = _declare(
        0, "Min Transparent Bounces", "Russian roulette leaves this many transparent surfaces alone", "Advanced",
        **_BOUNCES,
    )
    max_bounces: int = _declare(12, "Total", "Most bounces of a path", "Light Paths", **_BOUNCES)
    diffuse_bounces: int = _declare(4, "Diffuse", "Most diffuse bounces", "Light Paths", **_BOUNCES)
    glossy_bounces: int = _declare(4, "Glossy", "Most glossy bounces", "Light Paths", **_BOUNCES)
    transmission_bounces: int = _declare(
        12, "Transmission", "Most bounces through refractive surfaces", "Light Paths", **_BOUNCES,
    )
    volume_bounces: int = _declare(
        0, "Volume", "Most times that light is scattered within volumes after the first", "Light Paths", **_BOUNCES,
    )
    transparent_max_bounces: int = _declare(
        8, "Transparent", "Most transparent surfaces a ray passes straight through", "Light Paths", **_BOUNCES,
    )
    clamp_direct: float = _declare(
        0.0, "Clamp Direct", "Most light a sample may carry straight from a light (0 = off). Loses energy",
        "Light Paths", minimum=0,
    )
    clamp_indirect: float = _declare(
        0.0, "Clamp Indirect", "Most light a sample may carry after a bounce (0 = off). Loses energy", "Light Paths",
        scene_default=10.0, minimum=0,
    )
    filter_glossy: float = _declare(
        1.0, "Filter Glossy", "Blur glossy surfaces seen by blurry bounces, to lower noise (0 = off)", "Light Paths",
        minimum=0, maximum=10,
    )
    use_caustics_reflective: bool = _declare(
        True, "Reflective Caustics", "Follow light from diffuse surfaces over glossy reflections", "Light Paths",
    )
    use_caustics_refractive: bool = _declare(
        True, "Refractive Caustics", "Follow light from diffuse surfaces through refractions", "Light Paths",
    )
    film_transparent: bool = _declare(
        False, "Transparent", "Leave the background out of the picture; alpha says where it was", "Film",
    )
    pixel_filter: str = _declare(
        "BLACKMAN_HARRIS", "Pixel Filter",
        "How far the samples of a pixel spread over its neighbours, and with which weights", "Film",
        choices=(
            Choice("BOX", "Box", "One pixel, no overlap"),
            Choice("GAUSSIAN", "Gaussian", "Soft"),
            Choice("BLACKMAN_HARRIS", "Blackman-Harris", "Sharp without ringing"),
        ),
    )
    filter_width: float = _declare(
        1.5, "Width", "Width of the pixel filter, unless that is a box", "Film", minimum=0.01, maximum=10,
        unit="pixels",
    )
    threads: int = _declare(
        0, "Threads", "Threads to render with (0 = Blender's own number)", "Performance", minimum=0, maximum=1024,
    )
    texture_memory: int = _declare(
        0, "Texture Memory",
        "Memory for textures (0 = half of the machine's). Where they need more, they lie in a temporary file, and what "
        "is looked up is read from there", "Performance", minimum=0, maximum=1 << 20, unit="MiB",
    )
    guiding_probability: float = _declare(
        0.5, "Guiding Probability",
        "Share of directions that what was learned proposes, at first; the material proposes the others", "Learning",
        minimum=0, maximum=0.95,  # below one, so that the BSDF covers what the guide has not seen
    )
    learn_guiding_probability: bool = _declare(
        True, "Learn Probability",
        "Learn the share by region, none where guiding does not pay; off: the same everywhere", "Learning",
    )
    mis_compensation: bool = _declare(
        False, "MIS Compensation", "Learn what sampling the material leaves over", "Learning",
    )
    sample_weighting: str = _declare(
        "ITERATION", "Sample Weighting", "How samples from before much was learned count", "Learning",
        choices=_WEIGHTING_CHOICES,
    )
    training_steps: int = _declare(
        64, "Training Steps", "Steps that a network is trained between two iterations of a deterministic render",
        "Learning", minimum=1, maximum=1 << 20,
    )
    source_field: str = _declare(
        "VMM", "Source", "What the directions are drawn from that are resampled", "Candidates", choices=_SOURCE_CHOICES,
    )
    candidate_allocation: str = _declare(
        "ORCA", "Candidates", "How many directions are weighed at each surface", "Candidates",
        choices=(
            Choice("ORCA", "Optimized", "As many as pay for themselves there"),
            Choice("FIXED", "Fixed", "The same number everywhere"),
        ),
    )
    candidate_count: int = _declare(
        8, "Candidate Count",
        "Directions weighed at each surface where their number is fixed, and always by resampled mixtures",
        "Candidates", minimum=1, maximum=MAX_CANDIDATES,
    )
    defensive_alpha: float = _declare(
        0.5, "Trust", "Share of the choice that goes by what was learned; the rest keeps mistakes of it bounded",
        "Candidates", minimum=0, maximum=0.99,
    )
    ris_target: str = _declare(
        "COLOR", "Target", "Whether directions are weighed by colour", "Candidates",
        choices=(
            Choice("COLOR", "Color", "By colour channel"),
            Choice("SCALAR", "Gray", "By mean values, for comparisons"),
        ),
    )
    network_size: str = _declare(
        "COMPACT", "Network", "Size of the radiance network, which weighs directions", "Candidates",
        choices=(
            Choice("COMPACT", "Compact", "What a processor can train while it renders"),
            Choice("PAPER", "Large", "The sizes of the paper, which take three times as long to train"),
        ),
    )
    network_backend: str = _declare(
        "KERNEL", "Asked By", "What computes the radiance network while rendering", "Candidates",
        choices=(
            Choice("KERNEL", "Kernel", "The renderer's own code, within its main loop"),
            Choice("ONNXRUNTIME", "onnxruntime", "onnxruntime, on a GPU where it has one to use"),
            Choice("AUTO", "Automatic", "Whichever is faster on this machine, as measured once"),
        ),
    )
    mixture_preset: str = _declare(
        "COMPACT", "Preset", "Sizes and training of neural mixtures", "Neural Mixtures",
        choices=(
            Choice("PAPER", "Paper", "As published"),
            Choice("OFFICIAL", "Program", "As in the authors' program"),
            Choice("COMPACT", "Compact", "Without grids, for renders of few samples"),
            Choice("SMALL", "Small", "Compact, with fewer and narrower layers, for short renders"),
        ),
    )
    mixture_target: str = _declare(
        "PRODUCT", "Target", "What anisotropic neural mixtures are proportional to", "Neural Mixtures",
        choices=(
            Choice("RADIANCE", "Light", "Incident light"),
            Choice("COSINE", "Light and Cosine", "Incident light times the cosine"),
            Choice("PRODUCT", "Product", "Incident light times the material"),
        ),
    )
    mixture_lobes: str = _declare(
        "OWN", "Lobes", "Lobes of neural mixtures", "Neural Mixtures",
        choices=(
            Choice("OWN", "Own", "Those of the method"),
            Choice("VMF", "Round", "Von Mises-Fisher"),
            Choice("NASG", "Stretched", "Normalized anisotropic spherical Gaussians"),
            Choice("SG", "Round, More", "Fourteen spherical Gaussians"),
        ),
    )
    network_selection: bool = _declare(
        False, "Network's Share", "Let a neural mixture learn how often to guide, instead of a share by region",
        "Neural Mixtures",
    )
    u_dimension: str = _declare(
        "AUTO", "Fourth Dimension",
        "What networks may know of a path besides where it is; none where the scene has nothing of the kind",
        "Time and Wavelengths",
        choices=(
            Choice("NONE", "None", "The place alone"),
            Choice(
                "AUTO", "Automatic",
                "The time where something but the camera moves, else the wavelength where a material disperses",
            ),
            Choice("TIME", "Time", "The time, where something moves while the shutter is open"),
            Choice("WAVELENGTH", "Wavelength", "The wavelength, where a material disperses"),
        ),
    )
    mixture_u: str = _declare(
        "NONE", "Mixture's Encoding", "How a neural mixture sees the fourth dimension", "Time and Wavelengths",
        choices=_U_ENCODING_CHOICES,
    )
    network_u: str = _declare(
        "AUTO", "Network's Encoding", "How the network that weighs candidates sees the fourth dimension",
        "Time and Wavelengths", choices=_NETWORK_U_CHOICES,
    )
    strata: int = _declare(
        0, "Strata",
        "Render the shutter, or the wavelengths, in so many parts, one after the other, and let a neural mixture learn "
        "each from the last. For long renders where the light changes fast; 0 or 1 turn it off, others become a power "
        "of two",
        "Time and Wavelengths", minimum=0, maximum=MAX_STRATA,
    )
    use_nee: bool = _declare(
        True, "Sample Lights", "Next-event estimation: send a ray to a light from every hit. Off only for experiments",
        "Paths",
    )
    use_russian_roulette: bool = _declare(
        True, "Russian Roulette", "End dim paths early, at random. Off only for experiments", "Paths",
    )
    roulette: str = _declare(
        "AUTO", "Roulette By", "What decides which paths end early", "Paths",
        choices=(
            Choice("AUTO", "Automatic", "Learned light with automatic guiding, unless it loses; else throughput"),
            Choice("THROUGHPUT", "Throughput", "What the surfaces that a path has met have left of its light"),
            Choice("LEARNED", "Learned Light", "What a path is expected to bring to its pixel, by what others found"),
        ),
    )

    def __post_init__(self) -> None:
        for setting in SETTINGS.values():
            setting.check(getattr(self, setting.name))

    @property
    def method(self) -> Method:
        """The record of the guiding method."""
        return METHODS[self.guiding_method]

    @property
    def is_guided(self) -> bool:
        """Whether anything is to be learned: AUTO leaves renders alone that end before guiding can pay."""
        return self.guiding_method != "OFF" and (self.guiding_method != "AUTO" or self.samples >= LEAST_GUIDED_SAMPLES)

    @property
    def measures_cache(self) -> bool:
        """Whether paths end in the radiance cache, and some measure what that lacks."""
        return self.radiance_cache in MEASURED

    @property
    def learns_roulette(self) -> bool:
        """Whether roulette may go by what is learned of surfaces; with a radiance cache once that is given up."""
        is_automatic = self.roulette == "AUTO" and self.guiding_method == "AUTO" and self.is_guided
        may_lose_cache = self.is_guided and self.measures_cache
        is_wanted = self.roulette == "LEARNED" or is_automatic
        return is_wanted and self.use_russian_roulette and (self.radiance_cache == "OFF" or may_lose_cache)

    @property
    def learns_lights(self) -> bool:
        """Whether regions learn which lights to sample. Without guiding a radiance cache learns alone."""
        is_wanted = self.is_guided if self.light_selection == "AUTO" else self.light_selection == "LEARNED"
        return is_wanted and self.use_nee and (self.is_guided or self.radiance_cache == "OFF")

    @property
    def traces_photons(self) -> bool:
        """Whether photons find caustics, in scenes that may have some (`engine.render.resolution`)."""
        return self.caustics != "PATHS"

    @property
    def channel_count(self) -> int:
        """Width of a path's spectrum: wavelengths, or RGB. AUTO is RGB: `Session` decides it before."""
        return 4 if self.spectral == "ON" else 3

    def with_u(self, dimension: str) -> RenderSettings:
        """The same for a scene of which networks may know a `dimension`; with 'NONE' nothing has to do with u."""
        if dimension == "NONE":
            return replace(self, u_dimension="NONE", mixture_u="NONE", network_u="NONE", strata=0)
        return replace(self, u_dimension=dimension)

    @property
    def source(self) -> str:
        """What directions are drawn from, one of SOURCES."""
        return self.method.source or self.source_field

    @property
    def trains_network(self) -> bool:
        """Whether a process beside the render will train a network; AUTO may, but seldom does."""
        first = METHODS[rungs_of(self.method)[0]]
        learns = SOURCES[self.source].is_network or first.predictor in TRAINED_PREDICTORS
        return self.is_guided and learns


#: All settings of a render by name, in the order of panels and page.
SETTINGS = {item.name: Setting(item.name, item.default, **item.metadata) for item in fields(RenderSettings)}
