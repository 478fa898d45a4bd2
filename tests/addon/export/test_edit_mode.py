# SPDX-License-Identifier: GPL-3.0-or-later
"""Objects that are in Edit Mode: files are saved so, and viewports show it while one works."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np
import pytest

from tests.helpers.blender_scenes import empty_scene, export
from tests.helpers.plain_meshes import add_square


@pytest.fixture
def scene() -> Any:
    return empty_scene()


@pytest.mark.parametrize("use_motion_blur", [False, True])
def test_what_is_edited_is_seen_as_in_object_mode(scene: Any, use_motion_blur: bool) -> None:
    """Blender's evaluated datablock is empty then."""
    square = add_square()
    square.modifiers.new("Array", "ARRAY").count = 3
    scene.render.use_motion_blur = use_motion_blur
    before = export().meshes[0]
    bpy.context.view_layer.objects.active = square
    bpy.ops.object.mode_set(mode="EDIT")
    try:
        description = export()
    finally:
        bpy.ops.object.mode_set(mode="OBJECT")
    mesh = description.meshes[0]
    np.testing.assert_array_equal(mesh.vertices, before.vertices)
    np.testing.assert_array_equal(mesh.triangles, before.triangles)
    assert len(mesh.triangles) == 6
    said = [notice.problem for notice in description.notices]
    assert said == (["it is in Edit Mode"] if use_motion_blur else [])
