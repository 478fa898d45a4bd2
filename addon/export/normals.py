# SPDX-License-Identifier: GPL-3.0-or-later
"""Normals of evaluated meshes, from wherever Cycles takes them."""

from __future__ import annotations

import bpy
import numpy as np
import numpy.typing as npt

from engine.array_types import Float32Array

from ..versions import NORMALS_STOP_AT_FLAT_FACES, is_since
from .positions import read_positions
from .topology import Topology, gather


def read_normals(mesh: bpy.types.Mesh, topology: Topology) -> Float32Array | None:
    """Normals of the triangles' corners, float32 (T, 3, 3), or None where every face is flat.

    Where Cycles takes Blender's own normals of corners, which stop at flat faces and sharp edges, so do we. Else smooth
    faces have their vertices' normals, over all faces around them, and triangles of flat faces their own.
    """
    is_flat = read_flat_faces(mesh)
    if is_flat.all():
        return None
    if has_normals_of_corners(mesh):
        return gather(read_corner_normals(mesh), topology.corners).reshape(-1, 3, 3)
    normals = gather(read_vertex_normals(mesh), topology.vertices.reshape(-1)).reshape(-1, 3, 3)
    if is_flat.any():
        of_triangles = gather(is_flat, topology.polygons)
        normals[of_triangles] = _flat_normals(read_positions(mesh), topology.vertices[of_triangles])[:, None]
    return normals


def read_flat_faces(mesh: bpy.types.Mesh) -> npt.NDArray[np.bool_]:
    """Which faces are flat; where no face says so, sharp edges or normals of faces may make all of them flat."""
    if hasattr(mesh, "normals_domain") and "sharp_face" not in mesh.attributes:
        return np.full(len(mesh.polygons), mesh.normals_domain == "FACE")
    is_smooth = np.empty(len(mesh.polygons), bool)
    mesh.polygons.foreach_get("use_smooth", is_smooth)
    return ~is_smooth


def read_flat_triangles(mesh: bpy.types.Mesh, topology: Topology) -> npt.NDArray[np.bool_]:
    """Which triangles are of flat faces, bool (T,)."""
    return gather(read_flat_faces(mesh), topology.polygons)


def has_normals_of_corners(mesh: bpy.types.Mesh) -> bool:
    """Whether Cycles takes normals of corners, not of vertices."""
    if not hasattr(mesh, "normals_domain"):
        return mesh.use_auto_smooth
    if mesh.normals_domain != "CORNER":
        return False
    # Custom normals that are free vectors are an attribute only.
    return (
        is_since(NORMALS_STOP_AT_FLAT_FACES)
        or mesh.has_custom_normals
        or "custom_normal" in mesh.attributes
        or _has_sharp_edges(mesh)
    )


def read_vertex_normals(mesh: bpy.types.Mesh) -> Float32Array:
    """Normals of vertices over all faces around them, float32 (V, 3)."""
    flat = np.empty(len(mesh.vertices) * 3, np.float32)
    if hasattr(mesh, "vertex_normals"):
        mesh.vertex_normals.foreach_get("vector", flat)
    else:
        mesh.vertices.foreach_get("normal", flat)
    return flat.reshape(-1, 3)


def read_corner_normals(mesh: bpy.types.Mesh) -> Float32Array:
    """Blender's own normals of corners, float32 (corners, 3)."""
    flat = np.empty(len(mesh.loops) * 3, np.float32)
    if hasattr(mesh, "corner_normals"):
        mesh.corner_normals.foreach_get("vector", flat)
    else:
        # Before Blender 4.1 normals are split on demand.
        mesh.calc_normals_split()
        mesh.loops.foreach_get("normal", flat)
        mesh.free_normals_split()
    return flat.reshape(-1, 3)


def _flat_normals(vertices: Float32Array, triangles: npt.NDArray[np.integer]) -> Float32Array:
    """Normals of the planes of triangles, float32 (T, 3); (0, 0, 1) for those that are degenerate."""
    a, b, c = (vertices[triangles[:, corner]].astype(np.float64) for corner in range(3))
    normals = np.cross(b - a, c - a)
    lengths = np.linalg.norm(normals, axis=1)
    is_degenerate = ~(lengths > 0.0)
    normals[is_degenerate], lengths[is_degenerate] = (0.0, 0.0, 1.0), 1.0
    return (normals / lengths[:, None]).astype(np.float32)


def _has_sharp_edges(mesh: bpy.types.Mesh) -> bool:
    stored = mesh.attributes.get("sharp_edge")
    if stored is None:
        return False
    is_sharp = np.empty(len(stored.data), bool)
    stored.data.foreach_get("value", is_sharp)
    return bool(is_sharp.any())
