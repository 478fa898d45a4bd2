# SPDX-License-Identifier: GPL-3.0-or-later
"""Area lamps: rectangles by solid angle, ellipses by area, and the part of either that a narrow spread lets shine.

References: Urena, Fajardo and King 2013, "An Area-Preserving Parametrization for Spherical Rectangles"; the spread is
Cycles' model of a soft box: slats that hide 1 - (tan a_max - tan a) of the light.
"""

import math

import numpy as np

from engine.kernels.constants import PI
from engine.kernels.lights.lamp import Lamp, LampPoint
from engine.kernels.lights.mapping import concentric_disk
from engine.kernels.vector import add, cross, dot, normalize, scale, subtract
from engine.runtime.jit import kernel
from engine.state.lights import (
    FIRST_LAMP,
    LAMP_FLAG_DELTA,
    LAMP_FLAG_OF_KIND,
    LAMP_FLAGS,
    LAMP_KIND_COLUMNS,
    LAMP_P,
)

AREA = FIRST_LAMP + 2

FLAG_ELLIPSE = LAMP_FLAG_OF_KIND
#: DIRECTION leans against its axes, which are at right angles. As in Cycles rays meet the part of the plane across
#: DIRECTION whose distances along either axis are within half its length, and light samples lie in the axes' plane.
FLAG_LEANING = 2 * LAMP_FLAG_OF_KIND

# Columns of `LightArrays.lamps`.
#: Unit.
AXIS_U = LAMP_KIND_COLUMNS
AXIS_V = LAMP_KIND_COLUMNS + 3
#: Where it emits to.
DIRECTION = LAMP_KIND_COLUMNS + 6
LENGTH_U = LAMP_KIND_COLUMNS + 9
LENGTH_V = LAMP_KIND_COLUMNS + 10
#: Tangent of half the spread.
TAN_SPREAD = LAMP_KIND_COLUMNS + 11
#: 1 / (tan a - a), 0 = no spread.
SPREAD_SCALE = LAMP_KIND_COLUMNS + 12

#: Below this solid angle [sr] a rectangle is sampled by area.
SMALLEST_SOLID_ANGLE = np.float32(1e-4)

_REGION_NONE = 0
_REGION_RECTANGLE = 1
_REGION_ELLIPSE = 2


@kernel
def spread_attenuation(lamps, row, cosine):
    """Factor on an area lamp's radiance at the angle to its normal with this cosine."""
    spread_scale = lamps[row, SPREAD_SCALE]
    if spread_scale <= 0.0:
        return 0.0 * cosine + 1.0
    tangent = math.sqrt(max(0.0, 1.0 - cosine * cosine)) / max(cosine, 1e-10)
    return max(0.0, (lamps[row, TAN_SPREAD] - tangent) * spread_scale)


