# SPDX-License-Identifier: GPL-3.0-or-later
"""Curves and spheres as Embree takes them."""

from __future__ import annotations

import numpy as np

from engine.accel.called import address_of
from engine.accel.filters import cull
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
_BUFFER_INDEX = 0
_BUFFER_VERTEX = 1
_FORMAT_UINT = 0x5001
_FORMAT_FLOAT4 = 0x9004
_GEOMETRY_TYPES = {SHAPE_ROUND_LINEAR: 16, SHAPE_SPHERES: 50, SHAPE_ROUND: 58, SHAPE_RIBBONS: 59}
_PROPERTY_CULLS_SPHERES, _PROPERTY_CULLS_CURVES = 62, 63
_PROPERTY_HAS_CURVES, _PROPERTY_HAS_SPHERES = 99, 101

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
    run = np.cumsum(begins) - 1
    firsts = np.arange(len(rows)) + (1 + 2 * ends) * run
    vertices = np.empty(len(rows) + (1 + 2 * ends) * (int(run[-1]) + 1), np.uint32)
    lasts = np.append(begins[1:], True)
    vertices[firsts + ends] = rows[:, 0]
    vertices[firsts[lasts] + ends + 1] = rows[lasts, 1]
    if ends:
        vertices[firsts[begins]] = rows[begins, 0]
        vertices[firsts[lasts] + ends + 2] = rows[lasts, 1]
    return firsts.astype(np.uint32), vertices


def _points_at(geometry: GeometryArrays, row: np.ndarray, vertices: np.ndarray, first: int) -> np.ndarray:
    """Places and radii, float32 (C, 4), of a mesh's vertices, of which those of this step begin at `first`."""
    local = vertices.astype(np.int64) - int(row[MESH_FIRST_VERTEX])
    points = np.empty((len(vertices), 4), np.float32)
    points[:, :3] = geometry.vertices[first + local]
    points[:, 3] = geometry.radii[int(row[MESH_FIRST_RADIUS]) + local]
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
        embree.rtcSetSharedGeometryBuffer(handle, _BUFFER_INDEX, 0, _FORMAT_UINT, firsts.ctypes.data, 0, 4, count)
    starts, motion = [int(row[MESH_FIRST_VERTEX])], int(row[MESH_MOTION])
    if motion >= 0:
        begin, step_count = geometry.motion_table[motion, [MOTION_FIRST_VERTEX, MOTION_STEP_COUNT]].tolist()
        starts = [begin + step * int(row[MESH_VERTEX_COUNT]) for step in range(step_count)]
        embree.rtcSetGeometryTimeStepCount(handle, step_count)
    for step, start in enumerate(starts):
        points = _points_at(geometry, row, vertices, start)
        shared.append(points)
        embree.rtcSetSharedGeometryBuffer(
            handle, _BUFFER_VERTEX, step, _FORMAT_FLOAT4, points.ctypes.data, 0, 16, len(points)
        )
    # What is round is met from outside, as in Cycles. Blender's library does it by itself.
    culls = embree.rtcGetDeviceProperty(device, _PROPERTY_CULLS_CURVES if is_curve else _PROPERTY_CULLS_SPHERES)
    if shape != SHAPE_RIBBONS and not culls:
        embree.rtcSetGeometryIntersectFilterFunction(handle, address_of(cull))
        embree.rtcSetGeometryOccludedFilterFunction(handle, address_of(cull))
    return handle, shared
