# SPDX-License-Identifier: GPL-3.0-or-later
"""Bounds of media that vary: nothing is denser, and what is as it was is not looked up again."""

from __future__ import annotations

import numpy as np

from engine.builder.scene import SceneCache, build_scene
from engine.settings import RenderSettings
from engine.state.tracking import GRID_RESOLUTION
from tests.helpers.media_scenes import box_of_voxels, media_scene, placed, varying


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
