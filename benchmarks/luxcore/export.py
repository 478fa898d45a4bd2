# SPDX-License-Identifier: GPL-3.0-or-later
"""The open scene as LuxCore's properties and meshes: what both mean alike, and nothing else.

LuxCore's properties: https://wiki.luxcorerender.org/LuxCore_SDL_Reference_Manual_v2.5
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

Properties = dict[str, Any]
#: Points, triangles and normals.
Mesh = tuple[np.ndarray, np.ndarray, np.ndarray]

#: As smooth as these are in Blender, mirrors and clear glass are in LuxCore.
_SMOOTH = 1e-4


@dataclass(frozen=True)
class LuxScene:
    """A scene for `benchmarks.luxcore.process`.

    Attributes
    ----------
    properties : dict
        Of the scene and the film, by LuxCore's names.
    meshes : dict of str to (points, triangles, normals)
        float64 (V, 3) [m], int64 (T, 3), float64 (V, 3); three vertices a triangle.
    footprint : float
        Width of a pixel on what is seen in the middle of the picture [m].
    """

    properties: Properties
    meshes: dict[str, Mesh]
    footprint: float = 0.0


def _value(node: Any, name: str) -> Any:
    socket = node.inputs[name]
    if socket.is_linked:
        raise ValueError(f"its input {name} is linked")
    value = socket.default_value
    return float(value) if isinstance(value, float) else tuple(float(v) for v in value)


def _diffuse(node: Any) -> Properties:
    if _value(node, "Roughness") > _SMOOTH:
        raise ValueError("its diffuse surface is rough")
    return {"type": "matte", "kd": list(_value(node, "Color")[:3])}


def _glass(node: Any) -> Properties:
    if _value(node, "Roughness") > _SMOOTH:
        raise ValueError("its glass is rough")
    color = list(_value(node, "Color")[:3])
    return {"type": "glass", "kr": color, "kt": color, "interiorior": _value(node, "IOR"), "exteriorior": 1.0}


def _mirror(node: Any) -> Properties:
    if _value(node, "Roughness") > _SMOOTH:
        raise ValueError("its metal is rough")
    return {"type": "mirror", "kr": list(_value(node, "Color")[:3])}


_CLOSURES: Mapping[str, Callable[[Any], Properties]] = {
    "BSDF_DIFFUSE": _diffuse, "BSDF_GLASS": _glass, "BSDF_GLOSSY": _mirror,
}  # fmt: skip


def export_material(material: Any) -> Properties:
    """A material's properties, without their prefix.

    Raises
    ------
    ValueError
        Naming what LuxCore would not show alike.
    """
    if material is None:
        raise ValueError("an object has no material: give it one")
    node = next((n for n in material.node_tree.nodes if n.type == "OUTPUT_MATERIAL"), None)
    links = node.inputs["Surface"].links if node is not None else ()
    closure = links[0].from_node if links else None
    if closure is None or closure.type not in _CLOSURES:
        found = closure.bl_label if closure is not None else "no surface"
        raise ValueError(f"the material {material.name!r} is {found}: LuxCore shows Diffuse, Glass and Glossy alike")
    try:
        return _CLOSURES[closure.type](closure)
    except ValueError as error:
        raise ValueError(f"the material {material.name!r}: {error}; LuxCore would not show it alike") from error


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
    placed = points.reshape(-1, 3)[vertices] @ matrix[:3, :3].T + matrix[:3, 3]
    turned = normals.reshape(-1, 3) @ np.linalg.inv(matrix[:3, :3])
    item.to_mesh_clear()
    return placed, np.arange(3 * count).reshape(-1, 3), turned / np.linalg.norm(turned, axis=1, keepdims=True)


def _sun(item: Any, matrix: np.ndarray) -> Properties:
    data = item.data
    half = 0.5 * data.angle
    # What arrives by what leaves: LuxCore's gain is the radiance.
    scale = data.energy / (math.pi * math.sin(half) ** 2)
    return {
        "type": "distant", "direction": [float(v) for v in -matrix[:3, 2]], "theta": math.degrees(half),
        "gain": [float(scale * channel) for channel in data.color], "color": [1.0, 1.0, 1.0],
    }  # fmt: skip


def _glowing_sphere(item: Any, matrix: np.ndarray) -> tuple[Properties, Mesh]:
    """A lamp as a glowing mesh of the same power: LuxCore's own sphere is found by no path, and too bright by BiDir."""
    import bmesh

    data = item.data
    grid = bmesh.new()
    bmesh.ops.create_uvsphere(grid, u_segments=48, v_segments=24, radius=data.shadow_soft_size)
    bmesh.ops.triangulate(grid, faces=grid.faces)
    corners = np.array([[vertex.co for vertex in face.verts] for face in grid.faces], np.float64)
    grid.free()
    edges = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = 0.5 * float(np.linalg.norm(edges, axis=1).sum())
    radiance = [float(data.energy * channel / (math.pi * area)) for channel in data.color]
    points = corners.reshape(-1, 3)
    glow = {"type": "matte", "kd": [0.0] * 3, "emission": [1.0] * 3, "emission.gain": radiance}
    normals = points / data.shadow_soft_size
    return glow, (points + matrix[:3, 3], np.arange(len(points)).reshape(-1, 3), normals)


