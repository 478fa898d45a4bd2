# SPDX-License-Identifier: GPL-3.0-or-later
"""Picking an emitter for a stretch of a ray within a medium, which scatters its light anywhere along the stretch.

As in `engine.kernels.lights.tree` every choice is made in proportion to one estimate; here it is the irradiance that
points of the segment could get, integrated along it.

References: Conty Estevez and Kulla 2018, "Importance Sampling of Many Lights with Adaptive Tree Splitting", Eq. (4).
"""

import math

import numpy as np

from engine.kernels.constants import ONE_MINUS_EPSILON
from engine.kernels.local import local_floats
from engine.kernels.vector import dot
from engine.runtime.jit import kernel
from engine.state.lights import (
    DISTANT_EMITTER,
    DISTANT_ENERGY,
    GROUP_SIZE,
    NODE_AXIS,
    NODE_CENTER,
    NODE_COS_EMISSION,
    NODE_COS_NORMALS,
    NODE_ENERGY,
    NODE_RADIUS,
    NODE_SIN_NORMALS,
    NODE_SPREAD,
    NODE_TWO_SIDED,
)

#: Length [m] that stands for an endless segment: its square is a float still.
LONGEST = np.float32(1e15)
#: Cosine of a cone's half angle from which on it counts as a half-space, and sine of its normals' that this allows.
_NEARLY_FLAT = np.float32(0.02)
_ONE_NORMAL = np.float32(1e-3)
#: Of an emitter's strongest light: what it may send where its cone ends.
_LEAST_SHARE = np.float32(0.05)
#: What an interval is widened by, as a share of its length: roots are rounded.
_SLACK = np.float32(0.01)


@kernel
def from_node(nodes, node, p):
    """From the centre of a node to p."""
    g, k = node // GROUP_SIZE, node % GROUP_SIZE
    return (p[0] - nodes[g, NODE_CENTER, k], p[1] - nodes[g, NODE_CENTER + 1, k], p[2] - nodes[g, NODE_CENTER + 2, k])


@kernel
def _node_axis(nodes, node):
    g, k = node // GROUP_SIZE, node % GROUP_SIZE
    return (nodes[g, NODE_AXIS, k], nodes[g, NODE_AXIS + 1, k], nodes[g, NODE_AXIS + 2, k])


@kernel
def subtended_angle(across, along, length):
    """Angle [rad] that a segment is seen under from a point.

    Written so that it keeps its precision where the point is far away.

    Parameters
    ----------
    across : float [m], distance of the point from the segment's line, > 0
    along : float [m], from the segment's start to the foot of the point on the line
    length : float [m], at most `LONGEST`
    """
    return math.atan2(across * length, across * across - along * (length - along))


@kernel(forceinline=True)
def segment_importance(nodes, node, origin, direction, length, reach):
    """Irradiance that a node may cause, integrated along a segment, up to a constant; 0 only where it causes none.

    Distances are those of the node's energy, as in `node_importance`, integrated without a cosine; emission is that
    of the most favourable point of the segment and of the node's bounding sphere.

    Parameters
    ----------
    origin, direction : 3-tuples, world space [m], unit
    length : float [m], at most `LONGEST`
    reach : float [m], at most `length`: what lies beyond is too dim to matter
    """
    g, k = node // GROUP_SIZE, node % GROUP_SIZE
    start = from_node(nodes, node, origin)
    along = -dot(start, direction)
    squared = dot(start, start)
    across = math.sqrt(max(squared - along * along, 0.0) + nodes[g, NODE_SPREAD, k] + 1e-20)
    importance = nodes[g, NODE_ENERGY, k] * subtended_angle(across, along, reach) / across

    # The cosine of the axis and a point of the line has one extremum.
    axis = _node_axis(nodes, node)
    at_start = dot(axis, start)
    slope = dot(axis, direction)
    denominator = at_start + slope * along
    extremum = (at_start * along + slope * squared) / denominator if denominator != 0.0 else 0.0
    extremum = min(max(extremum, 0.0), length)
    cosine = np.float32(-1.0)
    closest = squared
    for point in range(3):
        t = extremum if point == 0 else (length if point == 1 else 0.0)
        at = squared + t * (t - 2.0 * along)
        closest = min(closest, at)
        projected = at_start + slope * t
        projected = abs(projected) if nodes[g, NODE_TWO_SIDED, k] > 0.0 else projected
        cosine = max(cosine, projected / math.sqrt(max(at, 1e-30)))
    t = min(max(along, 0.0), length)
    closest = min(closest, squared + t * (t - 2.0 * along))
    cosine = min(cosine, 1.0)
    radius = nodes[g, NODE_RADIUS, k]
    if closest <= radius * radius * 1.0001:
        return importance
    sine = math.sqrt(max(0.0, 1.0 - cosine * cosine))
    sine_around = radius / math.sqrt(closest)
    cosine_around = math.sqrt(max(0.0, 1.0 - sine_around * sine_around))
    nearest = cosine * cosine_around + sine * sine_around
    if cosine >= cosine_around or nearest >= nodes[g, NODE_COS_NORMALS, k]:
        return importance
    nearest_sine = sine * cosine_around - cosine * sine_around
    emitted = nearest * nodes[g, NODE_COS_NORMALS, k] + nearest_sine * nodes[g, NODE_SIN_NORMALS, k]
    return importance * max(emitted, 0.0) if emitted > nodes[g, NODE_COS_EMISSION, k] else 0.0


