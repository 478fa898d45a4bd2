# SPDX-License-Identifier: GPL-3.0-or-later
"""How Blender triangulates a mesh, and values spread over its triangles."""

from __future__ import annotations

from dataclasses import dataclass

import bpy
import numpy as np
import numpy.typing as npt

from engine.array_types import Int32Array, Uint32Array


@dataclass
class Topology:
    """How triangles lie on a Blender mesh.

    corners : intp (3 * T,), rows of Blender's face corners
    vertices : uint32 (T, 3)
    polygons : int32 (T,)
    """

    corners: npt.NDArray[np.intp]
    vertices: Uint32Array
    polygons: Int32Array


def read_topology(mesh: bpy.types.Mesh, triangle_count: int) -> Topology:
    """Triangles of a mesh whose loop triangles were computed."""
    corners = np.empty(triangle_count * 3, np.uint32)
    mesh.loop_triangles.foreach_get("loops", corners)
    corner_vertices = read_corner_vertices(mesh)
    polygons = np.empty(triangle_count, np.int32)
    if hasattr(mesh, "loop_triangle_polygons"):
        mesh.loop_triangle_polygons.foreach_get("value", polygons)
    else:
        mesh.loop_triangles.foreach_get("polygon_index", polygons)
    rows = corners.astype(np.intp)
    vertices = gather(corner_vertices.view(np.uint32), rows)
    return Topology(rows, vertices.reshape(-1, 3), polygons)


class Faces:
    """Faces of a Blender mesh as they are before triangulation, which goes by the shape too."""

    def __init__(self, corner_vertices: Int32Array, starts: Int32Array) -> None:
        self._arrays = (corner_vertices, starts)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Faces):
            return NotImplemented
        return all(np.array_equal(a, b) for a, b in zip(self._arrays, other._arrays, strict=True))

    __hash__ = None  # type: ignore[assignment]


def read_faces(mesh: bpy.types.Mesh) -> Faces:
    """Faces of a mesh."""
    starts = np.empty(len(mesh.polygons), np.int32)
    mesh.polygons.foreach_get("loop_start", starts)
    return Faces(read_corner_vertices(mesh), starts)


def read_corner_vertices(mesh: bpy.types.Mesh) -> Int32Array:
    """Vertex of each corner."""
    corner_vertices = np.empty(len(mesh.loops), np.int32)
    stored = mesh.attributes.get(".corner_vert")
    if stored is not None:
        stored.data.foreach_get("value", corner_vertices)
    else:
        mesh.loops.foreach_get("vertex_index", corner_vertices)
    return corner_vertices


def gather(values: np.ndarray, rows: npt.NDArray[np.integer]) -> np.ndarray:
    """`values[rows]`, several times faster than indexing (the rows come from Blender and are in range)."""
    result = np.empty((len(rows), *values.shape[1:]), values.dtype)
    if len(values):
        np.take(values, rows, axis=0, out=result, mode="clip")
    return result