def export_light(item: Any, matrix: np.ndarray, name: str) -> LuxScene:
    """A lamp's properties, and its mesh if it has one.

    Raises
    ------
    ValueError
        Naming what LuxCore would not show alike.
    """
    data = item.data
    if data.type == "SUN" and data.angle > 0.0:
        return LuxScene(_prefixed(f"scene.lights.{name}", _sun(item, matrix)), {})
    if data.type == "POINT" and data.shadow_soft_size > 0.0 and not data.use_soft_falloff:
        glow, mesh = _glowing_sphere(item, matrix)
        return _object(name, glow, mesh)
    raise ValueError(f"the lamp {item.name!r} is no sun, nor a point without soft falloff: LuxCore has none alike")


def _object(name: str, material: Properties, mesh: Mesh) -> LuxScene:
    """An object with a material of its own."""
    placed = _prefixed(f"scene.objects.{name}", {"shape": name, "material": name})
    return LuxScene(_prefixed(f"scene.materials.{name}", material) | placed, {name: mesh})


def _world(world: Any) -> list[float]:
    node = next((n for n in world.node_tree.nodes if n.type == "BACKGROUND"), None) if world is not None else None
    if node is None:
        return [0.0, 0.0, 0.0]
    try:
        return [_value(node, "Strength") * channel for channel in _value(node, "Color")[:3]]
    except ValueError as error:
        raise ValueError(f"the world {world.name!r} is not uniform: {error}") from error


def _camera(scene: Any) -> Properties:
    camera, render = scene.camera, scene.render
    data = camera.data
    width, height = render.resolution_x, render.resolution_y
    if data.type != "PERSP" or data.dof.use_dof or data.shift_x or data.shift_y or data.sensor_fit != "AUTO":
        raise ValueError("the camera has more than a lens: LuxCore would not show it alike")
    matrix = np.array(camera.matrix_world)
    origin, forward, up = matrix[:3, 3], -matrix[:3, 2], matrix[:3, 1]
    longest = max(width, height)
    across, along = width / longest, height / longest
    return {
        "scene.camera.type": "perspective",
        "scene.camera.lookat.orig": [float(v) for v in origin],
        "scene.camera.lookat.target": [float(v) for v in origin + forward],
        "scene.camera.up": [float(v) for v in up],
        "scene.camera.screenwindow": [-across, across, -along, along],
        "scene.camera.fieldofview": math.degrees(2.0 * math.atan(0.5 * data.sensor_width / data.lens)),
        "film.width": width,
        "film.height": height,
        # Half of what the filter spans, as Blender's width.
        "film.filter.type": "BLACKMANHARRIS",
        "film.filter.width": float(scene.cycles.filter_width),
    }


def export_scene(scene: Any) -> LuxScene:
    """Export the open scene, a `bpy.types.Scene`.

    Raises
    ------
    ValueError
        Naming the material, lamp, world or camera that LuxCore would not show alike.
    """
    import bpy

    if scene.cycles.pixel_filter_type != "BLACKMAN_HARRIS":
        raise ValueError("the scene's pixel filter is not Blackman-Harris, by which LuxCore is rendered")
    properties = _camera(scene)
    meshes: dict[str, Mesh] = {}
    radiance = _world(scene.world)
    if any(radiance):
        uniform = {"type": "constantinfinite", "gain": radiance, "color": [1.0, 1.0, 1.0]}
        properties |= _prefixed("scene.lights.world", uniform)
    for index, instance in enumerate(bpy.context.evaluated_depsgraph_get().object_instances):
        item, matrix = instance.object, np.array(instance.matrix_world)
        if item.type == "LIGHT":
            made = export_light(item, matrix, f"l{index}")
        elif item.type == "MESH":
            material = export_material(item.material_slots[0].material if item.material_slots else None)
            made = _object(f"m{index}", material, _mesh(item, matrix))
        else:
            continue
        properties |= made.properties
        meshes |= made.meshes
    return LuxScene(properties, meshes, _footprint(scene))


def _footprint(scene: Any) -> float:
    import bpy

    camera, render = scene.camera, scene.render
    matrix = np.array(camera.matrix_world)
    hit, place, *_ = scene.ray_cast(bpy.context.evaluated_depsgraph_get(), matrix[:3, 3], -matrix[:3, 2])
    if not hit:
        raise ValueError("nothing is seen in the middle of the picture, by which photons' radius is chosen")
    distance = float(np.linalg.norm(np.array(place) - matrix[:3, 3]))
    return distance * camera.data.sensor_width / camera.data.lens / max(render.resolution_x, render.resolution_y)


def _prefixed(prefix: str, properties: Properties) -> Properties:
    return {f"{prefix}.{name}": value for name, value in properties.items()}
