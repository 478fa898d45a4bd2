# SPDX-License-Identifier: GPL-3.0-or-later
"""Emissive triangles: uniform in solid angle where they are near and large, else uniform in area.

Both `sample_triangle` and `triangle_pdf` decide by where the receiver is alone (`sampled_solid_angle`). Far away a
point uniform in area is as good, and several times cheaper; Cycles draws the line at the same distance.

References: Arvo 1995, "Stratified Sampling of Spherical Triangles", and Peters 2021, "BRDF Importance Sampling for
Polygonal Lights", section 4, for the same without angles; Van Oosterom and Strackee 1983, "The Solid Angle of a Plane
Triangle"; Heitz 2019, "A Low-Distortion Map Between Triangle and Square".
"""

import numpy as np

from engine.kernels.angles import sine_and_cosine, upper_angle
from engine.kernels.eight import absolute, choose, larger, load_eight, root, store_eight
from engine.kernels.motion import moving_triangle
from engine.kernels.vector import add, cross, dot, scale, subtract
from engine.runtime.jit import kernel
from engine.state.lanes import (
    DRAW_DIRECTION,
    DRAW_DISTANCE,
    DRAW_PDF,
    DRAW_TRIANGLE,
    DRAW_U,
    DRAW_U0,
    DRAW_U1,
    DRAW_V,
)
from engine.state.lights import (
    EMITTER_FLAGS,
    EMITTER_INSTANCE,
    EMITTER_MOVING,
    EMITTER_TRIANGLE,
    TRIANGLE_EDGE1,
    TRIANGLE_EDGE2,
    TRIANGLE_V0,
)

#: Below, single precision cannot place a point within the spherical triangle; above, the receiver lies almost in it.
_SMALLEST_SOLID_ANGLE = np.float32(3e-4)
_LARGEST_SOLID_ANGLE = np.float32(6.2)
_FIRST = np.int64(0)


@kernel(forceinline=True)
def emissive_triangle(lights, geometry, emitter, time):
    """An emissive triangle at a time of the shutter: its first vertex and the two edges from it, world space."""
    triangles = lights.triangles
    if lights.emitters[emitter, EMITTER_FLAGS] & EMITTER_MOVING:
        v0, v1, v2 = moving_triangle(
            geometry, lights.emitters[emitter, EMITTER_INSTANCE], lights.emitters[emitter, EMITTER_TRIANGLE], time
        )
        return v0, subtract(v1, v0), subtract(v2, v0)
    return (
        (triangles[emitter, TRIANGLE_V0], triangles[emitter, TRIANGLE_V0 + 1], triangles[emitter, TRIANGLE_V0 + 2]),
        (
            triangles[emitter, TRIANGLE_EDGE1],
            triangles[emitter, TRIANGLE_EDGE1 + 1],
            triangles[emitter, TRIANGLE_EDGE1 + 2],
        ),
        (
            triangles[emitter, TRIANGLE_EDGE2],
            triangles[emitter, TRIANGLE_EDGE2 + 1],
            triangles[emitter, TRIANGLE_EDGE2 + 2],
        ),
    )


@kernel
def triangle_solid_angle(a, edge1, edge2, normal):
    """Solid angle [sr] of the triangle a, a + edge1, a + edge2 from the origin; `normal` = cross(edge1, edge2)."""
    b = add(a, edge1)
    c = add(a, edge2)
    la = root(dot(a, a))
    lb = root(dot(b, b))
    lc = root(dot(c, c))
    denominator = la * lb * lc + dot(a, b) * lc + dot(a, c) * lb + dot(b, c) * la
    return 2.0 * upper_angle(absolute(dot(a, normal)), denominator)


@kernel
def sampled_solid_angle(a, edge1, edge2, normal):
    """Solid angle [sr] of a triangle that is to be sampled by it, 0 where area is the better measure.

    It takes one triangle or eight at once, as do all kernels here that do not branch.
    """
    edge3 = subtract(edge2, edge1)
    longest = larger(larger(dot(edge1, edge1), dot(edge2, edge2)), dot(edge3, edge3))
    plane = dot(a, normal)
    solid_angle = triangle_solid_angle(a, edge1, edge2, normal)
    is_near = plane * plane <= longest * dot(normal, normal)
    is_fit = (solid_angle > _SMALLEST_SOLID_ANGLE) & (solid_angle <= _LARGEST_SOLID_ANGLE)
    return choose(is_near & is_fit, solid_angle, 0.0)


@kernel
def triangle_pdf(v0, edge1, edge2, p, wi, distance):
    """Density [sr^-1] with which `sample_triangle` proposes a point of the triangle seen along wi at `distance`."""
    a = subtract(v0, p)
    normal = cross(edge1, edge2)
    solid_angle = sampled_solid_angle(a, edge1, edge2, normal)
    if solid_angle > 0.0:
        return 1.0 / solid_angle
    projected = 0.5 * abs(dot(normal, wi))
    if projected > 0.0:
        return distance * distance / projected
    return 0.0 * distance


@kernel
def _unit(v):
    """Unit vector along `v`, zero if that is."""
    return scale(v, 1.0 / root(larger(dot(v, v), 1e-30)))


