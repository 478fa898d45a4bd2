# SPDX-License-Identifier: GPL-3.0-or-later
"""What Attribute nodes read, beside Cycles: groups of vertices, names of Cycles' own, properties, geometry nodes."""

from __future__ import annotations

import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from tests.helpers.blender_scenes import empty_scene, export  # noqa: E402
from tests.helpers.pass_scenes import make_material, render_both  # noqa: E402


def glow(name: str, kind: str = "GEOMETRY", output: str = "Color") -> Any:
    """Glows in the colour of an attribute."""

    def surface(tree: Any) -> Any:
        attribute, emission = tree.nodes.new("ShaderNodeAttribute"), tree.nodes.new("ShaderNodeEmission")
        attribute.attribute_name, attribute.attribute_type = name, kind
        tree.links.new(attribute.outputs[output], emission.inputs["Color" if output == "Color" else "Strength"])
        return emission.outputs[0]

    return make_material("Glow", surface)


def seen_scene() -> Any:
    scene = empty_scene()
    scene.camera.location, scene.camera.data.lens = (0.0, 0.0, 6.0), 38.0
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = 24, 24, 100
    return scene


def assert_alike(scene: Any, folder: Path, *, is_dark: bool = False) -> None:
    (ours, _), (theirs, _) = render_both(scene, folder, 32)
    names = [next(channel for channel in ours if channel.endswith(f"Combined.{part}")) for part in "RGB"]
    cells = [np.stack([image[name] for name in names]).reshape(3, 6, 4, 6, 4).mean(axis=(2, 4))
             for image in (ours, theirs)]  # fmt: skip
    assert (np.abs(cells[1]).max() < 1e-3) == is_dark
    off = np.abs(cells[0] - cells[1]) > 0.03 + 0.06 * np.abs(cells[1])
    # Edges of the mesh and of its faces cross a few cells.
    assert np.count_nonzero(off) <= 4
    np.testing.assert_allclose(cells[0].mean(axis=(1, 2)), cells[1].mean(axis=(1, 2)), rtol=0.015, atol=0.004)


def values_of(kind: str, domain: str) -> Callable[[Any, random.Random], None]:
    """An attribute of random values."""

    def add(shown: Any, numbers: random.Random) -> None:
        for item in shown.data.attributes.new("A", kind, domain).data:
            if kind in ("INT", "INT8"):
                item.value = numbers.randint(0, 5)
            elif kind == "BOOLEAN":
                item.value = numbers.random() < 0.3
            elif kind in ("INT32_2D", "INT16_2D"):
                item.value = (numbers.randint(0, 5), numbers.randint(0, 5))
            elif kind == "BYTE_COLOR":
                item.color = [numbers.random() for _ in range(4)]
            else:
                item.value = [numbers.random() for _ in range(4)]

    return add


def group(shown: Any, numbers: random.Random) -> None:
    added = shown.vertex_groups.new(name="A")
    for vertex in shown.data.vertices:
        if numbers.random() < 0.7:
            added.add([vertex.index], numbers.random(), "REPLACE")


def group_and_attribute(shown: Any, numbers: random.Random) -> None:
    shown.data.attributes.new("A", "FLOAT", "POINT")
    group(shown, numbers)


def bent(shown: Any, numbers: random.Random) -> None:
    for polygon in shown.data.polygons:
        polygon.use_smooth = polygon.index % 3 != 0
    for vertex in shown.data.vertices:
        vertex.co.z = numbers.random()


def waving(shown: Any, numbers: random.Random) -> None:
    bent(shown, numbers)
    shown.modifiers.new("Wave", "WAVE").height = 1.0


def sharp(shown: Any, numbers: random.Random) -> None:
    bent(shown, numbers)
    for edge in shown.data.attributes.new("sharp_edge", "BOOLEAN", "EDGE").data:
        edge.value = numbers.random() < 0.3


def second_map(shown: Any, numbers: random.Random) -> None:
    bent(shown, numbers)
    for corner in shown.data.uv_layers.new(name="Second").data:
        corner.uv = (numbers.random(), numbers.random())


def colored(shown: Any, numbers: random.Random) -> None:
    for corner in shown.data.color_attributes.new("Paint", "FLOAT_COLOR", "CORNER").data:
        corner.color = [numbers.random() for _ in range(4)]


CASES = {
    "group of vertices": ("A", group), "group before attribute": ("A", group_and_attribute),
    "normals": ("N", bent), "normals at sharp edges": ("N", sharp), "generated": ("generated", waving),
    "active map": ("uv", second_map), "active colour": ("vertex_color", colored),
    "tangents": ("tangent", bent), "tangents of a map": ("Second.tangent", second_map),
    "signs of tangents": ("Second.tangent_sign", second_map), "before displacement": ("undisplaced_tangent", bent),
    "integers on edges": ("A", values_of("INT", "EDGE")), "small integers on edges": ("A", values_of("INT8", "EDGE")),
    "truths on edges": ("A", values_of("BOOLEAN", "EDGE")), "bytes on edges": ("A", values_of("BYTE_COLOR", "EDGE")),
    "turns on edges": ("A", values_of("QUATERNION", "EDGE")),
}  # fmt: skip


def grid(name: str, change: Callable[[Any, random.Random], None], kind: str = "GEOMETRY") -> Any:
    scene = seen_scene()
    bpy.ops.mesh.primitive_grid_add(x_subdivisions=4, y_subdivisions=4, size=4, rotation=(0.2, 0.1, 0.3))
    bpy.context.object.data.materials.append(glow(name, kind))
    change(bpy.context.object, random.Random(3))
    return scene


