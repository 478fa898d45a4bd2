# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes, their attributes and instances, as they leave Blender."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from engine.scene.description import VISIBLE_ALL, VISIBLE_CAMERA, VISIBLE_GLOSSY, Mesh, SceneDescription
from tests.helpers.blender_scenes import empty_scene, export, render_and_export
from tests.helpers.plain_meshes import add_material, add_mesh, add_square


@pytest.fixture
def scene() -> Any:
    return empty_scene()


def corner_points(mesh: Mesh) -> np.ndarray:
    return mesh.vertices[mesh.triangles.reshape(-1)]


def test_square_becomes_two_flat_triangles(scene: Any) -> None:
    add_square()
    mesh = export().meshes[0]
    assert mesh.vertices.dtype == np.float32 and mesh.triangles.dtype == np.uint32
    np.testing.assert_array_equal(mesh.vertices, [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)])
    assert sorted(map(tuple, np.sort(mesh.triangles, axis=1).tolist())) == [(0, 1, 2), (0, 2, 3)]
    edges = np.diff(mesh.vertices[mesh.triangles], axis=1)
    assert (np.cross(edges[:, 0], edges[:, 1])[:, 2] > 0.0).all()
    assert mesh.corner_normals is None
    assert mesh.texture_space is not None
    np.testing.assert_allclose(mesh.texture_space, [(0.5, 0.5, 0.0), (0.5, 0.5, 1.0)])


def test_smooth_faces_carry_split_normals(scene: Any) -> None:
    roof = add_mesh([(0, 0, 0), (1, 0, 1), (1, 1, 1), (0, 1, 0), (2, 0, 0), (2, 1, 0)], [(0, 1, 2, 3), (1, 4, 5, 2)])
    roof.data.shade_smooth() if hasattr(roof.data, "shade_smooth") else roof.data.polygons.foreach_set(
        "use_smooth", [True, True]
    )
    mesh = export().meshes[0]
    assert mesh.corner_normals is not None and mesh.corner_normals.shape == (4, 3, 3)
    at_ridge = corner_points(mesh)[:, 0] == 1.0
    normals = mesh.corner_normals.reshape(-1, 3)
    np.testing.assert_allclose(normals[at_ridge], [(0.0, 0.0, 1.0)] * int(at_ridge.sum()), atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-5)
    assert (normals[corner_points(mesh)[:, 0] == 0.0][:, 0] < 0.0).all()


def test_sharp_edge_splits_normals(scene: Any) -> None:
    roof = add_mesh([(0, 0, 0), (1, 0, 1), (1, 1, 1), (0, 1, 0), (2, 0, 0), (2, 1, 0)], [(0, 1, 2, 3), (1, 4, 5, 2)])
    roof.data.polygons.foreach_set("use_smooth", [True, True])
    for edge in roof.data.edges:
        edge.use_edge_sharp = set(edge.vertices) == {1, 2}
    mesh = export().meshes[0]
    assert mesh.corner_normals is not None
    half = np.sqrt(0.5)
    np.testing.assert_allclose(np.abs(mesh.corner_normals.reshape(-1, 3)), [(half, 0.0, half)] * 12, atol=1e-6)


def add_prism(is_smooth: list[bool]) -> Any:
    """A wedge with a square floor, two slopes and two gables; which faces are smooth, in this order."""
    vertices = [(0, 0, 0), (2, 0, 0), (2, 2, 0), (0, 2, 0), (1, 0, 1), (1, 2, 1)]
    faces = [(3, 2, 1, 0), (0, 4, 5, 3), (1, 2, 5, 4), (0, 1, 4), (3, 5, 2)]
    prism = add_mesh(vertices, faces, "Prism")
    prism.data.polygons.foreach_set("use_smooth", is_smooth)
    prism.data.update()
    return prism


SLOPES = [False, True, True, False, False]


def normals_by_height(mesh: Mesh, height: float) -> np.ndarray:
    """Normals of the slopes' corners there."""
    assert mesh.corner_normals is not None
    points = mesh.vertices[mesh.triangles]
    planes = np.cross(points[:, 1] - points[:, 0], points[:, 2] - points[:, 0])
    is_slope = (planes[:, 2] > 0.0)[:, None] & (points[:, :, 2] == height)
    return mesh.corner_normals[is_slope]


