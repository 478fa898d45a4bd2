# SPDX-License-Identifier: GPL-3.0-or-later
"""Motion blur: shapes at Cycles' times, positions and normals, and what is not blurred is named."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from tests.helpers.blender_scenes import export
from tests.helpers.motion_scenes import add_cube, blurred_scene, curves_of, keyframe, open_shutter


@pytest.fixture
def scene() -> Any:
    return blurred_scene()


def add_stretching_cube(scene: Any, is_smooth: bool = True) -> Any:
    """A cube whose vertices are at z = 2 * z * value of a shape key, which goes from 0 to 1 in 20 frames."""
    cube = add_cube()
    for face in cube.data.polygons:
        face.use_smooth = is_smooth
    cube.shape_key_add(name="Basis")
    stretched = cube.shape_key_add(name="Stretched")
    for point in stretched.data:
        point.co.z *= 3.0
    keyframe(stretched, "value", {0: 0.0, 20: 1.0})
    scene.frame_set(10)
    return cube


def shape_at(item: Any, time: float) -> tuple[np.ndarray, np.ndarray]:
    """What Blender itself makes of an object at a time: positions and normals of corners of its triangles."""
    import bpy

    scene = bpy.context.scene
    found = scene.frame_current, scene.frame_subframe
    scene.frame_set(math.floor(time), subframe=time - math.floor(time))
    mesh = item.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
    mesh.calc_loop_triangles()
    positions = np.array([vertex.co for vertex in mesh.vertices], np.float32)
    normals = np.array(
        [[mesh.corner_normals[corner].vector for corner in triangle.loops] for triangle in mesh.loop_triangles],
        np.float32,
    )
    scene.frame_set(found[0], subframe=found[1])
    return positions, normals


@pytest.mark.parametrize("position", ["START", "CENTER"])
@pytest.mark.parametrize("steps", [1, 2])
def test_shape_keys(scene: Any, position: str, steps: int) -> None:
    cube = add_stretching_cube(scene)
    cube.cycles.motion_steps = steps
    cube.update_tag()
    open_shutter(scene, 4.0, position)
    scene.frame_set(10)
    description = export()
    mesh = description.meshes[0]
    start = 10.0 if position == "START" else 8.0
    assert mesh.motion_vertices.shape == (2**steps + 1, 8, 3) and mesh.motion_vertices.dtype == np.float32
    assert mesh.motion_normals.shape == (2**steps + 1, 12, 3, 3)
    for step, time in enumerate(np.linspace(start, start + 4.0, 2**steps + 1)):
        positions, normals = shape_at(cube, float(time))
        np.testing.assert_allclose(mesh.motion_vertices[step], positions, atol=1e-6)
        np.testing.assert_allclose(mesh.motion_normals[step], normals, atol=1e-6)
    np.testing.assert_array_equal(mesh.motion_vertices[2 ** (steps - 1)], mesh.vertices)
    np.testing.assert_array_equal(mesh.motion_normals[2 ** (steps - 1)], mesh.corner_normals)
    assert description.instances.motion == {} and description.notices == []


def test_flat_faces_have_no_normals(scene: Any) -> None:
    add_stretching_cube(scene, is_smooth=False)
    mesh = export().meshes[0]
    assert mesh.corner_normals is None and mesh.motion_normals is None and mesh.motion_vertices is not None


@pytest.mark.parametrize("switch", ["use_motion_blur", "use_deform_motion"])
def test_switches(scene: Any, switch: str) -> None:
    cube = add_stretching_cube(scene)
    keyframe(cube, "location", {0: (0.0, 0.0, 0.0), 20: (20.0, 0.0, 0.0)})
    setattr(cube.cycles, switch, False)
    cube.update_tag()
    scene.frame_set(10)
    description = export()
    assert description.meshes[0].motion_vertices is None
    assert bool(description.instances.motion) == (switch == "use_deform_motion")


def test_instances_share_a_shape_and_its_key_tells_it(scene: Any) -> None:
    import bpy

    from addon.export import ExportCache

    cube = add_stretching_cube(scene)
    for x in (3.0, 6.0):
        other = bpy.data.objects.new("Other", cube.data)
        other.location.x = x
        scene.collection.objects.link(other)
    cache = ExportCache()

    def meshes() -> Any:
        return export(cache=cache).meshes

    first = meshes()
    keys = [mesh.key for mesh in first]
    assert all(mesh.motion_vertices is not None for mesh in first) and len(set(keys)) == len(keys)
    assert [mesh.key for mesh in meshes()] == keys
    open_shutter(scene, 2.0)
    scene.update_tag()
    longer = meshes()
    assert all(a.key != b.key and np.array_equal(a.vertices, b.vertices) for a, b in zip(first, longer, strict=True))
    scene.render.use_motion_blur = False
    scene.update_tag()
    still = meshes()
    assert all(mesh.motion_vertices is None for mesh in still)
    assert not {mesh.key for mesh in still} & set(keys)


def test_modifiers_and_text(scene: Any) -> None:
    import bpy

    cube = add_cube()
    modifier = cube.modifiers.new("Turn", "SIMPLE_DEFORM")
    modifier.deform_method = "TWIST"
    keyframe(modifier, "angle", {0: 0.0, 20: 2.0})
    text = bpy.data.objects.new("Text", bpy.data.curves.new("Text", "FONT"))
    text.data.body = "I"
    scene.collection.objects.link(text)
    keyframe(text.data, "extrude", {0: 0.1, 20: 2.1})
    still = add_cube("Still")
    still.modifiers.new("Bevel", "BEVEL")
    scene.frame_set(10)
    description = export()
    by_name = dict(zip(description.instances.name, description.instances.mesh, strict=True))
    meshes = {name: description.meshes[row] for name, row in by_name.items()}
    for time, shape in zip((9.5, 10.0, 10.5), meshes["Cube"].motion_vertices, strict=True):
        np.testing.assert_allclose(shape, shape_at(cube, time)[0], atol=1e-6)
    extents = meshes["Text"].motion_vertices[:, :, 2].max(axis=1)
    np.testing.assert_allclose(extents, [1.05, 1.1, 1.15], atol=1e-5)
    assert meshes["Still"].motion_vertices is None and description.notices == []


def test_other_faces_are_named(scene: Any) -> None:
    cube = add_cube()
    modifier = cube.modifiers.new("Array", "ARRAY")
    keyframe(modifier, "count", {9: 2, 10: 3}, "CONSTANT")
    keyframe(cube, "location", {0: (0.0, 0.0, 0.0), 20: (20.0, 0.0, 0.0)})
    scene.frame_set(10)
    description = export()
    assert len(description.meshes[0].vertices) == 24 and description.meshes[0].motion_vertices is None
    assert [(notice.subject, "not blurred" in notice.problem) for notice in description.notices] == [("Cube", True)]
    assert 0 in description.instances.motion


def test_velocities_of_simulations(scene: Any) -> None:
    cube = add_cube()
    velocity = cube.data.attributes.new("velocity", "FLOAT_VECTOR", "POINT")
    velocity.data.foreach_set("vector", np.tile(np.float32((24.0, 0.0, 0.0)), 8))
    scene.render.fps = 24
    open_shutter(scene, 0.5)
    cube.data.update_tag()
    scene.update_tag()
    mesh = export().meshes[0]
    # A metre a frame, a quarter of a frame each way.
    move = mesh.motion_vertices[:, :, 0] - mesh.vertices[:, 0]
    np.testing.assert_allclose(move, np.repeat([[-0.25], [0.0], [0.25]], 8, axis=1), atol=1e-6)


def test_vertices_that_are_not_finite_keep_the_middle(scene: Any) -> None:
    cube = add_stretching_cube(scene)
    key = cube.data.shape_keys.key_blocks["Stretched"]
    for point in key.data:
        point.co.x = 3e38 if point.co.x > 0.0 else point.co.x
    curve = curves_of(key)[0]
    for point, value in zip(curve.keyframe_points, (0.0, 0.0), strict=True):
        point.co[1] = value
    curve.keyframe_points.insert(10.25, 1e30)
    for point in curve.keyframe_points:
        point.interpolation = "CONSTANT"
    key.slider_max = 10.0
    scene.frame_set(10)
    mesh = export().meshes[0]
    assert mesh.motion_vertices is None or np.isfinite(mesh.motion_vertices).all()


def test_geometry_nodes(scene: Any) -> None:
    """Meshes that nodes make, and their instances, which have no object of their own, in an order that changes."""
    import bpy

    tree = bpy.data.node_groups.new("Nodes", "GeometryNodeTree")
    tree.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    nodes, links = tree.nodes, tree.links
    points = nodes.new("GeometryNodeMeshLine")
    points.inputs["Count"].default_value = 3
    points.inputs["Offset"].default_value = (0.0, 4.0, 0.0)
    cube = nodes.new("GeometryNodeMeshCube")
    instance = nodes.new("GeometryNodeInstanceOnPoints")
    move = nodes.new("GeometryNodeTranslateInstances")
    stretch = nodes.new("GeometryNodeTransform")
    output = nodes.new("NodeGroupOutput")
    links.new(points.outputs[0], instance.inputs["Points"])
    links.new(cube.outputs[0], stretch.inputs["Geometry"])
    links.new(stretch.outputs[0], instance.inputs["Instance"])
    links.new(instance.outputs[0], move.inputs["Instances"])
    links.new(move.outputs[0], output.inputs[0])
    keyframe(move.inputs["Translation"], "default_value", {0: (0.0, 0.0, 0.0), 20: (20.0, 0.0, 0.0)})
    keyframe(stretch.inputs["Scale"], "default_value", {0: (1.0, 1.0, 1.0), 20: (1.0, 1.0, 21.0)})
    owner = add_cube("Owner")
    owner.modifiers.new("Nodes", "NODES").node_group = tree
    scene.frame_set(10)
    description = export()
    motion = description.instances.motion
    assert sorted(motion) == [0, 1, 2]
    for row in range(3):
        np.testing.assert_allclose(motion[row][:, 0, 3], [9.5, 10.0, 10.5], atol=1e-5)
        np.testing.assert_allclose(motion[row][:, 1, 3], 4.0 * row, atol=1e-5)
    heights = description.meshes[0].motion_vertices[:, :, 2].max(axis=1)
    np.testing.assert_allclose(heights, 0.5 * np.array([10.5, 11.0, 11.5]), atol=1e-4)
    # Fewer points at the end: who is there is known by its id.
    keyframe(points.inputs["Count"], "default_value", {10: 3, 10.25: 2}, "CONSTANT")
    scene.frame_set(10)
    motion = export().instances.motion
    np.testing.assert_allclose(motion[1][:, 0, 3], [9.5, 10.0, 10.5], atol=1e-5)
    np.testing.assert_allclose(motion[2][:, 0, 3], [9.5, 10.0, 10.0], atol=1e-5)


# ---------------------------------------------------------------------------------------------------------------------
# Strands and points


def _empty_nodes(name: str) -> Any:
    """A tree of geometry nodes with the sockets of a modifier's."""
    import bpy

    group = bpy.data.node_groups.new(name, "GeometryNodeTree")
    group.interface.new_socket("Geometry", in_out="INPUT", socket_type="NodeSocketGeometry")
    group.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    return group


