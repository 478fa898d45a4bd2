# SPDX-License-Identifier: GPL-3.0-or-later
"""What Blender's updates mean. The batches are those that Blender 3.4 sends for the edits named."""

from __future__ import annotations

import pytest

from addon.viewport.classify import Change, Touched, classify


def touched(kind: str, flags: str = "", object_kind: str = "") -> Touched:
    return Touched(kind, object_kind, "g" in flags, "t" in flags, "s" in flags)


TREE = touched("ShaderNodeTree")
SHADING = Change.MATERIALS | Change.WORLD | Change.LIGHTS


@pytest.mark.parametrize(
    "edit, batch, expected",
    [
        ("nothing", [], Change.NOTHING),
        ("an object is named or selected", [touched("Object", "", "MESH")], Change.NOTHING),
        ("another tab or workspace", [touched("WorkSpace"), touched("Screen")], Change.NOTHING),
        ("colour management, visibility, the frame", [touched("Scene")], Change.SETTINGS),
        ("an object is moved", [touched("Object", "t", "MESH")], Change.TRANSFORMS),
        ("an object's colour", [touched("Object", "s", "MESH")], Change.MATERIALS),
        ("a light is moved", [touched("Object", "t", "LIGHT")], Change.LIGHTS),
        ("a light's strength", [touched("Object", "g", "LIGHT"), touched("AreaLight", "gts")], Change.LIGHTS),
        ("a camera is moved", [touched("Object", "t", "CAMERA")], Change.CAMERA),
        ("a camera's lens", [touched("Object", "g", "CAMERA"), touched("Camera", "gts")], Change.CAMERA),
        ("a material", [touched("Material", "s"), TREE], Change.MATERIALS),
        ("the world", [touched("World", "s"), TREE], Change.WORLD),
        ("a light's nodes", [touched("PointLight", "s"), TREE], Change.LIGHTS),
        ("a tree of whom is not said", [TREE], SHADING),
        ("an image", [touched("Image")], SHADING),
        ("a mesh is edited", [touched("Object", "g", "MESH"), touched("Mesh", "gts")], Change.TOPOLOGY),
        ("an object is added", [touched("Scene"), touched("Object", "gts", "MESH"), touched("Collection", "g")],
         Change.SETTINGS | Change.TOPOLOGY),
        ("something yet to come", [touched("Whatever")], Change.TOPOLOGY),
    ],
)  # fmt: skip
def test_edits(edit: str, batch: list[Touched], expected: Change) -> None:
    assert classify(batch) == expected, edit


def test_objects_whose_properties_materials_read_are_looked_at() -> None:
    assert classify([touched("Object", "", "MESH")], reads_objects=True) == Change.TOPOLOGY
