# SPDX-License-Identifier: GPL-3.0-or-later
"""Which instances have faces in one place with others that somebody may see."""

from __future__ import annotations

import numpy as np
import pytest

from engine.builder.coincident import find_coincident
from tests.helpers.placed_quads import QUAD, QUAD_TRIANGLES, at, built, quad_scene, turned

#: Corners of a cube from -1 to 1, and its faces, which face outwards.
_CUBE = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float32)
_SIDES = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
_CUBE_TRIANGLES = np.array([t for a, b, c, d in _SIDES for t in ((a, b, c), (a, c, d))], np.uint32)


def found(description):
    return find_coincident(*built(description), lambda: None).tolist()


def quads(*transforms):
    return found(quad_scene(transforms))


def cubes(*transforms, triangles=_CUBE_TRIANGLES, vertices=_CUBE):
    return found(quad_scene(transforms, vertices=vertices, triangles=triangles))


TURNED = turned(0.4, 0) @ turned(0.7, 1)


@pytest.mark.parametrize("turn", [np.eye(4), TURNED], ids=["level", "turned"])
def test_a_rug_in_a_floor_is_found_and_what_is_elsewhere_is_not(turn):
    rug = at(0.3, 0.2, 0.0, (0.5, 0.5, 1.0))
    assert quads(turn, turn @ rug, turn @ at(5.0, 0.0, 0.0), turn @ at(0.0, 0.0, 1e-3)) == [True, True, False, False]


def test_faces_that_cross_are_not():
    assert quads(np.eye(4), turned(0.5 * np.pi, 0), turned(0.5 * np.pi, 1)) == [False] * 3


def test_what_a_box_stands_on_and_boxes_side_by_side_are_not_as_nobody_sees_them():
    floor_and_box = quad_scene([at(0.0, 0.0, 0.0, (9.0, 9.0, 1.0)), at(0.0, 0.0, 1.0)])
    box = quad_scene([np.eye(4)], vertices=_CUBE, triangles=_CUBE_TRIANGLES).meshes[0]
    floor_and_box.meshes.append(box)
    floor_and_box.instances.mesh = np.array([0, 1], np.int32)
    assert found(floor_and_box) == [False, False]
    assert cubes(np.eye(4), at(2.0, 0.0, 0.0)) == [False, False]
    assert cubes(np.eye(4), at(2.0, 0.5, 0.0, (1.0, 2.0, 3.0))) == [False, False]


def test_walls_of_a_shell_without_thickness_are():
    """One layer faces outwards, the other inwards, as rooms are that were made by an extrusion of no length."""
    shell = np.concatenate([_CUBE_TRIANGLES, _CUBE_TRIANGLES[:, ::-1]])
    assert cubes(np.eye(4), triangles=shell) == [True]
    assert cubes(np.eye(4)) == [False]


def test_both_sides_of_a_leaf_are():
    assert found(quad_scene([TURNED], triangles=np.concatenate([QUAD_TRIANGLES, QUAD_TRIANGLES[:, ::-1]]))) == [True]


def test_faces_among_many_are_found_by_their_share():
    """A grid of 100,000 triangles, of which a tenth lies there twice."""
    n = 224
    x, y = np.meshgrid(np.linspace(-1, 1, n), np.linspace(-1, 1, n))
    points = np.stack([x.ravel(), y.ravel(), 0.1 * np.sin(9.0 * x.ravel())], axis=1).astype(np.float32)
    a = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    grid = np.concatenate([np.stack([a, a + 1, a + n + 1], 1), np.stack([a, a + n + 1, a + n], 1)]).astype(np.uint32)
    assert cubes(np.eye(4), vertices=points, triangles=grid) == [False]
    assert cubes(np.eye(4), vertices=points, triangles=np.concatenate([grid, grid[::10]])) == [True]


def test_nothing_is_nowhere():
    assert quads() == []
    assert quads(at(np.nan, 0.0, 0.0), at(0.0, 0.0, 0.0, (0.0, 0.0, 0.0))) == [False, False]
    assert found(quad_scene([np.eye(4)], vertices=np.full_like(QUAD, np.inf))) == [False]
