# SPDX-License-Identifier: GPL-3.0-or-later
"""What the stability suite measures of a method in a case, and what counts as a problem."""

from __future__ import annotations

from dataclasses import dataclass, field

from benchmarks.bias import BiasTest
from engine.array_types import Float32Array

#: A bias that must be seen, and an error that is too much, over unguided rendering.
LEAST_BIAS, MOST_ERROR = 0.02, 1.2


@dataclass
class Picture:
    """One render: float32 (height, width, 3), row 0 at the top, and what the engine said of it.

    seconds : of processors, training included: small pictures on a busy machine have no other steady measure
    """

    image: Float32Array
    seconds: float
    path_count: int
    reject_count: int
    notices: list[str] = field(default_factory=list)
    guiding: list[str] = field(default_factory=list)
    stopped_at: int = 0


@dataclass
class Figures:
    """What a method did with a case.

    bias : BiasTest
    variance, variance_error, variance_whole : over unguided rendering at equal samples (`bias.variance_ratio`)
    total : squared error over that of unguided rendering (`total_error`)
    worst_pixel : squared error that one pixel in a thousand exceeds, over that of unguided rendering
    time : processor seconds over those of unguided rendering, medians; training included
    reject_count : samples that were thrown away, of all seeds; nonfinite_count : values of the pictures
    stopped : share of the seeds in which guiding was given up
    """

    case: str
    method: str
    seed_count: int
    bias: BiasTest
    variance: float
    variance_error: float
    variance_whole: float
    total: float
    worst_pixel: float
    time: float
    reject_count: int
    nonfinite_count: int
    stopped: float
    notices: list[str]

    @property
    def is_cached(self) -> bool:
        """Whether paths end in the radiance cache: then the image is biased, and what counts is its total error."""
        return "-" in self.method

    @property
    def error(self) -> float:
        """Over that of unguided rendering: the variance of an unbiased image, the total error of a cached one."""
        return self.total if self.is_cached else self.variance

    @property
    def problems(self) -> list[str]:
        """Of 'not finite', 'biased', 'noisier', 'blind' (2% of bias would not be seen) and 'noticed' (the engine's)."""
        found = {
            "not finite": self.nonfinite_count > 0,
            "biased": self.bias.is_biased and not self.is_cached,
            # Two standard errors: noise alone is no failure.
            "noisier": self.error - 2.0 * self.variance_error > MOST_ERROR,
            "blind": not self.bias.detectable <= LEAST_BIAS,
            "noticed": bool(self.notices),
        }
        return [name for name, is_so in found.items() if is_so]
