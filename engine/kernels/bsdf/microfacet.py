# SPDX-License-Identifier: GPL-3.0-or-later
"""Microfacet lobes: GGX with Smith's height-correlated masking, reflection and refraction.

References: Walter et al. 2007, "Microfacet Models for Refraction through Rough Surfaces"; Heitz 2014, "Understanding
the Masking-Shadowing Function in Microfacet-Based BRDFs"; Dupuy and Benyoub 2023, "Sampling Visible GGX Normals with
Spherical Caps".
"""

import math

import numpy as np

from engine.kernels.bsdf.closures import read3
from engine.kernels.bsdf.fresnel import fresnel_dielectric
from engine.kernels.bsdf.kinds import (
    ALPHA_X,
    ALPHA_Y,
    DELTA_ALPHA_SQUARED,
    ENERGY_SCALE,
    ETA,
    F0,
    F0_REAL,
    F82_B,
    GLASS,
    GLOSSY,
    GLOSSY_DIELECTRIC,
    GLOSSY_F82,
    GLOSSY_SCHLICK,
    REFLECTION_TINT,
    REFRACTION,
    TANGENT,
    TRANSMISSION_TINT,
)
from engine.kernels.bsdf.warp import concentric_disk
from engine.kernels.constants import INV_PI
from engine.kernels.vector import cross, dot, normalize, orthonormal_basis, scale, subtract, to_local, to_world
from engine.runtime.jit import kernel
from engine.state.lanes import CLOSURE_WEIGHT

#: A refractive index this close to 1 refracts as a delta lobe, whatever the roughness (Cycles).
MIN_ETA_STEP = np.float32(1e-4)


@kernel
def fresnel_blend(param, lane, i, kind, cos_h):
    """The part of a lobe's Fresnel term that all channels share, and the (negative) cosine of the refracted direction.

    It is 1 (GLOSSY), the reflectance (GLOSSY_DIELECTRIC, REFRACTION), the blend from F0 to 1 (GLOSSY_SCHLICK, GLASS) or
    the cosine itself (GLOSSY_F82); `lobe_color` makes a colour of it.
    """
    if kind == GLOSSY:
        return 1.0, 0.0
    if kind == GLOSSY_F82:
        return cos_h, 0.0
    reflectance, cos_t = fresnel_dielectric(cos_h, param[lane, i, ETA])
    if kind == GLOSSY_SCHLICK or kind == GLASS:
        f0 = param[lane, i, F0_REAL]
        # A division that need not wait for the reflectance.
        inverse = 1.0 / max(1.0 - f0, 1e-6)
        reflectance = min(max((reflectance - f0) * inverse, 0.0), 1.0)
    return reflectance, cos_t


@kernel
def lobe_color(param, lane, i, kind, blend, is_refracted, c):
    """Reflectance, or transmittance, of a facet for channel `c`, tint included and weight not."""
    if kind == REFRACTION:
        return 0.0 if blend >= 1.0 else 1.0
    if kind == GLOSSY or kind == GLOSSY_DIELECTRIC:
        return blend
    f0 = param[lane, i, F0 + c]
    if kind == GLOSSY_F82:
        s = min(max(1.0 - blend, 0.0), 1.0)
        s5 = s * s * s * s * s
        return min(max(f0 + (1.0 - f0) * s5 - param[lane, i, F82_B + c] * blend * s5 * s, 0.0), 1.0)
    f = f0 + (1.0 - f0) * blend
    if kind != GLASS:
        return f
    if is_refracted:
        return (1.0 - f) * param[lane, i, TRANSMISSION_TINT + c]
    return f * param[lane, i, REFLECTION_TINT + c]


@kernel
def glass_reflection_pmf(param, channels, lane, i, blend):
    """Probability that glass samples reflection at a facet; -1 if it does nothing with the light."""
    reflected = 0.0
    transmitted = 0.0
    for c in range(len(channels)):
        reflected += lobe_color(param, lane, i, GLASS, blend, False, c)
        transmitted += lobe_color(param, lane, i, GLASS, blend, True, c)
    total = reflected + transmitted
    return reflected / total if total > 0.0 else -1.0


