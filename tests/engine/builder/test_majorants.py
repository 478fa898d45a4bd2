# SPDX-License-Identifier: GPL-3.0-or-later
"""Bounds of media that vary: nothing is denser, and what is as it was is not looked up again."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from engine.builder.scene import SceneCache, build_scene
from engine.settings import RenderSettings
from engine.state.tracking import GRID_RESOLUTION
from tests.helpers.media_scenes import box_of_voxels, let_voxels_move, media_scene, placed, varying


def bounds_of(description, cache=None):
    """Bounds by cell along z, y and x, float32, of the only thing that has any."""
    grids = build_scene(description, RenderSettings(), cache or SceneCache()).media.arrays.majorants
    assert len(grids.table) == 1
    return grids.values.reshape(grids.table[0, GRID_RESOLUTION : GRID_RESOLUTION + 3][::-1])


def test_what_grows_steadily_is_bounded_everywhere_and_not_by_much():
    # Black: what the colour lacks is absorbed. The density is the height, where that is above 0.
    black = varying("Absorption", "Density", 3.0, Color=(0.0, 0.0, 0.0, 1.0))
    bounds = bounds_of(media_scene([black], [placed()]))
    top = np.maximum(3.0 * np.linspace(-1.0, 1.0, len(bounds) + 1)[1:], 0.0)[:, None, None]
    assert (bounds >= top).all() and (bounds <= top + 0.2).all()


def test_a_single_dense_voxel_is_found():
    values = np.full((40, 40, 40, 1), 0.01, np.float32)
    values[13, 27, 31] = 1.0
    bounds = bounds_of(box_of_voxels(values, 2.0))
    # Its place along each edge, in cells.
    x, y, z = (int(index / 39.0 * len(bounds)) for index in (13, 27, 31))
    around = bounds[z - 1 : z + 2, y - 1 : y + 2, x - 1 : x + 2]
    assert around.max() >= 2.0 and bounds[z, y, x] >= 2.0
    assert (bounds > 1.0).mean() < 0.02


@pytest.mark.parametrize(("count", "reach"), [(8, 1.0), (60, 2.0)])
def test_a_dense_voxel_bounds_no_more_than_what_is_near_it(count, reach):
    """Few voxels are looked up one by one, more of them in blocks of two."""
    values = np.full((count, count, count, 1), 0.01, np.float32)
    dense = np.array([count // 3, count // 2, count // 4])
    values[tuple(dense)] = 1.0
    bounds = bounds_of(box_of_voxels(values, 2.0))
    cells = np.array(bounds.shape[::-1])
    # Where a cell begins and ends along each edge, in voxels.
    low, high = (
        np.stack(np.meshgrid(*(np.arange(n) + k for n in cells), indexing="ij"), axis=-1) / cells * (count - 1)
        for k in (0, 1)
    )
    is_near = ((high > dense - reach) & (low < dense + reach)).all(axis=-1)
    holds = ((high > dense - 0.5) & (low < dense + 0.5)).all(axis=-1)
    bounds = bounds.transpose(2, 1, 0)
    assert bounds[~is_near].max() < 0.1
    # Half a voxel away along each axis an eighth is left.
    assert bounds[holds].min() >= 2.0 / 8.0


def test_bounds_are_kept_while_what_they_were_looked_up_of_stays():
    cache = SceneCache()
    scene = media_scene([varying("Scatter", "Density", 3.0)], [placed()])
    first = bounds_of(scene, cache)
    (kept,) = cache.bounds.bounds.values()
    # The medium goes by the object's own space: moved, it is the same.
    scene.instances.transform = placed(offset=(1.0, 2.0, 3.0))[None]
    assert np.array_equal(bounds_of(scene, cache), first)
    assert next(iter(cache.bounds.bounds.values())) is kept
    scene.materials[0] = varying("Scatter", "Density", 6.0)
    assert np.allclose(bounds_of(scene, cache), 2.0 * first, rtol=1e-4, atol=1e-4)
    # By the world's space it is another medium there.
    scene.materials[0] = varying("Scatter", "Density", 6.0, space="World")
    here = bounds_of(scene, cache)
    scene.instances.transform = placed(offset=(1.0, 2.0, 4.0))[None]
    assert bounds_of(scene, cache).max() > here.max() + 4.0


def _puff():
    values = np.zeros((40, 40, 40, 1), np.float32)
    values[18:22, 18:22, 18:22] = 1.0
    return box_of_voxels(values, 2.0)


def test_what_moves_is_bounded_everywhere_that_it_comes_to():
    random = np.random.default_rng(2)
    velocity = np.zeros((40, 40, 40, 3), np.float32)
    velocity[..., 0], velocity[..., 2] = 0.8, -0.4
    scene = let_voxels_move(_puff(), velocity + random.normal(size=velocity.shape).astype(np.float32) * 0.01)
    bounds = bounds_of(scene)
    cells = np.array(bounds.shape[::-1])
    lower, upper = scene.meshes[0].vertices.min(axis=0), scene.meshes[0].vertices.max(axis=0)
    # Its middle goes from -0.4 to 0.4 along x, and from 0.2 to -0.2 along z.
    for time in np.linspace(0.0, 1.0, 21):
        place = (time - 0.5) * np.array([0.8, 0.0, -0.4])
        x, y, z = ((place - lower) / (upper - lower) * cells).astype(int)
        assert bounds[z, y, x] >= 2.0
    # Nothing comes to where it would have to go across.
    x, y, z = ((np.array([0.0, 0.5, 0.0]) - lower) / (upper - lower) * cells).astype(int)
    assert bounds[z, y, x] < 0.5


def test_bounds_by_splines_are_those_of_the_voxels_two_away():
    values = np.zeros((24, 24, 24, 1), np.float32)
    values[10:12] = 1.0
    scene = box_of_voxels(values, 2.0)
    scene.materials[0].has_smooth_voxels = True
    bounds = bounds_of(scene)
    # Between the two layers a spline has 23/24 of what they hold, and two voxels away nothing.
    at = (10.5 - np.array([0.0, 1.9])) / 23.0 * bounds.shape[2]
    middle, beside = (bounds[:, :, int(x)].min() for x in at)
    assert middle >= 2.0 * 23.0 / 24.0 and beside > 0.0


@pytest.mark.parametrize("is_smooth", [False, True])
def test_voxels_larger_than_cells_are_bounded_everywhere_and_closely(is_smooth):
    values = np.random.default_rng(5).random((7, 7, 7)).astype(np.float32)
    scene = box_of_voxels(values[..., None], 2.0)
    scene.materials[0].has_smooth_voxels = is_smooth
    bounds = bounds_of(scene).transpose(2, 1, 0)
    # Nine points along each edge of a cell.
    count = 8 * len(bounds) + 1
    place = np.stack(np.meshgrid(*[np.linspace(0.0, 6.0, count)] * 3, indexing="ij"))
    # There is nothing around the voxels.
    padded, order = np.pad(values, 4), 3 if is_smooth else 1
    found = 2.0 * ndimage.map_coordinates(padded, place + 4.0, order=order, prefilter=False)
    for axis in range(3):
        rows = [found.take(range(start, count - 8 + start, 8), axis) for start in range(9)]
        found = np.max(rows, axis=0)
    assert (bounds >= found * (1.0 - 1e-3)).all()
    assert bounds.mean() < 1.1 * found.mean()