@kernel
def _lit_region(lamps, lamp_table, row, p):
    """The part of the lamp to sample for a receiver at p.

    Returns kind (_REGION_*), centre relative to p, axis u, length u, axis v, length v. With a spread the receiver sees
    only a circle of the lamp, centred at its own foot point: the smallest of the lamp's shape, the circle and a
    rectangle around both is taken.
    """
    offset = (lamps[row, LAMP_P] - p[0], lamps[row, LAMP_P + 1] - p[1], lamps[row, LAMP_P + 2] - p[2])
    axis_u = (lamps[row, AXIS_U], lamps[row, AXIS_U + 1], lamps[row, AXIS_U + 2])
    axis_v = (lamps[row, AXIS_V], lamps[row, AXIS_V + 1], lamps[row, AXIS_V + 2])
    length_u = lamps[row, LENGTH_U]
    length_v = lamps[row, LENGTH_V]
    is_ellipse = (lamp_table[row, LAMP_FLAGS] & FLAG_ELLIPSE) != 0
    kind = _REGION_ELLIPSE if is_ellipse else _REGION_RECTANGLE
    normal = (lamps[row, DIRECTION], lamps[row, DIRECTION + 1], lamps[row, DIRECTION + 2])
    height = -dot(normal, offset)
    if height <= 0.0:
        return _REGION_NONE, offset, axis_u, length_u, axis_v, length_v
    if lamps[row, SPREAD_SCALE] <= 0.0:
        return kind, offset, axis_u, length_u, axis_v, length_v

    reach = height * lamps[row, TAN_SPREAD]
    foot_u = -dot(axis_u, offset)
    foot_v = -dot(axis_v, offset)
    if lamp_table[row, LAMP_FLAGS] & FLAG_LEANING:
        foot_u -= height * dot(axis_u, normal)
        foot_v -= height * dot(axis_v, normal)
    half_u = 0.5 * length_u
    half_v = 0.5 * length_v
    low_v = foot_v - reach
    high_v = foot_v + reach
    if is_ellipse and length_u == length_v:
        # A disc has no orientation: turn u towards the foot point, the overlap is then as narrow as can be.
        apart = math.sqrt(foot_u * foot_u + foot_v * foot_v)
        if apart > 0.0:
            axis_u = scale(add(scale(axis_u, foot_u), scale(axis_v, foot_v)), 1.0 / apart)
            if lamp_table[row, LAMP_FLAGS] & FLAG_LEANING:
                axis_u = normalize(subtract(scale(normal, -height), offset))
            axis_v = cross(normal, axis_u)
        foot_u = apart
        foot_v = 0.0 * apart
        narrow = reach
        if apart > 0.0:
            # Half the common chord of the two circles, if their centres lie on both sides of it.
            chord_u = (apart * apart + half_u * half_u - reach * reach) / (2.0 * apart)
            if chord_u > 0.0 and chord_u < apart:
                narrow = math.sqrt(max(0.0, half_u * half_u - chord_u * chord_u))
        low_v = -narrow
        high_v = narrow
    low_u = max(foot_u - reach, -half_u)
    high_u = min(foot_u + reach, half_u)
    low_v = max(low_v, -half_v)
    high_v = min(high_v, half_v)
    if low_u >= high_u or low_v >= high_v:
        return _REGION_NONE, offset, axis_u, length_u, axis_v, length_v
    size_u = high_u - low_u
    size_v = high_v - low_v
    ellipse_area = 0.25 * PI * length_u * length_v
    circle_area = PI * reach * reach
    if not is_ellipse or size_u * size_v < min(ellipse_area, circle_area):
        center = add(
            offset, add(scale(axis_u, 0.5 * (low_u + high_u)), scale(axis_v, 0.5 * (low_v + high_v)))
        )
        return _REGION_RECTANGLE, center, axis_u, size_u, axis_v, size_v
    if circle_area < ellipse_area:
        center = add(offset, add(scale(axis_u, foot_u), scale(axis_v, foot_v)))
        return _REGION_ELLIPSE, center, axis_u, 2.0 * reach, axis_v, 2.0 * reach
    return _REGION_ELLIPSE, offset, axis_u, length_u, axis_v, length_v


@kernel
def rectangle_frame(center, axis_u, length_u, axis_v, length_v):
    """Rectangle around the origin's view: bounds along u and v, and its (negative) height along the normal."""
    u = dot(center, axis_u)
    v = dot(center, axis_v)
    z = -abs(dot(center, cross(axis_u, axis_v)))
    return u - 0.5 * length_u, u + 0.5 * length_u, v - 0.5 * length_v, v + 0.5 * length_v, z


@kernel
def _edge_cosine(x, z):
    return x / math.sqrt(x * x + z * z)


@kernel
def rectangle_angles(x0, x1, y0, y1, z):
    """Cosines of the edge planes' normals and the solid angle.

    asin instead of the paper's acos: their sum is the solid angle itself, nothing cancels.
    """
    n0 = _edge_cosine(-y0, z)
    n1 = _edge_cosine(x1, z)
    n2 = _edge_cosine(y1, z)
    n3 = _edge_cosine(-x0, z)
    g0 = math.asin(min(1.0, max(-1.0, n0 * n1)))
    g1 = math.asin(min(1.0, max(-1.0, n1 * n2)))
    g2 = math.asin(min(1.0, max(-1.0, n2 * n3)))
    g3 = math.asin(min(1.0, max(-1.0, n3 * n0)))
    return n0, n2, g2, g3, g0 + g1 + g2 + g3


@kernel
def sample_rectangle(x0, x1, y0, y1, z, n0, n2, g2, g3, solid_angle, u0, u1):
    """Point (x, y) of the rectangle, uniform in solid angle (Urena et al. 2013, algorithm 2)."""
    angle = u0 * solid_angle - g2 - g3
    sine = math.sin(angle)
    ratio = 0.0 * sine
    if sine != 0.0:
        ratio = (math.cos(angle) * n0 + n2) / sine
    cosine = math.copysign(1.0 / math.sqrt(ratio * ratio + n0 * n0), ratio)
    cosine = min(1.0, max(-1.0, cosine))
    x = -(cosine * z) / max(math.sqrt(1.0 - cosine * cosine), 1e-7)
    x = min(x1, max(x0, x))
    squared = x * x + z * z
    h0 = y0 / math.sqrt(squared + y0 * y0)
    h1 = y1 / math.sqrt(squared + y1 * y1)
    h = h0 + u1 * (h1 - h0)
    y = y1
    if h * h < 1.0 - 1e-6:
        y = h * math.sqrt(squared / (1.0 - h * h))
    return x, min(y1, max(y0, y))


