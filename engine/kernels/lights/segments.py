# SPDX-License-Identifier: GPL-3.0-or-later
"""Picking an emitter for a stretch of a ray within a medium, which scatters its light anywhere along the stretch.

As in `engine.kernels.lights.tree` every choice is made in proportion to one estimate; here it is the irradiance that
points of the segment could get, integrated along it.

References: Conty Estevez and Kulla 2018, "Importance Sampling of Many Lights with Adaptive Tree Splitting", Eq. (4).
"""

import math

import numpy as np

from engine.kernels.constants import ONE_MINUS_EPSILON
from engine.kernels.eight import absolute, at, choose, last_of, load_eight, root, sums_before
from engine.kernels.lights.linking import is_linked, tree_range
from engine.kernels.vector import dot
from engine.runtime.jit import kernel
from engine.state.lights import (
    DISTANT_EMITTER,
    DISTANT_ENERGY,
    GROUP_SIZE,
    HEADER_EMITTERS,
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

# Nodes of a group: int64, as in `engine.kernels.lights.tree`.
_ROOT = np.int64(0)
_LAST = np.int64(GROUP_SIZE - 1)
#: [rad]
_QUARTER_TURN = np.float32(0.5 * math.pi)
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


@kernel
def _angles(y, x):
    """About the angles [rad] of eight points (x, y) with y >= 0 against the x axis, in [0, pi]; off by 1e-4 at most.

    References: Hastings 1955, "Approximations for Digital Computers", sheet 11.
    """
    width = absolute(x)
    is_steep = y > width
    ratio = choose(is_steep, width, y) / choose(is_steep, y, choose(width > 1e-30, width, 1e-30))
    squared = ratio * ratio
    angle = 0.0208351 * squared - 0.085133
    angle = angle * squared + 0.180141
    angle = angle * squared - 0.3302995
    angle = (angle * squared + 0.999866) * ratio
    angle = choose(is_steep, _QUARTER_TURN - angle, angle)
    return choose(x >= 0.0, angle, 2.0 * _QUARTER_TURN - angle)


@kernel
def segment_importances(nodes, group, origin, direction, length, reach):
    """Irradiance that each node of a group may cause, integrated along a segment, up to a constant.

    It is 0 only where a node causes none. Distances are those of the node's energy, as in `group_importances`,
    integrated without a cosine; emission is that of the most favourable point of the segment and of the node's bounding
    sphere.

    Parameters
    ----------
    origin, direction : 3-tuples, world space [m], unit
    length : float [m], at most `LONGEST`
    reach : float [m], at most `length`: what lies beyond is too dim to matter

    Returns
    -------
    EIGHT
    """
    dx = origin[0] - load_eight(nodes, group, NODE_CENTER)
    dy = origin[1] - load_eight(nodes, group, NODE_CENTER + 1)
    dz = origin[2] - load_eight(nodes, group, NODE_CENTER + 2)
    along = 0.0 - (direction[0] * dx + direction[1] * dy + direction[2] * dz)
    squared = dx * dx + dy * dy + dz * dz
    across_squared = squared - along * along
    across_squared = choose(across_squared > 0.0, across_squared, 0.0) + load_eight(nodes, group, NODE_SPREAD) + 1e-20
    across = root(across_squared)
    energy = load_eight(nodes, group, NODE_ENERGY)
    importance = energy * _angles(across * reach, across_squared - along * (reach - along)) / across

    # The cosine of the axis and a point of the line has one extremum.
    axis_x = load_eight(nodes, group, NODE_AXIS)
    axis_y = load_eight(nodes, group, NODE_AXIS + 1)
    axis_z = load_eight(nodes, group, NODE_AXIS + 2)
    is_two_sided = load_eight(nodes, group, NODE_TWO_SIDED) > 0.0
    at_start = axis_x * dx + axis_y * dy + axis_z * dz
    slope = axis_x * direction[0] + axis_y * direction[1] + axis_z * direction[2]
    denominator = at_start + slope * along
    has_extremum = absolute(denominator) > 0.0
    extremum = (at_start * along + slope * squared) / choose(has_extremum, denominator, 1.0)
    extremum = choose(has_extremum & (extremum > 0.0), extremum, 0.0)
    extremum = choose(extremum >= length, length, extremum)
    cosine_there, closest_there = _seen_from(is_two_sided, at_start, slope, squared, along, extremum)
    cosine_at_end, closest_at_end = _seen_from(is_two_sided, at_start, slope, squared, along, 0.0 * squared + length)
    cosine, closest = _seen_from(is_two_sided, at_start, slope, squared, along, 0.0 * squared)
    cosine = choose(cosine_there > cosine, cosine_there, cosine)
    cosine = choose(cosine_at_end > cosine, cosine_at_end, cosine)
    closest = choose(closest_at_end > closest, closest, closest_at_end)
    closest = choose(closest_there > closest, closest, closest_there)
    foot = choose(along > 0.0, along, 0.0)
    foot = choose(foot >= length, length, foot)
    beside = squared + foot * (foot - 2.0 * along)
    closest = choose(beside > closest, closest, beside)
    cosine = choose(cosine >= 1.0, 1.0, cosine)

    radius = load_eight(nodes, group, NODE_RADIUS)
    is_inside = closest <= radius * radius * 1.0001
    sine = root(1.0 - cosine * cosine)
    sine_around = radius / root(choose(is_inside, 1.0, closest))
    cosine_around = root(1.0 - sine_around * sine_around)
    cos_normals = load_eight(nodes, group, NODE_COS_NORMALS)
    nearest = cosine * cosine_around + sine * sine_around
    faces = is_inside | (cosine >= cosine_around) | (nearest >= cos_normals)
    nearest_sine = sine * cosine_around - cosine * sine_around
    emitted = nearest * cos_normals + nearest_sine * load_eight(nodes, group, NODE_SIN_NORMALS)
    is_lit = emitted > load_eight(nodes, group, NODE_COS_EMISSION)
    importance = importance * choose(faces, 1.0, choose(emitted > 0.0, emitted, 0.0))
    # Where there is no node, there is no energy.
    return choose((energy > 0.0) & (faces | is_lit), importance, 0.0)


@kernel
def _seen_from(is_two_sided, at_start, slope, squared, along, t):
    """Cosine of eight nodes' axes at points of a segment, and the points' squared distance [m^2]."""
    apart = squared + t * (t - 2.0 * along)
    projected = at_start + slope * t
    projected = choose(is_two_sided, absolute(projected), projected)
    return projected / root(choose(apart > 1e-30, apart, 1e-30)), apart


@kernel
def _distant_importance(distant, k, length, reach):
    """The same of an emitter at infinity. What fills an endless segment fills the way to it as well."""
    return 0.0 * reach if length >= LONGEST else distant[k, DISTANT_ENERGY] * reach


@kernel
def pick_for_segment(lights, tree, origin, direction, length, reach, u):
    """Choose an emitter of a light tree for a segment; see `segment_importances`.

    What regions have learned of lights is of points, and counts for nothing here.

    Returns
    -------
    emitter : int, -1 where none can contribute
    pmf : float, its probability
    """
    nodes, children, distant = lights.nodes, lights.child, lights.distant
    pmf = 0.0 * u + 1.0
    root_group, first, last = tree_range(lights, tree)
    if not is_linked(lights) and distant.shape[0] == 0 and lights.header[HEADER_EMITTERS] == 1:
        # Where it lights nothing, no distance is found.
        return np.int64(0), pmf
    if last > first:
        local = 0.0 * u
        if root_group >= 0:
            local = at(segment_importances(nodes, root_group, origin, direction, length, reach), _ROOT)
        total = local
        for k in range(first, last):
            total += _distant_importance(distant, k, length, reach)
        if not total > 0.0:
            return np.int64(-1), 0.0 * total
        u = u * total
        if u >= local:
            u -= local
            chosen = np.int64(-1)
            mine = 0.0 * total
            for k in range(first, last):
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
    elif root_group < 0:
        return np.int64(-1), 0.0 * pmf
    group = np.int64(children[root_group, _ROOT])
    while group >= 0:
        importances = segment_importances(nodes, group, origin, direction, length, reach)
        before = sums_before(importances)
        below = at(before, _LAST) + at(importances, _LAST)
        if not below > 0.0:
            return np.int64(-1), below
        # The last that counts and begins at or before the target, so that rounding always leaves one.
        target = u * below
        chosen = last_of((importances > 0.0) & (before <= target))
        if chosen < 0:
            # Only of a total that is infinite.
            return np.int64(-1), 0.0 * u
        mine = at(importances, chosen)
        u = min((target - at(before, chosen)) / mine, ONE_MINUS_EPSILON)
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
