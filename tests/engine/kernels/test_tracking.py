# SPDX-License-Identifier: GPL-3.0-or-later
"""Following rays through grids: where they may collide is where the bounds say, and voxels are read across tiles."""

from __future__ import annotations

import numpy as np
import pytest

from engine.builder.scene import SceneCache, build_scene
from engine.kernels.shader.grids import sample_grid
from engine.kernels.tracking import majorant_at, next_collision
from engine.render.tracer import Tracer
from engine.settings import RenderSettings
from tests.helpers.media_scenes import box_of_voxels

_RANDOM = np.random.default_rng(3)


def _values(width=1):
    values = _RANDOM.random((20, 20, 20, width), np.float32)
    values[:, :9, 5:] = 0.0
    return values


def _expected(view, origin, direction, t, end, depth):
    """What `next_collision` finds, cell by cell: distance and bound, 0: nowhere."""
    while t < end:
        bound, ahead = majorant_at(view, 0, 0, origin, direction, np.float32(0.0), np.float32(t))
        ahead = min(ahead, end - t)
        if depth < bound * ahead:
            return t + depth / bound, bound
        depth -= bound * ahead
        t += ahead
    return end, 0.0


def test_a_ray_collides_where_the_bounds_of_all_cells_on_its_way_say():
    scene = build_scene(box_of_voxels(_values(), 2.0), RenderSettings(), SceneCache())
    tracer = Tracer(scene, RenderSettings())
    (batch,) = tracer.make_batches(1, 1, is_guided=False, records=False)
    paths, media = batch.work.paths, batch.work.media
    media.count[0], media.instance[0, 0], media.medium[0, 0] = 1, 0, 0
    rays = [((0.0, 0.0, 1.0), (0.0, 0.0, -1.0)), ((-1.0, 0.3, -0.7), (1.0, 0.0, 0.0))]
    for _ in range(40):
        direction = _RANDOM.normal(size=3)
        rays.append((tuple(_RANDOM.uniform(-1.0, 1.0, 3)), tuple(direction / np.linalg.norm(direction))))
    count = 0
    for origin, direction in rays:
        start, end, u = (np.float32(value) for value in (0.1 * _RANDOM.random(), 1.5, _RANDOM.random()))
        origin, direction = (tuple(np.float32(x) for x in vector) for vector in (origin, direction))
        t, entry, bound = next_collision(
            tracer.view, paths, media, 0, origin, direction, np.float32(0.0), start, end, u, np.float32(0.5), True
        )
        expected, expected_bound = _expected(tracer.view, origin, direction, start, end, -np.log(1.0 - u))
        assert t == pytest.approx(expected, abs=2e-4)
        assert (entry >= 0) == (expected_bound > 0.0)
        count += entry >= 0
        if entry >= 0:
            assert bound == pytest.approx(expected_bound, rel=1e-5)
    assert 10 < count < len(rays)


@pytest.mark.parametrize("width", [1, 3])
def test_voxels_are_mixed_alike_within_a_tile_and_across_tiles(width):
    values = _values(width)
    scene = build_scene(box_of_voxels(values), RenderSettings(), SceneCache())
    grids = scene.geometry.grids
    for point in _RANDOM.uniform(-1.0, 1.0, (200, 3)).astype(np.float32):
        place = (point.astype(np.float64) + 1.0) * 19 / 2.0
        low = np.minimum(place.astype(int), 18)
        part = values[tuple(slice(at, at + 2) for at in low)].astype(np.float64)
        for fraction in place - low:
            part = part[0] * (1.0 - fraction) + part[1] * fraction
        found = sample_grid(grids, 0, tuple(point), False)
        assert found == pytest.approx(np.broadcast_to(part, 3), abs=1e-4)