@kernel
def _region_pdf(kind, length_u, length_v, solid_angle, distance, cosine):
    """Density [sr^-1] of a point of the region at `distance`, seen under `cosine` to the lamp's normal."""
    if kind == _REGION_RECTANGLE:
        if solid_angle > SMALLEST_SOLID_ANGLE:
            return 1.0 / solid_angle
        return distance * distance / (cosine * length_u * length_v)
    return distance * distance / (cosine * 0.25 * PI * length_u * length_v)


@kernel
def area_pdf(lights, row, receiver, wi, distance):
    """See `Lamp.pdf`."""
    lamps = lights.lamps
    kind, center, axis_u, length_u, axis_v, length_v = _lit_region(lamps, lights.lamp_table, row, receiver.p)
    cosine = -(
        lamps[row, DIRECTION] * wi[0]
        + lamps[row, DIRECTION + 1] * wi[1]
        + lamps[row, DIRECTION + 2] * wi[2]
    )
    if kind == _REGION_NONE or not cosine > 0.0:
        return 0.0 * distance
    solid_angle = 0.0 * distance
    if kind == _REGION_RECTANGLE:
        x0, x1, y0, y1, z = rectangle_frame(center, axis_u, length_u, axis_v, length_v)
        _, _, _, _, solid_angle = rectangle_angles(x0, x1, y0, y1, z)
    return _region_pdf(kind, length_u, length_v, solid_angle, distance, cosine)


@kernel
def _covers(lamps, lamp_table, row, x, y, tolerance):
    """Whether plane coordinates (x, y) from the lamp's centre [m] are on it."""
    u = x / lamps[row, LENGTH_U]
    v = y / lamps[row, LENGTH_V]
    if lamp_table[row, LAMP_FLAGS] & FLAG_ELLIPSE:
        return u * u + v * v <= 0.25 + tolerance
    return abs(u) <= 0.5 + tolerance and abs(v) <= 0.5 + tolerance


@kernel
def hit_area(lights, row, origin, direction, t_min, t_max):
    """See `Lamp.hit`: only the side that shines is met."""
    lamps, lamp_table = lights.lamps, lights.lamp_table
    normal = (lamps[row, DIRECTION], lamps[row, DIRECTION + 1], lamps[row, DIRECTION + 2])
    facing = dot(direction, normal)
    if facing >= 0.0:
        return 0.0 * facing - 1.0
    offset = (lamps[row, LAMP_P] - origin[0], lamps[row, LAMP_P + 1] - origin[1], lamps[row, LAMP_P + 2] - origin[2])
    t = dot(offset, normal) / facing
    if not (t > t_min and t < t_max):
        return 0.0 * facing - 1.0
    inplane = subtract(scale(direction, t), offset)
    x = inplane[0] * lamps[row, AXIS_U] + inplane[1] * lamps[row, AXIS_U + 1]
    x += inplane[2] * lamps[row, AXIS_U + 2]
    y = inplane[0] * lamps[row, AXIS_V] + inplane[1] * lamps[row, AXIS_V + 1]
    y += inplane[2] * lamps[row, AXIS_V + 2]
    if _covers(lamps, lamp_table, row, x, y, 0.0):
        return t
    return 0.0 * facing - 1.0


@kernel(fastmath=False)
def _rounded(p, first, second, third):
    """Where a lamp's point is from p that is the sum of these, and by which direction and how far.

    As in Cycles, to the last bit: by that what lies in the lamp's plane hides it or does not.
    """
    x = ((p[0] + first[0]) + second[0]) + third[0] - p[0]
    y = ((p[1] + first[1]) + second[1]) + third[1] - p[1]
    z = ((p[2] + first[2]) + second[2]) + third[2] - p[2]
    distance = math.sqrt((x * x + y * y) + z * z)
    length = max(distance, 1e-30)
    return (x, y, z), (x / length, y / length, z / length), distance