def planes_of(mesh: Mesh) -> np.ndarray:
    """Normals of the planes of the triangles."""
    points = mesh.vertices[mesh.triangles]
    planes = np.cross(points[:, 1] - points[:, 0], points[:, 2] - points[:, 0])
    return planes / np.linalg.norm(planes, axis=1, keepdims=True)


def test_smooth_faces_beside_flat_ones_have_normals_as_in_cycles(scene: Any) -> None:
    import bpy

    prism = add_prism(SLOPES)
    mesh = export().meshes[0]
    planes = planes_of(mesh)
    is_slope = planes[:, 2] > 0.0
    assert mesh.corner_normals is not None
    np.testing.assert_allclose(mesh.corner_normals[~is_slope], np.repeat(planes[~is_slope][:, None], 3, 1), atol=1e-6)
    evaluated = prism.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
    of_vertices = np.array([vertex.normal for vertex in evaluated.vertices])
    assert (np.abs(of_vertices[:, 1]) > 0.1).all()  # gables lean on them
    if bpy.app.version < (5, 2):
        np.testing.assert_allclose(
            mesh.corner_normals[is_slope], of_vertices[mesh.triangles[is_slope]], atol=1e-6
        )
    else:
        np.testing.assert_allclose(mesh.corner_normals[is_slope][..., 1], 0.0, atol=1e-6)


def test_all_edges_sharp_count_only_where_no_face_is_flat(scene: Any) -> None:
    prism = add_prism(SLOPES)
    prism.data.edges.foreach_set("use_edge_sharp", [True] * len(prism.data.edges))
    assert np.abs(normals_by_height(export().meshes[0], 1.0)[:, 1]).min() > 0.1
    prism.data.shade_smooth()
    prism.data.edges.foreach_set("use_edge_sharp", [True] * len(prism.data.edges))
    assert export().meshes[0].corner_normals is None


def test_sharp_edges_and_custom_normals_keep_corners_apart(scene: Any) -> None:
    prism = add_prism(SLOPES)
    for edge in prism.data.edges:
        edge.use_edge_sharp = set(edge.vertices) == {4, 5}
    half = np.sqrt(0.5)
    np.testing.assert_allclose(np.abs(normals_by_height(export().meshes[0], 1.0)), [(half, 0.0, half)] * 6, atol=1e-6)
    for edge in prism.data.edges:
        edge.use_edge_sharp = False
    prism.data.normals_split_custom_set([(0.0, 0.6, 0.8)] * len(prism.data.loops))
    np.testing.assert_allclose(normals_by_height(export().meshes[0], 1.0), [(0.0, 0.6, 0.8)] * 6, atol=1e-3)


@pytest.mark.parametrize("domain", ["POINT", "FACE", "CORNER"])
def test_free_normals_are_those_of_smooth_faces(scene: Any, domain: str) -> None:
    prism = add_prism(SLOPES)
    stored = prism.data.attributes.new("custom_normal", "FLOAT_VECTOR", domain)
    stored.data.foreach_set("vector", [0.0, 0.6, 0.8] * len(stored.data))
    np.testing.assert_allclose(normals_by_height(export().meshes[0], 1.0), [(0.0, 0.6, 0.8)] * 6, atol=1e-6)


def test_bent_flat_faces(scene: Any) -> None:
    """Their triangles have their own normals, or those of faces if normals of corners are taken."""
    import bpy

    bent = add_mesh(
        [(0, 0, 0), (1, 0, 0), (1, 1, 1), (0, 1, 0), (-1, 0, 0), (-1, 1, 0)], [(0, 1, 2, 3), (4, 0, 3, 5)], "Bent"
    )
    bent.data.polygons.foreach_set("use_smooth", [False, True])
    for is_sharp in (False, True):
        bent.data.edges.foreach_set("use_edge_sharp", [is_sharp] + [False] * (len(bent.data.edges) - 1))
        mesh = export().meshes[0]
        assert mesh.corner_normals is not None
        is_flat = mesh.vertices[mesh.triangles][:, :, 0].max(axis=1) > 0.0
        assert is_flat.sum() == 2
        expected = planes_of(mesh)[is_flat][:, None]
        if is_sharp or bpy.app.version >= (5, 2):
            expected = np.array(bent.data.polygons[0].normal)
        np.testing.assert_allclose(mesh.corner_normals[is_flat], np.broadcast_to(expected, (2, 3, 3)), atol=1e-6)


