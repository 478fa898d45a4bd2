# SPDX-License-Identifier: GPL-3.0-or-later
"""What a user may choose: one frozen dataclass, the same names as `scene.neuralguide` in Blender."""

from __future__ import annotations

from dataclasses import dataclass

GUIDING_METHODS = ("OFF",)
PIXEL_FILTERS = ("BOX", "GAUSSIAN", "BLACKMAN_HARRIS")

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
    guiding_method: str = "OFF"
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
        if self.pixel_filter not in PIXEL_FILTERS:
            raise ValueError(f"pixel_filter {self.pixel_filter!r}: choose one of {', '.join(PIXEL_FILTERS)}")
        if self.threads < 0:
            raise ValueError(f"threads is {self.threads}: choose 0 (all) or more")
        for name in ("max_bounces", "diffuse_bounces", "glossy_bounces", "transmission_bounces"):
            if getattr(self, name) < 0:
                raise ValueError(f"{name} is {getattr(self, name)}: choose 0 or more")
