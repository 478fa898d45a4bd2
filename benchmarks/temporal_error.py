# SPDX-License-Identifier: GPL-3.0-or-later
"""Errors of a sequence against two independent references: in all, over time, and where things come in sight.

Every square is a product of the differences to the two references, so that their own noise does not count. As
elsewhere here, the worst 0.1% of the values are left out: those whose difference to both references' mean is largest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from engine.denoise.motion import follow

#: Frames over which the variance of an error is taken.
WINDOW = 8
#: Frames back to which a pixel is followed, to tell whether it has come in sight.
SIGHT = 4
_LEFT_OUT = 0.001


@dataclass(frozen=True)
class References:
    """Two independent renders of each frame, and how things move.

    Attributes
    ----------
    first, second : list of float32 (height, width, 3), row 0 at the bottom
    clean : list of float32 (height, width, 3)
        Of which brightness errors are relative to: both denoised. Where noisy ones are dark by chance a picture seems
        too bright too.
    vectors : list of float32 (height, width, 4) [pixels]
    """

    first: Sequence[np.ndarray]
    second: Sequence[np.ndarray]
    clean: Sequence[np.ndarray]
    vectors: Sequence[np.ndarray]

    def scale(self, index: int) -> np.ndarray:
        """What squares of a frame's errors are relative to: float32 (height, width)."""
        mean = float(np.mean(self.clean))
        return np.asarray(np.square(self.clean[index]).mean(axis=2) + 0.01 * mean * mean)


@dataclass(frozen=True)
class SequenceErrors:
    """Relative squared errors, means over frames and pixels without the worst 0.1%.

    Attributes
    ----------
    total : float
    whole : float
        The same with the worst 0.1%.
    temporal : float
        Variance of the error over `WINDOW` frames, along motion.
    disoccluded : float
        Error of the pixels that show what was hidden or out of the picture `SIGHT` frames before; nan where there are
        none.
    disoccluded_share : float
        Of all pixels.
    """

    total: float
    whole: float
    temporal: float
    disoccluded: float
    disoccluded_share: float


class _Values:
    """Products of errors, and the squares by which the worst are found."""

    def __init__(self) -> None:
        self._parts: list[tuple[np.ndarray, np.ndarray]] = []

    def add(self, first: np.ndarray, second: np.ndarray, scale: np.ndarray, kept: np.ndarray) -> None:
        """Add pixels: differences to the references, (frames, height, width, 3); what they are relative to; which."""
        degrees = max(len(first) - 1, 1)
        product, square = (
            (values.sum(axis=0).mean(axis=2) / degrees / scale)[kept]
            for values in (first * second, np.square(0.5 * (first + second)))
        )
        self._parts.append((product, square))

    def mean(self, left_out: float = _LEFT_OUT) -> float:
        """Without the worst; nan where there is none."""
        products, squares = (np.concatenate(side) for side in zip(*self._parts, strict=True))
        order = np.argsort(squares)
        kept = order[: len(order) - int(left_out * len(order))]
        return float(products[kept].mean()) if len(kept) else float("nan")

    @property
    def count(self) -> int:
        """Values in all."""
        return sum(len(products) for products, _ in self._parts)


def sequence_errors(pictures: Sequence[np.ndarray], references: References) -> SequenceErrors:
    """Errors of pictures, float32 (height, width, 3) each, row 0 at the bottom; `WINDOW` frames or more."""
    count, vectors = len(pictures), references.vectors.__getitem__
    errors = [
        np.stack([np.subtract(picture, reference[index]) for index, picture in enumerate(pictures)])
        for reference in (references.first, references.second)
    ]
    scales = [references.scale(index) for index in range(count)]
    total, hidden, temporal = _Values(), _Values(), _Values()
    for index in range(count):
        now = [side[index : index + 1] for side in errors]
        total.add(*now, scales[index], np.ones(scales[index].shape, bool))
        if index >= SIGHT:
            *_, sighting = follow(vectors, index, index - SIGHT, -1)
            hidden.add(*now, scales[index], ~sighting.is_seen)
    for start in range(0, count - WINDOW + 1, WINDOW // 2):
        tracks = [[side[start]] for side in errors]
        scale, is_seen = scales[start].copy(), np.ones(scales[start].shape, bool)
        for sighting in follow(vectors, start, start + WINDOW - 1, 1):
            index, is_seen = start + sighting.lag, sighting.is_seen
            scale += scales[index][sighting.places]
            for side, track in zip(errors, tracks, strict=True):
                track.append(side[index][sighting.places])
        first, second = (np.stack(track) - np.mean(track, axis=0) for track in tracks)
        temporal.add(first, second, scale / WINDOW, is_seen)
    return SequenceErrors(total.mean(), total.mean(0.0), temporal.mean(), hidden.mean(), hidden.count / total.count)
