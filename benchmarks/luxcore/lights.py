# SPDX-License-Identifier: GPL-3.0-or-later
"""Lamps and the world: suns, points, a uniform sky and a picture of one."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from benchmarks.luxcore.properties import LuxScene, Mesh, Properties, prefixed, refuse_links, socket_value

#: LuxCore's pictures of all directions begin at x and go on to y, Blender's at -x.
_TURNED = [-1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]


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
    if data.use_nodes and data.node_tree is not None and data.node_tree.nodes:
        raise ValueError(f"the lamp {item.name!r} has nodes: LuxCore would not show it alike")
    if data.type == "SUN" and data.angle > 0.0:
        return LuxScene(prefixed(f"scene.lights.{name}", _sun(item, matrix)), {})
    if data.type == "POINT" and data.shadow_soft_size > 0.0 and not data.use_soft_falloff:
        glow, mesh = _glowing_sphere(item, matrix)
        return export_object(name, prefixed(f"scene.materials.{name}", glow), mesh)
    raise ValueError(f"the lamp {item.name!r} is no sun, nor a point without soft falloff: LuxCore has none alike")


def export_object(name: str, material: Properties, mesh: Mesh) -> LuxScene:
    """An object with a material of its own, of the same name."""
    placed = prefixed(f"scene.objects.{name}", {"shape": name, "material": name})
    return LuxScene(material | placed, {name: mesh})


def export_world(world: Any) -> LuxScene:
    """The light of a world, if it has any.

    Raises
    ------
    ValueError
        If it is neither uniform nor a plain picture of all directions.
    """
    node = next((n for n in world.node_tree.nodes if n.type == "BACKGROUND"), None) if world is not None else None
    if node is None:
        return LuxScene({}, {})
    try:
        strength = socket_value(node, "Strength")
        links = node.inputs["Color"].links
        if not links:
            return _uniform([strength * channel for channel in socket_value(node, "Color")[:3]])
        return _pictured(links[0].from_node, strength)
    except ValueError as error:
        raise ValueError(
            f"the world {world.name!r} is neither uniform nor a plain picture: {error}; LuxCore would not show it alike"
        ) from error


def _uniform(radiance: list[float]) -> LuxScene:
    if not any(radiance):
        return LuxScene({}, {})
    uniform = {"type": "constantinfinite", "gain": radiance, "color": [1.0, 1.0, 1.0]}
    return LuxScene(prefixed("scene.lights.world", uniform), {})


def _pictured(node: Any, strength: float) -> LuxScene:
    if node.type != "TEX_ENVIRONMENT" or node.image is None:
        raise ValueError(f"its colour is by {node.bl_label}")
    refuse_links(node)
    image = node.image
    # Floats are linear here, whatever the file has; and what has not been read yet says nothing of itself.
    width, height = image.size
    values = np.empty(width * height * 4, np.float32)
    image.pixels.foreach_get(values)
    if node.projection != "EQUIRECTANGULAR" or node.interpolation != "Linear":
        raise ValueError("its picture is not equirectangular, or not interpolated linearly")
    if not image.is_float:
        raise ValueError("its picture is not of floats")
    mapping = node.texture_mapping
    is_mapped = tuple(mapping.scale) != (1.0, 1.0, 1.0) or any(mapping.rotation) or any(mapping.translation)
    if is_mapped:
        raise ValueError("its picture is mapped")
    picture = values.reshape(height, width, 4)[::-1, :, :3]
    sky = {
        "type": "infinite", "file": "world", "gamma": 1.0, "gain": [strength] * 3,
        "transformation": _TURNED,
    }  # fmt: skip
    return LuxScene(prefixed("scene.lights.world", sky), {}, images={"world": np.ascontiguousarray(picture)})

