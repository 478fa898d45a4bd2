# SPDX-License-Identifier: GPL-3.0-or-later
"""Adaptive subdivision: meshes are divided as often as the picture can show, and the file stays as it is."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from addon.versions import SETTINGS, is_since  # noqa: E402
from tests.helpers.blender_scenes import render_and_export  # noqa: E402
from tests.helpers.pass_scenes import render_both  # noqa: E402

pytestmark = pytest.mark.skipif(
    not is_since(SETTINGS["use_adaptive_subdivision"].since), reason="this Blender subdivides before it is asked to"
)


def subdivided(item: Any, level: int, **settings: Any) -> Any:
    """An adaptive subdivision modifier on an object."""
    modifier = item.modifiers.new("Subdivision", "SUBSURF")
    modifier.render_levels, modifier.use_adaptive_subdivision = level, True
    for name, value in settings.items():
        setattr(modifier, name, value)
    return modifier


def level_of(scene: Any, resolution: int = 64) -> int:
    """How many times the cube of a scene was divided in a render."""
    description = render_and_export(scene, resolution=resolution)
    mesh = description.meshes[description.instances.mesh[description.instances.name.index("Cube")]]
    return round(np.log(len(mesh.triangles) / 12) / np.log(4))


def test_a_level_out_of_reach_costs_what_the_picture_shows(cube_scene: Any, tmp_path: Path) -> None:
    """Level 11 of a cube is 25 million faces; the picture is Cycles' all the same."""
    modifier = subdivided(bpy.data.objects["Cube"], 11)
    cube_scene.render.resolution_x = cube_scene.render.resolution_y = 64
    began = time.monotonic()
    description = render_and_export(cube_scene, resolution=64)
    # 40 s and 4.7 GiB before; a tenth of a second now.
    assert time.monotonic() - began < 10.0
    assert max(len(mesh.triangles) for mesh in description.meshes) < 200_000
    assert modifier.render_levels == 11
    (notice,) = (notice for notice in description.notices if notice.subject == "Cube")
    assert notice.problem == "adaptive subdivision is not supported"
    assert notice.fallback.startswith("subdivided evenly") and notice.fallback.endswith("instead of 11")
    (ours, _), (theirs, _) = render_both(cube_scene, tmp_path, 64)
    for channel in "RGB":
        image, expected = (images[f"ViewLayer.Combined.{channel}"] for images in (ours, theirs))
        blocks = [picture.reshape(8, 8, 8, 8).mean(axis=(1, 3)) for picture in (image, expected)]
        np.testing.assert_allclose(blocks[0], blocks[1], rtol=0.05, atol=0.02 * expected.max())


def test_levels_follow_what_the_camera_sees(cube_scene: Any) -> None:
    cube = bpy.data.objects["Cube"]
    modifier = subdivided(cube, 8)
    near = level_of(cube_scene)
    modifier.adaptive_pixel_size = 4.0
    coarse = level_of(cube_scene)
    modifier.adaptive_pixel_size = 1.0
    cube.location = 100.0 * (cube.location - cube_scene.camera.location) + cube_scene.camera.location
    far = level_of(cube_scene)
    assert near == coarse + 2 and near > far + 2
    modifier.adaptive_space, modifier.adaptive_object_edge_length = "OBJECT", 0.3
    # Edges of the cube are 2 long: 2 / 2^3 is the first below 0.3.
    assert level_of(cube_scene) == 3


def test_lower_levels_and_others_stay(cube_scene: Any) -> None:
    modifier = subdivided(bpy.data.objects["Cube"], 2)
    assert level_of(cube_scene, resolution=256) == 2
    modifier.render_levels, modifier.use_adaptive_subdivision = 6, False
    assert level_of(cube_scene) == 6


def test_levels_hold_while_the_shutter_is_open(cube_scene: Any) -> None:
    """At other times Blender evaluates anew; the mesh has the same faces there, so that its shape can be blurred."""
    cube = bpy.data.objects["Cube"]
    cube.shape_key_add(name="Basis")
    key = cube.shape_key_add(name="Grown")
    for point in key.data:
        point.co = 1.5 * point.co
    for frame, value in ((0, 0.0), (2, 1.0)):
        key.value = value
        key.keyframe_insert("value", frame=frame)
    subdivided(cube, 9)
    cube_scene.render.use_motion_blur = True
    description = render_and_export(cube_scene, resolution=32)
    mesh = description.meshes[description.instances.mesh[description.instances.name.index("Cube")]]
    assert len(mesh.triangles) < 200_000
    assert mesh.motion_vertices is not None
    sizes = np.abs(mesh.motion_vertices).max(axis=(1, 2))
    assert sizes[0] < sizes[-1]


def test_later_frames_of_persistent_data(cube_scene: Any) -> None:
    from addon.export import ExportCache

    cube_scene.render.use_persistent_data = True
    modifier = subdivided(bpy.data.objects["Cube"], 9)
    frames = render_and_export(cube_scene, frames=3, cache=ExportCache(), resolution=32)
    counts = [sum(len(mesh.triangles) for mesh in description.meshes) for description in frames]
    assert counts[0] == counts[1] == counts[2] < 200_000
    assert modifier.render_levels == 9
