# SPDX-License-Identifier: GPL-3.0-or-later
"""Culling by camera and by distance, as Simplify asks for it."""

from __future__ import annotations

from typing import Any

import pytest

from tests.helpers.blender_scenes import empty_scene

bpy = pytest.importorskip("bpy")


@pytest.fixture
def scene() -> Any:
    """Triangles around a camera at the origin that looks down, each of which may be culled by both means."""
    scene = empty_scene()
    scene.camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    scene.collection.objects.link(scene.camera)
    scene.camera.data.sensor_width = scene.camera.data.lens = 36.0
    scene.render.resolution_x = scene.render.resolution_y = 100
    places = {"seen": (0, 0, -4), "beside": (4, 0, -4), "behind": (0, 0, 4), "edge": (2.3, 0, -4), "far": (0, 0, -90)}
    for name, place in places.items():
        data = bpy.data.meshes.new(name)
        data.from_pydata([(-0.1, -0.1, 0), (0.1, -0.1, 0), (0, 0.1, 0)], [], [(0, 1, 2)])
        made = bpy.data.objects.new(name, data)
        made.location = place
        scene.collection.objects.link(made)
    scene.render.use_simplify = True
    return scene


def shown(scene: Any, by_camera: bool = False, by_distance: bool = False) -> set[str]:
    """Which objects are exported where all want to be culled by these means."""
    from addon.export.scene import export_scene

    for thing in scene.objects:
        if thing.type == "MESH":
            thing.cycles.use_camera_cull, thing.cycles.use_distance_cull = by_camera, by_distance
    scene.update_tag()
    bpy.context.view_layer.update()
    return set(export_scene(bpy.context.evaluated_depsgraph_get()).instances.name)


EVERYTHING = {"seen", "beside", "behind", "edge", "far"}


def test_nothing_is_culled_unless_scene_and_object_want_it(scene: Any) -> None:
    assert shown(scene, True, True) == EVERYTHING
    scene.cycles.use_camera_cull = scene.cycles.use_distance_cull = True
    assert shown(scene) == EVERYTHING
    scene.render.use_simplify = False
    assert shown(scene, True, True) == EVERYTHING


def test_the_camera_culls_what_is_beside_and_behind(scene: Any) -> None:
    scene.cycles.use_camera_cull = True
    scene.cycles.camera_cull_margin = 0.0
    assert shown(scene, True) == {"seen", "far"}
    scene.cycles.camera_cull_margin = 0.2
    assert shown(scene, True) == {"seen", "edge", "far"}


def test_distance_culls_what_is_beyond_it(scene: Any) -> None:
    scene.cycles.use_distance_cull = True
    scene.cycles.distance_cull_margin = 10.0
    assert shown(scene, False, True) == EVERYTHING - {"far"}
    scene.cycles.distance_cull_margin = 0.0
    assert shown(scene, False, True) == EVERYTHING


def test_by_both_means_both_have_to_want_it(scene: Any) -> None:
    scene.cycles.use_camera_cull = scene.cycles.use_distance_cull = True
    scene.cycles.distance_cull_margin = 10.0
    assert shown(scene, True, True) == EVERYTHING
    scene.cycles.distance_cull_margin = 5.0
    assert shown(scene, True, True) == EVERYTHING - {"beside"}


def test_panoramas_and_stereo_see_everything(scene: Any) -> None:
    scene.cycles.use_camera_cull = True
    scene.camera.data.type = "PANO"
    assert shown(scene, True) == EVERYTHING
