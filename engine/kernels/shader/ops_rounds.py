# SPDX-License-Identifier: GPL-3.0-or-later
"""What nodes read of curves and point clouds, and hair of triangles: the instruction OP_ROUND, `value <- | ROUND_*`."""

from engine.kernels.memory import write3
from engine.kernels.rounds import centre_of, radius_at, shape_at
from engine.kernels.shader.surface import edges, read_point
from engine.kernels.vector import dot, negate, normalize, scale, subtract
from engine.runtime.jit import kernel
from engine.state.geometry import SHAPE_SPHERES, SHAPE_TRIANGLES
from engine.state.lanes import (
    POINT_FLAG_BACKFACING,
    POINT_FLAGS,
    POINT_INSTANCE,
    POINT_TANGENT,
    POINT_TIME,
    POINT_TRIANGLE,
    POINT_U,
    POINT_WO,
)

ROUND_IS_STRAND = 0
ROUND_THICKNESS = 1
ROUND_TANGENT_NORMAL = 2
ROUND_CENTRE = 3
ROUND_RADIUS = 4
# Edges of a triangle by which Embree counts u and v, turned to the viewer as normals are.
ROUND_EDGE_U = 5
ROUND_EDGE_V = 6


@kernel
def is_strand(geometry, points, lane):
    """Whether a point lies on a curve."""
    shape = shape_at(geometry, points.integer[lane, POINT_INSTANCE])
    return shape != SHAPE_TRIANGLES and shape != SHAPE_SPHERES


@kernel
def run_round_op(code, pc, memory, geometry, points, lane):
    """OP_ROUND: 0 on other surfaces than those asked about."""
    kind, out = code[pc + 3], code[pc + 2]
    instance, row = points.integer[lane, POINT_INSTANCE], points.integer[lane, POINT_TRIANGLE]
    time = points.real[lane, POINT_TIME]
    is_curve = is_strand(geometry, points, lane)
    is_sphere = shape_at(geometry, instance) == SHAPE_SPHERES
    if kind == ROUND_TANGENT_NORMAL:
        n = (0.0, 0.0, 0.0)
        tangent, wo = read_point(points, lane, POINT_TANGENT), read_point(points, lane, POINT_WO)
        square = dot(tangent, tangent)
        if is_curve and square > 0.0:
            n = normalize(subtract(wo, scale(tangent, dot(tangent, wo) / square)))
        write3(memory, out, n)
    elif kind == ROUND_EDGE_U or kind == ROUND_EDGE_V:
        edge = (0.0, 0.0, 0.0)
        if instance >= 0 and shape_at(geometry, instance) == SHAPE_TRIANGLES:
            along_u, along_v = edges(geometry, instance, row, time)
            edge = along_u if kind == ROUND_EDGE_U else along_v
            if points.integer[lane, POINT_FLAGS] & POINT_FLAG_BACKFACING:
                edge = negate(edge)
        write3(memory, out, edge)
    elif kind == ROUND_CENTRE:
        p = (0.0, 0.0, 0.0)
        if is_sphere:
            p = centre_of(geometry, instance, row, time)
        write3(memory, out, p)
    elif kind == ROUND_IS_STRAND:
        memory[out] = 1.0 if is_curve else 0.0
    else:
        wanted = is_curve if kind == ROUND_THICKNESS else is_sphere
        radius = 0.0
        if wanted:
            radius = radius_at(geometry, instance, row, points.real[lane, POINT_U] if is_curve else 0.0, time)
        memory[out] = 2.0 * radius if kind == ROUND_THICKNESS else radius
