# SPDX-License-Identifier: GPL-3.0-or-later
"""Attributes of meshes, from Blender's domains and types to those of the engine."""

from __future__ import annotations

import bpy
import numpy as np
import numpy.typing as npt

from engine.array_types import Float32Array
from engine.scene.description import Attribute

from .colorspaces import from_srgb, to_srgb
from .topology import Topology, gather

#: Blender's types that Cycles reads: property to read, width, type of the numbers. Matrices, texts and integers of two
#: components are 0 there.
_TYPES: dict[str, tuple[str, int, npt.DTypeLike]] = {
    "FLOAT": ("value", 1, np.float32),
    "INT": ("value", 1, np.int32),
    "INT8": ("value", 1, np.int32),
    "BOOLEAN": ("value", 1, np.bool_),
    "FLOAT2": ("vector", 2, np.float32),
    "FLOAT_VECTOR": ("vector", 3, np.float32),
    "FLOAT4": ("vector", 4, np.float32),
    "FLOAT_COLOR": ("color", 4, np.float32),
    "BYTE_COLOR": ("color", 4, np.float32),
    "QUATERNION": ("value", 4, np.float32),
}


def read_attribute(
    mesh: bpy.types.Mesh, name: str, topology: Topology, vertex_groups: tuple[str, ...] = ()
) -> Attribute | None:
    """The attribute or vertex group `name`, None if the mesh has none of a usable type. Colours come scene-linear.

    Parameters
    ----------
    vertex_groups : tuple of str
        Names of the mesh's vertex groups.
    """
    # A group comes before an attribute of the same name.
    if name in vertex_groups:
        return Attribute("POINT", _read_weights(mesh, vertex_groups.index(name)))
    stored = mesh.attributes.get(name)
    if stored is None or len(stored.data) == 0:
        return None
    values = read_values(stored)
    if values is None:
        return None
    if stored.domain == "POINT":
        return Attribute("POINT", values)
    if stored.domain == "EDGE":
        return Attribute("POINT", _edges_to_points(mesh, stored.data_type, values))
    if stored.domain == "FACE":
        return Attribute("FACE", gather(values, topology.polygons))
    return Attribute("CORNER", gather(values, topology.corners))


def read_values(stored: bpy.types.Attribute) -> Float32Array | None:
    """Numbers of an attribute, float32 (N, width); None of types that Cycles does not read."""
    if stored.data_type not in _TYPES:
        return None
    prop, width, dtype = _TYPES[stored.data_type]
    flat: np.ndarray = np.empty(len(stored.data) * width, dtype)
    stored.data.foreach_get(prop, flat)
    return flat.reshape(-1, width).astype(np.float32, copy=False)


def read_uv_map(mesh: bpy.types.Mesh, layer: bpy.types.MeshUVLoopLayer) -> Float32Array:
    """UV coordinates of every face corner, float32 (corners, 2)."""
    flat = np.empty(len(mesh.loops) * 2, np.float32)
    if hasattr(layer, "uv"):
        layer.uv.foreach_get("vector", flat)
    else:
        layer.data.foreach_get("uv", flat)
    return flat.reshape(-1, 2)


def _read_weights(mesh: bpy.types.Mesh, group: int) -> Float32Array:
    """Weights of a vertex group, float32 (V, 1), 0 for vertices that are not in it.

    Blender has no array of them: this takes a microsecond or three a vertex.
    """

    def weight(vertex: bpy.types.MeshVertex) -> float:
        for element in vertex.groups:
            if element.group == group:
                return element.weight
        return 0.0

    return np.fromiter(map(weight, mesh.vertices), np.float32, len(mesh.vertices)).reshape(-1, 1)


def _edges_to_points(mesh: bpy.types.Mesh, data_type: str, values: Float32Array) -> Float32Array:
    """Values of vertices from those of the edges around them, mixed as Blender mixes values of a type."""
    if data_type == "BYTE_COLOR":
        # Bytes are mixed as they are stored.
        mixed = np.floor(_mean_over_edges(mesh, np.rint(to_srgb(values, is_associated=False) * 255.0))) / 255.0
        mixed[:, :3] = from_srgb(mixed[:, :3])
        return mixed.astype(np.float32)
    if data_type == "QUATERNION":
        return _from_rotation_vectors(_mean_over_edges(mesh, _to_rotation_vectors(values)))
    means = _mean_over_edges(mesh, values)
    if data_type == "BOOLEAN":
        return (means > 0.0).astype(np.float32)
    if data_type in ("INT", "INT8"):
        # Halves away from zero.
        return np.copysign(np.floor(np.abs(means) + 0.5), means).astype(np.float32)
    return means.astype(np.float32)


def _mean_over_edges(mesh: bpy.types.Mesh, values: np.ndarray) -> npt.NDArray[np.float64]:
    ends = np.empty(len(mesh.edges) * 2, np.int32)
    mesh.edges.foreach_get("vertices", ends)
    vertex_count = len(mesh.vertices)
    count = np.bincount(ends, minlength=vertex_count)
    columns = [
        np.bincount(ends, weights=np.repeat(values[:, i], 2), minlength=vertex_count) for i in range(values.shape[1])
    ]
    return np.stack(columns, axis=1) / np.maximum(count, 1)[:, None]


def _to_rotation_vectors(quaternions: np.ndarray) -> np.ndarray:
    """Axis times angle of rotations (w, x, y, z), normalised."""
    unit = quaternions / np.maximum(np.linalg.norm(quaternions, axis=1, keepdims=True), 1e-30)
    sine = np.linalg.norm(unit[:, 1:], axis=1, keepdims=True)
    angle = 2.0 * np.arctan2(sine, unit[:, :1])
    return unit[:, 1:] / np.maximum(sine, 1e-30) * angle


def _from_rotation_vectors(vectors: np.ndarray) -> Float32Array:
    """Quaternions (w, x, y, z) of axes times angles."""
    angle = np.linalg.norm(vectors, axis=1, keepdims=True)
    axis = vectors / np.maximum(angle, 1e-30)
    return np.concatenate([np.cos(0.5 * angle), axis * np.sin(0.5 * angle)], axis=1).astype(np.float32)
