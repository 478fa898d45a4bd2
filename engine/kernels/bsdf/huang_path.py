# SPDX-License-Identifier: GPL-3.0-or-later
"""A ray's way through a fibre of elliptical cross section and rough surface, as far as Huang's model draws it.

Directions are in the fibre's axes: x along the ellipse's major axis, y along the fibre. `gamma` is the parameter of a
point (sin gamma, b cos gamma) of the ellipse, whose axes are 1 and b; `phi` a direction's angle to z about the fibre.

References
----------
Huang, Hullin and Hanika 2022, "A Microfacet-based Hair Scattering Model".
"""

import math

import numpy as np

from engine.kernels.bsdf.fresnel import fresnel_dielectric
from engine.kernels.bsdf.lookup import GLASS_ALBEDO, read_volume
from engine.kernels.bsdf.microfacet import sample_ggx_normal
from engine.kernels.constants import ONE_MINUS_EPSILON
from engine.kernels.rng import hash_combine, unit_float
from engine.kernels.vector import dot, negate, normalize, orthonormal_basis, scale, subtract, to_local, to_world
from engine.runtime.jit import kernel


@kernel
def angle_of(phi, b):
    """The ellipse's parameter that is stored for a direction of angle `phi`."""
    if b == 1.0:
        return phi
    return math.atan2(b * math.sin(phi), math.cos(phi))


@kernel
def spherical(theta, phi):
    """Direction at `theta` to the normal plane."""
    cosine = math.cos(theta)
    return math.sin(phi) * cosine, math.sin(theta), math.cos(phi) * cosine


@kernel
def angles(w):
    """Angle of a direction to the normal plane, and about the fibre."""
    return math.atan2(w[1], math.sqrt(w[0] * w[0] + w[2] * w[2])), math.atan2(w[0], w[2])


@kernel
def side_of(sine, cosine, b):
    """Normal (x, z) of the ellipse where its parameter has this sine and cosine."""
    over = 1.0 / math.sqrt(b * b * sine * sine + cosine * cosine)
    return b * sine * over, cosine * over


@kernel
def side_at(gamma, b):
    """Normal (x, z) of the ellipse."""
    return side_of(math.sin(gamma), math.cos(gamma), b)


@kernel
def tilted(side, tilt):
    """The normal, tilted along the fibre as its scales are, by an angle of this cosine and sine."""
    return side[0] * tilt[0], tilt[1], side[1] * tilt[0]


@kernel
def facing(side, w):
    """Cosine between a normal (x, z) and a direction."""
    return side[0] * w[0] + side[1] * w[2]


@kernel
def facet_masking(alpha_squared, cosine):
    """Smith's Lambda of GGX."""
    return 0.5 * math.sqrt(1.0 + alpha_squared * max(1.0 / (cosine * cosine) - 1.0, 0.0)) - 0.5


@kernel
def shadowing(alpha_squared, cos_o, cos_i):
    """What of the light off visible facets is not hidden behind others: Smith's G over its part for one side."""
    visible = 1.0 + facet_masking(alpha_squared, cos_o)
    return visible / (visible + facet_masking(alpha_squared, cos_i))


@kernel
def sample_facet(alpha, m, w, u0, u1):
    """A facet's normal, about `m`, of those that are visible from `w`, which sees `m`."""
    tangent, bitangent = orthonormal_basis(m)
    h = sample_ggx_normal(to_local(w, tangent, bitangent, m), alpha, alpha, u0, u1)
    return to_world(h, tangent, bitangent, m)


@kernel
def refracted(w, h, cos_t, eta):
    """Direction behind a facet that `w` points away from; `eta` as of `fresnel_dielectric`, which gives `cos_t`."""
    inverse = 1.0 / eta
    return normalize(subtract(scale(h, inverse * dot(h, w) + cos_t), scale(w, inverse)))


@kernel
def _mirrored(w, h):
    return subtract(scale(h, 2.0 * dot(h, w)), w)