def test_modifiers_are_applied(scene: Any) -> None:
    square = add_square()
    square.modifiers.new("Array", "ARRAY").count = 3
    mesh = export().meshes[0]
    assert len(mesh.triangles) == 6
    assert mesh.vertices[:, 0].max() == pytest.approx(3.0)


@pytest.mark.parametrize("kind", ["FONT", "CURVE", "SURFACE", "META"])
def test_other_geometry_becomes_a_mesh(scene: Any, kind: str) -> None:
    import bpy

    if kind == "FONT":
        bpy.ops.object.text_add()
    elif kind == "CURVE":
        bpy.ops.curve.primitive_bezier_circle_add()
        bpy.context.object.data.bevel_depth = 0.1
    elif kind == "SURFACE":
        bpy.ops.surface.primitive_nurbs_surface_sphere_add()
    else:
        bpy.ops.object.metaball_add(type="BALL")
    description = export()
    assert len(description.meshes) == len(description.instances.mesh) == 1
    assert len(description.meshes[0].triangles) > 10
    assert not description.notices


def test_every_uv_map_and_only_wanted_attributes(scene: Any) -> None:
    square = add_square()
    data = square.data
    for name, offset in (("First", 0.0), ("Second", 0.5)):
        layer = data.uv_layers.new(name=name)
        for loop in data.loops:
            layer.data[loop.index].uv = data.vertices[loop.vertex_index].co[:2]
            layer.data[loop.index].uv[0] += offset
    data.uv_layers["Second"].active_render = True
    data.attributes.new("weight", "FLOAT", "POINT").data.foreach_set("value", [0.0, 1.0, 2.0, 3.0])
    data.attributes.new("unused", "FLOAT", "POINT")
    add_material(square, ("ShaderNodeAttribute", {"attribute_name": "weight"}))
    mesh = export().meshes[0]
    assert set(mesh.attributes) == {"First", "Second", "weight"}
    assert mesh.default_uv == "Second"
    points = corner_points(mesh)
    assert mesh.attributes["First"].domain == "CORNER"
    np.testing.assert_allclose(mesh.attributes["First"].data, points[:, :2])
    np.testing.assert_allclose(mesh.attributes["Second"].data, points[:, :2] + (0.5, 0.0))
    assert mesh.attributes["weight"].domain == "POINT"
    np.testing.assert_array_equal(mesh.attributes["weight"].data, [[0.0], [1.0], [2.0], [3.0]])


@pytest.mark.parametrize(
    ("kind", "domain", "values", "expected"),
    [
        ("INT", "FACE", [7], [[7.0], [7.0]]),
        ("BOOLEAN", "FACE", [True], [[1.0], [1.0]]),
        ("FLOAT_VECTOR", "POINT", range(12), np.arange(12.0).reshape(4, 3)),
        ("FLOAT2", "POINT", range(8), np.arange(8.0).reshape(4, 2)),
        ("FLOAT_COLOR", "POINT", range(16), np.arange(16.0).reshape(4, 4)),
    ],
)
def test_attribute_types(scene: Any, kind: str, domain: str, values: Any, expected: Any) -> None:
    square = add_square()
    prop = {"FLOAT_VECTOR": "vector", "FLOAT2": "vector", "FLOAT_COLOR": "color"}.get(kind, "value")
    square.data.attributes.new("x", kind, domain).data.foreach_set(prop, list(values))
    add_material(square, ("ShaderNodeAttribute", {"attribute_name": "x"}))
    attribute = export().meshes[0].attributes["x"]
    assert attribute.domain == domain
    np.testing.assert_array_equal(attribute.data, expected)


def test_edge_attribute_is_averaged_onto_points(scene: Any) -> None:
    square = add_square()
    values = square.data.attributes.new("x", "FLOAT", "EDGE")
    for edge in square.data.edges:
        values.data[edge.index].value = float(sum(edge.vertices))
    add_material(square, ("ShaderNodeAttribute", {"attribute_name": "x"}))
    attribute = export().meshes[0].attributes["x"]
    assert attribute.domain == "POINT"
    # Edges 01, 12, 23 and 30 weigh 1, 3, 5 and 3.
    np.testing.assert_allclose(attribute.data[:, 0], [2.0, 2.0, 4.0, 4.0])


