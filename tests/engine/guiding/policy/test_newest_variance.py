# SPDX-License-Identifier: GPL-3.0-or-later
"""The variance that allocation and light shares go by is that of the newest guided samples."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from engine.guiding.policy.costs import IterationCosts
from engine.guiding.policy.iteration import Traced
from engine.guiding.policy.sets import make_learner
from engine.guiding.policy.trial import NewestVariance
from engine.guiding.records.cache_records import allocate_cache_records
from engine.guiding.records.unit_records import UnitRecords
from engine.guiding.records.vertices import VertexRecords, allocate_vertex_records
from engine.ris.orca import LEAST_RETURN, CandidateCosts, pixel_weights
from engine.settings import RenderSettings
from engine.state.film import FilmTile, allocate_tile
from engine.state.unit import CURRENT, PLAIN, Unit, UnitCosts
from tests.helpers.guiding_harness import random_directions

SIZE = (40, 50)
PIXELS = SIZE[0] * SIZE[1]
RAYS = 5
RECORDS = 2000


def samples(rng: np.random.Generator, spread: float, count: int) -> np.ndarray:
    """Samples about one: float64 (count, P, 3)."""
    return 1.0 + spread * rng.normal(size=(count, PIXELS, 3))


def sums_of(values: np.ndarray) -> FilmTile:
    """A unit of all pixels."""
    tile = allocate_tile(PIXELS, 3)
    tile.radiance[:], tile.square[:] = values.sum(axis=0), (values**2).sum(axis=0)
    tile.weight[:] = tile.count[:] = tile.weight_squared[:] = len(values)
    return tile


def records(rng: np.random.Generator) -> VertexRecords:
    """What paths in a box have met, evenly lit."""
    made = allocate_vertex_records(RECORDS)
    made.position[:], made.direction[:] = rng.random((RECORDS, 3)), random_directions(rng, RECORDS)
    made.normal[:] = (0.0, 0.0, 1.0)
    for column in (made.radiance, made.pdf, made.distance, made.roughness):
        column[:] = 1.0
    made.bsdf_pdf[:] = made.guide_pdf[:] = made.benefit[:] = np.nan
    return made


def test_allocation_goes_by_the_guided_samples_of_late() -> None:
    """Guiding makes a hundredth of the variance; the first sample, and later unguided ones, had all of it."""
    rng = np.random.default_rng(3)
    learner = make_learner(RenderSettings(guiding_method="VMM", guiding_trial=False, samples=64), 1, PIXELS)
    assert learner is not None
    sums = allocate_tile(PIXELS, 3)
    whole = np.zeros((PIXELS, 2), np.int32)
    first = 0
    guidance = learner.first()
    for count, spread in ((1, 1.0), (2, 1.0), (4, 0.1), (8, 0.1), (16, 0.1), (16, 0.1)):
        for arm in (CURRENT, PLAIN):
            is_plain = arm == PLAIN
            unit = sums_of(samples(rng, 1.0 if is_plain else spread, max(count // 4, 1) if is_plain else count))
            for column, added in zip(sums, unit, strict=True):
                column += added
            learner.compare(Unit(whole, np.arange(PIXELS), first, count, arm), unit, UnitCosts())
        made = UnitRecords(records(rng), allocate_cache_records(0))
        costs = IterationCosts(Counter(), RAYS * PIXELS * count, PIXELS * count, PIXELS * count, 0, 0)
        guidance = learner.learn(Traced([made], 0.1, sums, SIZE, costs, (first + count, count)))
        first += count
    learner.close()
    mean = (sums.radiance / sums.weight[:, None]).reshape(*SIZE, 3)
    expected = 0.1**2 * float(pixel_weights(mean).mean())
    assert guidance.allocation is not None
    found = RAYS / (LEAST_RETURN * CandidateCosts().per_candidate * guidance.allocation.constants[0])
    # The four looks before have left a little.
    assert found == pytest.approx(expected, rel=0.3)


def test_looks_forget() -> None:
    rng = np.random.default_rng(4)
    newest = NewestVariance(PIXELS)
    assert np.isnan(newest.look()).all()
    some = np.arange(PIXELS - 1)

    def add(spread: float, count: int) -> float:
        unit = sums_of(samples(rng, spread, count))
        newest.add(some, unit.radiance, unit.square, count)
        variance = newest.look()
        assert np.isnan(variance[-1])
        return float(variance[:-1].mean())

    assert np.isnan(add(10.0, 1))
    assert add(10.0, 4) == pytest.approx(100.0, rel=0.05)
    for _ in range(12):
        latest = add(1.0, 8)
    assert latest == pytest.approx(1.0, rel=0.1)
    # The mean is taken from the same samples, and that is made up for.
    few = NewestVariance(PIXELS)
    unit = sums_of(samples(rng, 2.0, 2))
    few.add(np.arange(PIXELS), unit.radiance, unit.square, 2)
    assert few.look().mean() == pytest.approx(4.0, rel=0.05)


def test_pixels_without_new_samples_are_left_out() -> None:
    """They have converged; what their variance was says nothing of what is still to be rendered."""
    rng = np.random.default_rng(5)
    newest = NewestVariance(PIXELS)
    unit = sums_of(samples(rng, 3.0, 8))
    newest.add(np.arange(PIXELS), unit.radiance, unit.square, 8)
    assert np.isfinite(newest.look()).all()
    few = np.arange(0, PIXELS, 3)
    unit = sums_of(samples(rng, 1.0, 64))
    newest.add(few, unit.radiance[few], unit.square[few], 64)
    variance = newest.look()
    assert np.array_equal(np.flatnonzero(np.isfinite(variance)), few)
