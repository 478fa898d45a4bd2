# SPDX-License-Identifier: GPL-3.0-or-later
"""Objects that are in Edit Mode: files are saved so, and viewports show it while one works."""

from __future__ import annotations

from typing import Any

import bpy
import pytest

from tests.helpers.blender_scenes import empty_scene, render_and_export
from tests.helpers.plain_meshes import add_material, add_square


@pytest.fixture
def scene() -> Any:
    return empty_scene()


@pytest.fixture
def edited(scene: Any) -> Any:
    """Three squares in a row, made of one by a modifier, being edited."""
    square = add_square()
    square.data.uv_layers.new(name="UVMap")
    add_material(square, ("ShaderNodeUVMap", {"uv_map": "UVMap"}), output="UV")
    square.modifiers.new("Array", "ARRAY").count = 3
    bpy.context.view_layer.objects.active = square
    bpy.ops.object.mode_set(mode="EDIT")
    yield square
    bpy.ops.object.mode_set(mode="OBJECT")


@pytest.mark.parametrize("count", [3, 1])
def test_what_is_edited_is_seen_with_the_modifiers_that_are_shown_there(
    scene: Any, edited: Any, count: int
) -> None:
    """As in Cycles. Blender's evaluated datablock is empty where there are none."""
    edited.modifiers[0].show_in_editmode = count == 3
    description = render_and_export(scene)
    assert len(description.meshes[0].triangles) == 2 * count
    assert description.meshes[0].vertices[:, 0].max() == pytest.approx(count)
    assert any(len(attribute.data) == 6 * count for attribute in description.meshes[0].attributes.values())
    assert not description.notices


def test_what_is_edited_now_is_seen(scene: Any, edited: Any) -> None:
    edited.modifiers.clear()
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.mesh.duplicate_move(TRANSFORM_OT_translate={"value": (0.0, 1.0, 0.0)})
    assert len(render_and_export(scene).meshes[0].triangles) == 4


def test_motion_blur_shows_what_is_edited_in_its_shape_and_says_so(scene: Any, edited: Any) -> None:
    scene.render.use_motion_blur = True
    edited.modifiers[0].show_in_editmode = False
    description = render_and_export(scene)
    assert len(description.meshes[0].triangles) == 2
    assert [notice.problem for notice in description.notices] == ["it is in Edit Mode"]