def test_byte_colors_come_linear(scene: Any) -> None:
    square = add_square()
    layer = square.data.color_attributes.new("Col", "BYTE_COLOR", "CORNER")
    layer.data.foreach_set("color_srgb", [0.5, 1.0, 0.0, 1.0] * 4)
    add_material(square, ("ShaderNodeVertexColor", {"layer_name": ""}))
    mesh = export().meshes[0]
    assert mesh.default_color == "Col"
    linear = ((128 / 255 + 0.055) / 1.055) ** 2.4
    np.testing.assert_allclose(mesh.attributes["Col"].data, [(linear, 1.0, 0.0, 1.0)] * 6, rtol=1e-3)


def test_tangents_agree_with_blenders_mikktspace(scene: Any) -> None:
    import bpy

    bpy.ops.mesh.primitive_uv_sphere_add(segments=12, ring_count=8)
    sphere = bpy.context.object
    sphere.data.polygons.foreach_set("use_smooth", [True] * len(sphere.data.polygons))
    sphere.modifiers.new("Triangulate", "TRIANGULATE")
    add_material(sphere, ("ShaderNodeNormalMap", {}), output="Normal")
    mesh = export().meshes[0]
    exported = mesh.attributes[".tangent"]
    assert exported.domain == "CORNER" and exported.data.shape == (3 * len(mesh.triangles), 4)

    evaluated = sphere.evaluated_get(bpy.context.evaluated_depsgraph_get()).to_mesh()
    evaluated.calc_tangents()
    expected = np.array([(*loop.tangent, loop.bitangent_sign) for loop in evaluated.loops])
    corners = np.array([triangle.loops[:] for triangle in evaluated.loop_triangles]).reshape(-1)
    # At the poles triangles of several fans meet in corners that are equal to us and not connected for mikktspace.
    inner = np.abs(corner_points(mesh)[:, 2]) < 0.99
    assert inner.sum() > 400
    np.testing.assert_allclose(exported.data[inner], expected[corners][inner], atol=2e-3)


def test_material_slots_by_face_data_and_object(scene: Any) -> None:
    import bpy

    item = add_mesh([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)], [(0, 1, 2), (0, 1, 3), (0, 2, 3)])
    for name in ("A", "B"):
        item.data.materials.append(bpy.data.materials.new(name))
    item.data.polygons.foreach_set("material_index", [1, 0, 5])
    twin = bpy.data.objects.new("Twin", item.data)
    scene.collection.objects.link(twin)
    twin.material_slots[0].link = "OBJECT"
    twin.material_slots[0].material = bpy.data.materials.new("C")
    description = export()
    instances = description.instances
    assert len(description.meshes) == 1 and list(instances.mesh) == [0, 0]
    slots = description.meshes[0].material_slots
    shown = {}
    for row, name in enumerate(instances.name):
        indices = instances.materials[instances.material_offset[row] + slots]
        shown[name] = [description.materials[index].name for index in indices]
    # A slot beyond the last is the last.
    assert shown == {"Object": ["B", "A", "B"], "Twin": ["B", "C", "B"]}


def test_empty_slots_are_the_default_material(scene: Any) -> None:
    add_square()
    assert list(export().instances.materials) == [-1]


def test_material_override_of_the_view_layer(scene: Any) -> None:
    import bpy

    square = add_square()
    add_material(square)
    bpy.context.view_layer.material_override = bpy.data.materials.new("Clay")
    description = export()
    assert [description.materials[i].name for i in description.instances.materials] == ["Clay"]


def test_collection_instances_share_their_mesh(scene: Any) -> None:
    import bpy

    square = add_square()
    collection = bpy.data.collections.new("Hidden")
    collection.objects.link(square)
    scene.collection.objects.unlink(square)
    for i in range(3):
        empty = bpy.data.objects.new(f"Empty{i}", None)
        empty.instance_type = "COLLECTION"
        empty.instance_collection = collection
        empty.location = (i, 2.0, 0.0)
        scene.collection.objects.link(empty)
    description = export()
    assert len(description.meshes) == 1
    np.testing.assert_allclose(description.instances.transform[:, :3, 3], [(i, 2.0, 0.0) for i in range(3)])
    np.testing.assert_allclose(description.instances.transform[:, 3], [(0.0, 0.0, 0.0, 1.0)] * 3)
    assert len(set(description.instances.random.tolist())) == 3


