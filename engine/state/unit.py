# SPDX-License-Identifier: GPL-3.0-or-later
"""A unit of work: which pixels and samples, by which arm, and what it cost."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

#: Unit.stratum: samples lie in all of the shutter, and have a row of the film for each stratum.
ALL_STRATA = -1

# Unit.arm
PLAIN = -1
CURRENT = 0
CHALLENGER = 1
#: By what the iteration before went by, recorded by nobody: while it is learned from (`engine.render.bridge`).
BRIDGE = 2


@dataclass(frozen=True)
class Unit:
    """A tile of pixels by a range of samples: the smallest piece of work, always done whole.

    pixels : int32 (P, 2), column and row in the full image
    film_index : int64 (P,), where they are on the film
    """

    pixels: np.ndarray
    film_index: np.ndarray
    sample_first: int
    sample_count: int
    #: Which of the methods in use renders it: PLAIN, or by what has been learned, with paths recorded to learn more.
    arm: int = 0
    #: Part of u that its samples lie in, of so many equal ones (`engine.render.strata`).
    stratum: int = 0
    strata: int = 1
    #: Whether guiding is tried in the iteration, but on none of these pixels.
    is_aside: bool = False

    @property
    def path_count(self) -> int:
        """Paths that it takes."""
        return len(self.pixels) * self.sample_count


@dataclass(frozen=True)
class UnitCosts:
    """What a unit took: of its thread's processor time [s], whatever else the machine does, and counted."""

    seconds: float = 0.0
    ray_count: int = 0
    guided_vertices: int = 0
    resampled_candidates: int = 0
