# SPDX-License-Identifier: GPL-3.0-or-later
"""The open scene as LuxCore's properties and meshes: what both mean alike, and nothing else."""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.luxcore.camera import export_camera, pixel_width
from benchmarks.luxcore.lights import export_light, export_object, export_world
from benchmarks.luxcore.materials import export_material, glows
from benchmarks.luxcore.properties import LuxScene, Mesh

#: How near something must be behind what glows for its back to be covered, over the triangle's size.
_COVERED = 0.02


def _mesh(item: Any, matrix: np.ndarray) -> Mesh:
    data = item.to_mesh()
    data.calc_loop_triangles()
    count = len(data.loop_triangles)
    loops, points, normals = np.empty(3 * count, np.int64), np.empty(3 * len(data.vertices)), np.empty(9 * count)
    vertices = np.empty(3 * count, np.int64)
    data.loop_triangles.foreach_get("loops", loops)
    data.loop_triangles.foreach_get("vertices", vertices)
    data.loop_triangles.foreach_get("split_normals", normals)
    data.vertices.foreach_get("co", points)
    slots = np.empty(count, np.int64)
    data.loop_triangles.foreach_get("material_index", slots)
    item.to_mesh_clear()
    if slots.any():
        raise ValueError(f"{item.name!r} has faces of a second material: separate them, LuxCore has one for an object")
    placed = points.reshape(-1, 3)[vertices] @ matrix[:3, :3].T + matrix[:3, 3]
    turned = normals.reshape(-1, 3) @ np.linalg.inv(matrix[:3, :3])
    triangles = np.arange(3 * count).reshape(-1, 3)
    if np.linalg.det(matrix[:3, :3]) < 0.0:
        # What mirrors turns triangles over, whose front is where they are seen counterclockwise.
        triangles = triangles[:, ::-1]
    return placed, triangles, turned / np.linalg.norm(turned, axis=1, keepdims=True)


def _is_covered(scene: Any, corners: np.ndarray, towards: np.ndarray) -> bool:
    """Whether something lies right behind triangles, (T, 3, 3), on the side of their unit vectors `towards`, (T, 3)."""
    import bpy

    graph = bpy.context.evaluated_depsgraph_get()
    weights = np.array([[1.0, 1.0, 1.0], [8.0, 1.0, 1.0], [1.0, 8.0, 1.0], [1.0, 1.0, 8.0]])
    weights /= weights.sum(axis=1, keepdims=True)
    for triangle, direction in zip(corners, towards, strict=True):
        size = float(np.linalg.norm(triangle[1:] - triangle[0], axis=1).max())
        for place in weights @ triangle:
            # A step aside, so that it is not the triangle itself that is met.
            origin = place + 1e-5 * size * direction
            hit, *_ = scene.ray_cast(graph, origin, direction, distance=_COVERED * size)
            if not hit:
                return False
    return True


def _glowing(scene: Any, item: Any, mesh: Mesh) -> Mesh:
    """A mesh that glows, turned so that its front does: LuxCore's glow on one side, Blender's on both.

    Raises
    ------
    ValueError
        If both sides may be seen.
    """
    points, triangles, normals = mesh
    corners = points[triangles]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    front = across / np.linalg.norm(across, axis=1, keepdims=True)
    if _is_covered(scene, corners, -front):
        return mesh
    if _is_covered(scene, corners, front):
        return points, triangles[:, ::-1], -normals
    raise ValueError(f"{item.name!r} glows on both sides, of which none is covered: LuxCore's meshes glow on one")


def _is_closed(item: Any) -> bool:
    """Whether a mesh has an inside, which nobody sees."""
    import bmesh

    grid = bmesh.new()
    grid.from_mesh(item.data)
    closed = len(grid.edges) > 0 and all(edge.is_manifold for edge in grid.edges) and grid.calc_volume(signed=True) > 0
    grid.free()
    return closed


def _require_visible(item: Any) -> None:
    kinds = ("camera", "diffuse", "glossy", "transmission", "shadow", "volume_scatter")
    if not all(getattr(item, f"visible_{kind}") for kind in kinds) or item.is_holdout or item.is_shadow_catcher:
        raise ValueError(f"{item.name!r} is hidden from some rays: LuxCore would not show it alike")


def _object(scene: Any, item: Any, matrix: np.ndarray, name: str) -> LuxScene:
    _require_visible(item)
    material = export_material(item.material_slots[0].material if item.material_slots else None, name)
    mesh = _mesh(item, matrix)
    if glows(material) and not _is_closed(item):
        mesh = _glowing(scene, item, mesh)
    return export_object(name, material, mesh)


def export_scene(scene: Any) -> LuxScene:
    """Export the open scene, a `bpy.types.Scene`.

    Raises
    ------
    ValueError
        Naming the material, mesh, lamp, world or camera that LuxCore would not show alike.
    """
    import bpy

    if scene.cycles.pixel_filter_type != "BLACKMAN_HARRIS":
        raise ValueError("the scene's pixel filter is not Blackman-Harris, by which LuxCore is rendered")
    # It brings matrices up to date.
    graph = bpy.context.evaluated_depsgraph_get()
    world = export_world(scene.world)
    properties = export_camera(scene) | world.properties
    meshes: dict[str, Mesh] = {}
    for index, instance in enumerate(graph.object_instances):
        item, matrix = instance.object, np.array(instance.matrix_world)
        if item.type == "LIGHT":
            made = export_light(item, matrix, f"l{index}")
        elif item.type == "MESH":
            made = _object(scene, item, matrix, f"m{index}")
        else:
            continue
        properties |= made.properties
        meshes |= made.meshes
    return LuxScene(properties, meshes, _footprint(scene), world.images)


def _footprint(scene: Any) -> float:
    import bpy

    matrix = np.array(scene.camera.matrix_world)
    hit, place, *_ = scene.ray_cast(bpy.context.evaluated_depsgraph_get(), matrix[:3, 3], -matrix[:3, 2])
    if not hit:
        raise ValueError("nothing is seen in the middle of the picture, by which photons' radius is chosen")
    return float(np.linalg.norm(np.array(place) - matrix[:3, 3])) * pixel_width(scene)