def _add_nodes(owner: Any, moved: str) -> None:
    """Geometry nodes that shift what is there by the frame along z, and make radii of the frame."""
    group = _empty_nodes("Rise")
    nodes, links = group.nodes, group.links
    given, left = nodes.new("NodeGroupInput"), nodes.new("NodeGroupOutput")
    time = nodes.new("GeometryNodeInputSceneTime")
    vector, shift, radius = nodes.new("ShaderNodeCombineXYZ"), nodes.new("GeometryNodeSetPosition"), nodes.new(moved)
    links.new(time.outputs["Frame"], vector.inputs["Z"])
    links.new(vector.outputs[0], shift.inputs["Offset"])
    links.new(time.outputs["Frame"], radius.inputs["Radius"])
    links.new(given.outputs[0], shift.inputs[0])
    links.new(shift.outputs[0], radius.inputs[0])
    links.new(radius.outputs[0], left.inputs[0])
    owner.modifiers.new("Rise", "NODES").node_group = group


def _add_strands(scene: Any) -> Any:
    import bpy

    data = bpy.data.hair_curves.new("Strands")
    data.add_curves([3, 2])
    data.position_data.foreach_set("vector", np.arange(15, dtype=np.float32))
    strands = bpy.data.objects.new("Strands", data)
    scene.collection.objects.link(strands)
    return strands


