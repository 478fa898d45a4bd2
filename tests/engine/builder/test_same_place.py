# SPDX-License-Identifier: GPL-3.0-or-later
"""Which lamps lie in surfaces, what is far from the origin, and where nobody looks any further."""

from __future__ import annotations

import numpy as np
import pytest

from engine.builder.same_place import find_same_place
from engine.scene.description import VISIBLE_ALL, VISIBLE_SHADOW, Light
from engine.state.geometry import INSTANCE_FLAG_BAKED, INSTANCE_FLAG_IN_PLACE, INSTANCE_FLAGS
from tests.helpers.placed_quads import QUAD_TRIANGLES, at, built, quad_scene, turned

#: A ceiling of 6 m by 6 m, 2 m high.
CEILING = at(0.0, 0.0, 2.0, (3.0, 3.0, 1.0))


def lamp(matrix, name="Lamp", size=1.0, **settings):
    """An area lamp, `size` wide along both axes."""
    settings = {"size_x": size, "size_y": size, **settings}
    return Light(name, name, "AREA", np.asarray(matrix, np.float32), (1.0, 1.0, 1.0), 10.0, **settings)


def geometry_of(*transforms, visibility=None, **mesh):
    return built(quad_scene(transforms, visibility, **mesh))[0]


def find(geometry, lights, names, is_glass=False, is_clear=False):
    every = np.ones(len(geometry.instance_table), bool)
    return find_same_place(geometry, lights, names, is_glass & every, is_clear & every)


def said(geometry, *lamps, names=None):
    """Notices, as users read them, and the lamps that they are of."""
    names = names or [f"Quad {k}" for k in range(len(geometry.instance_table))]
    found = find(geometry, lamps, names)
    return [f"{notice.subject}: {notice.problem}" for notice in found.notices], found.lights.tolist()


@pytest.mark.parametrize(
    "place, is_in_it",
    [
        (at(0.3, 0.2, 2.0), True),
        (turned(0.5, position=(0.3, 0.2, 2.0)), True),
        (turned(np.pi, axis=0, position=(0.3, 0.2, 2.0)), True),
        (at(3.4, 0.0, 2.0), True),
        (at(0.3, 0.2, 2.0 - 1e-3), False),
        (at(0.3, 0.2, 2.0 + 1e-3), False),
        (at(3.5, 0.0, 2.0), False),
        (at(3.6, 0.0, 2.0), False),
        (turned(0.5 * np.pi, axis=0, position=(0.3, 0.2, 2.0)), False),
        (turned(1e-3, axis=0, position=(0.3, 0.2, 2.0)), False),
    ],
    ids=[
        "level", "turned in the plane", "upside down", "partly beside", "below", "above", "beside, with a common edge",
        "beside", "upright through it", "tilted through it",
    ],
)  # fmt: skip
def test_a_lamp_lies_in_what_overlaps_it_in_its_plane(place, is_in_it):
    expected = (["light Lamp: it lies in Quad 0"], [0]) if is_in_it else ([], [])
    assert said(geometry_of(CEILING), lamp(place)) == expected


def test_planes_that_are_no_coordinate_planes_are_found():
    turn = turned(0.7, 0) @ turned(0.4, 1)
    assert said(geometry_of(turn @ CEILING), lamp(turn @ at(0.3, 0.2, 2.0)))[1] == [0]
    assert said(geometry_of(turn @ CEILING), lamp(turn @ at(0.3, 0.2, 2.0 - 1e-3)))[1] == []


def test_only_area_lamps_lie_in_surfaces():
    point = Light("p", "Point", "POINT", at(0.0, 0.0, 2.0).astype(np.float32), (1.0, 1.0, 1.0), 10.0)
    assert said(geometry_of(CEILING), point, lamp(at(0.0, 0.0, 2.0)))[1] == [1]


def test_sizes_count_along_both_axes():
    beside = at(4.0, 0.0, 2.0)
    assert said(geometry_of(CEILING), lamp(beside, shape="RECTANGLE", size_x=1.0, size_y=9.0))[1] == []
    assert said(geometry_of(CEILING), lamp(beside, shape="RECTANGLE", size_x=9.0, size_y=1.0))[1] == [0]
    # A square and a disk have one size.
    assert said(geometry_of(CEILING), lamp(at(0.0, 4.0, 2.0), shape="DISK", size_x=1.0, size_y=9.0))[1] == []
    assert said(geometry_of(CEILING), lamp(at(0.0, 4.0, 2.0), shape="ELLIPSE", size_x=1.0, size_y=9.0))[1] == [0]


def test_of_instances_that_share_a_mesh_each_is_looked_at_where_it_is():
    floor, ceiling = at(0.0, 0.0, 0.0, (3.0, 3.0, 1.0)), turned(np.pi, 0, (0.0, 0.0, 2.0), (3.0, 3.0, 1.0))
    geometry = geometry_of(floor, ceiling)
    assert not (geometry.instance_table[:, INSTANCE_FLAGS] & INSTANCE_FLAG_BAKED).any(), "they are instances"
    lamps = lamp(at(0.3, 0.2, 2.0)), lamp(at(0.3, 0.2, 0.0), "Low"), lamp(at(0.3, 0.2, 1.0), "Between")
    assert said(geometry, *lamps) == (["light Lamp: it lies in Quad 1", "light Low: it lies in Quad 0"], [0, 1])


