# SPDX-License-Identifier: GPL-3.0-or-later
"""What a user may choose: one frozen dataclass, the same names as `scene.neuralguide` in Blender."""

from __future__ import annotations

from dataclasses import dataclass, replace

#: What directions can be drawn from.
SOURCES = ("VMM", "SDTREE", "SDTREE_VARIANCE", "NPM", "NPM_PRODUCT", "NASG", "FLOW")
#: Sources that are networks of their own.
NETWORK_SOURCES = ("NPM", "NPM_PRODUCT", "NASG", "FLOW")
#: Networks that give mixtures.
MIXTURE_SOURCES = ("NPM", "NPM_PRODUCT", "NASG")
#: Drawing from a source alone, or resampling what it proposes by something learned.
#: AUTO compares them while it renders, unguided rendering included.
GUIDING_METHODS = ("OFF", "AUTO", *SOURCES, "VMM_RIS", "TABLE_RIS", "NEURAL_RIS")
#: What `NASG` is proportional to: incident radiance, that times the cosine, or times the whole BSDF.
MIXTURE_TARGETS = ("RADIANCE", "COSINE", "PRODUCT")
#: Lobes of neural mixtures: those of the method's paper, or others.
MIXTURE_LOBES = ("OWN", "VMF", "NASG", "SG")
#: Sizes of neural mixtures: the paper's, those of its authors' program, or without grids, for renders of few records.
MIXTURE_PRESETS = ("PAPER", "OFFICIAL", "COMPACT")
#: What a network may know of a path besides where it is, u in [0, 1]: AUTO is the time where something moves, else the
#: wavelength where a material disperses. Asked for where there is nothing of the kind, it is NONE.
U_DIMENSIONS = ("NONE", "AUTO", "TIME", "WAVELENGTH")
#: How it sees that: as frequencies, by learned planes over a coordinate and u, or by learned grids over position and u.
U_ENCODINGS = ("NONE", "FREQUENCY", "PLANES", "HASH4D")
#: The same of the network that weighs candidates. AUTO is what has been found to pay (docs/benchmarks.md): octaves of
#: the wavelength, and nothing of the time.
NETWORK_U_ENCODINGS = ("AUTO", "NONE", "FREQUENCY", "PLANES")
#: Most parts of u that a render goes through one by one.
MAX_STRATA = 64
CANDIDATE_ALLOCATIONS = ("ORCA", "FIXED")
#: Whether resampling weighs colour channels by the path's throughput, or the mean of everything.
RIS_TARGETS = ("COLOR", "SCALAR")
#: Whether ORCA minimises the error relative to the pixel's value, or the plain one.
#: Sizes of the radiance network: of what a render on a processor can train, and the paper's.
NETWORK_SIZES = ("COMPACT", "PAPER")
ORCA_ERRORS = ("RELATIVE", "ABSOLUTE")
SAMPLE_WEIGHTINGS = ("ITERATION", "UNIFORM")
#: Most candidates of a vertex.
MAX_CANDIDATES = 32
#: Whether paths carry wavelengths: AUTO where a material disperses.
SPECTRAL_MODES = ("OFF", "ON", "AUTO")
PIXEL_FILTERS = ("BOX", "GAUSSIAN", "BLACKMAN_HARRIS")

#: Samples a pixel from which on AUTO guides: of fewer, too many are spent on learning (docs/experiments.md).
LEAST_GUIDED_SAMPLES = 16
#: More samples than this overflow the sampler's index.
MAX_SAMPLES = 1 << 24


