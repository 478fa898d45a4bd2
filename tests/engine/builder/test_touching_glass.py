# SPDX-License-Identifier: GPL-3.0-or-later
"""Faces of glass that lie in other surfaces: which are drawn into the glass, how far, and what the picture is then."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from engine.builder.boundaries import APART
from engine.builder.scene import SceneCache, build_scene
from engine.builder.touching_glass import draw_into_glass, touching_faces
from engine.scene.description import Link, Material, Node, NodeGraph
from engine.settings import RenderSettings
from tests.helpers.media_renders import picture
from tests.helpers.media_scenes import media_scene, medium, placed, put_into_ball
from tests.helpers.small_scenes import material

NOTHING = np.zeros(2, bool)
IS_GLASS = np.array([True, False])


def glass(name="Glass", **inputs):
    node = Node("ShaderNodeBsdfGlass", "Glass", {"Color": (1.0, 1.0, 1.0, 1.0), "Roughness": 0.0, "IOR": 1.5, **inputs})
    return Material(name, name, NodeGraph([node], Link(0, "BSDF")))


def on_a_floor(gap=0.0, place=lambda matrix: matrix, first=None, offset=(0.0, 0.0)):
    """A box of glass, 2 m wide, on the upper face of a flat one."""
    boxes = [placed(offset=(*offset, 1.0 + gap)), placed((4.0, 4.0, 0.5), (0.0, 0.0, -0.5))]
    return media_scene([first or glass(), material()], [place(box) for box in boxes])


def turned(matrix):
    """A transform followed by a turn about an axis that is none of the coordinates', and a mirror."""
    angle, axis = 0.7, np.array([1.0, 2.0, 3.0]) / np.sqrt(14.0)
    cross = np.cross(np.eye(3), axis)
    turn = np.eye(4)
    turn[:3, :3] += np.sin(angle) * -cross + (1.0 - np.cos(angle)) * cross @ cross
    return (np.diag([-1.0, 1.0, 1.0, 1.0]) @ turn @ matrix).astype(np.float32)


@pytest.mark.parametrize("place", [lambda matrix: matrix, turned])
def test_the_face_on_the_floor_moves_into_the_glass_and_no_other(place):
    scene = on_a_floor(place=place)
    offsets = touching_faces(scene, IS_GLASS, NOTHING)
    assert list(offsets) == [0]
    at_the_bottom = scene.meshes[0].vertices[:, 2] < 0.0
    assert np.allclose(offsets[0][~at_the_bottom], 0.0) and np.allclose(offsets[0][at_the_bottom, :2], 0.0, atol=1e-9)
    # The corners of the floor are the farthest coordinates.
    assert 0.5 < offsets[0][at_the_bottom, 2].min() / (4.0 * APART) <= offsets[0][:, 2].max() / (4.0 * APART) < 1.5
    drawn = draw_into_glass(scene, offsets)
    assert drawn.meshes[0].key != scene.meshes[0].key
    assert (drawn.meshes[0].vertices[at_the_bottom, 2] > scene.meshes[0].vertices[at_the_bottom, 2]).all()


@pytest.mark.parametrize(
    "scene",
    [
        on_a_floor(gap=1e-4),
        on_a_floor(offset=(5.0, 0.0)),
        on_a_floor(offset=(5.5, 0.0)),
        on_a_floor(gap=-0.7),
        put_into_ball(on_a_floor()),
    ],
    ids=["above", "beside, with a common edge", "beside", "through", "balls"],
)
def test_glass_that_lies_in_no_other_surface_stays_as_it_is(scene):
    assert touching_faces(scene, IS_GLASS, NOTHING) == {}
    assert draw_into_glass(scene, {}) is scene


def test_what_is_no_glass_and_sheets_without_a_thickness_stay_as_they_are():
    assert touching_faces(on_a_floor(), NOTHING, NOTHING) == {}
    # Boundaries of media are drawn apart by themselves.
    assert touching_faces(on_a_floor(), IS_GLASS, np.array([False, True])) == {}
    scene = on_a_floor()
    assert touching_faces(with_faces(scene, [0, 1]), IS_GLASS, NOTHING) == {}


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("number", [0, 1])
def test_broken_meshes_touch_nothing(number):
    for triangles, vertices in ((np.array([[0, 1, 99]], np.uint32), None), (None, np.nan)):
        scene = on_a_floor()
        broken = replace(scene.meshes[0], key="broken", vertices=scene.meshes[0].vertices.copy())
        if triangles is not None:
            broken.triangles, broken.material_slots = triangles, np.zeros(1, np.int32)
        if vertices is not None:
            broken.vertices[0] = vertices
        scene.meshes.append(broken)
        scene.instances.mesh[number] = 1
        assert touching_faces(scene, IS_GLASS, NOTHING) == {}


def with_faces(scene, faces, turn=False):
    """The scene with a mesh of its own for the glass: these of its triangles, turned to the other side if need be."""
    whole = scene.meshes[0]
    triangles = whole.triangles[faces][:, ::-1] if turn else whole.triangles[faces]
    part = replace(whole, key="part", triangles=triangles, material_slots=whole.material_slots[faces])
    scene.meshes.append(part)
    scene.instances.mesh[0] = 1
    return scene


@pytest.mark.parametrize("faces, turn", [([0, 1, 4, 5, 6, 7], False), (list(range(12)), True)], ids=["open", "turned"])
def test_open_glass_is_behind_its_faces_and_closed_glass_within_them(faces, turn):
    offsets = touching_faces(with_faces(on_a_floor(), faces, turn), IS_GLASS, NOTHING)
    assert list(offsets) == [1] and offsets[1][:, 2].max() > 0.0 and offsets[1].min() == 0.0


def test_glass_that_changes_its_shape_moves_at_all_times():
    scene = on_a_floor()
    mesh = scene.meshes[0]
    mesh.motion_vertices = np.stack([mesh.vertices, mesh.vertices])
    drawn = draw_into_glass(scene, touching_faces(scene, IS_GLASS, NOTHING)).meshes[0]
    assert (drawn.motion_vertices == drawn.vertices).all()


INK = medium("Absorption", "ShaderNodeBsdfGlass", Color=(0.5, 0.2, 0.8, 1.0), Density=0.2)
INK.graph.nodes[1].inputs["IOR"] = 1.5


@pytest.mark.parametrize("first", [glass(), INK, glass(Roughness=0.3)], ids=["smooth", "with ink inside", "rough"])
def test_glass_on_a_floor_is_as_bright_as_a_little_above_it(first):
    """A ray that missed the floor behind the glass, or left the glass without being bent, would change the picture."""
    settings = {"samples": 512, "max_bounces": 12}
    gaps = [picture(on_a_floor(gap, first=first), **settings).mean(axis=(0, 1)) for gap in (0.0, 1e-4, 1e-3)]
    assert np.allclose(gaps[1], gaps[2], rtol=3e-3)
    assert np.allclose(gaps[0], gaps[1], rtol=3e-3)


def test_a_session_draws_apart_once_and_puts_back_what_no_longer_touches():
    settings, cache = RenderSettings(samples=1, threads=1, spectral="OFF"), SceneCache()
    touching = build_scene(on_a_floor(), settings, cache).geometry
    assert build_scene(on_a_floor(), settings, cache).geometry is touching
    above = build_scene(on_a_floor(1e-4), settings, cache).geometry
    fresh = build_scene(on_a_floor(1e-4), settings, SceneCache()).geometry
    assert np.array_equal(above.vertices, fresh.vertices) and not np.array_equal(above.vertices, touching.vertices)