@pytest.mark.parametrize("steps", [1, 2])
def test_curves_of_geometry_nodes_move_and_keep_the_middle_s_thickness(scene: Any, steps: int) -> None:
    """As in Cycles, whose strands do not swell."""
    strands = _add_strands(scene)
    _add_nodes(strands, "GeometryNodeSetCurveRadius")
    strands.cycles.motion_steps = steps
    (mesh,) = export().meshes
    times = np.linspace(9.5, 10.5, 2**steps + 1)
    assert mesh.motion_vertices.shape == (len(times), 5, 3)
    np.testing.assert_allclose(mesh.motion_vertices[:, 1, 2], 5.0 + times, rtol=1e-6)
    np.testing.assert_allclose(mesh.rounds.motion_radii, 10.0, rtol=1e-6)


def test_points_move_and_swell(scene: Any) -> None:
    import bpy

    bpy.ops.object.pointcloud_random_add()
    cloud = bpy.context.object
    _add_nodes(cloud, "GeometryNodeSetPointRadius")
    (mesh,) = export().meshes
    moved = mesh.motion_vertices[:, :, 2] - mesh.vertices[:, 2]
    np.testing.assert_allclose(moved, [[-0.5], [0.0], [0.5]] * np.ones(len(mesh.vertices)), atol=1e-5)
    np.testing.assert_allclose(mesh.rounds.motion_radii[:, 0], [9.5, 10.0, 10.5], rtol=1e-6)


