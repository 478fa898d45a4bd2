# SPDX-License-Identifier: GPL-3.0-or-later
"""Attributes of meshes, from Blender's domains and types to those of the engine."""

from __future__ import annotations

import bpy
import numpy as np
import numpy.typing as npt

from engine.array_types import Float32Array
from engine.scene.description import Attribute

from .topology import Topology, gather

#: Blender's types: property to read, width, type of the numbers.
_TYPES: dict[str, tuple[str, int, npt.DTypeLike]] = {
    "FLOAT": ("value", 1, np.float32),
    "INT": ("value", 1, np.int32),
    "INT8": ("value", 1, np.int32),
    "BOOLEAN": ("value", 1, np.bool_),
    "FLOAT2": ("vector", 2, np.float32),
    "INT32_2D": ("value", 2, np.int32),
    "INT16_2D": ("value", 2, np.int32),
    "FLOAT_VECTOR": ("vector", 3, np.float32),
    "FLOAT_COLOR": ("color", 4, np.float32),
    "BYTE_COLOR": ("color", 4, np.float32),
    "QUATERNION": ("value", 4, np.float32),
}


def read_attribute(mesh: bpy.types.Mesh, name: str, topology: Topology) -> Attribute | None:
    """The attribute `name`, None if the mesh has none of a usable type. Colours come scene-linear."""
    stored = mesh.attributes.get(name)
    if stored is None or stored.data_type not in _TYPES or len(stored.data) == 0:
        return None
    prop, width, dtype = _TYPES[stored.data_type]
    flat: np.ndarray = np.empty(len(stored.data) * width, dtype)
    stored.data.foreach_get(prop, flat)
    values = flat.reshape(-1, width).astype(np.float32, copy=False)
    if stored.domain == "POINT":
        return Attribute("POINT", values)
    if stored.domain == "EDGE":
        return Attribute("POINT", _edges_to_points(mesh, values))
    if stored.domain == "FACE":
        return Attribute("FACE", gather(values, topology.polygons))
    return Attribute("CORNER", gather(values, topology.corners))


def read_uv_map(mesh: bpy.types.Mesh, layer: bpy.types.MeshUVLoopLayer) -> Float32Array:
    """UV coordinates of every face corner, float32 (corners, 2)."""
    flat = np.empty(len(mesh.loops) * 2, np.float32)
    if hasattr(layer, "uv"):
        layer.uv.foreach_get("vector", flat)
    else:
        layer.data.foreach_get("uv", flat)
    return flat.reshape(-1, 2)


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
