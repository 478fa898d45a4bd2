# SPDX-License-Identifier: GPL-3.0-or-later
"""Where photons begin, and how many: most go where they bring light that is seen."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from engine.array_types import Float32Array, FloatArray
from engine.render.photon_maps import PhotonMaps
from engine.render.photon_radius import MOST_NEIGHBOURS
from engine.render.photon_starts import Starts
from engine.state.photons import (
    MAP_RADIUS,
    PHOTON_P,
    PHOTON_POWER,
    PHOTON_START,
    PHOTON_WIDTH,
    CasterArrays,
    PhotonMap,
)

#: Pieces of two objects, and their groups.
_PIECES, _PER_GROUP = 64, 4


def casters() -> CasterArrays:
    """Pieces of different sizes."""
    numbers = np.random.default_rng(3)
    told = SimpleNamespace(
        instance=np.array([0, 1], np.int32), row=np.repeat(np.array([0, 1], np.int32), _PIECES // 2),
        group=np.arange(_PIECES, dtype=np.int32) // _PER_GROUP,
        area=numbers.uniform(0.5, 2.0, _PIECES).astype(np.float32),
    )  # fmt: skip
    return cast(CasterArrays, told)


def probabilities(begins: PhotonMap) -> FloatArray:
    return np.diff(begins.cumulative, prepend=0.0)


def with_photons(begins: PhotonMap, starts: FloatArray, power: float) -> PhotonMap:
    photons = np.zeros((len(starts), PHOTON_WIDTH), np.float32)
    photons[:, PHOTON_START] = starts
    photons[:, PHOTON_POWER : PHOTON_POWER + 3] = power
    return begins._replace(photons=photons)


@pytest.mark.parametrize("known", ["nothing", "paths", "light"])
def test_densities_are_those_of_what_is_drawn(known: str) -> None:
    starts, seen = Starts(casters()), np.zeros(2 * _PIECES, np.float32)
    seen[[4, 9, 70]] = 1.0, 3.0, 2.0
    begins = starts.at_first(None if known == "nothing" else seen)
    if known == "light":
        begins = starts.by_light(seen, with_photons(begins, np.array([9, 9, 70]), 1.0), 1000)
    found = probabilities(begins)
    assert begins.cumulative[-1] == 1.0 and (found > 0.0).all()
    np.testing.assert_allclose(found, begins.place_density * starts.area, rtol=1e-5)


def test_photons_begin_on_sides_that_see_lamps_if_paths_look_from_there() -> None:
    """Paths look for lamps from both sides of the first object, and photons have brought light from one of them."""
    starts, seen = Starts(casters()), np.zeros(2 * _PIECES, np.float32)
    seen[:_PIECES] = 1.0
    first = starts.at_first(seen)
    even = np.arange(0, _PIECES, 2).repeat(20)
    found = probabilities(starts.by_light(seen, with_photons(first, even, 1.0), 4000))
    assert found[:_PIECES:2].sum() > 0.75
    assert found[1:_PIECES:2].sum() < 0.15


def test_what_brings_more_light_has_more_photons() -> None:
    starts, seen = Starts(casters()), np.ones(2 * _PIECES, np.float32)
    first = starts.at_first(seen)
    begun = np.random.default_rng(1).choice(2 * _PIECES, 40000, p=probabilities(first))
    photons = with_photons(first, begun, 1.0)
    density = first.place_density[begun].astype(np.float64)
    # Light is ten times as bright on the second object, 5.5 on average. A quarter of the photons does not go by it.
    light = np.where(begun >= _PIECES, 10.0, 1.0)
    photons.photons[:, PHOTON_POWER : PHOTON_POWER + 3] = (light / density)[:, None]
    found = starts.by_light(seen, photons, len(begun)).place_density
    expected = (0.25 + 0.75 * 10.0 / 5.5) / (0.25 + 0.75 / 5.5)
    assert found[_PIECES:].mean() / found[:_PIECES].mean() == pytest.approx(expected, rel=0.1)


def test_without_light_they_begin_where_paths_look() -> None:
    starts, seen = Starts(casters()), np.ones(2 * _PIECES, np.float32)
    first = starts.at_first(seen)
    np.testing.assert_array_equal(starts.by_light(seen, first, 100).place_density, first.place_density)


def test_where_few_paths_look_chance_tells_little() -> None:
    """Of counts that differ by no more than chance has it the photons begin nearly evenly, where groups truly differ by
    these.
    """
    starts, numbers = Starts(casters()), np.random.default_rng(5)

    def spread(seen: FloatArray) -> float:
        density = starts.at_first(seen.astype(np.float32)).place_density[:_PIECES]
        return float(density.std() / density.mean())

    by_chance = numbers.poisson(starts.area / _PER_GROUP * 2.0).astype(np.float64)
    by_chance[_PIECES:] = 0.0
    assert by_chance.max() >= 2.0 and spread(by_chance) < 0.1
    truly = np.zeros(2 * _PIECES)
    truly[:_PER_GROUP] = 200.0
    # The root of how often they are seen is what photons go by.
    assert spread(truly) > 1.0


def test_the_first_map_is_small() -> None:
    """A trial may find that photons do not pay; what follows is as sharp as if it had not been small."""

    def send_off(_begins: PhotonMap, first: int, count: int) -> Float32Array:
        photons = np.zeros((count, PHOTON_WIDTH), np.float32)
        photons[:, PHOTON_P : PHOTON_P + 2] = np.random.default_rng(first).random((count, 2))
        photons[:, PHOTON_POWER : PHOTON_POWER + 3] = 1.0
        return photons

    pixels = 200_000
    maps = PhotonMaps(pixels, casters(), is_tried=False)

    def map_of(sample: int) -> PhotonMap:
        seen = np.zeros(2 * _PIECES, np.float32)
        found = maps.map_of(sample, send_off, lambda _begins: (0.0, seen), lambda _map: None)
        assert found is not None
        return found

    # Whoever asks first for a later sample has the same radii.
    third, first, second = map_of(2), map_of(0), map_of(1)
    assert len(first.photons) < len(second.photons) == pixels
    # Sixteen neighbours within a disc.
    assert len(first.photons) * np.pi * float(first.numbers[MAP_RADIUS]) ** 2 == pytest.approx(16.0, rel=0.1)
    # The light is the same everywhere: as many as there may be.
    radius = float(second.numbers[MAP_RADIUS])
    assert pixels * np.pi * radius**2 == pytest.approx(MOST_NEIGHBOURS, rel=0.2)
    counts = [len(first.photons), len(second.photons), len(third.photons)]
    assert third.numbers[MAP_RADIUS] == pytest.approx(radius * (sum(counts) / sum(counts[:2])) ** (-1 / 6), rel=1e-4)