@kernel
def _spherical_direction(a, b, c, solid_angle, u0, u1):
    """Uniform direction within the spherical triangle of unit vectors a, b, c.

    A first number cuts off a part with its share of the solid angle, by an arc from b to a point between a and c; a
    second one chooses on that arc. Both without the angles that Arvo's formulas go by.
    """
    ac = dot(a, c)
    sine, cosine = sine_and_cosine(0.5 * u0 * solid_angle)
    along_a = absolute(dot(a, cross(b, c))) * cosine - (ac + dot(b, c)) * sine
    along_c = (1.0 + dot(a, b)) * sine
    # Half-way to the cut, which is a reflected by it.
    middle = add(scale(a, along_a), scale(c, along_c))
    squared = dot(middle, middle)
    has_middle = squared > 0.0
    reflected = subtract(scale(middle, 2.0 * (along_a + along_c * ac) / choose(has_middle, squared, 1.0)), a)
    cut = (
        choose(has_middle, reflected[0], c[0]),
        choose(has_middle, reflected[1], c[1]),
        choose(has_middle, reflected[2], c[2]),
    )
    chord = subtract(cut, b)
    # 1 - cosine of the arc, and of the part that is taken of it.
    whole = 0.5 * dot(chord, chord)
    part = u1 * whole
    share = root(u1 * (2.0 - part) / larger(2.0 - whole, 1e-7))
    return add(scale(b, 1.0 - part - share * (1.0 - whole)), scale(cut, share))


@kernel
def _draw(a, edge1, edge2, u0, u1):
    """`sample_triangle` of the triangle a, a + edge1, a + edge2 for a receiver at the origin; of eight, or of one."""
    normal = cross(edge1, edge2)
    solid_angle = sampled_solid_angle(a, edge1, edge2, normal)
    is_near = solid_angle > 0.0

    wi = _spherical_direction(_unit(a), _unit(add(a, edge1)), _unit(add(a, edge2)), solid_angle, u0, u1)
    # Where the direction meets the plane, as barycentrics; rounding may put them slightly outside.
    facing = dot(normal, wi)
    meets = absolute(facing) > 0.0
    t = choose(meets, dot(normal, a) / choose(meets, facing, 1.0), 0.0)
    offset = subtract(scale(wi, t), a)
    inverse = 1.0 / dot(normal, normal)
    u = larger(dot(cross(offset, edge2), normal) * inverse, 0.0)
    v = larger(dot(cross(edge1, offset), normal) * inverse, 0.0)
    shrink = 1.0 / larger(u + v, 1.0)

    is_upper = u1 > u0
    u = choose(is_near, u * shrink, choose(is_upper, 0.5 * u0, u0 - 0.5 * u1))
    v = choose(is_near, v * shrink, choose(is_upper, u1 - 0.5 * u0, 0.5 * u1))
    point = add(a, add(scale(edge1, u), scale(edge2, v)))
    distance = root(dot(point, point))
    is_away = distance > 0.0
    wi = scale(point, 1.0 / choose(is_away, distance, 1.0))
    projected = 0.5 * absolute(dot(normal, wi))
    is_seen = projected > 0.0
    by_area = choose(is_seen, distance * distance / choose(is_seen, projected, 1.0), 0.0)
    pdf = choose(is_near, 1.0 / choose(is_near, solid_angle, 1.0), by_area)
    return choose(is_away, pdf, 0.0), wi, distance, u, v


@kernel
def sample_triangle(v0, edge1, edge2, p, u0, u1):
    """Point of a triangle, given by a vertex and the edges from it, for a receiver at p.

    Returns
    -------
    pdf : float [sr^-1], 0 = none
    wi : unit direction; distance : float
    u, v : barycentrics of vertices 1 and 2
    """
    return _draw(subtract(v0, p), edge1, edge2, u0, u1)


@kernel
def put_triangle(draws, k, v0, edge1, edge2, p):
    """Leave for `sample_triangles` a triangle and a receiver at place `k`: arguments of `sample_triangle`."""
    a = subtract(v0, p)
    for c in range(3):
        draws.real[0, DRAW_TRIANGLE + c, k] = a[c]
        draws.real[0, DRAW_TRIANGLE + 3 + c, k] = edge1[c]
        draws.real[0, DRAW_TRIANGLE + 6 + c, k] = edge2[c]


@kernel
def _load_three(draws, column):
    """Three columns, eight values each."""
    real = draws.real
    return load_eight(real, _FIRST, column), load_eight(real, _FIRST, column + 1), load_eight(real, _FIRST, column + 2)


@kernel
def sample_triangles(draws):
    """`sample_triangle` at all eight places, whatever lies there; `drawn_triangle` says the results."""
    real = draws.real
    pdf, wi, distance, u, v = _draw(
        _load_three(draws, DRAW_TRIANGLE), _load_three(draws, DRAW_TRIANGLE + 3), _load_three(draws, DRAW_TRIANGLE + 6),
        load_eight(real, _FIRST, DRAW_U0), load_eight(real, _FIRST, DRAW_U1),
    )
    store_eight(real, _FIRST, DRAW_PDF, pdf)
    store_eight(real, _FIRST, DRAW_DIRECTION, wi[0])
    store_eight(real, _FIRST, DRAW_DIRECTION + 1, wi[1])
    store_eight(real, _FIRST, DRAW_DIRECTION + 2, wi[2])
    store_eight(real, _FIRST, DRAW_DISTANCE, distance)
    store_eight(real, _FIRST, DRAW_U, u)
    store_eight(real, _FIRST, DRAW_V, v)


@kernel
def drawn_triangle(draws, k):
    """What `sample_triangle` returns, of place `k` after `sample_triangles`."""
    real = draws.real
    wi = (real[0, DRAW_DIRECTION, k], real[0, DRAW_DIRECTION + 1, k], real[0, DRAW_DIRECTION + 2, k])
    return real[0, DRAW_PDF, k], wi, real[0, DRAW_DISTANCE, k], real[0, DRAW_U, k], real[0, DRAW_V, k]
