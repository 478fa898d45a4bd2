# SPDX-License-Identifier: GPL-3.0-or-later
"""Microfacet lobes: GGX with Smith's height-correlated masking, reflection and refraction.

References: Walter et al. 2007, "Microfacet Models for Refraction through Rough Surfaces"; Heitz 2014, "Understanding the
Masking-Shadowing Function in Microfacet-Based BRDFs"; Dupuy and Benyoub 2023, "Sampling Visible GGX Normals with
Spherical Caps".
"""

import math

import numpy as np

from engine.jit import kernel
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
from engine.kernels.vector import add, cross, dot, normalize, orthonormal_basis, scale, subtract, to_local, to_world
from engine.state import CLOSURE_WEIGHT

#: A refractive index this close to 1 refracts as a delta lobe, whatever the roughness (Cycles).
MIN_ETA_STEP = np.float32(1e-4)


@kernel
def fresnel_blend(closures, lane, i, kind, cos_h):
    """The part of a lobe's Fresnel term that all channels share, and the cosine of the refracted direction.

    It is the reflectance (GLOSSY_DIELECTRIC, REFRACTION), the blend from F0 to 1 (GLOSSY_SCHLICK, GLASS), or the cosine
    itself (GLOSSY_F82); `channel_reflectance` makes a colour of it.
    """
    if kind == GLOSSY_F82:
        return cos_h, 0.0
    if kind < GLOSSY_DIELECTRIC:
        return 1.0, 0.0
    reflectance, cos_t = fresnel_dielectric(cos_h, closures.param[lane, i, ETA])
    if kind == GLOSSY_SCHLICK or kind == GLASS:
        f0 = closures.param[lane, i, F0_REAL]
        reflectance = min(max((reflectance - f0) / max(1.0 - f0, 1e-6), 0.0), 1.0)
    return reflectance, cos_t


@kernel
def channel_reflectance(closures, lane, i, kind, blend, c):
    """Reflectance of channel `c` without tints, from `fresnel_blend`."""
    param = closures.param
    if kind == GLOSSY_SCHLICK or kind == GLASS:
        f0 = param[lane, i, F0 + c]
        return f0 + (1.0 - f0) * blend
    if kind == GLOSSY_F82:
        f0 = param[lane, i, F0 + c]
        s = min(max(1.0 - blend, 0.0), 1.0)
        s5 = s * s * s * s * s
        return min(max(f0 + (1.0 - f0) * s5 - param[lane, i, F82_B + c] * blend * s5 * s, 0.0), 1.0)
    return blend


@kernel
def glass_reflection_probability(closures, lane, i, blend, cos_t):
    """Share of reflection in what glass does with light at a facet; -1 if it does nothing."""
    param = closures.param
    reflected = 0.0
    transmitted = 0.0
    for c in range(len(closures.channels)):
        f = channel_reflectance(closures, lane, i, GLASS, blend, c)
        reflected += f * param[lane, i, REFLECTION_TINT + c]
        transmitted += (1.0 - f) * param[lane, i, TRANSMISSION_TINT + c]
    total = reflected + transmitted
    return reflected / total if total > 0.0 else -1.0


@kernel
def ggx_lambda(alpha_tan_squared):
    """Smith's Lambda of GGX (Heitz 2014, Eq. 72) of (alpha tan(theta))^2."""
    return 0.5 * (math.sqrt(1.0 + alpha_tan_squared) - 1.0)


@kernel
def alpha_tan_squared(alpha_x, alpha_y, v):
    """(alpha tan(theta))^2 of a direction in the lobe's frame (Heitz 2014, Eq. 86)."""
    x = alpha_x * v[0]
    y = alpha_y * v[1]
    return (x * x + y * y) / (v[2] * v[2])


@kernel
def lobe_frame(closures, lane, i, n):
    """Tangent and bitangent of an anisotropic lobe."""
    param = closures.param
    tangent = (param[lane, i, TANGENT], param[lane, i, TANGENT + 1], param[lane, i, TANGENT + 2])
    return tangent, cross(n, tangent)


