# SPDX-License-Identifier: GPL-3.0-or-later
"""Point and spot lights: a sphere, or with soft falloff a disc that turns to face the receiver.

A spot is a point light seen through a cone; where its whole sphere is wider than its cone, directions are drawn from
the cone instead.
"""

import math

from engine.kernels.constants import INV_PI, INV_TWO_PI, PI
from engine.kernels.lights.lamp import Lamp, LampPoint
from engine.kernels.lights.mapping import (
    concentric_disk,
    cosine_hemisphere,
    one_minus_cos_of_sin_squared,
    surroundings_pdf,
    uniform_cone,
    uniform_sphere,
)
from engine.kernels.vector import add, dot, length, normalize, orthonormal_basis, scale, subtract
from engine.runtime.jit import kernel
from engine.state.lights import (
    FIRST_LAMP,
    LAMP_FLAG_OF_KIND,
    LAMP_FLAGS,
    LAMP_KIND,
    LAMP_KIND_COLUMNS,
    LAMP_P,
    LAMP_PROGRAM,
)

POINT = FIRST_LAMP
SPOT = FIRST_LAMP + 1

#: A sphere, else a disc that faces the receiver (soft falloff).
FLAG_SPHERE = LAMP_FLAG_OF_KIND

# Columns of `LightArrays.lamps`; spots have all of them, points RADIUS and INVERSE.
RADIUS = LAMP_KIND_COLUMNS
#: Where it emits to.
DIRECTION = LAMP_KIND_COLUMNS + 1
#: 3x3, world directions to local ones.
INVERSE = LAMP_KIND_COLUMNS + 4
#: Of half the spot's angle.
COSINE = LAMP_KIND_COLUMNS + 13
#: 1 / ((1 - cos) blend).
BLEND_SCALE = LAMP_KIND_COLUMNS + 14
#: 1 - cos of the widest cone after scaling.
ONE_MINUS_COS = LAMP_KIND_COLUMNS + 15


@kernel
def _to_local(lamps, row, w):
    """A direction of the world in the lamp's own space, not normalised."""
    x = lamps[row, INVERSE] * w[0] + lamps[row, INVERSE + 1] * w[1] + lamps[row, INVERSE + 2] * w[2]
    y = lamps[row, INVERSE + 3] * w[0] + lamps[row, INVERSE + 4] * w[1] + lamps[row, INVERSE + 5] * w[2]
    z = lamps[row, INVERSE + 6] * w[0] + lamps[row, INVERSE + 7] * w[1] + lamps[row, INVERSE + 8] * w[2]
    return x, y, z


@kernel
def spot_attenuation(lamps, row, wi):
    """What a spot's cone lets through towards -wi, 0 to 1: a smooth step over the blend, in the lamp's own space."""
    x, y, z = _to_local(lamps, row, wi)
    norm = math.sqrt(x * x + y * y + z * z)
    if not norm > 0.0:
        return 0.0 * norm
    t = min(1.0, max(0.0, (z / norm - lamps[row, COSINE]) * lamps[row, BLEND_SCALE]))
    return t * t * (3.0 - 2.0 * t)


@kernel
def ray_sphere(center, radius, origin, direction, t_min, t_max):
    """First crossing of a sphere's surface at t in (t_min, t_max) from outside, or leaving it from inside; -1 = none.

    `origin` is where the ray started, whatever t_min: a light that contains it is crossed on the way out.
    """
    to_center = subtract(center, origin)
    along = dot(to_center, direction)
    squared = dot(to_center, to_center)
    outside = squared > radius * radius
    if outside and along < 0.0:
        return 0.0 * along - 1.0
    across = subtract(to_center, scale(direction, along))
    half_chord_squared = radius * radius - dot(across, across)
    if half_chord_squared < 0.0:
        return 0.0 * along - 1.0
    half_chord = math.sqrt(half_chord_squared)
    t = along - half_chord if outside else along + half_chord
    if t > t_min and t < t_max:
        return t
    return 0.0 * along - 1.0


@kernel
def sphere_cone(lamps, lamp_table, row, distance_squared):
    """1 - cos of the cone that directions towards a spherical lamp are drawn from, and whether it is the spot's own."""
    radius = lamps[row, RADIUS]
    wide = one_minus_cos_of_sin_squared(radius * radius / distance_squared)
    if lamp_table[row, LAMP_KIND] == SPOT and lamps[row, ONE_MINUS_COS] <= wide:
        return lamps[row, ONE_MINUS_COS], True
    return wide, False