def test_instances_have_the_color_of_their_instancer(scene: Any) -> None:
    import bpy

    square = add_square()
    square.color = (0.4, 0.5, 0.1, 1.0)
    add_material(square, ("ShaderNodeAttribute", {"attribute_type": "OBJECT", "attribute_name": "color"}))
    collection = bpy.data.collections.new("Hidden")
    collection.objects.link(square)
    colors = [(1.0, 0.0, 0.0, 0.25), (0.0, 1.0, 0.0, 0.5), (0.0, 0.0, 1.0, 0.75)]
    for color in colors:
        empty = bpy.data.objects.new("Empty", None)
        empty.instance_type, empty.instance_collection, empty.color = "COLLECTION", collection, color
        scene.collection.objects.link(empty)
    instances = export().instances
    # The square itself, then its instances.
    expected = [tuple(square.color), *colors]
    np.testing.assert_allclose(instances.color, expected, rtol=1e-6)
    np.testing.assert_allclose(properties_of_instances(export(), "object:color"), expected, rtol=1e-6)


def properties_of_instances(description: SceneDescription, name: str) -> list[Any]:
    """What instances have of a property that materials read."""
    return list(description.instances.properties[name])


def test_face_instances_carry_texture_coordinates_when_wanted(scene: Any) -> None:
    ground = add_mesh([(0, 0, 0), (4, 0, 0), (4, 4, 0), (0, 4, 0), (8, 0, 0), (8, 4, 0)], [(0, 1, 2, 3), (1, 4, 5, 2)])
    layer = ground.data.uv_layers.new(name="UV")
    for loop in ground.data.loops:
        layer.data[loop.index].uv = ground.data.vertices[loop.vertex_index].co[:2]
    child = add_square()
    child.parent = ground
    ground.instance_type = "FACES"
    # Blender remembers undeformed coordinates of meshes that have modifiers.
    ground.modifiers.new("Still", "CAST").factor = 1e-6
    assert not export().instances.dupli_uv.any()
    add_material(child, ("ShaderNodeTexCoord", {"from_instancer": True}), output="Generated")
    instances = render_and_export(scene).instances
    rows = [i for i, name in enumerate(instances.name) if name == "Square" and instances.dupli_uv[i].any()]
    np.testing.assert_allclose(instances.dupli_uv[rows], [(2.0, 2.0), (6.0, 2.0)])
    # Blender's orco of the instancer is in [-1, 1]; Cycles takes half of it and subtracts a half.
    np.testing.assert_allclose(instances.dupli_generated[rows], [(-0.75, -0.5, -0.5), (-0.25, -0.5, -0.5)], atol=1e-5)


def test_geometry_nodes_instances_of_a_made_mesh(scene: Any) -> None:
    import bpy

    tree = bpy.data.node_groups.new("Nodes", "GeometryNodeTree")
    tree.interface.new_socket("Geometry", in_out="INPUT", socket_type="NodeSocketGeometry")
    tree.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    source, result = tree.nodes.new("NodeGroupInput"), tree.nodes.new("NodeGroupOutput")
    cube, instance = tree.nodes.new("GeometryNodeMeshCube"), tree.nodes.new("GeometryNodeInstanceOnPoints")
    tree.links.new(source.outputs[0], instance.inputs["Points"])
    tree.links.new(cube.outputs[0], instance.inputs["Instance"])
    tree.links.new(instance.outputs[0], result.inputs[0])
    square = add_square()
    square.modifiers.new("Nodes", "NODES").node_group = tree
    description = export()
    assert len(description.meshes) == 1 and len(description.meshes[0].triangles) == 12
    np.testing.assert_allclose(
        np.sort(description.instances.transform[:, :2, 3], axis=0), [(0, 0), (0, 0), (1, 1), (1, 1)]
    )


def test_particle_instances(scene: Any) -> None:
    import bpy

    child = add_square("Leaf")
    bpy.ops.mesh.primitive_plane_add(size=4.0)
    settings = bpy.context.object.modifiers.new("Particles", "PARTICLE_SYSTEM").particle_system.settings
    settings.count = 20
    settings.frame_start = settings.frame_end = 1
    settings.render_type = "OBJECT"
    settings.instance_object = child
    scene.frame_set(2)
    description = export()
    leaves = [i for i, name in enumerate(description.instances.name) if name == "Leaf"]
    assert len(leaves) == 21
    assert len({int(description.instances.mesh[i]) for i in leaves}) == 1