@kernel
def eval_microfacet(param, channels, lane, i, kind, n, wo, wi, factor, out, row):
    """Add `factor` times f |cos| of a microfacet lobe to out[row] and return its pdf [sr^-1]; delta lobes give 0."""
    cos_o = dot(n, wo)
    cos_i = dot(n, wi)
    is_refracted = cos_i < 0.0
    alpha_x = param[lane, i, ALPHA_X]
    alpha_y = param[lane, i, ALPHA_Y]
    alpha_squared = alpha_x * alpha_y
    if cos_o <= 0.0 or cos_i == 0.0 or not alpha_squared > DELTA_ALPHA_SQUARED:
        return 0.0
    if (is_refracted and kind < REFRACTION) or (kind == REFRACTION and not is_refracted):
        return 0.0
    eta = param[lane, i, ETA] if is_refracted else 1.0
    if is_refracted and abs(eta - 1.0) < MIN_ETA_STEP:
        return 0.0
    h = (eta * wi[0] + wo[0], eta * wi[1] + wo[1], eta * wi[2] + wo[2])
    inverse_length = 1.0 / math.sqrt(max(dot(h, h), 1e-30))
    cos_nh = dot(n, h)
    # Facets look up: where the far side is denser, eta wi + wo points down.
    if cos_nh < 0.0:
        inverse_length = -inverse_length
    h = scale(h, inverse_length)
    cos_nh *= inverse_length
    cos_ho = dot(h, wo)
    cos_hi = dot(h, wi)
    if cos_ho <= 0.0 or (cos_hi >= 0.0 and is_refracted):
        return 0.0

    blend, _ = fresnel_blend(param, lane, i, kind, cos_ho)
    branch_pmf = 1.0
    if kind == GLASS:
        branch_pmf = glass_reflection_pmf(param, channels, lane, i, blend)
        if branch_pmf < 0.0:
            return 0.0
        if is_refracted:
            branch_pmf = 1.0 - branch_pmf

    # D |dh / dwi| / cos_o (Walter et al. 2007, Eqs. 14 and 17).
    inverse_o = 1.0 / cos_o
    common = 0.25 * inverse_o
    if is_refracted:
        common = eta * inverse_length * eta * inverse_length * abs(cos_ho * cos_hi) * inverse_o
    # (alpha tan(theta))^2 of both directions.
    stretched_o = 0.0
    stretched_i = 0.0
    if alpha_x == alpha_y or is_refracted:
        # sin^2 by cross product: 1 - cos^2 would lose the lobe of a nearly smooth surface.
        sine = cross(n, h)
        slope = dot(sine, sine) + alpha_squared * cos_nh * cos_nh
        common *= alpha_squared * INV_PI / (slope * slope)
        stretched_o = alpha_squared * max(inverse_o * inverse_o - 1.0, 0.0)
        stretched_i = alpha_squared * max(1.0 / (cos_i * cos_i) - 1.0, 0.0)
    else:
        tangent = read3(param, lane, i, TANGENT)
        bitangent = cross(n, tangent)
        x = dot(tangent, h) / alpha_x
        y = dot(bitangent, h) / alpha_y
        slope = x * x + y * y + cos_nh * cos_nh
        common *= INV_PI / (alpha_squared * slope * slope)
        x = alpha_x * dot(tangent, wo) * inverse_o
        y = alpha_y * dot(bitangent, wo) * inverse_o
        stretched_o = x * x + y * y
        x = alpha_x * dot(tangent, wi) / cos_i
        y = alpha_y * dot(bitangent, wi) / cos_i
        stretched_i = x * x + y * y
    # 1 + Lambda(wo) and Lambda(wi) (Heitz 2014, Eqs. 72 and 86).
    masking_o = 0.5 + 0.5 * math.sqrt(1.0 + stretched_o)
    lambda_i = 0.5 * math.sqrt(1.0 + stretched_i) - 0.5

    value = factor * param[lane, i, ENERGY_SCALE] * common / (masking_o + lambda_i)
    for c in range(len(channels)):
        color = lobe_color(param, lane, i, kind, blend, is_refracted, c)
        out[row, c] += param[lane, i, CLOSURE_WEIGHT + c] * color * value
    return common * branch_pmf / masking_o


@kernel
def sample_ggx_normal(wo, alpha_x, alpha_y, u0, u1):
    """Visible normal of GGX for `wo` in the lobe's frame, wo.z > 0.

    The cap is reached through the concentric disk: z = 1 - r^2 (1 + wo.z).
    """
    stretched = normalize((alpha_x * wo[0], alpha_y * wo[1], wo[2]))
    x, y = concentric_disk(u0, u1)
    height = 1.0 + stretched[2]
    depth = (x * x + y * y) * height
    radius = math.sqrt(max(height * (2.0 - depth), 0.0))
    h_x = alpha_x * (x * radius + stretched[0])
    h_y = alpha_y * (y * radius + stretched[1])
    return normalize((h_x, h_y, max(height - depth, 1e-12)))


@kernel
def sample_microfacet(param, channels, lane, i, kind, n, wo, u0, u1, u2):
    """Direction from a microfacet lobe.

    Returns
    -------
    wi : tuple of 3 float32
    is_refracted, is_delta : bool
    blend : float32, of `fresnel_blend` at the facet
    branch_pmf : float32, probability of having reflected (or refracted) there; 0 = no sample
    """
    cos_o = dot(n, wo)
    if cos_o <= 0.0:
        return wo, False, False, 0.0, 0.0
    alpha_x = param[lane, i, ALPHA_X]
    alpha_y = param[lane, i, ALPHA_Y]
    is_delta = not alpha_x * alpha_y > DELTA_ALPHA_SQUARED
    h = n
    if not is_delta:
        tangent, bitangent = orthonormal_basis(n)
        if alpha_x != alpha_y:
            tangent = read3(param, lane, i, TANGENT)
            bitangent = cross(n, tangent)
        local = sample_ggx_normal(to_local(wo, tangent, bitangent, n), alpha_x, alpha_y, u1, u2)
        h = to_world(local, tangent, bitangent, n)
    cos_ho = dot(h, wo)
    blend, cos_t = fresnel_blend(param, lane, i, kind, cos_ho)
    branch_pmf = 1.0
    is_refracted = False
    if kind == REFRACTION:
        is_refracted = True
        if blend >= 1.0:
            branch_pmf = 0.0
    elif kind == GLASS:
        branch_pmf = glass_reflection_pmf(param, channels, lane, i, blend)
        is_refracted = u0 >= branch_pmf
        if is_refracted:
            branch_pmf = 1.0 - branch_pmf if branch_pmf >= 0.0 else 0.0
    along_h = 2.0 * cos_ho
    along_wo = 1.0
    if is_refracted:
        along_wo = 1.0 / param[lane, i, ETA]
        along_h = along_wo * cos_ho + cos_t
        is_delta = is_delta or abs(along_wo - 1.0) < MIN_ETA_STEP
    wi = normalize(subtract(scale(h, along_h), scale(wo, along_wo)))
    if (dot(n, wi) < 0.0) != is_refracted:
        branch_pmf = 0.0
    return wi, is_refracted, is_delta, blend, branch_pmf