@pytest.mark.parametrize("case", CASES)
def test_names_and_types_of_meshes(case: str, blender: Any, tmp_path: Path) -> None:
    if CASES[case][0] == "N" and bpy.app.version >= (5, 2):
        pytest.skip("in Blender 5.2 Cycles has normals in world space there, and a notice says so")
    assert_alike(grid(*CASES[case]), tmp_path)


@pytest.mark.parametrize("kind", ["INT32_2D", "INT16_2D"])
def test_pairs_of_integers_are_not_there(kind: str, blender: Any, tmp_path: Path) -> None:
    if kind not in [item.identifier for item in bpy.types.Attribute.bl_rna.properties["data_type"].enum_items]:
        pytest.skip("another Blender has the type")
    assert_alike(grid("A", values_of(kind, "POINT")), tmp_path, is_dark=True)


def test_what_cycles_makes_and_we_do_not_is_named(blender: Any) -> None:
    grid("pointiness", bent)
    assert [(item.subject, item.problem, item.fallback) for item in export().notices] == [
        ("Grid / Glow / Attribute", "attribute 'pointiness' is not supported", "0 everywhere")
    ]


@pytest.mark.parametrize(
    ("name", "is_dark"),
    [("is_wet", False), ("visible_camera", False), ("scale", False), ("scale.y", True), ("scale[1]", True),
     ("color[0]", True), ("modifiers[0].height", False)],
)  # fmt: skip
def test_properties_of_objects(name: str, is_dark: bool, blender: Any, tmp_path: Path) -> None:
    def change(shown: Any, numbers: random.Random) -> None:
        waving(shown, numbers)
        shown["is_wet"] = True

    assert_alike(grid(name, change, "OBJECT"), tmp_path, is_dark=is_dark)


def scattering(kind: str, *, has_ids: bool = False, is_nested: bool = False, instanced: Any = None) -> Any:
    """Geometry nodes: cubes or a collection on a grid, with an attribute of the instances."""
    tree = bpy.data.node_groups.new("Scatter", "GeometryNodeTree")
    tree.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")

    def node(name: str, **inputs: Any) -> Any:
        added = tree.nodes.new(name)
        for key, value in inputs.items():
            added.inputs[key.replace("_", " ")].default_value = value
        return added

    def scaled_index(factor: float, least: float) -> Any:
        scaled = node("ShaderNodeMath")
        scaled.operation = "MULTIPLY_ADD"
        scaled.inputs[1].default_value, scaled.inputs[2].default_value = factor, least
        tree.links.new(node("GeometryNodeInputIndex").outputs[0], scaled.inputs[0])
        return scaled.outputs[0]

    def stored(geometry: Any, factor: float) -> Any:
        store = node("GeometryNodeStoreNamedAttribute", Name="tint")
        store.data_type, store.domain = kind, "INSTANCE"
        tree.links.new(geometry, store.inputs["Geometry"])
        tree.links.new(scaled_index(factor, 0.1), store.inputs["Value"])
        return store.outputs[0]

    if instanced is None:
        cube, painted = node("GeometryNodeMeshCube", Size=(0.6, 0.6, 0.6)), node("GeometryNodeSetMaterial")
        painted.inputs["Material"].default_value = bpy.data.materials["Glow"]
        tree.links.new(cube.outputs[0], painted.inputs[0])
        instanced = painted.outputs[0]
    else:
        collection = node("GeometryNodeCollectionInfo")
        collection.inputs[0].default_value = instanced
        instanced = collection.outputs[0]
    points = node("GeometryNodeMeshGrid", Size_X=3.0, Size_Y=3.0, Vertices_X=3, Vertices_Y=3)
    scatter = node("GeometryNodeInstanceOnPoints")
    tree.links.new(points.outputs[0], scatter.inputs["Points"])
    tree.links.new(instanced, scatter.inputs["Instance"])
    result = scatter.outputs[0]
    if has_ids:
        ids = node("GeometryNodeSetID")
        tree.links.new(result, ids.inputs["Geometry"])
        tree.links.new(scaled_index(-3.0, 100.0), ids.inputs["ID"])
        result = ids.outputs[0]
    result = stored(result, 0.1)
    if is_nested:
        line = node("GeometryNodeMeshLine", Count=2, Offset=(0.3, 0.5, 0.0))
        again = node("GeometryNodeInstanceOnPoints")
        tree.links.new(line.outputs[0], again.inputs["Points"])
        tree.links.new(result, again.inputs["Instance"])
        result = stored(again.outputs[0], 0.5)
    tree.links.new(result, node("NodeGroupOutput").inputs[0])
    return tree


@pytest.mark.parametrize(
    "how", [{"kind": "FLOAT"}, {"kind": "BOOLEAN"}, {"kind": "FLOAT_COLOR", "is_nested": True},
            {"kind": "FLOAT", "has_ids": True, "is_nested": True}, {"kind": "FLOAT", "instanced": True}],
    ids=["numbers", "truths", "nested", "ids", "collection"],
)  # fmt: skip
def test_attributes_of_geometry_nodes_instances(how: dict[str, Any], blender: Any, tmp_path: Path) -> None:
    scene = seen_scene()
    material = glow("tint", "INSTANCER")
    if how.get("instanced"):
        bpy.ops.mesh.primitive_cube_add(size=0.6)
        bpy.context.object.data.materials.append(material)
        how = how | {"instanced": bpy.data.collections.new("Cubes")}
        how["instanced"].objects.link(bpy.context.object)
        scene.collection.objects.unlink(bpy.context.object)
    host = bpy.data.objects.new("Host", bpy.data.meshes.new("None"))
    scene.collection.objects.link(host)
    host.modifiers.new("Scatter", "NODES").node_group = scattering(**how)
    assert_alike(scene, tmp_path)