def test_hidden_objects_are_left_out(scene: Any) -> None:
    add_square("Shown")
    add_square("Hidden").hide_render = True
    invisible = add_square("Invisible")
    for name in filter(lambda name: name.startswith("visible_"), invisible.bl_rna.properties.keys()):
        setattr(invisible, name, False)
    # hide_render counts in a final render's dependency graph only: check what an engine is given.
    assert render_and_export(scene).instances.name == ["Shown"]


def test_ray_visibility_holdout_and_indirect_only(scene: Any) -> None:
    import bpy

    item = add_square("Rays")
    item.visible_glossy = False
    add_square("Own").is_holdout = True
    for name in ("Held", "Indirect"):
        collection = bpy.data.collections.new(name)
        scene.collection.children.link(collection)
        square = add_square(name)
        collection.objects.link(square)
        scene.collection.objects.unlink(square)
    layers = bpy.context.view_layer.layer_collection.children
    layers["Held"].holdout = True
    layers["Indirect"].indirect_only = True
    instances = export().instances
    visibility = dict(zip(instances.name, (instances.visibility & VISIBLE_ALL).tolist(), strict=True))
    assert visibility == {
        "Rays": VISIBLE_ALL & ~VISIBLE_GLOSSY,
        "Own": VISIBLE_ALL,
        "Held": VISIBLE_ALL,
        "Indirect": VISIBLE_ALL & ~VISIBLE_CAMERA,
    }
    held = dict(zip(instances.name, instances.is_holdout.tolist(), strict=True))
    assert held == {"Rays": False, "Own": True, "Held": True, "Indirect": False}


def test_object_values(scene: Any) -> None:
    square = add_square("Plane")
    square.pass_index = 7
    square.color = (0.1, 0.2, 0.3, 0.4)
    square.is_shadow_catcher = True
    square.shadow_terminator_geometry_offset = 0.25
    square.scale, square.location = (2.0, -1.0, 3.0), (1.0, 2.0, 3.0)
    description = export()
    instances = description.instances
    assert list(instances.pass_index) == [7]
    np.testing.assert_allclose(instances.terminator_offset, [0.25])
    np.testing.assert_allclose(instances.color, [(0.1, 0.2, 0.3, 0.4)], rtol=1e-6)
    np.testing.assert_allclose(
        instances.transform[0], [[2, 0, 0, 1], [0, -1, 0, 2], [0, 0, 3, 3], [0, 0, 0, 1]], atol=1e-6
    )
    # What Cycles 5.0.1 renders for Object Info > Random of an object of this name.
    np.testing.assert_allclose(instances.random, [0.1357643], rtol=1e-6)
    assert list(instances.is_shadow_catcher) == [True]
    assert description.notices == []


def test_random_of_a_name_that_is_not_ascii(scene: Any) -> None:
    add_square("Plåne x")
    np.testing.assert_allclose(export().instances.random, [0.54099333], rtol=1e-6)


def test_properties_of_objects_are_values_of_instances(scene: Any) -> None:
    import bpy

    square = add_square("A")
    twin = bpy.data.objects.new("B", square.data)
    scene.collection.objects.link(twin)
    square["dirt"], twin["dirt"] = 0.25, [0.5, 0.75, 1.0]
    add_material(square, ("ShaderNodeAttribute", {"attribute_name": "dirt", "attribute_type": "OBJECT"}))
    description = export()
    assert len(description.meshes) == 1
    values = dict(zip(description.instances.name, properties_of_instances(description, "object:dirt"), strict=True))
    np.testing.assert_array_equal(values["A"], [0.25, 0.25, 0.25, 1.0])
    np.testing.assert_array_equal(values["B"], [0.5, 0.75, 1.0, 1.0])


def test_undeformed_coordinates_of_a_deformed_mesh(scene: Any) -> None:
    square = add_square()
    square.modifiers.new("Cast", "CAST").factor = 0.5
    add_material(square, ("ShaderNodeTexCoord", {}), output="Generated")
    mesh = render_and_export(scene).meshes[0]
    undeformed = mesh.attributes["__undeformed"].data
    np.testing.assert_allclose(undeformed, [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], atol=1e-6)
    assert not np.allclose(mesh.vertices, undeformed, atol=1e-2)


