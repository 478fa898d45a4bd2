# SPDX-License-Identifier: GPL-3.0-or-later
"""What Attribute nodes name, beside Cycles: attributes of all types, Cycles' own names, properties of objects."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from addon.versions import NORMALS_AS_ATTRIBUTES, OWN_ATTRIBUTES_FIRST, is_since  # noqa: E402
from tests.helpers.attribute_scenes import DOMAINS, TYPES, compare_tiles  # noqa: E402
from tests.helpers.blender_scenes import empty_scene  # noqa: E402

#: Names that Cycles has for attributes of its own, but for those that are not read (`standard_attributes.UNREAD`).
STANDARD = (
    "generated", "uv", "tangent", "tangent_sign", "undisplaced_tangent", "undisplaced_tangent_sign", "vertex_color",
    "undeformed", "undisplaced", "undisplaced_N", "particle", "curve_intercept", "curve_length", "curve_random",
    "point_random", "ptex_face_id", "ptex_uv", "density", "color", "flame", "heat", "temperature", "velocity",
    "velocity_x", "shadow_transparency",
)  # fmt: skip

PROPERTIES = (
    "number", "whole", "switch", "off", "text", "two", "three", "four", "five", "whole two", "switches", "group", "",
    "missing", "location", "color", "color[0]", '["number"]', '["three"][1]', "pass_index", "hide_render",
    "visible_camera", "name", "rotation_mode", "rotation_euler[1]", "matrix_world", "lock_location", "scale",
    "modifiers[0].factor", 'modifiers["Still"].factor', "of the mesh", "texspace_size", "use_auto_texspace",
    "data.vertices[3].co", "parent", "cycles.ao_distance", "active_material.pass_index",
    "scale.y",
)  # fmt: skip

OF_THE_LAYER = (
    "number", "switch", "three", "five", "of the scene", "of the world", "samples", "use_sky", "frame_current",
    "render.resolution_x", "name", "gravity", "color", "missing", "",
)  # fmt: skip


def check(scene: Any, cases: list[tuple[str, str]], folder: Path, set_up: Any = None) -> list[np.ndarray]:
    """Compare all cases, and name those that differ; returns what Cycles has."""
    found = compare_tiles(scene, cases, folder, set_up)
    wrong = [
        (case, ours[4].round(4).tolist(), theirs[4].round(4).tolist())
        for case, (ours, theirs) in zip(cases, found, strict=True)
        if _differing(ours, theirs) > 1
    ]
    assert wrong == []
    return [theirs for _, theirs in found]


def _differing(ours: np.ndarray, theirs: np.ndarray) -> int:
    """How many pixels differ: one may lie on an edge between two faces."""
    is_close = np.isclose(ours, theirs, rtol=0.01, atol=0.01 * max(1.0, np.abs(theirs).max()))
    return int((~is_close.all(axis=1)).sum())


def test_all_types_on_all_domains(blender: Any, tmp_path: Path) -> None:
    names = [f"{kind} {domain}" for kind in TYPES for domain in DOMAINS]
    found = dict(zip(names, check(empty_scene(), [("GEOMETRY", name) for name in names], tmp_path), strict=True))
    # Cycles reads no more than one integer, and no matrices.
    unread = {name for name in names if "_2D" in name or "4X4" in name}
    assert {name for name in names if not found[name][:, :7].any()} - {"BOOLEAN FACE"} == unread


def test_names_that_cycles_has_itself(blender: Any, tmp_path: Path) -> None:
    names = [
        *STANDARD, "", "missing", "Group", "UVMap", "Second", "UVMap.tangent", "UVMap.tangent_sign", "Second.tangent",
        "UVMap.undisplaced_tangent", "position", "normal", "material_index", "Col", "Generated",
    ]  # fmt: skip
    found = dict(zip(names, check(empty_scene(), [("GEOMETRY", name) for name in names], tmp_path), strict=True))
    for name in ("generated", "uv", "tangent", "vertex_color", "Group", "UVMap.tangent"):
        assert found[name][:, 0].all(), name


def test_a_meshs_own_attributes_and_the_names_of_cycles(blender: Any, tmp_path: Path) -> None:
    def add(tile: Any, number: int) -> None:
        stored = tile.data.attributes.new(STANDARD[number], "FLOAT_VECTOR", "POINT")
        stored.data.foreach_set("vector", [0.1, 0.2, 0.3] * 15 + [9.0, 9.0, 9.0])

    found = check(empty_scene(), [("GEOMETRY", name) for name in STANDARD], tmp_path, add)
    own = [name for name, values in zip(STANDARD, found, strict=True) if np.allclose(values[:, :3], (0.1, 0.2, 0.3))]
    assert own == ([name for name in STANDARD if name != "generated"] if is_since(OWN_ATTRIBUTES_FIRST) else [])


def test_a_group_comes_before_an_attribute_of_its_name(blender: Any, tmp_path: Path) -> None:
    def add(tile: Any, _number: int) -> None:
        tile.data.attributes.new("Group", "FLOAT", "POINT")

    (found,) = check(empty_scene(), [("GEOMETRY", "Group")], tmp_path, add)
    assert found[:, 0].all()


def test_names_of_cycles_on_other_meshes(blender: Any, tmp_path: Path) -> None:
    cases = [
        ("flat", "tangent"), ("mixed", "tangent"), ("bare", "uv"), ("bare", "tangent"), ("bare", "tangent_sign"),
        ("bare", "UVMap.tangent"), ("bare", "vertex_color"), ("deformed", "generated"), ("deformed", "Group"),
        ("keyed", "generated"), ("flattened", "generated"),
    ]  # fmt: skip
    if not is_since(NORMALS_AS_ATTRIBUTES) or is_since(OWN_ATTRIBUTES_FIRST):
        cases += [(kind, "N") for kind in ("smooth", "flat", "mixed", "split", "sharp", "deformed")]

    def change(tile: Any, number: int) -> None:
        kind, mesh = cases[number][0], tile.data
        if kind in ("flat", "mixed"):
            mesh.polygons.foreach_set("use_smooth", [kind == "mixed" and i % 2 == 0 for i in range(9)])
        elif kind == "bare":
            for layers in (mesh.uv_layers, mesh.color_attributes):
                while layers:
                    layers.remove(layers[0])
        elif kind == "deformed":
            tile.modifiers.new("Deform", "CAST").factor = 0.8
        elif kind == "keyed":
            tile.shape_key_add(name="Basis")
            key = tile.shape_key_add(name="Grown")
            key.value = 1.0
            for point in key.data:
                point.co = 0.5 * point.co * (1.0 + point.co.length)
        elif kind == "flattened":
            for vertex in mesh.vertices:
                vertex.co.z = 0.0
        elif kind == "split":
            mesh.normals_split_custom_set([(0.3, 0.1, 1.0)] * len(mesh.loops))
        elif kind == "sharp":
            edges = mesh.attributes.new("sharp_edge", "BOOLEAN", "EDGE")
            edges.data.foreach_set("value", [i % 2 == 0 for i in range(len(edges.data))])

    check(empty_scene(), [("GEOMETRY", name) for _, name in cases], tmp_path, change)


def test_properties_of_objects_and_layers(blender: Any, tmp_path: Path) -> None:
    scene = empty_scene()
    layer = scene.view_layers[0]
    scene.world = bpy.data.worlds.new("World")
    scene.world.color = (0.2, 0.3, 0.4)
    layer["number"], layer["switch"], layer["three"], layer["five"] = 0.3, True, [0.3, 0.2, 0.1], [0.1] * 5
    scene["of the scene"], scene.world["of the world"] = 0.9, 0.45

    def fill(tile: Any, number: int) -> None:
        values = {
            "number": 0.25, "whole": 3, "switch": True, "off": False, "text": "x", "two": [0.1, 0.2],
            "three": [0.1, 0.2, 0.3], "four": [0.1, 0.2, 0.3, 0.4], "five": [0.1] * 5, "whole two": [1, 2],
            "switches": [True, False], "group": {"x": 1.0},
        }  # fmt: skip
        for name, value in values.items():
            tile[name] = value
        tile.data["of the mesh"], tile.data["texspace_size"] = 0.6, 0.7
        tile.color, tile.pass_index = (0.1, 0.2, 0.3, 0.4), 7
        tile.modifiers.new("Still", "CAST").factor = 1e-3

    cases = [(kind, name) for kind in ("OBJECT", "INSTANCER") for name in PROPERTIES]
    cases += [("VIEW_LAYER", name) for name in OF_THE_LAYER]
    found = dict(zip(cases, check(scene, cases, tmp_path, fill), strict=True))
    np.testing.assert_allclose(found["OBJECT", "switch"][0], [1.0] * 8)
    # Numbers of an array, and arrays of switches, are not properties.
    assert not found["OBJECT", "color[0]"].any() and not found["OBJECT", "scale.y"].any()
    assert not found["OBJECT", "switches"].any()


def test_what_is_not_read_is_named(blender: Any) -> None:
    from tests.helpers.attribute_scenes import attribute_material
    from tests.helpers.blender_scenes import export

    scene = empty_scene()
    bpy.ops.mesh.primitive_plane_add()
    assert scene is not None
    for name in ("pointiness", "random_per_island", "generated_transform", "uv"):
        bpy.context.object.data.materials.append(attribute_material("GEOMETRY", name))
    notices = export().notices
    assert [notice.problem for notice in notices] == [
        "attribute 'generated_transform' is not supported"
    ]


def test_normals_of_what_cycles_moves_are_in_the_world(blender: Any) -> None:
    """One object alone, that is not blurred and has no light below its surface; windows do not move meshes."""
    from addon.export.context import Window
    from tests.helpers.attribute_scenes import attribute_material
    from tests.helpers.blender_scenes import export

    if not is_since(NORMALS_AS_ATTRIBUTES):
        pytest.skip("until Blender 5.2 N is in the object's space")
    scene = empty_scene()
    bpy.ops.mesh.primitive_plane_add()
    plane = bpy.context.object
    # Turned from z to x, and mirrored.
    plane.rotation_euler, plane.scale = (0.0, math.pi / 2, 0.0), (1.0, 2.0, -3.0)
    material = attribute_material("GEOMETRY", "N")
    plane.data.materials.append(material)

    def normal(**arguments: Any) -> list[float]:
        description = export(**arguments)
        assert not description.notices
        (normals,) = [mesh.attributes["standard:N"].data for mesh in description.meshes]
        return [round(float(value), 5) + 0.0 for value in normals[0]]

    own, moved = [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]
    assert normal() == moved
    assert normal(window=Window(is_shown=lambda shown: True)) == own
    scattering = material.node_tree.nodes.new("ShaderNodeSubsurfaceScattering")
    output = next(node for node in material.node_tree.nodes if node.bl_idname == "ShaderNodeOutputMaterial")
    glow = output.inputs["Surface"].links[0].from_socket
    both = material.node_tree.nodes.new("ShaderNodeAddShader")
    material.node_tree.links.new(glow, both.inputs[0])
    material.node_tree.links.new(scattering.outputs[0], both.inputs[1])
    material.node_tree.links.new(both.outputs[0], output.inputs["Surface"])
    assert normal() == own
    material.node_tree.links.new(glow, output.inputs["Surface"])
    scene.render.use_motion_blur = True
    assert normal() == moved
    for frame, place in ((0, 0.0), (2, 1.0)):
        plane.location.x = place
        plane.keyframe_insert("location", frame=frame)
    assert normal() == own
    scene.render.use_motion_blur = False
    assert normal() == moved
    scene.collection.objects.link(plane.copy())
    assert normal() == own
