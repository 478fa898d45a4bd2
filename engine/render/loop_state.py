# SPDX-License-Identifier: GPL-3.0-or-later
"""What the rest of a render depends on besides the film and what was learned.

Random numbers are functions of seed, pixel and sample (`engine.kernels.rng`), so which samples a tile has is all of
their state: an unguided render goes on to the same picture. One that learns begins its iterations anew, behind all
samples that any pixel may have by then, so that none counts twice. The state is plain: numbers, texts and arrays, as
`engine.render.checkpoint_file` keeps them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from engine.array_types import Int32Array
from engine.render.schedule import LEAST_TASK_SAMPLES, START, Begin, task_samples


@dataclass(frozen=True)
class LooksState:
    """What looks at the picture have found so far (`engine.render.looks`).

    is_active : bool (P,), which pixels go on; empty: nobody has looked
    pixels_looked_at : int, samples a pixel at that
    expected_paths : float, that were to come after it
    due : int, samples a pixel at the next look at the denoised picture; -1: no more looks
    looks : int, at the denoised picture
    looked_at : int, samples a pixel at the last of them
    error : float, as it was estimated; negative: it never was
    """

    is_active: npt.NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, np.bool_))
    pixels_looked_at: int = 0
    expected_paths: float = 0.0
    due: int = 0
    looks: int = 0
    looked_at: int = 0
    error: float = -1.0


@dataclass(frozen=True)
class LoopState:
    """How far a render has come.

    first, count : int, as of `Begin`
    ends : int32 (tiles,), samples that each tile has; empty: `first` each
    skipped : int, samples by which these numbers run ahead of what every pixel has got
    seconds : float, that it has taken
    path_count : int, that it has traced
    ended_by : str, of `ENDINGS`, '' if it has not ended
    looks : LooksState
    """

    first: int = 0
    count: int = 1
    ends: Int32Array = field(default_factory=lambda: np.zeros(0, np.int32))
    skipped: int = 0
    seconds: float = 0.0
    path_count: int = 0
    ended_by: str = ""
    looks: LooksState = field(default_factory=LooksState)

    @property
    def begin(self) -> Begin:
        """Where the schedule takes up."""
        if not len(self.ends):
            return replace(START, first=self.first, count=self.count)
        return Begin(self.first, self.count, tuple(self.ends.tolist()))

    @property
    def samples(self) -> int:
        """Samples a pixel: what was to be had where the render has ended."""
        return (int(self.ends.max()) if len(self.ends) else self.first) - self.skipped

    @property
    def has_image(self) -> bool:
        """Whether every pixel has a sample."""
        return (int(self.ends.min()) if len(self.ends) else self.first) > self.skipped

    def anew(self, least: int, most: int) -> LoopState:
        """The same where what goes on from it begins behind sample `most`, and pixels are only sure to have `least`."""
        count = max(task_samples(most), LEAST_TASK_SAMPLES)
        return replace(self, first=most, count=count, ends=self.ends[:0], skipped=self.skipped + most - least)

    def check(self) -> None:
        """Raise where no render can have come so far.

        Raises
        ------
        ValueError
            Saying what is wrong.
        """
        looks = self.looks
        numbers = (
            self.first, self.skipped, self.path_count, self.seconds, looks.pixels_looked_at, looks.expected_paths,
            looks.looks,
        )  # fmt: skip
        if not all(math.isfinite(number) and number >= 0 for number in numbers) or self.count < 1:
            raise ValueError("a number is negative, or none")
        if len(self.ends) and self.ends.min() < self.first:
            raise ValueError("a tile has fewer samples than it began with")


#: Of a render that begins.
NOTHING_DONE = LoopState()