@pytest.mark.parametrize("kind", ["points", "strands"])
def test_velocities_of_strands_and_points(scene: Any, kind: str) -> None:
    """They come before what is there at other times, as in Cycles."""
    import bpy

    if kind == "points":
        bpy.ops.object.pointcloud_random_add()
        owner = bpy.context.object
    else:
        owner = _add_strands(scene)
    _add_nodes(owner, "GeometryNodeSetPointRadius" if kind == "points" else "GeometryNodeSetCurveRadius")
    velocity = owner.data.attributes.new("velocity", "FLOAT_VECTOR", "POINT")
    count = len(owner.data.points)
    velocity.data.foreach_set("vector", np.tile(np.array([24.0, 0.0, 0.0], np.float32), count))
    owner.cycles.motion_steps = 3
    owner.data.update_tag()
    (mesh,) = export().meshes
    assert len(mesh.motion_vertices) == 3 and mesh.rounds.motion_radii is None
    np.testing.assert_allclose(
        mesh.motion_vertices[:, :, 0] - mesh.vertices[:, 0], [[-0.5], [0.0], [0.5]] * np.ones(count), atol=1e-5
    )


def test_hair_moves_with_the_shape_of_its_mesh(scene: Any) -> None:
    cube = add_stretching_cube(scene)
    settings = cube.modifiers.new("Fur", "PARTICLE_SYSTEM").particle_system.settings
    settings.type, settings.count, settings.hair_length = "HAIR", 40, 0.5
    open_shutter(scene, 4.0)
    scene.frame_set(10)
    hair = next(mesh for mesh in export().meshes if mesh.rounds is not None)
    middle = hair.motion_vertices[1]
    np.testing.assert_array_equal(middle, hair.vertices)
    # Roots are at z = (1 + 2 x / 20) of where they were: 1.8, 2 and 2.2 at the frames 8, 10 and 12.
    roots = hair.motion_vertices[:, np.unique(hair.triangles[:, 2]), 2]
    on_top = np.abs(roots[1] - 2.0) < 1e-4
    assert on_top.any()
    np.testing.assert_allclose(roots[:, on_top], np.array([[1.8], [2.0], [2.2]]) * np.ones(on_top.sum()), atol=1e-4)


