# SPDX-License-Identifier: GPL-3.0-or-later
"""Curves and spheres as Embree takes them."""

from __future__ import annotations

import numpy as np

from engine.accel.called import address_of
from engine.accel.filters import cull
from engine.accel.geometry_calls import (
    BUFFER_INDEX,
    BUFFER_VERTEX,
    FORMAT_FLOAT4,
    FORMAT_UINT,
)
from engine.accel.library import embree
from engine.state.geometry import (
    MESH_FIRST_RADIUS,
    MESH_FIRST_TRIANGLE,
    MESH_FIRST_VERTEX,
    MESH_MOTION,
    MESH_SHAPE,
    MESH_SUBDIVISIONS,
    MESH_TRIANGLE_COUNT,
    MESH_VERTEX_COUNT,
    MOTION_FIRST_VERTEX,
    MOTION_STEP_COUNT,
    SHAPE_RIBBONS,
    SHAPE_ROUND,
    SHAPE_ROUND_LINEAR,
    SHAPE_SPHERES,
    GeometryArrays,
)

# Embree 4 API constants (rtcore headers).
_GEOMETRY_TYPES = {SHAPE_ROUND_LINEAR: 16, SHAPE_SPHERES: 50, SHAPE_ROUND: 58, SHAPE_RIBBONS: 59}
_PROPERTY_CULLS_SPHERES, _PROPERTY_CULLS_CURVES = 62, 63
_PROPERTY_HAS_CURVES, _PROPERTY_HAS_SPHERES = 99, 101

#: Control points that are copied at a time.
_ROWS = 1 << 16
#: Control points that a run of segments has before its first vertex, which are copies of it, and behind its last.
_ENDS = {SHAPE_RIBBONS: 1, SHAPE_ROUND: 1, SHAPE_ROUND_LINEAR: 0}


def control_points(rows: np.ndarray, ends: int) -> tuple[np.ndarray, np.ndarray]:
    """How Embree numbers the control points of curves.

    Parameters
    ----------
    rows : uint32 (S, 3)
        Segments of `GeometryArrays.triangles`. Where one does not go on from that before, a new run begins.
    ends : int
        Of `_ENDS`.

    Returns
    -------
    firsts : uint32 (S,)
        First control point of each segment.
    vertices : uint32 (C,)
        The vertex that each control point lies at.
    """
    begins = np.ones(len(rows), np.bool_)
    begins[1:] = (rows[1:, 0] != rows[:-1, 1]) | (rows[1:, 2] != rows[:-1, 2])
    firsts = np.cumsum(begins, dtype=np.uint32)
    run_count = int(firsts[-1])
    firsts -= np.uint32(1)
    firsts *= np.uint32(1 + 2 * ends)
    firsts += np.arange(len(rows), dtype=np.uint32)
    vertices = np.empty(len(rows) + (1 + 2 * ends) * run_count, np.uint32)
    lasts = np.append(begins[1:], True)
    vertices[firsts + np.uint32(ends)] = rows[:, 0]
    vertices[firsts[lasts] + np.uint32(ends + 1)] = rows[lasts, 1]
    if ends:
        vertices[firsts[begins]] = rows[begins, 0]
        vertices[firsts[lasts] + np.uint32(ends + 2)] = rows[lasts, 1]
    return firsts, vertices


def _points_at(geometry: GeometryArrays, row: np.ndarray, vertices: np.ndarray, step: int) -> np.ndarray:
    """Places and radii, float32 (C, 4), of a mesh's vertices: -1 = at the middle of the shutter, else at a step."""
    first_vertex, first_radius = int(row[MESH_FIRST_VERTEX]), int(row[MESH_FIRST_RADIUS])
    to_place = 0
    to_radius = first_radius - first_vertex
    if step >= 0:
        begin = int(geometry.motion_table[int(row[MESH_MOTION]), MOTION_FIRST_VERTEX])
        to_place = begin + step * int(row[MESH_VERTEX_COUNT]) - first_vertex
        to_radius += (1 + step) * int(row[MESH_VERTEX_COUNT])
    points = np.empty((len(vertices), 4), np.float32)
    for begin in range(0, len(vertices), _ROWS):
        rows = slice(begin, begin + _ROWS)
        which = vertices[rows].astype(np.int64)
        points[rows, :3] = geometry.vertices[which + to_place]
        points[rows, 3] = geometry.radii[which + to_radius]
    return points


def round_geometry(device: int, geometry: GeometryArrays, mesh: int) -> tuple[int, list[np.ndarray]]:
    """Address of a new geometry of curves or spheres, and the arrays that it shares.

    Raises
    ------
    RuntimeError
        Where this Embree library was built without them.
    """
    row = geometry.mesh_table[mesh]
    shape, first, count = int(row[MESH_SHAPE]), int(row[MESH_FIRST_TRIANGLE]), int(row[MESH_TRIANGLE_COUNT])
    is_curve = shape != SHAPE_SPHERES
    if not embree.rtcGetDeviceProperty(device, _PROPERTY_HAS_CURVES if is_curve else _PROPERTY_HAS_SPHERES):
        raise RuntimeError(f"this Embree library has no {'curves' if is_curve else 'spheres'}: use Blender's own")
    rows = geometry.triangles[first : first + count]
    handle: int = embree.rtcNewGeometry(device, _GEOMETRY_TYPES[shape])
    shared = []
    vertices = rows[:, 0]
    if is_curve:
        firsts, vertices = control_points(rows, _ENDS[shape])
        embree.rtcSetGeometryTessellationRate(handle, float(row[MESH_SUBDIVISIONS] + 1))
        shared.append(firsts)
        embree.rtcSetSharedGeometryBuffer(handle, BUFFER_INDEX, 0, FORMAT_UINT, firsts.ctypes.data, 0, 4, count)
    steps, motion = [-1], int(row[MESH_MOTION])
    if motion >= 0:
        steps = list(range(int(geometry.motion_table[motion, MOTION_STEP_COUNT])))
        embree.rtcSetGeometryTimeStepCount(handle, len(steps))
    for number, step in enumerate(steps):
        points = _points_at(geometry, row, vertices, step)
        shared.append(points)
        embree.rtcSetSharedGeometryBuffer(
            handle, BUFFER_VERTEX, number, FORMAT_FLOAT4, points.ctypes.data, 0, 16, len(points)
        )
    # What is round is met from outside, as in Cycles. Blender's library does it by itself.
    culls = embree.rtcGetDeviceProperty(device, _PROPERTY_CULLS_CURVES if is_curve else _PROPERTY_CULLS_SPHERES)
    if shape != SHAPE_RIBBONS and not culls:
        embree.rtcSetGeometryIntersectFilterFunction(handle, address_of(cull))
        embree.rtcSetGeometryOccludedFilterFunction(handle, address_of(cull))
    return handle, shared
