# SPDX-License-Identifier: GPL-3.0-or-later
"""Maps of photons, one for each range of samples: made by the threads that need them, the same whoever makes them.

Radii shrink with all photons that have been sent off so far, so that the mean of the maps' estimates converges: bias
goes with the square of the radius, noise with one over photons within it. Windows of time and wavelengths shrink with
them (`engine.render.photon_windows`).

References: Knaus and Zwicker 2011, "Progressive Photon Mapping: A Probabilistic Approach", Eq. (20) with alpha = 2/3.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from engine.array_types import Float32Array
from engine.kernels.hash_grid import sort_into_buckets
from engine.kernels.photon_windows import parts_of_times
from engine.render.photon_radius import best_radius, neighbours_within, radius_of_neighbours
from engine.render.photon_starts import Starts
from engine.render.photon_windows import Windows, share_of_photons
from engine.render.photons_within import PhotonsWithin, part_marks
from engine.state.photons import (
    MAP_BUCKETS,
    MAP_EXPECTED,
    MAP_GATHERED_ONE_IN,
    MAP_HALF_TIME,
    MAP_HALF_WAVES,
    MAP_INVERSE_CELL,
    MAP_NUMBERS,
    MAP_ONE_IN,
    MAP_PIXELS,
    MAP_RADIUS,
    MAP_SCALE,
    PHOTON_P,
    PHOTON_TIME,
    CasterArrays,
    PhotonMap,
    no_photons,
)

#: Photons for each path that goes by their map, and where there are marks within media, of which each leaves several.
_PHOTONS_PER_PATH, _PHOTONS_PER_PATH_IN_MEDIA = 1.0, 0.5
#: Least and most photons of a map. The first has fewer, since a trial may find that none are worth their time.
_FEWEST, _MOST, _MOST_AT_FIRST = 1 << 12, 1 << 21, 1 << 17
#: Photons that a thread sends off at a time.
CHUNK = 4096
#: Samples of a pixel that go by one map, at most.
_MOST_SAMPLES = 16
#: As tasks grow, by an eighth of the samples so far: a task goes by one map.
_MOST_DIVISIONS = 8
#: Photons within the radius of the first map.
_FIRST_NEIGHBOURS = 16
#: Radii are at most this many times a pixel's: where few photons arrive, paths find what they lack.
MOST_PIXELS = 6.0
#: And where the picture is denoised, so that noise of pixels is another one in each.
MOST_PIXELS_DENOISED = 0.5
#: The map's own are at least this at first: a smaller disc sharpens nothing that a pixel's filter would not blur.
LEAST_PIXELS = 0.5
#: MAP_ONE_IN then: for samples before this one, whose few maps a denoiser would take for patterns, and later.
ONE_IN_EARLY, ONE_IN_LATER, EARLY_SAMPLES = 32, 8, 16
#: MAP_GATHERED_ONE_IN, at most, and how many photons a path is to gather in a disc.
MOST_ONE_IN = 8
_GATHERED = 8.0
#: Maps that are kept: tiles are not all at the same sample.
_KEPT = 3

#: Sends off photons, which begin as a map without any says: from the first, so many; what arrives is float32
#: (F, `photon_width`), or None: it was stopped.
SendOff = Callable[[PhotonMap, int, int], Float32Array | None]
#: By a map without photons: radius of a pixel where it gathers photons [m], 0: nowhere, and how often paths that had
#: gathered some have left each side of the casters' pieces; None: it was stopped.
Look = Callable[[PhotonMap], tuple[float, Float32Array] | None]
#: What photons gain by a map, 0: they do not pay; None: it was stopped.
TryOut = Callable[[PhotonMap], float | None]

NO_PHOTONS = no_photons()


def _maps_of_octave(octave: int, divisions: int) -> int:
    """Maps that samples 2^octave to 2^(octave + 1) go by."""
    samples = 1 << octave
    return min(max(divisions, samples // _MOST_SAMPLES), samples)


def samples_of_map(number: int, divisions: int = 1) -> tuple[int, int]:
    """First sample of a map, and how many go by it.

    Parameters
    ----------
    number : int
    divisions : int
        Maps that twice the samples so far go by, at least: a power of two.
    """
    if number == 0:
        return 0, 1
    number, octave = number - 1, 0
    while number >= _maps_of_octave(octave, divisions):
        number -= _maps_of_octave(octave, divisions)
        octave += 1
    count = (1 << octave) // _maps_of_octave(octave, divisions)
    return (1 << octave) + number * count, count


def map_of_sample(sample: int, divisions: int = 1) -> int:
    """Which map a sample goes by; `divisions` as of `samples_of_map`."""
    if sample == 0:
        return 0
    last = sample.bit_length() - 1
    before = 1 + sum(_maps_of_octave(octave, divisions) for octave in range(last))
    return before + ((sample - (1 << last)) * _maps_of_octave(last, divisions) >> last)


def divisions_of(pixel_count: int) -> int:
    """`divisions` of a picture: one too large for a photon a path in the largest map has more maps."""
    lacking = _PHOTONS_PER_PATH * pixel_count * _MOST_SAMPLES / _MOST
    return min(1 << max(math.ceil(math.log2(max(lacking, 1.0))), 0), _MOST_DIVISIONS)


@dataclass
class _Growing:
    """A map in the making.

    number : int; first, count : int, its photons
    radius : float or None, to be found [m]
    shrunk : float, the radius over that of the second map
    """

    number: int
    first: int
    count: int
    radius: float | None
    shrunk: float = 1.0
    next_chunk: int = 0
    found: dict[int, Float32Array] = field(default_factory=dict)
    made: PhotonMap | None = None

    @property
    def chunk_count(self) -> int:
        """How many pieces it is made in."""
        return -(-self.count // CHUNK)


class PhotonMaps:
    """The maps of a render.

    Parameters
    ----------
    pixel_count : int
    casters : CasterArrays
    is_tried : bool
        Whether a trial decides if there are any.
    is_denoised : bool
        Whether the picture will be.
    windows : Windows
    """

    def __init__(
        self, pixel_count: int, casters: CasterArrays, *, is_tried: bool, is_denoised: bool = False,
        windows: Windows = Windows(),
    ) -> None:
        self._windows = windows
        self._pixel_count, self._casters, self._is_tried = pixel_count, casters, is_tried
        self._divisions = divisions_of(pixel_count)
        self._is_denoised = is_denoised
        self._starts = Starts(casters)
        #: Say with what densities photons begin: those of the first map, before anything is known all over the casters,
        #: and those of all others.
        self._first_begins = self._starts.at_first()
        self._begins: PhotonMap | None = None
        #: By how much paths alone would be noisier, 0 where photons are given up; None: it is not known.
        self.gain: float | None = None
        self._trial = threading.Lock()
        self._maps: dict[int, _Growing] = {}
        #: Of the second map, from which on radii shrink [m].
        self._best_radius: float | None = None
        #: Photons of that map in one of its discs.
        self._neighbours = 0.0
        self._within = PhotonsWithin()
        #: Photons for each path, of all maps but the first.
        self._per_path = _PHOTONS_PER_PATH
        self._seen = np.zeros(0, np.float32)
        self._pixel_radius: float | None = None
        self._changed = threading.Condition()

    def map_of(self, sample: int, send_off: SendOff, look: Look, try_out: TryOut) -> PhotonMap | None:
        """The map of a sample, made here and by the other threads that ask; None: it was stopped.

        Where a trial says that photons do not pay, it is one without any.
        """
        if self.gain == 0.0:
            return NO_PHOTONS
        with self._trial:
            if self._pixel_radius is None and (seen := look(self._first_begins)) is not None:
                self._pixel_radius, self._seen = seen
                self._first_begins = self._starts.at_first(self._seen)
        if self._pixel_radius is None:
            return None
        if self._begins is None and self._made(0, send_off) is None:
            return None
        if self._is_tried and self.gain is None:
            first = self._made(0, send_off)
            with self._trial:
                if self.gain is None and first is not None:
                    self.gain = try_out(first)
            if self.gain is None:
                return None
            if self.gain == 0.0:
                self._maps.clear()
                return NO_PHOTONS
        if sample > 0 and self._best_radius is None and self._made(1, send_off) is None:
            return None
        return self._made(map_of_sample(sample, self._divisions), send_off)

    def _photons_of(self, number: int) -> int:
        _, samples = samples_of_map(number, self._divisions)
        most, per_path = (_MOST, self._per_path) if number > 0 else (_MOST_AT_FIRST, _PHOTONS_PER_PATH)
        return int(min(max(per_path * self._pixel_count * samples, _FEWEST), most))

    def _begin(self, number: int) -> _Growing:
        first = sum(self._photons_of(before) for before in range(number))
        count = self._photons_of(number)
        if number < 2:
            return _Growing(number, first, count, None)
        assert self._best_radius is not None
        # Eq. (20): r^2 shrinks by the number of photons to the power of alpha - 1.
        shrunk = ((first + count) / (self._photons_of(0) + self._photons_of(1))) ** self._windows.exponent
        return _Growing(number, first, count, self._best_radius * shrunk, shrunk)

    def _made(self, number: int, send_off: SendOff) -> PhotonMap | None:
        begins = self._begins if number > 0 else self._first_begins
        assert begins is not None
        with self._changed:
            growing = self._maps.get(number)
            if growing is None:
                growing = self._maps[number] = self._begin(number)
                for oldest in [one for one, it in self._maps.items() if it.made is not None][: -_KEPT]:
                    del self._maps[oldest]
        while growing.made is None:
            with self._changed:
                chunk = growing.next_chunk
                if chunk == growing.chunk_count:
                    # Others are at it; they may be stopped, and so may this thread.
                    if not self._changed.wait(0.05) and send_off(begins, 0, 0) is None:
                        return None
                    continue
                growing.next_chunk += 1
            first = chunk * CHUNK
            found = send_off(begins, growing.first + first, min(CHUNK, growing.count - first))
            if found is None:
                return None
            with self._changed:
                growing.found[chunk] = found
                if len(growing.found) == growing.chunk_count:
                    growing.made = self._finish(growing, begins)
                    self._changed.notify_all()
        return growing.made

    def _finish(self, growing: _Growing, begins: PhotonMap) -> PhotonMap:
        found = np.concatenate([growing.found[chunk] for chunk in range(growing.chunk_count)])
        growing.found.clear()
        photons, marks = part_marks(found)
        radius, area = growing.radius, float(self._casters.area.sum())
        if growing.number == 0:
            radius = self._first_radius(radius_of_neighbours(photons, _FIRST_NEIGHBOURS, area))
        elif growing.number == 1:
            self._best_radius = radius = self._first_radius(best_radius(photons, area))
            self._neighbours = neighbours_within(photons, radius, area)
        assert radius is not None
        made = make_map(
            photons, growing.count, radius, begins,
            self._windows.half_time(radius / growing.shrunk, growing.shrunk), self._windows.half_waves(growing.shrunk),
            most_pixels=MOST_PIXELS_DENOISED if self._is_denoised else MOST_PIXELS,
            pixels_one_in=self._pixels_one_in(growing), one_in=self._one_in(growing),
        )
        if growing.number > 0:
            return self._within.add_to(made, marks, growing.count, growing.first + growing.count)
        most = self._at_most(math.inf)
        made = self._within.begin_with(made, marks, growing.count, most)
        if self._begins is None:
            if len(marks) > 0:
                self._per_path = _PHOTONS_PER_PATH_IN_MEDIA
            begins = self._starts.by_light(self._seen, made, growing.count)
            self._within.learn(made, begins, growing.count, self._photons_of(1), most)
            self._begins = self._within.ready(begins)
        return made

    def _one_in(self, growing: _Growing) -> int:
        """MAP_GATHERED_ONE_IN of a map: discs with few photons are gathered whole."""
        if growing.number == 0:
            return MOST_ONE_IN
        expected = self._neighbours * growing.count / self._photons_of(1) * growing.shrunk**2
        return int(min(max(expected / _GATHERED, 1.0), MOST_ONE_IN))

    def _pixels_one_in(self, growing: _Growing) -> int:
        if not self._is_denoised:
            return 0
        first, _ = samples_of_map(growing.number, self._divisions)
        return ONE_IN_EARLY if first < EARLY_SAMPLES else ONE_IN_LATER

    def _first_radius(self, radius: float) -> float:
        least = LEAST_PIXELS * (self._pixel_radius or 0.0)
        return self._at_most(self._windows.first_radius(max(radius, least)))

    def _at_most(self, radius: float) -> float:
        return min(radius, MOST_PIXELS * self._pixel_radius) if self._pixel_radius else radius


def make_map(
    photons: Float32Array, emitted: int, radius: float, begins: PhotonMap, half_time: float = 0.0,
    half_waves: float = 0.0, *, most_pixels: float = MOST_PIXELS, pixels_one_in: int = 0, one_in: int = MOST_ONE_IN,
) -> PhotonMap:
    """Photons sorted into a grid.

    Parameters
    ----------
    photons : float32 (P, `photon_width`), that have arrived
    emitted : int, that have been sent off
    radius : float [m]
    begins : PhotonMap, one without photons that says how these began
    half_time, half_waves : float, MAP_HALF_TIME and MAP_HALF_WAVES
    most_pixels : float, pixels_one_in, one_in : int, MAP_PIXELS, MAP_ONE_IN and MAP_GATHERED_ONE_IN
    """
    buckets = 1 << max(len(photons) // 2, 1).bit_length()
    numbers = np.zeros(MAP_NUMBERS, np.float32)
    disc = math.pi * radius * radius
    numbers[MAP_RADIUS], numbers[MAP_INVERSE_CELL] = radius, 1.0 / (2.0 * radius)
    numbers[MAP_HALF_TIME], numbers[MAP_HALF_WAVES] = half_time, half_waves
    numbers[MAP_EXPECTED] = emitted * disc * share_of_photons(half_time, half_waves) / one_in
    numbers[MAP_SCALE] = 1.0 / numbers[MAP_EXPECTED]
    numbers[MAP_PIXELS] = most_pixels
    header = begins.header.copy()
    header[MAP_BUCKETS], header[MAP_ONE_IN], header[MAP_GATHERED_ONE_IN] = buckets, pixels_one_in, one_in
    starts, order = np.zeros(buckets + 1, np.int32), np.zeros(len(photons), np.int32)
    parts = np.zeros(len(photons), np.int64)
    if half_time > 0.0:
        parts_of_times(photons[:, PHOTON_TIME], numbers[MAP_HALF_TIME], parts)
    sort_into_buckets(photons, parts, numbers[MAP_INVERSE_CELL], buckets - 1, starts, order)
    in_order = np.ascontiguousarray(photons[order])
    places = np.ascontiguousarray(in_order[:, PHOTON_P : PHOTON_P + 3])
    return begins._replace(header=header, numbers=numbers, starts=starts, places=places, photons=in_order)