@kernel
def _distant_importance(distant, k, length, reach):
    """The same of an emitter at infinity. What fills an endless segment fills the way to it as well."""
    return 0.0 * reach if length >= LONGEST else distant[k, DISTANT_ENERGY] * reach


@kernel
def pick_for_segment(lights, origin, direction, length, reach, u):
    """Choose an emitter for a segment; see `segment_importance`.

    What regions have learned of lights is of points, and counts for nothing here.

    Returns
    -------
    emitter : int, -1 where none can contribute
    pmf : float, its probability
    """
    nodes, children, distant = lights.nodes, lights.child, lights.distant
    pmf = 0.0 * u + 1.0
    if distant.shape[0] > 0:
        local = 0.0 * u
        if nodes.shape[0] > 0:
            local = segment_importance(nodes, np.int64(0), origin, direction, length, reach)
        total = local
        for k in range(distant.shape[0]):
            total += _distant_importance(distant, k, length, reach)
        if not total > 0.0:
            return np.int64(-1), 0.0 * total
        u = u * total
        if u >= local:
            u -= local
            chosen = np.int64(-1)
            mine = 0.0 * total
            for k in range(distant.shape[0]):
                importance = _distant_importance(distant, k, length, reach)
                if importance > 0.0:
                    chosen = np.int64(distant[k, DISTANT_EMITTER])
                    mine = importance
                    if u < importance:
                        break
                    u -= importance
            if chosen >= 0:
                return chosen, mine / total
            u = local
        pmf = local / total
        u = min(u / local, ONE_MINUS_EPSILON)
    elif nodes.shape[0] == 0:
        return np.int64(-1), 0.0 * pmf
    importances = local_floats()
    group = np.int64(children[0, 0])
    while group >= 0:
        below = 0.0 * pmf
        for k in range(GROUP_SIZE):
            importance = segment_importance(nodes, GROUP_SIZE * group + k, origin, direction, length, reach)
            importances[k] = importance
            below += importance
        if not below > 0.0:
            return np.int64(-1), below
        # The last that counts and begins at or before the target, so that rounding always leaves one.
        target = u * below
        chosen = np.int64(0)
        begin = 0.0 * pmf
        mine = begin
        reached = begin
        for k in range(GROUP_SIZE):
            importance = importances[k]
            if importance > 0.0 and reached <= target:
                chosen = k
                begin = reached
                mine = importance
            reached += importance
        u = min((target - begin) / mine, ONE_MINUS_EPSILON)
        pmf *= mine / below
        group = np.int64(children[group, chosen])
    return ~group, pmf


@kernel
def _outer_cone(nodes, node):
    """Cosine and sine of the angle from the axis up to which a node emits; below 0 both are beyond a half turn."""
    g, k = node // GROUP_SIZE, node % GROUP_SIZE
    cos_normals, sin_normals = nodes[g, NODE_COS_NORMALS, k], nodes[g, NODE_SIN_NORMALS, k]
    cos_emission = nodes[g, NODE_COS_EMISSION, k]
    sin_emission = math.sqrt(max(0.0, 1.0 - cos_emission * cos_emission))
    return (
        cos_normals * cos_emission - sin_normals * sin_emission,
        sin_normals * cos_emission + cos_normals * sin_emission,
    )


