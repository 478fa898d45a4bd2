# SPDX-License-Identifier: GPL-3.0-or-later
"""What meshes that materials displace bring along, and how they are diced: shapes that are odd, and each setting."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from addon.export.fans import fans_of  # noqa: E402
from addon.versions import NORMALS_STOP_AT_FLAT_FACES, SETTINGS, is_since  # noqa: E402
from engine.builder.dicing import dice  # noqa: E402
from engine.scene.attribute_names import FANS, SMOOTH, VERTEX_NORMALS  # noqa: E402
from engine.scene.description import Mesh  # noqa: E402
from tests.helpers.blender_scenes import displacing_material, empty_scene, render_and_export  # noqa: E402

needs_dicing = pytest.mark.skipif(
    not is_since(SETTINGS["use_adaptive_subdivision"].since), reason="this Blender subdivides before it is asked to"
)


def displaced(vertices: list, faces: list, edges: tuple = (), kind: str = "SIMPLE") -> Any:
    """An object with adaptive subdivision that its material displaces, in a scene with a camera 5 m above."""
    scene = empty_scene()
    scene.camera.location.z = 5.0
    material = displacing_material()
    mesh = bpy.data.meshes.new("Mesh")
    mesh.from_pydata(vertices, list(edges), faces)
    mesh.materials.append(material)
    item = bpy.data.objects.new("Object", mesh)
    scene.collection.objects.link(item)
    modifier = item.modifiers.new("Subdivision", "SUBSURF")
    modifier.subdivision_type, modifier.render_levels = kind, 2
    if hasattr(modifier, "use_adaptive_subdivision"):
        modifier.use_adaptive_subdivision = True
    return item


SQUARE = [(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)]


def exported(resolution: int = 64) -> Mesh:
    (mesh,) = render_and_export(bpy.context.scene, resolution=resolution).meshes
    return mesh


@needs_dicing
@pytest.mark.parametrize("kind", ["SIMPLE", "CATMULL_CLARK"])
def test_faces_of_any_number_of_corners_loose_edges_and_fins(kind: str) -> None:
    pentagon = [(np.cos(a), np.sin(a), 0.0) for a in np.linspace(0.0, 2.0 * np.pi, 6)[:-1]]
    # A fin makes an edge of three faces; two vertices have an edge and no face.
    vertices = [*pentagon, (0.0, 0.0, 1.0), (3, 3, 0), (4, 3, 0)]
    fins = [(0, 1, 2, 3, 4), (0, 1, 5), (1, 0, 2)]
    displaced(vertices, fins, edges=((6, 7),), kind=kind)
    mesh = exported()
    assert mesh.dicing is not None
    diced = dice(mesh, mesh.dicing)
    assert len(diced.triangles) > 2000 and np.isfinite(diced.vertices).all()


@needs_dicing
def test_a_mesh_without_faces_is_left_out() -> None:
    displaced([], [])
    assert not render_and_export(bpy.context.scene).meshes
    displaced(SQUARE, [], edges=((0, 1),))
    assert not render_and_export(bpy.context.scene).meshes


@needs_dicing
def test_each_setting_of_dicing_is_cycles() -> None:
    item, scene = displaced(SQUARE, [(0, 1, 2, 3)]), bpy.context.scene
    modifier = item.modifiers[0]

    def found() -> Any:
        dicing = exported().dicing
        assert dicing is not None
        return dicing

    first = found()
    # A pixel of a picture of 64, one length ahead; the offscreen scale of 4 adds thrice that with each length.
    pixel = scene.camera.data.sensor_width / scene.camera.data.lens / 64.0
    assert first.growth == pytest.approx(pixel) and first.outside == pytest.approx(3.0 * pixel)
    assert first.level == scene.cycles.max_subdivisions - 1
    scene.cycles.dicing_rate = 2.0
    modifier.adaptive_pixel_size = 3.0
    assert found().growth == pytest.approx(6.0 * pixel)
    scene.cycles.preview_dicing_rate = 1.0
    scene.cycles.offscreen_dicing_scale = 1.0
    scene.cycles.max_subdivisions = 3
    assert found().growth == pytest.approx(6.0 * pixel) and found().outside == 0.0 and found().level == 2
    # Cycles takes no lower rate than a tenth of a pixel.
    scene.cycles.dicing_rate = modifier.adaptive_pixel_size = 0.1
    assert found().growth == pytest.approx(0.1 * pixel)
    other = bpy.data.objects.new("Other", bpy.data.cameras.new("Other"))
    other.location = (0.0, 0.0, 9.0)
    scene.collection.objects.link(other)
    scene.cycles.dicing_camera = other
    assert found().to_space[2, 3] == pytest.approx(-9.0)
    modifier.adaptive_space, modifier.adaptive_object_edge_length = "OBJECT", 0.25
    scene.cycles.dicing_rate = 2.0
    assert found().length == pytest.approx(0.5) and found().growth == 0.0


@needs_dicing
def test_uvs_go_along_linearly_and_creases_stay_sharp() -> None:
    item = displaced(SQUARE, [(0, 1, 2, 3)])
    layer = item.data.uv_layers.new(name="UVMap")
    layer.data.foreach_set("uv", [0, 0, 2, 0, 2, 2, 0, 2])
    mesh = exported()
    assert mesh.dicing is not None
    diced = dice(mesh, mesh.dicing)
    places = diced.vertices[diced.triangles.reshape(-1)]
    assert len(places) > 500
    np.testing.assert_allclose(diced.attributes["UVMap"].data, places[:, :2] + 1.0, atol=1e-5)
    # Catmull and Clark's surface of a square is round; with creases at its rim it is the square, up to its corners.
    for crease, is_round in ((0.0, True), (1.0, False)):
        item = displaced(SQUARE, [(0, 1, 2, 3)], kind="CATMULL_CLARK")
        item.modifiers[0].boundary_smooth = "ALL"
        marks = item.data.attributes.new("crease_edge", "FLOAT", "EDGE")
        marks.data.foreach_set("value", [crease] * 4)
        points = item.data.attributes.new("crease_vert", "FLOAT", "POINT")
        points.data.foreach_set("value", [crease] * 4)
        mesh = exported()
        corner = np.abs(mesh.vertices[:, :2]).min(axis=1).max()
        assert (corner < 0.9) == is_round


def test_a_loop_in_a_group_in_a_displacement_is_cut_open() -> None:
    item = displaced(SQUARE, [(0, 1, 2, 3)])
    group = bpy.data.node_groups.new("Loop", "ShaderNodeTree")
    if hasattr(group, "interface"):
        group.interface.new_socket("Height", in_out="OUTPUT", socket_type="NodeSocketFloat")
    else:
        group.outputs.new("NodeSocketFloat", "Height")
    first, second = (group.nodes.new("ShaderNodeMath") for _ in range(2))
    group.links.new(first.outputs[0], second.inputs[0])
    group.links.new(second.outputs[0], first.inputs[0])
    group.links.new(second.outputs[0], group.nodes.new("NodeGroupOutput").inputs[0])
    tree = item.data.materials[0].node_tree
    node = tree.nodes.new("ShaderNodeGroup")
    node.node_tree = group
    displacement = next(node for node in tree.nodes if node.type == "DISPLACEMENT")
    tree.links.new(node.outputs[0], displacement.inputs["Height"])
    description = render_and_export(bpy.context.scene)
    assert any("loop" in notice.problem for notice in description.notices)
    (material,) = description.materials
    assert material.graph is not None and material.graph.displacement is not None


@pytest.mark.skipif(is_since(NORMALS_STOP_AT_FLAT_FACES), reason="Cycles tears meshes at sharp edges up to Blender 5.1")
def test_sharp_edges_part_corners() -> None:
    item = displaced([(-1, 0, 0), (0, 0, 1), (0, 1, 1), (-1, 1, 0), (1, 0, 0), (1, 1, 0)],
                     [(0, 1, 2, 3), (1, 4, 5, 2)])  # fmt: skip
    item.modifiers.clear()
    item.data.polygons.foreach_set("use_smooth", [True, True])
    marks = item.data.attributes.new("sharp_edge", "BOOLEAN", "EDGE")
    marks.data.foreach_set("value", [sorted(edge.vertices) == [1, 2] for edge in item.data.edges])
    mesh = exported()
    assert VERTEX_NORMALS not in mesh.attributes and mesh.attributes[SMOOTH].data.all()
    corners = mesh.triangles.reshape(-1)
    fans = mesh.attributes[FANS].data[:, 0]
    for vertex in range(6):
        assert len(np.unique(fans[corners == vertex])) == (2 if vertex in (1, 2) else 1)


def test_fans_go_around_a_vertex_until_two_sharp_edges() -> None:
    """Four triangles about a vertex, of which each goes (0, rim k, rim k + 1)."""
    vertices = np.array([0, 1, 2, 0, 2, 3, 0, 3, 4, 0, 4, 1], np.int32)
    # Edges 0 to 3 are spokes to rim 1 to 4, edges 4 to 7 the rim.
    edges = np.array([0, 4, 1, 1, 5, 2, 2, 6, 3, 3, 7, 0], np.int32)
    following = np.array([1, 2, 0, 4, 5, 3, 7, 8, 6, 10, 11, 9], np.int32)
    for sharp, parts in (((), 1), ((0,), 1), ((0, 2), 2), ((0, 1, 2, 3), 4)):
        is_sharp = np.isin(np.arange(8), sharp)
        fans = fans_of(vertices, edges, following, is_sharp)
        assert len(np.unique(fans[vertices == 0])) == parts