@kernel
def hit_sphere(lights, row, origin, direction, t_min, t_max):
    """See `Lamp.hit`."""
    lamps, lamp_table = lights.lamps, lights.lamp_table
    center = (lamps[row, LAMP_P], lamps[row, LAMP_P + 1], lamps[row, LAMP_P + 2])
    from_center = subtract(origin, center)
    is_sphere = (lamp_table[row, LAMP_FLAGS] & FLAG_SPHERE) != 0
    if lamp_table[row, LAMP_KIND] == SPOT and dot(direction, from_center) >= 0.0:
        return 0.0 * t_min - 1.0
    if is_sphere:
        return ray_sphere(center, lamps[row, RADIUS], origin, direction, t_min, t_max)
    # The disc through the centre, perpendicular to the line from the ray's start.
    distance = length(from_center)
    facing = -dot(direction, from_center)
    if not facing > 0.0:
        return 0.0 * t_min - 1.0
    t = distance * distance / facing
    offset = add(from_center, scale(direction, t))
    if t > t_min and t < t_max and dot(offset, offset) < lamps[row, RADIUS] * lamps[row, RADIUS]:
        return t
    return 0.0 * t_min - 1.0


@kernel
def sphere_pdf(lights, row, receiver, wi, distance):
    """See `Lamp.pdf`."""
    lamps, lamp_table, p = lights.lamps, lights.lamp_table, receiver.p
    center = (lamps[row, LAMP_P], lamps[row, LAMP_P + 1], lamps[row, LAMP_P + 2])
    from_center = subtract(p, center)
    squared = dot(from_center, from_center)
    radius = lamps[row, RADIUS]
    if lamp_table[row, LAMP_FLAGS] & FLAG_SPHERE:
        if squared > radius * radius:
            one_minus_cos, _ = sphere_cone(lamps, lamp_table, row, squared)
            return INV_TWO_PI / one_minus_cos
        return surroundings_pdf(receiver.n, wi, receiver.has_transmission)
    cosine = -dot(from_center, wi) / math.sqrt(squared)
    if cosine > 0.0:
        return distance * distance * INV_PI / (cosine * radius * radius)
    return 0.0 * distance


@kernel
def leaving_sphere(lights, row, p, wi):
    """See `Lamp.leaving`."""
    lamps, lamp_table = lights.lamps, lights.lamp_table
    if lamp_table[row, LAMP_KIND] != SPOT:
        return 0.0 * p[0] + 1.0
    if lamp_table[row, LAMP_FLAGS] & FLAG_SPHERE:
        center = (lamps[row, LAMP_P], lamps[row, LAMP_P + 1], lamps[row, LAMP_P + 2])
        from_center = subtract(p, center)
        if dot(from_center, from_center) <= lamps[row, RADIUS] * lamps[row, RADIUS]:
            return 0.0 * p[0] + 1.0
    return spot_attenuation(lamps, row, wi)