@kernel
def energy_scale(data, cosine, alpha, eta):
    """What single scattering between facets of glass loses, by `BsdfTables.data`."""
    z = math.sqrt(abs((eta - 1.0) / (eta + 1.0)))
    side = 4096 if eta < 1.0 else 0
    return 1.0 / max(read_volume(data, GLASS_ALBEDO + side, 16, z, cosine, math.sqrt(alpha)), 1e-3)


@kernel
def facet_numbers(seed, number, order):
    """Two numbers in [0, 1) for the facet that way `number` of some meets as its first (0), second or third.

    Those of the first two facets are spread evenly over the ways. References: Roberts 2018, "The Unreasonable
    Effectiveness of Quasirandom Sequences", in four dimensions.
    """
    u0 = unit_float(hash_combine(seed, np.uint32(2 * order + 1)))
    u1 = unit_float(hash_combine(seed, np.uint32(2 * order + 2)))
    if order == 0:
        u0 += np.float32(number) * np.float32(0.8566749)
        u1 += np.float32(number) * np.float32(0.7338919)
    else:
        u0 += np.float32(number) * np.float32(0.6287067)
        u1 += np.float32(number) * np.float32(0.5385973)
    return min(u0 - math.floor(u0), ONE_MINUS_EPSILON), min(u1 - math.floor(u1), ONE_MINUS_EPSILON)


@kernel
def first_facet(alpha, tilt, eta, side, v, u):
    """Where a ray enters that was seen from `v`, by the facet of two numbers `u` in [0, 1).

    Returns
    -------
    inside : tuple of 3 float32
        The way inside.
    transmitted : float32
        Share of the light that takes it; 0 if none does.
    """
    m = tilted(side, tilt)
    cos_o = dot(m, v)
    if cos_o <= 0.0 or facing(side, v) <= 0.0:
        return v, 0.0
    h = sample_facet(alpha, m, v, u[0], u[1])
    reflected, cos_t = fresnel_dielectric(dot(v, h), eta)
    if reflected >= 1.0:
        return v, 0.0
    inside = refracted(v, h, cos_t, eta)
    cos_i = -dot(m, inside)
    if cos_i <= 0.0 or facing(side, inside) >= 0.0:
        return v, 0.0
    return inside, (1.0 - reflected) * shadowing(alpha * alpha, cos_o, cos_i)


@kernel
def second_facet(alpha, tilt, eta, side, w, u):
    """Where that ray, which came from `w`, is reflected on the far side.

    Returns
    -------
    back : tuple of 3 float32
        The way after it, backwards.
    reflected : float32
        The facet's reflectance.
    shown : float32
        What facets do not hide of it; 0 if it does not stay inside, -1 if the ray does not meet this side at all.
    """
    m = tilted(side, tilt)
    cos_o = dot(m, w)
    if cos_o <= 0.0 or facing(side, w) <= 0.0:
        return w, 0.0, -1.0
    h = sample_facet(alpha, m, w, u[0], u[1])
    reflected, _ = fresnel_dielectric(dot(w, h), 1.0 / eta)
    out = _mirrored(w, h)
    shown = 0.0
    if dot(m, out) > 0.0 and facing(side, out) > 0.0:
        shown = shadowing(alpha * alpha, cos_o, dot(m, out))
    return negate(out), reflected, shown


@kernel
def third_facet(alpha, m, eta, w, u):
    """Reflectance where it meets the fibre's surface for the third time, and what facets do not hide: 0 if nothing."""
    cos_o = dot(m, w)
    if cos_o <= 0.0:
        return 0.0, 0.0
    h = sample_facet(alpha, m, w, u[0], u[1])
    reflected, _ = fresnel_dielectric(dot(w, h), 1.0 / eta)
    return reflected, shadowing(alpha * alpha, cos_o, dot(m, _mirrored(w, h)))