def test_hair_that_is_carried_keeps_its_shape(scene: Any) -> None:
    """Its keys come back from the world, a little beside where they were."""
    cube = add_cube()
    settings = cube.modifiers.new("Fur", "PARTICLE_SYSTEM").particle_system.settings
    settings.type, settings.count, settings.hair_length = "HAIR", 40, 0.5
    keyframe(cube, "rotation_euler", {0: (0.0, 0.0, 0.0), 20: (0.3, 0.0, 3.0)})
    keyframe(cube, "location", {0: (0.0, 0.0, 0.0), 20: (20.0, 0.0, 0.0)})
    scene.frame_set(10)
    description = export()
    assert all(mesh.motion_vertices is None for mesh in description.meshes)
    assert len(description.instances.motion) == 2


def test_strands_that_become_more_are_not_blurred(scene: Any) -> None:
    strands = _add_strands(scene)
    group = _empty_nodes("More")
    nodes, links = group.nodes, group.links
    given, left = nodes.new("NodeGroupInput"), nodes.new("NodeGroupOutput")
    time = nodes.new("GeometryNodeInputSceneTime")
    more, half = nodes.new("GeometryNodeDuplicateElements"), nodes.new("ShaderNodeMath")
    more.domain, half.operation = "SPLINE", "FLOOR"
    links.new(time.outputs["Frame"], half.inputs[0])
    links.new(half.outputs[0], more.inputs["Amount"])
    links.new(given.outputs[0], more.inputs[0])
    links.new(more.outputs[0], left.inputs[0])
    strands.modifiers.new("More", "NODES").node_group = group
    description = export()
    assert description.meshes[0].motion_vertices is None
    assert any("other strands or points" in notice.problem for notice in description.notices)


def test_strands_that_get_other_keys_are_followed_by_evenly_spread_ones(scene: Any) -> None:
    """As in Cycles."""
    strands = _add_strands(scene)
    group = _empty_nodes("Keys")
    nodes, links = group.nodes, group.links
    given, left = nodes.new("NodeGroupInput"), nodes.new("NodeGroupOutput")
    time, more, count = (
        nodes.new(name) for name in ("GeometryNodeInputSceneTime", "GeometryNodeResampleCurve", "ShaderNodeMath")
    )
    count.operation = "FLOOR"
    links.new(time.outputs["Frame"], count.inputs[0])
    links.new(count.outputs[0], more.inputs["Count"])
    links.new(given.outputs[0], more.inputs[0])
    links.new(more.outputs[0], left.inputs[0])
    strands.modifiers.new("Keys", "NODES").node_group = group
    open_shutter(scene, 2.0)
    scene.frame_set(10)
    description = export()
    (mesh,) = description.meshes
    # Straight strands, cut evenly into 9, 10 and 11 keys: of each, 10 that are evenly spread lie in the same places.
    assert len(mesh.vertices) == 20 and description.notices == []
    assert mesh.motion_vertices is not None
    np.testing.assert_allclose(mesh.motion_vertices, np.repeat(mesh.vertices[None], 3, axis=0), atol=1e-4)


def test_keys_between_those_of_others() -> None:
    from addon.export.rounds import as_many_keys

    values = np.array([[0.0], [4.0], [1.0], [2.0], [3.0], [9.0]], np.float32)
    found = as_many_keys(values, np.array([0, 2, 5, 6]), np.array([0, 3, 5, 7]))
    assert found.ravel().tolist() == [0.0, 2.0, 4.0, 1.0, 3.0, 9.0, 9.0]
