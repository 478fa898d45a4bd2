# SPDX-License-Identifier: GPL-3.0-or-later
"""Emissive triangles: uniform in solid angle where they are near and large, else uniform in area.

Both `sample_triangle` and `triangle_pdf` decide by where the receiver is alone (`sampled_solid_angle`). Far away a
point uniform in area is as good, and several times cheaper; Cycles draws the line at the same distance.

References: Arvo 1995, "Stratified Sampling of Spherical Triangles", and Peters 2021, "BRDF Importance Sampling for
Polygonal Lights", section 4, for the same without angles; Van Oosterom and Strackee 1983, "The Solid Angle of a Plane
Triangle"; Heitz 2019, "A Low-Distortion Map Between Triangle and Square".
"""

import math

import numpy as np

from engine.kernels.angles import sine_and_cosine, upper_angle
from engine.kernels.motion import point_to_world, triangle_at
from engine.kernels.vector import add, cross, dot, length, normalize, scale, subtract
from engine.runtime.jit import kernel
from engine.state.geometry import INSTANCE_FLAG_BAKED, INSTANCE_FLAGS, INSTANCE_MESH
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


@kernel
def _moving_triangle(geometry, instance, triangle, time):
    """World space vertices of a triangle that moves or changes its shape."""
    v0, v1, v2 = triangle_at(geometry, geometry.instance_table[instance, INSTANCE_MESH], triangle, time)
    if not geometry.instance_table[instance, INSTANCE_FLAGS] & INSTANCE_FLAG_BAKED:
        v0 = point_to_world(geometry, instance, time, v0)
        v1 = point_to_world(geometry, instance, time, v1)
        v2 = point_to_world(geometry, instance, time, v2)
    return v0, v1, v2


@kernel(forceinline=True)
def emissive_triangle(lights, geometry, emitter, time):
    """An emissive triangle at a time of the shutter: its first vertex and the two edges from it, world space."""
    triangles = lights.triangles
    if lights.emitters[emitter, EMITTER_FLAGS] & EMITTER_MOVING:
        v0, v1, v2 = _moving_triangle(
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
    la = length(a)
    lb = length(b)
    lc = length(c)
    denominator = la * lb * lc + dot(a, b) * lc + dot(a, c) * lb + dot(b, c) * la
    return 2.0 * upper_angle(abs(dot(a, normal)), denominator)


@kernel
def sampled_solid_angle(a, edge1, edge2, normal):
    """Solid angle [sr] of a triangle that is to be sampled by it, 0 where area is the better measure."""
    edge3 = subtract(edge2, edge1)
    longest = max(dot(edge1, edge1), dot(edge2, edge2), dot(edge3, edge3))
    plane = dot(a, normal)
    if plane * plane > longest * dot(normal, normal):
        return 0.0 * plane
    solid_angle = triangle_solid_angle(a, edge1, edge2, normal)
    if solid_angle > _SMALLEST_SOLID_ANGLE and solid_angle < _LARGEST_SOLID_ANGLE:
        return solid_angle
    return 0.0 * plane


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
def _spherical_direction(a, b, c, solid_angle, u0, u1):
    """Uniform direction within the spherical triangle of unit vectors a, b, c.

    A first number cuts off a part with its share of the solid angle, by an arc from b to a point between a and c; a
    second one chooses on that arc. Both without the angles that Arvo's formulas go by.
    """
    ac = dot(a, c)
    sine, cosine = sine_and_cosine(0.5 * u0 * solid_angle)
    along_a = abs(dot(a, cross(b, c))) * cosine - (ac + dot(b, c)) * sine
    along_c = (1.0 + dot(a, b)) * sine
    # Half-way to the cut, which is a reflected by it.
    middle = add(scale(a, along_a), scale(c, along_c))
    squared = dot(middle, middle)
    cut = c
    if squared > 0.0:
        cut = subtract(scale(middle, 2.0 * (along_a + along_c * ac) / squared), a)
    chord = subtract(cut, b)
    # 1 - cosine of the arc, and of the part that is taken of it.
    whole = 0.5 * dot(chord, chord)
    part = u1 * whole
    share = math.sqrt(u1 * (2.0 - part) / max(2.0 - whole, 1e-7))
    return add(scale(b, 1.0 - part - share * (1.0 - whole)), scale(cut, share))


@kernel(forceinline=True)
def sample_triangle(v0, edge1, edge2, p, u0, u1):
    """Point of a triangle, given by a vertex and the edges from it, for a receiver at p.

    Returns
    -------
    pdf : float [sr^-1], 0 = none
    wi : unit direction; distance : float
    u, v : barycentrics of vertices 1 and 2
    normal : cross(edge 1, edge 2), not normalised
    """
    a = subtract(v0, p)
    normal = cross(edge1, edge2)
    squared = dot(normal, normal)
    solid_angle = sampled_solid_angle(a, edge1, edge2, normal)
    u = u0
    v = u1
    pdf = 0.0 * u0
    inside = solid_angle > 0.0
    if inside:
        wi = _spherical_direction(
            normalize(a), normalize(add(a, edge1)), normalize(add(a, edge2)), solid_angle, u0, u1
        )
        # Where the direction meets the plane, as barycentrics; rounding may put them slightly outside.
        facing = dot(normal, wi)
        t = 0.0 * u0
        if facing != 0.0:
            t = dot(normal, a) / facing
        offset = subtract(scale(wi, t), a)
        u = max(0.0, dot(cross(offset, edge2), normal) / squared)
        v = max(0.0, dot(cross(edge1, offset), normal) / squared)
        if u + v > 1.0:
            excess = 1.0 / (u + v)
            u *= excess
            v *= excess
        pdf = 1.0 / solid_angle
    elif v > u:
        u *= 0.5
        v -= u
    else:
        v *= 0.5
        u -= v
    point = add(a, add(scale(edge1, u), scale(edge2, v)))
    distance = length(point)
    if not distance > 0.0:
        return 0.0 * u0, (0.0, 0.0, 1.0), distance, u, v, normal
    wi = scale(point, 1.0 / distance)
    if not inside:
        projected = 0.5 * abs(dot(normal, wi))
        if projected > 0.0:
            pdf = distance * distance / projected
    return pdf, wi, distance, u, v, normal
