# SPDX-License-Identifier: GPL-3.0-or-later
"""Attributes of meshes, from Blender's domains and types to those of the engine."""

from __future__ import annotations

import bpy
import numpy as np
import numpy.typing as npt

from engine.array_types import Float32Array
from engine.scene.description import Attribute

from .colorspaces import from_srgb
from .topology import Topology, gather

#: Blender's types: property to read, width, type of the numbers.
_TYPES: dict[str, tuple[str, int, npt.DTypeLike]] = {
    "FLOAT": ("value", 1, np.float32),
    "INT": ("value", 1, np.int32),
    "INT8": ("value", 1, np.int32),
    "BOOLEAN": ("value", 1, np.bool_),
    "FLOAT2": ("vector", 2, np.float32),
    "FLOAT_VECTOR": ("vector", 3, np.float32),
    "FLOAT_COLOR": ("color", 4, np.float32),
    "BYTE_COLOR": ("color", 4, np.float32),
    "QUATERNION": ("value", 4, np.float32),
}


def read_attribute(mesh: bpy.types.Mesh, name: str, topology: Topology) -> Attribute | None:
    """The attribute `name`, None if the mesh has none of a usable type. Colours come scene-linear."""
    stored = mesh.attributes.get(name)
    values = None if stored is None else read_values(stored)
    if stored is None or values is None:
        return None
    if stored.domain == "POINT":
        return Attribute("POINT", values)
    if stored.domain == "EDGE":
        return Attribute("POINT", _mixed_at_points(mesh, stored, values))
    if stored.domain == "FACE":
        return Attribute("FACE", gather(values, topology.polygons))
    return Attribute("CORNER", gather(values, topology.corners))


def read_values(stored: bpy.types.Attribute) -> Float32Array | None:
    """All values of an attribute, float32 (N, 1 to 4); None if it has none, or is of a type that nodes cannot read."""
    if stored.data_type not in _TYPES or len(stored.data) == 0:
        return None
    prop, width, dtype = _TYPES[stored.data_type]
    flat: np.ndarray = np.empty(len(stored.data) * width, dtype)
    stored.data.foreach_get(prop, flat)
    return flat.reshape(-1, width).astype(np.float32, copy=False)


def read_positions(mesh: bpy.types.Mesh) -> Float32Array:
    """Positions of the vertices, float32 (V, 3)."""
    flat = np.empty(len(mesh.vertices) * 3, np.float32)
    position = mesh.attributes.get("position")
    if position is not None:
        position.data.foreach_get("vector", flat)
    else:
        mesh.vertices.foreach_get("co", flat)
    return flat.reshape(-1, 3)


def read_uv_map(mesh: bpy.types.Mesh, layer: bpy.types.MeshUVLoopLayer) -> Float32Array:
    """UV coordinates of every face corner, float32 (corners, 2)."""
    flat = np.empty(len(mesh.loops) * 2, np.float32)
    if hasattr(layer, "uv"):
        layer.uv.foreach_get("vector", flat)
    else:
        layer.data.foreach_get("uv", flat)
    return flat.reshape(-1, 2)


def _mixed_at_points(mesh: bpy.types.Mesh, stored: bpy.types.Attribute, values: Float32Array) -> Float32Array:
    """What Blender makes of edges' values at vertices, by the type of the attribute."""
    if stored.data_type == "BYTE_COLOR":
        # Bytes are mixed as they are, encoded.
        flat = np.empty(values.size, np.float32)
        stored.data.foreach_get("color_srgb", flat)
        mixed = _edges_to_points(mesh, flat.reshape(values.shape))
        mixed[:, :3] = from_srgb(mixed[:, :3])
        return mixed
    if stored.data_type == "QUATERNION":
        return _from_turns(_edges_to_points(mesh, _to_turns(values)))
    mixed = _edges_to_points(mesh, values)
    if stored.data_type in ("INT", "INT8"):
        return np.trunc(mixed + np.copysign(np.float32(0.5), mixed))
    if stored.data_type == "BOOLEAN":
        return (mixed > 0.0).astype(np.float32)
    return mixed


def _to_turns(quaternions: Float32Array) -> Float32Array:
    """Axis by angle [rad], float32 (N, 3), of quaternions of any length, w first."""
    w, axis = quaternions[:, :1], quaternions[:, 1:]
    sine = np.linalg.norm(axis, axis=1, keepdims=True)
    angle = 2.0 * np.arctan2(sine, w)
    return np.divide(axis * angle, sine, out=np.zeros_like(axis), where=sine > 0.0)


def _from_turns(turns: Float32Array) -> Float32Array:
    angle = np.linalg.norm(turns, axis=1, keepdims=True)
    axis = np.divide(turns, angle, out=np.zeros_like(turns), where=angle > 0.0)
    return np.concatenate([np.cos(angle / 2.0), axis * np.sin(angle / 2.0)], axis=1)


def _edges_to_points(mesh: bpy.types.Mesh, values: Float32Array) -> Float32Array:
    """Mean over the edges at each vertex, as Blender converts between the domains."""
    ends = np.empty(len(mesh.edges) * 2, np.int32)
    mesh.edges.foreach_get("vertices", ends)
    vertex_count = len(mesh.vertices)
    count = np.bincount(ends, minlength=vertex_count)
    columns = [
        np.bincount(ends, weights=np.repeat(values[:, i], 2), minlength=vertex_count) for i in range(values.shape[1])
    ]
    return (np.stack(columns, axis=1) / np.maximum(count, 1)[:, None]).astype(np.float32)
