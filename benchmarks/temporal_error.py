# SPDX-License-Identifier: GPL-3.0-or-later
"""Errors of a sequence against two independent references: in all, over time, and where things come in sight.

Every square is a product of the differences to the two references, so that their own noise does not count.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from engine.denoise.motion import follow

#: Frames over which the variance of an error is taken.
WINDOW = 8
#: Frames back to which a pixel is looked for, to tell whether it has come in sight.
_UNSEEN = 1
#: Pixels left out: where the references differ most.
_LEFT_OUT = 0.01


@dataclass(frozen=True)
class References:
    """Two independent renders of each frame, and how things move.

    Attributes
    ----------
    first, second : list of float32 (height, width, 3), row 0 at the bottom
    vectors : list of float32 (height, width, 4) [pixels]
    """

    first: Sequence[np.ndarray]
    second: Sequence[np.ndarray]
    vectors: Sequence[np.ndarray]

    def scale(self, index: int) -> np.ndarray:
        """What squares of a frame's errors are relative to: float64 (height, width)."""
        mean = 0.5 * float(np.mean(self.first) + np.mean(self.second))
        return 0.25 * np.square(self.first[index] + self.second[index]).mean(axis=2) + 0.01 * mean * mean

    def counts(self, index: int) -> np.ndarray:
        """Pixels of a frame that count: bool (height, width)."""
        apart = np.square(self.first[index] - self.second[index]).mean(axis=2) / self.scale(index)
        return apart <= np.quantile(apart, 1.0 - _LEFT_OUT)


@dataclass(frozen=True)
class SequenceErrors:
    """Relative squared errors, means over frames and pixels.

    Attributes
    ----------
    total : float
    temporal : float
        Variance of the error over `WINDOW` frames, along motion.
    changing : float
        Half the square of the change of the error from one frame to the next, along motion.
    disoccluded : float
        Error of the pixels that show what the frame before did not; nan where there are none.
    disoccluded_share : float
        Of all pixels.
    """

    total: float
    temporal: float
    changing: float
    disoccluded: float
    disoccluded_share: float


def sequence_errors(pictures: Sequence[np.ndarray], references: References) -> SequenceErrors:
    """Errors of pictures, float32 (height, width, 3) each, row 0 at the bottom."""
    apart = [
        (picture - first, picture - second)
        for picture, first, second in zip(pictures, references.first, references.second, strict=True)
    ]
    count = len(pictures)
    scales = [references.scale(index) for index in range(count)]
    counted = [references.counts(index) for index in range(count)]
    total: list[np.ndarray] = []
    hidden: list[np.ndarray] = []
    changing: list[np.ndarray] = []
    temporal: list[np.ndarray] = []
    for index in range(count):
        square = (apart[index][0] * apart[index][1]).mean(axis=2) / scales[index]
        total.append(square[counted[index]])
        if index >= _UNSEEN:
            sighting = next(iter(follow(references.vectors.__getitem__, index, index - 1, -1)))
            hidden.append(square[counted[index] & ~sighting.is_seen])
            change = [apart[index][side] - apart[index - 1][side][sighting.places] for side in (0, 1)]
            kept = counted[index] & sighting.is_seen & counted[index - 1][sighting.places]
            changing.append((0.5 * (change[0] * change[1]).mean(axis=2) / scales[index])[kept])
    for start in range(0, count - WINDOW + 1, WINDOW // 2):
        temporal.append(_variance(apart, scales, counted, references, start))
    unseen = np.concatenate(hidden)
    return SequenceErrors(
        float(np.concatenate(total).mean()), float(np.concatenate(temporal).mean()),
        float(np.concatenate(changing).mean()), float(unseen.mean()) if unseen.size else float("nan"),
        unseen.size / max(sum(map(int, map(np.sum, counted[_UNSEEN:]))), 1),
    )  # fmt: skip


def _variance(
    apart: Sequence[tuple[np.ndarray, np.ndarray]], scales: Sequence[np.ndarray], counted: Sequence[np.ndarray],
    references: References, start: int,
) -> np.ndarray:
    """Variance over `WINDOW` frames from `start` on of the errors of what can be seen in all of them."""
    errors: list[list[np.ndarray]] = [[side] for side in apart[start]]
    scale, kept = scales[start].copy(), counted[start].copy()
    for sighting in follow(references.vectors.__getitem__, start, start + WINDOW - 1, 1):
        index, places = start + sighting.lag, sighting.places
        for side in (0, 1):
            errors[side].append(apart[index][side][places])
        scale += scales[index][places]
        kept &= sighting.is_seen & counted[index][places]
    first, second = (np.stack(side) - np.mean(side, axis=0) for side in errors)
    return ((first * second).sum(axis=0).mean(axis=2) / (WINDOW - 1) / (scale / WINDOW))[kept]