@dataclass(frozen=True)
class RenderSettings:
    """Settings of one render; validated on construction.

    Raises
    ------
    ValueError
        Naming the setting and what to do.
    """

    samples: int = 128
    time_limit: float = 0.0  # [s], 0 = none
    seed: int = 0
    max_bounces: int = 12
    diffuse_bounces: int = 4
    glossy_bounces: int = 4
    transmission_bounces: int = 12
    transparent_max_bounces: int = 8
    min_light_bounces: int = 0
    min_transparent_bounces: int = 0
    guiding_method: str = "OFF"  # Blender's users begin with AUTO
    guiding_probability: float = 0.5  # share of candidates that the guide proposes, the BSDF the others
    learn_guiding_probability: bool = True  # by region, from guiding_probability on
    guiding_trial: bool = True  # compare with unguided samples, and go on without guiding where it does not pay
    candidate_allocation: str = "ORCA"
    candidate_count: int = 8  # with the allocation FIXED
    defensive_alpha: float = 0.5  # share of resampling by the learned target, against the source density
    ris_target: str = "COLOR"
    orca_error: str = "RELATIVE"
    network_size: str = "COMPACT"
    network_u: str = "AUTO"
    source_field: str = "VMM"  # what directions are drawn from before they are resampled
    mixture_target: str = "PRODUCT"
    mixture_lobes: str = "OWN"
    mixture_preset: str = "COMPACT"
    u_dimension: str = "AUTO"
    mixture_u: str = "NONE"
    strata: int = 0  # parts of u that a neural mixture learns one by one
    network_selection: bool = False  # let a neural mixture learn how often to guide, vertex by vertex
    mis_compensation: bool = False  # learn what BSDF sampling leaves over
    sample_weighting: str = "ITERATION"
    radiance_cache: bool = False  # biased: end paths at the first rough surface, by what was learned
    training_share: float = 0.25  # of the processors' time
    deterministic: bool = False
    spectral: str = "AUTO"
    use_nee: bool = True
    use_russian_roulette: bool = True
    use_caustics_reflective: bool = True
    use_caustics_refractive: bool = True
    light_sampling_threshold: float = 0.01
    filter_glossy: float = 1.0
    clamp_direct: float = 0.0
    clamp_indirect: float = 0.0
    pixel_filter: str = "BLACKMAN_HARRIS"
    filter_width: float = 1.5  # [pixels]
    film_transparent: bool = False
    threads: int = 0

    def __post_init__(self) -> None:
        if not 1 <= self.samples <= MAX_SAMPLES:
            raise ValueError(f"samples is {self.samples}: choose 1 to {MAX_SAMPLES}")
        if self.time_limit < 0.0:
            raise ValueError(f"time_limit is {self.time_limit} s: choose 0 (none) or more")
        if self.guiding_method not in GUIDING_METHODS:
            raise ValueError(f"guiding_method {self.guiding_method!r}: choose one of {', '.join(GUIDING_METHODS)}")
        for name, choices in (
            ("pixel_filter", PIXEL_FILTERS),
            ("candidate_allocation", CANDIDATE_ALLOCATIONS),
            ("ris_target", RIS_TARGETS),
            ("network_size", NETWORK_SIZES),
            ("network_u", NETWORK_U_ENCODINGS),
            ("source_field", SOURCES),
            ("mixture_target", MIXTURE_TARGETS),
            ("mixture_lobes", MIXTURE_LOBES),
            ("mixture_preset", MIXTURE_PRESETS),
            ("u_dimension", U_DIMENSIONS),
            ("mixture_u", U_ENCODINGS),
            ("orca_error", ORCA_ERRORS),
            ("sample_weighting", SAMPLE_WEIGHTINGS),
            ("spectral", SPECTRAL_MODES),
        ):
            if getattr(self, name) not in choices:
                raise ValueError(f"{name} {getattr(self, name)!r}: choose one of {', '.join(choices)}")
        if not 0 <= self.strata <= MAX_STRATA:
            raise ValueError(f"strata is {self.strata}: choose 0 (none) to {MAX_STRATA}")
        if not 1 <= self.candidate_count <= MAX_CANDIDATES:
            raise ValueError(f"candidate_count is {self.candidate_count}: choose 1 to {MAX_CANDIDATES}")
        if not 0.0 <= self.guiding_probability <= 0.95:
            # Below one, so that the BSDF covers what the guide has not seen.
            raise ValueError(f"guiding_probability is {self.guiding_probability}: choose 0 to 0.95")
        if not 0.0 <= self.defensive_alpha <= 0.99:
            raise ValueError(f"defensive_alpha is {self.defensive_alpha}: choose 0 to 0.99")
        if not 0.0 < self.training_share <= 1.0:
            raise ValueError(f"training_share is {self.training_share}: choose more than 0, at most 1")
        if self.threads < 0:
            raise ValueError(f"threads is {self.threads}: choose 0 (all) or more")
        for name in ("max_bounces", "diffuse_bounces", "glossy_bounces", "transmission_bounces"):
            if getattr(self, name) < 0:
                raise ValueError(f"{name} is {getattr(self, name)}: choose 0 or more")

    @property
    def is_guided(self) -> bool:
        """Whether anything is to be learned: AUTO leaves renders alone that end before guiding can pay."""
        return self.guiding_method != "OFF" and (self.guiding_method != "AUTO" or self.samples >= LEAST_GUIDED_SAMPLES)

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
        return self.guiding_method if self.guiding_method in SOURCES else self.source_field
