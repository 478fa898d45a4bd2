# SPDX-License-Identifier: GPL-3.0-or-later
"""Which instances were never moved off what they are copies of."""

from __future__ import annotations

import numpy as np
import pytest

from engine.builder.copies import unmoved_copies
from engine.builder.world_boxes import WorldBoxes, world_boxes, world_matrices
from engine.scene.description import Mesh
from engine.state.geometry import INSTANCE_FLAG_BAKED, INSTANCE_FLAGS
from tests.helpers.placed_quads import QUAD, QUAD_TRIANGLES, at, built, quad_scene, turned


def found(scene):
    geometry = built(scene)[0]
    with np.errstate(all="ignore"):
        return unmoved_copies(geometry, world_boxes(geometry, world_matrices(geometry))).tolist()


@pytest.mark.parametrize("place", [np.eye(4), turned(0.7, 0, (3.0, -2.0, 5.0), (1.0, 2.0, 1.0))])
def test_copies_of_one_mesh_are_found_where_they_are(place):
    moved = at(0.0, 0.0, 1e-5) @ place
    assert found(quad_scene([place])) == [False]
    assert found(quad_scene([place, moved, place, at(9.0, 0.0, 0.0), place])) == [True, False, True, False, True]
    assert found(quad_scene([place, moved])) == [False, False]


def test_copies_that_have_a_mesh_of_their_own_are_found_however_they_are_divided():
    place = turned(0.7, 0, (3.0, -2.0, 5.0))
    scene = quad_scene([place, place, place])
    scene.meshes.append(Mesh("own", "Own", QUAD, QUAD_TRIANGLES, None, np.zeros(2, np.int32)))
    other = np.array([(1, 2, 3), (1, 3, 0)], np.uint32)
    scene.meshes.append(Mesh("divided", "Divided", QUAD, other, None, np.zeros(2, np.int32)))
    scene.instances.mesh = np.array([0, 1, 2], np.int32)
    assert (built(scene)[0].instance_table[:, INSTANCE_FLAGS] & INSTANCE_FLAG_BAKED).all()
    assert found(scene) == [True] * 3


@pytest.mark.filterwarnings("error")
def test_what_is_nowhere_is_no_copy():
    with np.errstate(all="ignore"):
        assert found(quad_scene([np.full((4, 4), np.nan)] * 2)) == [False, False]
        assert found(quad_scene([])) == []


def test_boxes_of_which_the_first_number_agrees_are_compared_as_a_whole():
    geometry = built(quad_scene([np.eye(4)] * 3))[0]
    low, high = np.zeros((3, 3)), np.zeros((3, 3))
    low[1, 0], high[1, 0] = -0.618, 1.0
    assert unmoved_copies(geometry, WorldBoxes(low, high, np.ones(3))).tolist() == [True, False, True]
