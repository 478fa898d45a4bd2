# SPDX-License-Identifier: GPL-3.0-or-later
"""Units are added to the film in float32, product and sum rounded one after the other; alike tasks all at once."""

from __future__ import annotations

import numpy as np
import pytest

from engine.guiding.policy.trial import ArmSamples
from engine.render.film import Film
from engine.render.render_loop import RenderLoop
from engine.render.request import RenderRequest
from engine.render.schedule import is_alike
from engine.render.strata import StrataFilm
from engine.scene.description import Frame
from engine.settings import RenderSettings
from engine.state.columns import rows_of
from engine.state.film import FilmLayout, allocate_tile
from engine.state.unit import UnitCosts

LAYOUT = FilmLayout(
    use_features=True, use_residual=True, use_half=True, use_denoising=True, light_part_count=2, has_catchers=True
)


def some_sums(random, count, *, is_read_only=False):
    tile = allocate_tile(count, 3, LAYOUT)
    for column in tile:
        column[...] = (random.random(column.shape) * 50.0).astype(column.dtype)
        column.flags.writeable = not is_read_only
    return tile


@pytest.mark.parametrize("weight", [1.0, 0.3, 2.0 / 3.0])
@pytest.mark.parametrize("is_read_only", [False, True])
def test_sums_are_rounded_as_numpy_does(weight, is_read_only):
    random = np.random.default_rng(4)
    film = Film(16, 8, LAYOUT)
    expected = {name: column.copy() for name, column in film.sums._asdict().items()}
    factor = np.float32(weight)
    for _ in range(3):
        tile = some_sums(random, 40, is_read_only=is_read_only)
        pixels = random.permutation(128)[:40]
        first = expected["count"][pixels] == 0
        film.merge(pixels, tile, weight)
        for name, column in tile._asdict().items():
            if name == "points":
                expected[name][pixels[first]] = column[first]
            elif name in ("weight", "weight_squared"):
                expected[name][pixels] += tile.count * (factor if name == "weight" else factor * factor)
            elif name == "residual_square":
                expected[name][pixels] += column * (factor * factor)
            elif name == "count":
                expected[name][pixels] += column
            elif column.size:
                expected[name][pixels] += column * factor
    for name, column in film.sums._asdict().items():
        np.testing.assert_array_equal(column, expected[name], name)


@pytest.mark.parametrize("strata", [1, 2])
def test_alike_tasks_at_once_are_what_they_are_one_by_one(strata):
    frame = Frame(96, 64, (0, 0, 96, 64))
    settings = RenderSettings(samples=64, guiding_method="VMM", deterministic=True, strata=strata, seed=1)
    films, learners = [], []
    for at_once in (False, True):
        random = np.random.default_rng(7)
        film = Film(96, 64, LAYOUT) if strata == 1 else StrataFilm(96, 64, strata, LAYOUT)
        loop = RenderLoop(RenderRequest(frame, settings), film, 1, lambda guidance, arm: None)
        loop.ready()
        tasks = [loop.take() for _ in loop.tiles]
        assert all(is_alike(task, tasks[0]) for task in tasks)
        assert tasks[0].arm_samples == ArmSamples(*tasks[0].arm_samples)
        units = [loop.unit(task) for task in tasks]
        counts = [len(unit.pixels) * strata for unit in units]
        ends = np.cumsum(counts)
        sums, costs = some_sums(random, int(ends[-1])), [UnitCosts(1.0, 7, 3, 2)] * len(tasks)
        if at_once:
            loop.keep_alike(tasks, units, sums, costs, None)
        else:
            for task, unit, count, end in zip(tasks, units, counts, ends, strict=True):
                loop.keep(task, unit, rows_of(sums, end - count, end), costs[0], None)
        films.append(film)
        learners.append(loop.progress(0).fraction)
        loop.learner.close()
    one, other = (film.sums._asdict() for film in films)
    for name, column in one.items():
        np.testing.assert_array_equal(column, other[name], name)
    assert learners[0] == learners[1] > 0.0
