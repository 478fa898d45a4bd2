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
from engine.kernels.constants import ONE_MINUS_EPSILON, PI
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
def normal_at(gamma, b, tilt):
    """Normal of the ellipse, tilted along the fibre as its scales are."""
    x, _, z = normalize((b * math.sin(gamma), 0.0 * b, math.cos(gamma)))
    cosine = math.cos(tilt)
    return x * cosine, math.sin(tilt), z * cosine


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
def first_facet(alpha, tilt, eta, b, gamma, v, u):
    """Where a ray enters that was seen from `v` at `gamma`.

    Returns
    -------
    theta, phi : float32
        Of the way inside.
    transmitted : float32
        Share of the light that takes it; 0 if none does.
    """
    m = normal_at(gamma, b, tilt)
    m_round = normal_at(gamma, b, 0.0)
    cos_o = dot(m, v)
    if cos_o <= 0.0 or dot(m_round, v) <= 0.0:
        return 0.0, 0.0, 0.0
    h = sample_facet(alpha, m, v, u[0], u[1])
    reflected, cos_t = fresnel_dielectric(dot(v, h), eta)
    if reflected >= 1.0:
        return 0.0, 0.0, 0.0
    inside = refracted(v, h, cos_t, eta)
    cos_i = -dot(m, inside)
    if cos_i <= 0.0 or dot(m_round, inside) >= 0.0:
        return 0.0, 0.0, 0.0
    theta = math.atan2(inside[1], math.sqrt(inside[0] * inside[0] + inside[2] * inside[2]))
    return theta, math.atan2(inside[0], inside[2]), (1.0 - reflected) * shadowing(alpha * alpha, cos_o, cos_i)


@kernel
def second_facet(alpha, tilt, eta, b, gamma, theta, phi, u):
    """Where that ray is reflected on the far side, at `gamma`.

    Returns
    -------
    theta, phi : float32
        Of the way after it, backwards.
    reflected : float32
        The facet's reflectance.
    shown : float32
        What facets do not hide of it; 0 if it does not stay inside, -1 if the ray does not meet this side at all.
    """
    w = negate(spherical(theta, phi))
    m = normal_at(gamma, b, -tilt)
    m_round = normal_at(gamma, b, 0.0)
    cos_o = dot(m, w)
    if cos_o <= 0.0 or dot(m_round, w) <= 0.0:
        return 0.0, 0.0, 0.0, -1.0
    h = sample_facet(alpha, m, w, u[0], u[1])
    reflected, _ = fresnel_dielectric(dot(w, h), 1.0 / eta)
    out = _mirrored(w, h)
    shown = 0.0
    if dot(m, out) > 0.0 and dot(m_round, out) > 0.0:
        shown = shadowing(alpha * alpha, cos_o, dot(m, out))
    back = negate(out)
    theta = math.atan2(back[1], math.sqrt(back[0] * back[0] + back[2] * back[2]))
    return theta, math.atan2(back[0], back[2]), reflected, shown


@kernel
def third_facet(alpha, tilt, eta, b, gamma, theta, phi, u):
    """Reflectance where it meets the fibre's surface for the third time, and what facets do not hide: 0 if nothing."""
    w = spherical(theta, phi)
    m = normal_at(gamma, b, -tilt)
    cos_o = dot(m, w)
    if cos_o <= 0.0:
        return 0.0, 0.0
    h = sample_facet(alpha, m, w, u[0], u[1])
    reflected, _ = fresnel_dielectric(dot(w, h), 1.0 / eta)
    return reflected, shadowing(alpha * alpha, cos_o, dot(m, _mirrored(w, h)))


@kernel
def second_gamma(gamma, phi, b):
    """The ellipse's parameter of the inward normal where a ray that entered at `gamma` meets it again."""
    return 2.0 * angle_of(phi, b) - gamma


@kernel
def third_gamma(gamma, phi, phi_back, b):
    """And for the third time."""
    return gamma - 2.0 * (angle_of(phi, b) - angle_of(phi_back, b)) + PI