@kernel
def eval_microfacet(closures, lane, i, kind, n, wo, wi, factor, out, row):
    """Add `factor` times f |cos| of a microfacet lobe to out[row] and return its pdf [sr^-1]; delta lobes give 0."""
    param = closures.param
    cos_o = dot(n, wo)
    cos_i = dot(n, wi)
    is_refracted = cos_i < 0.0
    alpha_x = param[lane, i, ALPHA_X]
    alpha_y = param[lane, i, ALPHA_Y]
    alpha_squared = alpha_x * alpha_y
    if cos_o <= 0.0 or cos_i == 0.0 or not alpha_squared > DELTA_ALPHA_SQUARED:
        return 0.0
    if is_refracted:
        if kind < REFRACTION:
            return 0.0
        eta = param[lane, i, ETA]
        if abs(eta - 1.0) < MIN_ETA_STEP:
            return 0.0
        h = add(scale(wi, eta), wo)
    else:
        if kind == REFRACTION:
            return 0.0
        eta = 1.0
        h = add(wi, wo)
    inverse_length = 1.0 / math.sqrt(max(dot(h, h), 1e-30))
    # Facets look up: where the far side is denser, eta wi + wo points down.
    if dot(n, h) < 0.0:
        inverse_length = -inverse_length
    h = scale(h, inverse_length)
    cos_ho = dot(h, wo)
    cos_hi = dot(h, wi)
    if cos_ho <= 0.0 or (cos_hi >= 0.0 and is_refracted):
        return 0.0

    blend, cos_t = fresnel_blend(closures, lane, i, kind, cos_ho)
    branch_pmf = 1.0
    if kind == GLASS:
        branch_pmf = glass_reflection_probability(closures, lane, i, blend, cos_t)
        if branch_pmf < 0.0:
            return 0.0
        if is_refracted:
            branch_pmf = 1.0 - branch_pmf
    elif kind == REFRACTION and blend >= 1.0:
        return 0.0

    # sin^2 by cross product: 1 - cos^2 would lose the lobe of a nearly smooth surface.
    cos_nh = dot(n, h)
    if alpha_x == alpha_y or is_refracted:
        sine = cross(n, h)
        slope = dot(sine, sine) + alpha_squared * cos_nh * cos_nh
        density = alpha_squared * INV_PI / (slope * slope)
        lambda_o = ggx_lambda(alpha_squared * max(1.0 / (cos_o * cos_o) - 1.0, 0.0))
        lambda_i = ggx_lambda(alpha_squared * max(1.0 / (cos_i * cos_i) - 1.0, 0.0))
    else:
        tangent, bitangent = lobe_frame(closures, lane, i, n)
        h_x = dot(tangent, h) / alpha_x
        h_y = dot(bitangent, h) / alpha_y
        slope = h_x * h_x + h_y * h_y + cos_nh * cos_nh
        density = INV_PI / (alpha_squared * slope * slope)
        lambda_o = ggx_lambda(alpha_tan_squared(alpha_x, alpha_y, to_local(wo, tangent, bitangent, n)))
        lambda_i = ggx_lambda(alpha_tan_squared(alpha_x, alpha_y, to_local(wi, tangent, bitangent, n)))

    # D |dh / dwi| / cos_o (Walter et al. 2007, Eqs. 14 and 17).
    common = density / cos_o
    if is_refracted:
        jacobian = eta * inverse_length
        common *= jacobian * jacobian * abs(cos_ho * cos_hi)
    else:
        common *= 0.25

    if factor != 0.0:
        value = factor * param[lane, i, ENERGY_SCALE] * common / (1.0 + lambda_o + lambda_i)
        for c in range(len(closures.channels)):
            f = channel_reflectance(closures, lane, i, kind, blend, c)
            if is_refracted:
                f = (1.0 - f) * param[lane, i, TRANSMISSION_TINT + c] if kind == GLASS else 1.0
            elif kind == GLASS:
                f *= param[lane, i, REFLECTION_TINT + c]
            out[row, c] += param[lane, i, CLOSURE_WEIGHT + c] * f * value
    return common * branch_pmf / (1.0 + lambda_o)


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
    return normalize(
        (
            alpha_x * (x * radius + stretched[0]),
            alpha_y * (y * radius + stretched[1]),
            max(1.0 - depth + stretched[2], 1e-12),
        )
    )


@kernel
def sample_microfacet(closures, lane, i, kind, n, wo, ng, u0, u1, u2):
    """Direction from a microfacet lobe.

    Returns
    -------
    is_valid : bool
    wi : tuple of 3 float32
    is_refracted, is_delta : bool
    blend : float32, of `fresnel_blend` at the facet
    branch_pmf : float32, probability of having reflected (or refracted) there
    """
    param = closures.param
    cos_o = dot(n, wo)
    if cos_o <= 0.0:
        return False, wo, False, False, 0.0, 0.0
    alpha_x = param[lane, i, ALPHA_X]
    alpha_y = param[lane, i, ALPHA_Y]
    is_delta = not alpha_x * alpha_y > DELTA_ALPHA_SQUARED
    h = n
    if not is_delta:
        tangent, bitangent = orthonormal_basis(n)
        if alpha_x != alpha_y:
            tangent, bitangent = lobe_frame(closures, lane, i, n)
        local = sample_ggx_normal(to_local(wo, tangent, bitangent, n), alpha_x, alpha_y, u1, u2)
        h = to_world(local, tangent, bitangent, n)
    cos_ho = dot(h, wo)
    blend, cos_t = fresnel_blend(closures, lane, i, kind, cos_ho)
    branch_pmf = 1.0
    is_refracted = False
    if kind == REFRACTION:
        is_refracted = True
        if blend >= 1.0:
            return False, wo, False, False, 0.0, 0.0
    elif kind == GLASS:
        branch_pmf = glass_reflection_probability(closures, lane, i, blend, cos_t)
        is_refracted = u0 >= branch_pmf
        if is_refracted:
            branch_pmf = 1.0 - branch_pmf if branch_pmf >= 0.0 else 0.0
    if is_refracted:
        eta = param[lane, i, ETA]
        inverse_eta = 1.0 / eta
        wi = subtract(scale(h, inverse_eta * cos_ho + cos_t), scale(wo, inverse_eta))
        is_delta = is_delta or abs(eta - 1.0) < MIN_ETA_STEP
    else:
        wi = subtract(scale(h, 2.0 * cos_ho), wo)
    wi = normalize(wi)
    # Only samples are checked against the geometric normal: evaluation would show the facets of smooth meshes (Cycles).
    is_valid = branch_pmf > 0.0 and (dot(n, wi) < 0.0) == is_refracted and (dot(ng, wi) < 0.0) == is_refracted
    return is_valid, wi, is_refracted, is_delta, blend, branch_pmf


@kernel
def delta_weight(closures, lane, i, kind, blend, is_refracted, c):
    """Weight of a delta lobe for channel `c`, given `fresnel_blend`."""
    param = closures.param
    f = channel_reflectance(closures, lane, i, kind, blend, c)
    if is_refracted:
        f = (1.0 - f) * param[lane, i, TRANSMISSION_TINT + c] if kind == GLASS else 1.0
    elif kind == GLASS:
        f *= param[lane, i, REFLECTION_TINT + c]
    return param[lane, i, CLOSURE_WEIGHT + c] * param[lane, i, ENERGY_SCALE] * f