def test_what_casts_no_shadow_holds_no_lamps():
    seen = VISIBLE_ALL & ~VISIBLE_SHADOW
    assert said(geometry_of(CEILING, visibility=[seen]), lamp(at(0.0, 0.0, 2.0))) == ([], [])


def test_a_notice_names_the_first_few_surfaces():
    tiles = [at(x, y, 2.0, (0.2, 0.2, 1.0)) for x in (-0.4, 0.0, 0.4) for y in (-0.2, 0.2)]
    (sentence,), _ = said(geometry_of(*tiles), lamp(at(0.0, 0.0, 2.0)), names=[f"Tile {k}" for k in range(6)])
    assert sentence == "light Lamp: it lies in Tile 0, Tile 1, Tile 2, Tile 3 and 2 more"


@pytest.mark.parametrize(
    "distance, size, is_far", [(1e3, 10.0, False), (1e6, 10.0, True), (1e6, 1e5, False)],
    ids=["near", "far", "far for something smaller"],
)  # fmt: skip
def test_what_is_far_from_the_origin_for_its_size_is_marked(distance, size, is_far):
    geometry = geometry_of(at(distance, 0.0, 0.0, (size, size, size)))
    place = find(geometry, [], ["Quad"])
    assert place.instances.tolist() == [is_far]
    marked = place.mark(geometry, np.zeros(1, bool))
    assert (marked is geometry) is not is_far
    assert bool(marked.instance_table[0, INSTANCE_FLAGS] & INSTANCE_FLAG_IN_PLACE) is is_far
    assert not geometry.instance_table[0, INSTANCE_FLAGS] & INSTANCE_FLAG_IN_PLACE, "others may read it meanwhile"


def test_what_small_things_stand_on_is_far_where_they_are():
    ground, stone = at(1e6, 0.0, 0.0, (5e4, 5e4, 1.0)), at(1e6, 0.0, 2.0, (1.0, 1.0, 1.0))
    geometry = geometry_of(ground, stone)
    assert find(geometry, [], ["Ground", "Stone"]).instances.tolist() == [True, True]


def test_lamps_far_from_the_origin_are_found_and_not_named():
    assert said(geometry_of(CEILING), lamp(at(1e6, 0.0, 0.0)), lamp(at(1e2, 0.0, 0.0))) == ([], [0])


def test_glass_that_may_touch_is_marked_with_what_it_touches():
    geometry = geometry_of(np.eye(4), np.eye(4), at(9.0, 0.0, 0.0))
    place = find(geometry, [], ["Glass", "Table", "Wall"], np.array([True, False, False]))
    assert place.instances.tolist() == [True, True, False] and place.notices == []


def test_unmoved_copies_are_marked_but_not_those_that_rays_go_straight_through():
    geometry = geometry_of(CEILING, CEILING, CEILING, at(0.0, 0.0, 1.0))
    place = find(geometry, [], list("ABCD"), is_clear=np.array([False, True, False, False]))
    assert place.instances.tolist() == [True, False, True, False] and place.notices == []


def grid(count):
    """A square of `count` by `count` squares, from -1 to 1."""
    ticks = np.linspace(-1.0, 1.0, count + 1, dtype=np.float32)
    vertices = np.stack([*np.meshgrid(ticks, ticks, indexing="ij"), np.zeros((count + 1, count + 1))], axis=-1)
    corner = (np.arange(count)[:, None] * (count + 1) + np.arange(count)).ravel()
    triangles = corner[:, None] + np.array([[0, count + 1, count + 2], [0, count + 2, 1]])[:, None]
    flat = vertices.reshape(-1, 3).astype(np.float32), triangles.reshape(-1, 3).astype(np.uint32)
    return dict(zip(("vertices", "triangles"), flat, strict=True))


def test_what_is_divided_too_finely_holds_no_lamps_and_costs_no_time():
    """Lamps that nobody comes to count as free."""
    fine, finer = geometry_of(CEILING, **grid(150)), geometry_of(CEILING, **grid(240))
    assert said(fine, lamp(at(0.3, 0.2, 2.0)))[1] == [0]
    assert said(finer, lamp(at(0.3, 0.2, 2.0)))[1] == []
    # Each lies in a plane of its own, for which all of the mesh is looked at.
    lamps = [lamp(turned(0.01 * k, 0) @ at(0.0, 0.0, 0.0), f"Lamp {k}") for k in range(600)]
    tilted = built(quad_scene([turned(0.01 * k, 0) for k in range(600)], **grid(100)))[0]
    found = said(tilted, *lamps)[1]
    assert 0 < len(found) < 600 and found == list(range(len(found)))


@pytest.mark.filterwarnings("error")
def test_what_is_nowhere_holds_nothing():
    broken = np.array([(-1, -1, 0), (1, -1, 0), (np.inf, 1, 0), (-1, np.nan, 0)], np.float32)
    geometry = geometry_of(CEILING, vertices=broken, triangles=QUAD_TRIANGLES)
    assert said(geometry, lamp(at(0.0, 0.0, 2.0)))[0] == []
    flat = lamp(at(0.0, 0.0, 2.0), size=0.0), lamp(np.full((4, 4), np.nan))
    assert said(geometry_of(CEILING), *flat) == ([], [])
    assert said(geometry_of(), lamp(at(0.0, 0.0, 2.0))) == ([], [])
