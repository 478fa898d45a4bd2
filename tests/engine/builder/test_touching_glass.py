# SPDX-License-Identifier: GPL-3.0-or-later
"""Glass that may touch other surfaces, and these: what is found, and that rays start in place there."""

from __future__ import annotations

import numpy as np
import pytest

from engine.builder.scene import SceneCache, build_scene
from engine.builder.touching_glass import touching_glass
from engine.builder.world_boxes import world_boxes, world_matrices
from engine.scene.description import Link, Material, Node, NodeGraph
from engine.settings import RenderSettings
from engine.state.geometry import INSTANCE_FLAG_IN_PLACE, INSTANCE_FLAGS
from tests.helpers.media_scenes import media_scene, placed
from tests.helpers.placed_quads import at, built, quad_scene, turned
from tests.helpers.small_scenes import material


def glass(name="Glass", **inputs):
    node = Node("ShaderNodeBsdfGlass", "Glass", {"Color": (1.0, 1.0, 1.0, 1.0), "Roughness": 0.0, "IOR": 1.5, **inputs})
    return Material(name, name, NodeGraph([node], Link(0, "BSDF")))


#: Two squares, 2 m wide, one 2 m above the other.
DECKS = {
    "vertices": np.array([(x, y, z) for z in (0, 2) for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))], np.float32),
    "triangles": np.array([(0, 1, 2), (0, 2, 3), (4, 5, 6), (4, 6, 7)], np.uint32),
}


def found(*transforms, is_glass=(True,), **mesh):
    """What may touch, of squares 2 m wide, of which the first ones may be glass."""
    geometry = built(quad_scene(transforms, **mesh))[0]
    which = np.zeros(len(transforms), bool)
    which[: len(is_glass)] = is_glass
    with np.errstate(all="ignore"):
        matrices = world_matrices(geometry)
        boxes = world_boxes(geometry, matrices)
    return touching_glass(geometry, matrices, boxes, which).tolist()


@pytest.mark.parametrize(
    "other, is_touched",
    [
        (np.eye(4), True),
        (at(9.0, 0.0, 0.0, (10.0, 10.0, 1.0)), True),
        (at(2.0, 0.0, 0.0), True),
        (turned(0.5 * np.pi, axis=0), False),
        (at(0.0, 0.0, 1e-3), False),
        (at(2.001, 0.0, 0.0), False),
    ],
    ids=["in one place", "on a large one", "with a common edge", "through it", "above", "beside"],
)
def test_glass_and_what_is_where_it_is_are_found(other, is_touched):
    assert found(np.eye(4), other) == [is_touched] * 2
    assert found(other, np.eye(4)) == [is_touched] * 2
    turn = turned(0.5 * np.pi, 1) @ at(3.0, -2.0, 5.0)
    assert found(turn, turn @ other) == [is_touched] * 2


def test_only_pairs_with_glass_are_looked_at():
    assert found(np.eye(4), np.eye(4), is_glass=(False,)) == [False, False]
    far = at(50.0, 0.0, 0.0)
    assert found(np.eye(4), np.eye(4), far, far) == [True, True, False, False]
    assert found(far, np.eye(4), np.eye(4), is_glass=(True,)) == [False, False, False]


def test_what_is_around_glass_without_being_near_is_left_alone():
    """Between two decks: the box around both is there, those around their triangles are not."""
    between = at(0.0, 0.0, 1.0, (0.1, 0.1, 0.1))
    assert found(between, np.eye(4), **DECKS) == [False, False]
    assert found(at(0.0, 0.0, 2.0, (0.1, 0.1, 0.1)), np.eye(4), **DECKS) == [True, True]
    assert found(at(0.0, 0.0, 1.9, (0.1, 0.1, 0.1)), np.eye(4), **DECKS) == [False, False], "through one"
    # The same in the space of a single user's mesh, which is the world's.
    turn = turned(0.5 * np.pi, 1) @ at(3.0, -2.0, 5.0)
    assert found(turn @ between, turn, **DECKS) == [False, False]


def test_what_nobody_comes_to_counts_as_touching():
    """Hundreds of thousands of pieces of glass take no more time than some."""
    for count, is_taken_for_granted in ((20, False), (1600, True)):
        row = [at(10.0 * k, 0.0, 0.0) for k in range(count)]
        between = row[-1] @ at(0.0, 0.0, 1.0, (0.1, 0.1, 0.1))
        which = found(*row, between, is_glass=[True] * (count - 1) + [False, True], **DECKS)
        assert which == [False] * (count - 1) + [is_taken_for_granted] * 2


@pytest.mark.filterwarnings("error")
def test_what_is_nowhere_touches_nothing():
    with np.errstate(all="ignore"):
        assert found(np.eye(4), np.full((4, 4), np.nan)) == [False, False]
        assert found(np.full((4, 4), np.inf), np.eye(4)) == [False, False]
    # What is flat has no way back to its own space.
    assert found(np.eye(4), np.diag([0.0, 1.0, 1.0, 1.0]) @ at(0.0, 0.0, 9.0)) == [False, False]


def box_on_a_floor(gap=0.0, first=None):
    return media_scene(
        [first or glass(), material()],
        [placed(offset=(0.0, 0.0, 1.0 + gap)), placed((4.0, 4.0, 0.5), (0.0, 0.0, -0.5))],
    )


def in_place(scene, cache=None):
    """On which instances rays start in place."""
    built_scene = build_scene(scene, RenderSettings(samples=1, threads=1, spectral="OFF"), cache or SceneCache())
    return (built_scene.geometry.instance_table[:, INSTANCE_FLAGS] & INSTANCE_FLAG_IN_PLACE != 0).tolist()


def test_rays_start_in_place_on_glass_and_what_it_stands_on():
    assert in_place(box_on_a_floor()) == [True, True]
    assert in_place(box_on_a_floor(gap=1e-3)) == [False, False]
    assert in_place(box_on_a_floor(first=material("Gray"))) == [False, False]


def test_a_session_looks_again_when_glass_is_moved_or_becomes_something_else():
    cache = SceneCache()
    assert in_place(box_on_a_floor(), cache) == [True, True]
    assert in_place(box_on_a_floor(gap=1e-3), cache) == [False, False]
    assert in_place(box_on_a_floor(), cache) == [True, True]
    assert in_place(box_on_a_floor(first=material("Gray")), cache) == [False, False]