@kernel
def sample_sphere(lights, row, receiver, u0, u1):
    """See `Lamp.sample`: the spot's cone is what leaves the lamp."""
    lamps, lamp_table = lights.lamps, lights.lamp_table
    p, n = receiver.p, receiver.n
    center = (lamps[row, LAMP_P], lamps[row, LAMP_P + 1], lamps[row, LAMP_P + 2])
    from_center = subtract(p, center)
    squared = dot(from_center, from_center)
    center_distance = math.sqrt(squared)
    radius = lamps[row, RADIUS]
    pdf = 0.0 * u0
    none = pdf
    t = 0.0 * u0
    wi = (0.0, 0.0, 1.0)
    ng = wi
    if not center_distance > 0.0 and radius <= 0.0:
        return LampPoint(pdf, wi, t, ng, pdf, none, none)
    axis = (0.0, 0.0, 1.0)
    if center_distance > 0.0:
        axis = scale(from_center, -1.0 / center_distance)
    if lamp_table[row, LAMP_FLAGS] & FLAG_SPHERE:
        if squared > radius * radius:
            one_minus_cos, from_spot = sphere_cone(lamps, lamp_table, row, squared)
            cone_axis = axis
            if from_spot:
                cone_axis = (
                    -lamps[row, DIRECTION],
                    -lamps[row, DIRECTION + 1],
                    -lamps[row, DIRECTION + 2],
                )
            wi, turned = uniform_cone(cone_axis, one_minus_cos, u0, u1)
            if from_spot:
                t = ray_sphere(center, radius, p, wi, 0.0, 3e38)
                if t < 0.0:
                    return LampPoint(pdf, wi, t, ng, pdf, none, none)
            else:
                half_chord_squared = radius * radius - squared * turned * (2.0 - turned)
                t = center_distance * (1.0 - turned) - math.sqrt(max(0.0, half_chord_squared))
            pdf = INV_TWO_PI / one_minus_cos
        else:
            if receiver.has_transmission:
                wi = uniform_sphere(u0, u1)
            else:
                wi, _ = cosine_hemisphere(n, u0, u1)
            pdf = surroundings_pdf(n, wi, receiver.has_transmission)
            along = center_distance * dot(axis, wi)
            t = along + math.sqrt(max(0.0, radius * radius - squared + along * along))
        ng = normalize(add(from_center, scale(wi, t)))
        u, v = coordinates_on_sphere(lights, row, ng, wi)
        return LampPoint(pdf, wi, t, ng, leaving_sphere(lights, row, p, wi), u, v)

    x, y = concentric_disk(u0, u1)
    tangent, bitangent = orthonormal_basis(axis)
    to_point = subtract(add(scale(tangent, x * radius), scale(bitangent, y * radius)), from_center)
    t = length(to_point)
    wi = scale(to_point, 1.0 / t)
    factor = leaving_sphere(lights, row, p, wi)
    ng = (-wi[0], -wi[1], -wi[2])
    u, v = coordinates_on_sphere(lights, row, ng, wi)
    if radius > 0.0:
        pdf = t * t / (PI * radius * radius * max(1e-20, dot(axis, wi)))
        return LampPoint(pdf, wi, t, ng, factor, u, v)
    return LampPoint(0.0 * pdf + 1.0, wi, t, ng, factor / (t * t), u, v)


@kernel
def coordinates_on_sphere(lights, row, ng, wi):
    """Texture coordinates u and v, which only programs read: of points the two angles, of spots as they project.

    Barycentrics in Cycles' manner, in the lamp's own space; `ng` is the normal, `wi` leads towards the lamp.
    """
    lamps, none = lights.lamps, 0.0 * ng[0]
    if lights.lamp_table[row, LAMP_PROGRAM] < 0:
        return none, none
    if lights.lamp_table[row, LAMP_KIND] == SPOT:
        x, y, z = _to_local(lamps, row, wi)
        # Seen along the cone its width is 1.
        cosine = lamps[row, COSINE]
        scaled = 0.5 * cosine / math.sqrt(max(1e-20, 1.0 - cosine * cosine)) / z if z != 0.0 else none
        return 0.5 - y * scaled, (x + y) * scaled
    x, y, z = _to_local(lamps, row, ng)
    norm = math.sqrt(x * x + y * y + z * z)
    if not norm > 0.0:
        return none, none + 1.0
    u = 0.5 - math.atan2(x, y) * (0.5 * INV_PI)
    v = 1.0 - math.acos(min(1.0, max(-1.0, z / norm))) * INV_PI
    return v, 1.0 - u - v


@kernel
def place_sphere(lights, row, origin, direction, t):
    """See `Lamp.place`: discs face the ray."""
    lamps = lights.lamps
    ng = (-direction[0], -direction[1], -direction[2])
    if lights.lamp_table[row, LAMP_FLAGS] & FLAG_SPHERE:
        center = (lamps[row, LAMP_P], lamps[row, LAMP_P + 1], lamps[row, LAMP_P + 2])
        ng = normalize(add(subtract(origin, center), scale(direction, t)))
    u, v = coordinates_on_sphere(lights, row, ng, direction)
    return ng, u, v


POINT_LAMP = Lamp(POINT, False, sample_sphere, sphere_pdf, hit_sphere, leaving_sphere, place_sphere)
SPOT_LAMP = Lamp(SPOT, False, sample_sphere, sphere_pdf, hit_sphere, leaving_sphere, place_sphere)