@kernel
def emission_cone(nodes, node):
    """What `emission_towards` needs to know of a node: the cosine where emission ends, and 1 over the cosines' span."""
    g, k = node // GROUP_SIZE, node % GROUP_SIZE
    cosine, sine = _outer_cone(nodes, node)
    if sine <= 0.0:
        return cosine, 0.0 * cosine
    return cosine, 1.0 / max(nodes[g, NODE_COS_NORMALS, k] - cosine, 1e-3)


@kernel
def emission_towards(nodes, node, away, apart, outer, inverse_span):
    """About what a node's emitter sends to a point, up to a constant; above 0 wherever it could send anything.

    Parameters
    ----------
    away : 3-tuple [m], from the node's centre to the point; apart : float [m], its length, > 0
    outer, inverse_span : float, see `emission_cone`
    """
    g, k = node // GROUP_SIZE, node % GROUP_SIZE
    share = 1.0 + 0.0 * apart
    if inverse_span > 0.0:
        cosine = dot(_node_axis(nodes, node), away) / apart
        cosine = abs(cosine) if nodes[g, NODE_TWO_SIDED, k] > 0.0 else cosine
        share = min(max((cosine - outer) * inverse_span, _LEAST_SHARE), 1.0)
    return share / (apart * apart + nodes[g, NODE_SPREAD, k])


@kernel
def _widened(start, end, length):
    """An interval that rounding has not made too narrow, within [0, length]."""
    slack = _SLACK * (min(end, length) - max(start, 0.0)) + 1e-5 * (abs(start) + min(abs(end), length))
    return max(start - slack, 0.0), min(end + slack, length)


@kernel
def lit_interval(nodes, node, origin, direction, length):
    """The part of a segment that a node may light: what its cone of emission leaves, seen from any of its points.

    Returns
    -------
    start, end : float [m], within [0, length]; start >= end: it lights nothing
    """
    g, k = node // GROUP_SIZE, node % GROUP_SIZE
    cosine, sine = _outer_cone(nodes, node)
    sin_normals = nodes[g, NODE_SIN_NORMALS, k]
    whole = 0.0 * length
    if nodes[g, NODE_TWO_SIDED, k] > 0.0 or sine <= 0.0 or cosine <= -_NEARLY_FLAT:
        return whole, length
    radius = nodes[g, NODE_RADIUS, k]
    axis = _node_axis(nodes, node)
    start = from_node(nodes, node, origin)
    slope = dot(axis, direction)
    if cosine < _NEARLY_FLAT:
        if sin_normals > _ONE_NORMAL:
            return whole, length
        height = dot(axis, start) + radius
        if slope == 0.0:
            return (whole, length) if height > 0.0 else (length, whole)
        crossing = -height / slope
        if slope > 0.0:
            return _widened(crossing, length, length)
        return _widened(whole, crossing, length)
    # A cone around all cones of the bounding sphere's points: its tip lies behind.
    back = radius / sine
    tip = (start[0] + axis[0] * back, start[1] + axis[1] * back, start[2] + axis[2] * back)
    height = dot(axis, tip)
    along = dot(tip, direction)
    squared = cosine * cosine
    a = slope * slope - squared
    b = height * slope - squared * along
    c = height * height - squared * dot(tip, tip)
    if abs(a) < 1e-4:
        return whole, length
    discriminant = b * b - a * c
    if discriminant <= 0.0:
        # A ray that crosses no side of the double cone is outside of it.
        return (length, whole) if a < 0.0 else (whole, length)
    root = math.sqrt(discriminant)
    near = (-b - root) / a if a > 0.0 else (-b + root) / a
    far = (-b + root) / a if a > 0.0 else (-b - root) / a
    if a > 0.0:
        # One nappe is met on either side: the one in front is on the side that the ray goes to along the axis.
        if slope > 0.0:
            return _widened(far, length, length)
        return _widened(whole, near, length)
    if height + 0.5 * (near + far) * slope <= 0.0:
        return length, whole
    return _widened(near, far, length)