@kernel
def sample_area(lights, row, receiver, u0, u1):
    """See `Lamp.sample`: the spread is what leaves the lamp; texture coordinates are barycentrics in Cycles' manner,
    (v + 1/2, -u - v) of the place on it."""
    lamps, lamp_table, p = lights.lamps, lights.lamp_table, receiver.p
    none = 0.0 * u0
    normal = (lamps[row, DIRECTION], lamps[row, DIRECTION + 1], lamps[row, DIRECTION + 2])
    own_u = (lamps[row, AXIS_U], lamps[row, AXIS_U + 1], lamps[row, AXIS_U + 2])
    own_v = (lamps[row, AXIS_V], lamps[row, AXIS_V + 1], lamps[row, AXIS_V + 2])
    from_lamp = (p[0] - lamps[row, LAMP_P], p[1] - lamps[row, LAMP_P + 1], p[2] - lamps[row, LAMP_P + 2])
    if lamp_table[row, LAMP_FLAGS] & LAMP_FLAG_DELTA:
        # No spread: only the foot point shines here.
        height = dot(normal, from_lamp)
        x = dot(own_u, from_lamp)
        y = dot(own_v, from_lamp)
        wi = (-normal[0], -normal[1], -normal[2])
        if height <= 0.0 or not _covers(lamps, lamp_table, row, x, y, 0.0):
            return LampPoint(none, wi, none, normal, none, none, none)
        u = x / lamps[row, LENGTH_U]
        v = y / lamps[row, LENGTH_V]
        return LampPoint(none + 1.0, wi, height, normal, none + 1.0, v + 0.5, -u - v)

    kind, center, axis_u, length_u, axis_v, length_v = _lit_region(lamps, lamp_table, row, p)
    if kind == _REGION_NONE:
        return LampPoint(none, normal, none, normal, none, none, none)
    solid_angle = none
    x = (u0 - 0.5) * length_u
    y = (u1 - 0.5) * length_v
    if kind == _REGION_RECTANGLE:
        x0, x1, y0, y1, z = rectangle_frame(center, axis_u, length_u, axis_v, length_v)
        n0, n2, g2, g3, solid_angle = rectangle_angles(x0, x1, y0, y1, z)
        x += 0.5 * (x0 + x1)
        y += 0.5 * (y0 + y1)
        if solid_angle > SMALLEST_SOLID_ANGLE:
            x, y = sample_rectangle(x0, x1, y0, y1, z, n0, n2, g2, g3, solid_angle, u0, u1)
        n = cross(axis_u, axis_v)
        third = scale(n, z if dot(n, center) < 0.0 else -z)
    else:
        x, y = concentric_disk(u0, u1)
        x *= 0.5 * length_u
        y *= 0.5 * length_v
        third = center
    to_point, wi, distance = _rounded(p, scale(axis_u, x), scale(axis_v, y), third)
    cosine = -dot(normal, wi)
    if not cosine > 0.0:
        return LampPoint(none, wi, none, normal, none, none, none)
    pdf = _region_pdf(kind, length_u, length_v, solid_angle, distance, cosine)
    factor = spread_attenuation(lamps, row, cosine)
    inplane = add(to_point, from_lamp)
    x = dot(own_u, inplane)
    y = dot(own_v, inplane)
    if factor <= 0.0 or not _covers(lamps, lamp_table, row, x, y, 1e-5):
        factor = none
    u = x / lamps[row, LENGTH_U]
    v = y / lamps[row, LENGTH_V]
    return LampPoint(pdf, wi, distance, normal, factor, v + 0.5, -u - v)


@kernel
def leaving_area(lights, row, p, wi):
    """See `Lamp.leaving`."""
    cosine = -(
        wi[0] * lights.lamps[row, DIRECTION]
        + wi[1] * lights.lamps[row, DIRECTION + 1]
        + wi[2] * lights.lamps[row, DIRECTION + 2]
    )
    return spread_attenuation(lights.lamps, row, cosine)


@kernel
def place_area(lights, row, origin, direction, t):
    """See `Lamp.place`."""
    lamps = lights.lamps
    inplane = (
        origin[0] + t * direction[0] - lamps[row, LAMP_P],
        origin[1] + t * direction[1] - lamps[row, LAMP_P + 1],
        origin[2] + t * direction[2] - lamps[row, LAMP_P + 2],
    )
    u = dot((lamps[row, AXIS_U], lamps[row, AXIS_U + 1], lamps[row, AXIS_U + 2]), inplane) / lamps[row, LENGTH_U]
    v = dot((lamps[row, AXIS_V], lamps[row, AXIS_V + 1], lamps[row, AXIS_V + 2]), inplane) / lamps[row, LENGTH_V]
    return (lamps[row, DIRECTION], lamps[row, DIRECTION + 1], lamps[row, DIRECTION + 2]), v + 0.5, -u - v


LAMP = Lamp(AREA, False, sample_area, area_pdf, hit_area, leaving_area, place_area)
