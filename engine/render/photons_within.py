# SPDX-License-Identifier: GPL-3.0-or-later
"""Marks of photons within media: how many, within what radius they are gathered, and the grid that they are in.

References: Knaus and Zwicker 2011, "Progressive Photon Mapping: A Probabilistic Approach", section 4.2: in a volume the
ball shrinks by the number of photons to the power of alpha - 1. Bias goes with the square of the radius, noise with one
over photons within it, so both vanish alike for alpha = 4 / 7.
"""

from __future__ import annotations

import math

import numpy as np

from engine.array_types import Float32Array, FloatArray
from engine.kernels.hash_grid import note_occupied, sort_into_buckets
from engine.render.photon_radius import squared_distances
from engine.state.photons import (
    BLOCK_CELLS,
    IS_WITHIN,
    MAP_MARKS,
    MAP_RADIUS,
    MAP_TUBE_BUCKETS,
    MAP_TUBE_EXPECTED,
    MAP_TUBE_INVERSE_CELL,
    MAP_TUBE_RADIUS,
    MAP_TUBE_SCALE,
    MARKS_AT_FIRST,
    PHOTON_IS_WITHIN,
    PHOTON_POWER,
    PHOTON_SCATTERING,
    PHOTON_START,
    TUBE_LENGTH,
    TUBE_ONE_IN,
    PhotonMap,
    bucket_starts,
)

#: Marks that maps have for each photon that is sent off, and most that a photon draws on a segment.
#: Threads have room for that many of all photons that they send off at a time, since no photon collides twice.
_MARKS_PER_PHOTON, _MOST_MARKS = 0.5, 16
#: Few marks share a bucket with those of another place.
_BUCKETS_PER_MARK = 4
#: Marks within the first cylinder, of how many that is asked, and its bound over that of surfaces.
_FIRST_NEIGHBOURS, _ASKED, _FARTHER = 4, 256, 2.0
#: To which power of the number of photons the radius shrinks: (alpha - 1) / 3.
_SHRINKS = -1.0 / 7.0


def part_marks(found: Float32Array) -> tuple[Float32Array, Float32Array]:
    """Photons that have arrived at surfaces, and marks within media; float32 (N, PHOTON_WIDTH) all."""
    is_within = found[:, PHOTON_IS_WITHIN] == IS_WITHIN
    return found[~is_within], found[is_within]


def scattered_power(photons: PhotonMap) -> FloatArray:
    """What a medium scatters of the photon at each mark of a map, mean over channels and marks [W]: float64 (M,)."""
    power = np.abs(photons.within[:, PHOTON_POWER : PHOTON_POWER + 3]).mean(axis=1, dtype=np.float64)
    scattered: FloatArray = power * photons.within[:, PHOTON_SCATTERING] / photons.header[MAP_MARKS]
    return scattered


def with_marks(photons: PhotonMap, marks: Float32Array, emitted: int, radius: float) -> PhotonMap:
    """A map and marks within media, sorted into a grid.

    Parameters
    ----------
    marks : float32 (M, PHOTON_WIDTH)
    emitted : int, photons that have been sent off
    radius : float [m]
    """
    header, numbers = photons.header.copy(), photons.numbers.copy()
    buckets = max(1 << max(_BUCKETS_PER_MARK * len(marks) - 1, 1).bit_length(), BLOCK_CELLS)
    header[MAP_TUBE_BUCKETS] = buckets
    numbers[MAP_TUBE_RADIUS], numbers[MAP_TUBE_INVERSE_CELL] = radius, 1.0 / (2.0 * radius)
    tube = TUBE_LENGTH * math.pi * radius**3
    numbers[MAP_TUBE_EXPECTED] = emitted * float(header[MAP_MARKS]) * tube / TUBE_ONE_IN
    numbers[MAP_TUBE_SCALE] = 1.0 / numbers[MAP_TUBE_EXPECTED]
    starts, order = bucket_starts(buckets), np.zeros(len(marks), np.int32)
    sort_into_buckets(marks, np.zeros(len(marks), np.int64), numbers[MAP_TUBE_INVERSE_CELL], buckets - 1, starts, order)
    note_occupied(starts, buckets)
    return photons._replace(
        header=header, numbers=numbers, starts_within=starts, within=np.ascontiguousarray(marks[order])
    )


class PhotonsWithin:
    """Marks of a render's maps, whose number and radius the first map tells."""

    def __init__(self) -> None:
        self._marks, self._first_sent = MARKS_AT_FIRST, 1
        self._first_radius: float | None = None

    def ready(self, begins: PhotonMap) -> PhotonMap:
        """A map without photons that says, too, how many marks they draw."""
        header = begins.header.copy()
        header[MAP_MARKS] = self._marks
        return begins._replace(header=header)

    def begin_with(self, photons: PhotonMap, marks: Float32Array, emitted: int, farthest: float) -> PhotonMap:
        """The first map with its marks: `emitted` photons have been sent off, and discs have at most that radius."""
        return with_marks(photons, marks, emitted, _first_radius(photons, _radius_of_neighbours(marks), farthest))

    def learn(self, first: PhotonMap, begins: PhotonMap, emitted: int, next_emitted: int, farthest: float) -> None:
        """Decide how many marks are drawn from now on, and within what radius they are gathered.

        Parameters
        ----------
        first : PhotonMap
            The first one, with its marks.
        begins : PhotonMap
            Says how photons begin from now on.
        emitted, next_emitted : int
            Photons that have been sent off for the first map, and that will be for the next.
        farthest : float
            Bound on the radius on surfaces [m].
        """
        marks, drawn = first.within, int(first.header[MAP_MARKS])
        start = marks[:, PHOTON_START].astype(np.int64)
        # Marks that a photon will leave if it draws one.
        begun = first.place_density[start].astype(np.float64)
        rate = float((begins.place_density[start] / begun).sum()) / (emitted * drawn)
        wanted = round(_MARKS_PER_PHOTON / rate) if rate > 0.0 else _MOST_MARKS
        self._marks, self._first_sent = min(max(wanted, 1), _MOST_MARKS), next_emitted
        more = max(rate * next_emitted * self._marks, 1.0) / max(len(marks), 1)
        radius = _radius_of_neighbours(marks) * more ** (-1.0 / 3.0)
        self._first_radius = _first_radius(first, radius, farthest)

    def add_to(self, photons: PhotonMap, marks: Float32Array, emitted: int, sent: int) -> PhotonMap:
        """Another map with its marks, `sent` photons having been sent off so far."""
        assert self._first_radius is not None
        return with_marks(photons, marks, emitted, self._first_radius * (sent / self._first_sent) ** _SHRINKS)


def _first_radius(photons: PhotonMap, radius: float, farthest: float) -> float:
    """A radius within bounds [m]: that on surfaces where marks tell none."""
    bounded = min(radius, _FARTHER * farthest)
    return bounded if 0.0 < bounded < math.inf else float(photons.numbers[MAP_RADIUS])


def _radius_of_neighbours(marks: Float32Array) -> float:
    """Median radius of cylinders that hold so many neighbours of a mark [m], infinite where there are next to none."""
    neighbours = min(_FIRST_NEIGHBOURS, len(marks) - 1)
    if neighbours < 1:
        return math.inf
    squared = squared_distances(marks, neighbours, _ASKED)
    # By the volume of a ball about each.
    return math.sqrt(float(np.median(squared))) * (4.0 / 3.0 / TUBE_LENGTH) ** (1.0 / 3.0)