def test_undeformed_coordinates_of_a_still_mesh_are_its_own(scene: Any) -> None:
    """To the last bit; found back from the world's space they would be off."""
    square = add_square()
    assert "__undeformed" not in export().meshes[0].attributes
    add_material(square, ("ShaderNodeTexCoord", {}), output="Generated")
    mesh = export().meshes[0]
    np.testing.assert_array_equal(mesh.attributes["__undeformed"].data, mesh.vertices)


def test_bad_meshes_do_not_stop_the_export(scene: Any) -> None:
    nan = add_square("NaN")
    nan.data.vertices[0].co.x = float("nan")
    add_mesh([(0, 0, 0)] * 3, [(0, 1, 2)], "Point")
    add_mesh([], [], "Nothing")
    add_mesh([(0, 0, 0), (1, 0, 0)], [], "Loose")
    flat = add_square("Flat")
    flat.scale = (1.0, 0.0, 1.0)
    description = export()
    assert description.instances.name == ["NaN", "Point"]
    # The engine says which faces it leaves out for their vertices.
    assert [notice.subject for notice in description.notices] == ["Flat"]


def test_unsupported_objects_are_named_once(scene: Any) -> None:
    import bpy

    pencils = getattr(bpy.data, "grease_pencils_v3", None) or bpy.data.grease_pencils
    for kind in ("Volume", "Pencil"):
        data = bpy.data.volumes.new(kind) if kind == "Volume" else pencils.new(kind)
        scene.collection.objects.link(bpy.data.objects.new(kind, data))
    description = export()
    subjects = [notice.subject for notice in description.notices]
    assert {"Volume", "Pencil"} <= set(subjects)
    assert len(subjects) == len(set(subjects))


def test_unchanged_meshes_are_the_same_object(scene: Any) -> None:
    from addon.export import ExportCache

    cache = ExportCache()
    still, moved, bent = add_square("Still"), add_square("Moved"), add_square("Bent")
    add_material(still)
    first = export(cache=cache)
    moved.location.x = 3.0
    bent.data.vertices[0].co.z = 1.0
    bent.data.update()
    second = export(cache=cache)
    assert first.meshes[0] is second.meshes[0] and first.meshes[1] is second.meshes[1]
    assert first.meshes[2] is not second.meshes[2] and first.meshes[2].key != second.meshes[2].key
    assert second.instances.transform[1, 0, 3] == 3.0
    assert first.materials[0] is second.materials[0]


def test_persistent_data_skips_what_blender_calls_untouched(scene: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    from addon.export import ExportCache, geometry

    add_square("Still")
    animated = add_square("Animated")
    animated.shape_key_add(name="Basis")
    key = animated.shape_key_add(name="Up")
    for point in key.data:
        point.co.z = 1.0
    for frame in (1, 3):
        key.value = (frame - 1) / 2
        key.keyframe_insert("value", frame=frame)
    read: list[str] = []
    read_positions = geometry.read_positions

    def spy(mesh: Any) -> Any:
        read.append(mesh.name)
        return read_positions(mesh)

    monkeypatch.setattr(geometry, "read_positions", spy)
    scene.render.use_persistent_data = True
    descriptions = render_and_export(scene, frames=3, cache=ExportCache())
    assert [d.meshes[1].vertices[0, 2] for d in descriptions] == pytest.approx([0.0, 0.5, 1.0], abs=1e-6)
    assert descriptions[0].meshes[0] is descriptions[2].meshes[0]
    assert read.count("Animated") == 3
    assert read.count("Still") == 1


def test_cache_forgets_what_is_gone(scene: Any) -> None:
    import bpy

    from addon.export import ExportCache

    cache = ExportCache()
    square, gone = add_square(), add_square("Gone")
    export(cache=cache)
    assert len(cache.meshes) == 2
    bpy.data.objects.remove(gone)
    for _ in range(8):
        export(cache=cache)
    assert [key[0] for key in cache.meshes] == [square.name]


def test_failed_export_is_not_built_upon(scene: Any) -> None:
    from addon.export import ExportCache

    cache = ExportCache()
    add_square()
    export(cache=cache)
    assert cache.depsgraph != 0
    scene.camera = None
    with pytest.raises(ValueError, match="no camera"):
        export(cache=cache)
    assert cache.depsgraph == 0
