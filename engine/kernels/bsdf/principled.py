# SPDX-License-Identifier: GPL-3.0-or-later
"""Principled BSDF: sheen over coat over (metal, glass, or dielectric specular over diffuse)."""

import math

from engine.jit import kernel
from engine.kernels.bsdf.closures import append_closure, weight_below
from engine.kernels.bsdf.diffuse import add_emission, add_oren_nayar, add_transparent
from engine.kernels.bsdf.energy import finish_lobe
from engine.kernels.bsdf.fresnel import eta_of_f0, f0_of_eta, f82_b, f82_mean, fresnel_mean, interface_mean_blend
from engine.kernels.bsdf.glossy import append_glass, append_microfacet, blend_to_white, rotate_tangent
from engine.kernels.bsdf.kinds import (
    CLOSURE_NO_REFLECTIVE_CAUSTICS,
    DIFFUSE,
    GLOSSY_DIELECTRIC,
    GLOSSY_F82,
    GLOSSY_SCHLICK,
    MULTI_GGX,
    WEIGHT_CUTOFF,
)
from engine.kernels.bsdf.normals import valid_specular_normal
from engine.kernels.bsdf.sheen import append_sheen
from engine.kernels.vector import add, dot, normalize, scale


@kernel
def clamp01(x):
    """`x` in [0, 1]."""
    return min(max(x, 0.0), 1.0)


@kernel
def multiply(a, b):
    """Product of two colours."""
    return a[0] * b[0], a[1] * b[1], a[2] * b[2]


@kernel
def not_negative(color):
    """Colour with negative channels set to 0."""
    return max(color[0], 0.0), max(color[1], 0.0), max(color[2], 0.0)


@kernel
def absorb_in_coat(weight, cos_o, coat_weight, ior, tint):
    """Weight left below a tinted coat.

    The tint is what is absorbed along a path of the coat's thickness at perpendicular incidence, raised to the length
    of the refracted view path (Beer's law).
    """
    path_length = 1.0 / math.sqrt(max(1.0 - (1.0 - cos_o * cos_o) / (ior * ior), 1e-6))
    return (
        weight[0] * (1.0 + coat_weight * (tint[0] ** path_length - 1.0)),
        weight[1] * (1.0 + coat_weight * (tint[1] ** path_length - 1.0)),
        weight[2] * (1.0 + coat_weight * (tint[2] ** path_length - 1.0)),
    )


@kernel
def add_layer(
    closures, tables, lane, kind, weight, scale_in, wo, n, is_multiple, alpha_x, alpha_y, tangent, eta, f0, b, fresnel
):
    """Append a reflecting lobe of weight `weight` times `scale_in`; returns what it leaves of `weight` below."""
    i = append_microfacet(
        closures, lane, kind, scale(weight, scale_in), n, alpha_x, alpha_y, tangent, eta, f0, b, f0
    )
    if i < 0:
        return weight
    layer = finish_lobe(closures.param, tables.data, lane, i, kind, wo, is_multiple, fresnel)
    return weight_below(layer, weight)


@kernel
def add_principled(
    closures,
    tables,
    lane,
    weight,
    wo,
    ng,
    n,
    coat_normal,
    tangent,
    is_backfacing,
    distribution,
    base_color,
    metallic,
    roughness,
    diffuse_roughness,
    ior,
    specular_level,
    specular_tint,
    anisotropic,
    anisotropic_rotation,
    transmission,
    coat_weight,
    coat_roughness,
    coat_ior,
    coat_tint,
    sheen_weight,
    sheen_roughness,
    sheen_tint,
    emission_color,
    emission_strength,
    alpha,
):
    """Append the lobes of the Principled BSDF (version 2, as in Blender 4 and 5), without subsurface and thin film.

    Parameters
    ----------
    weight, base_color, specular_tint, coat_tint, sheen_tint, emission_color : tuple of 3 float32
    wo, ng, n, coat_normal, tangent : tuple of 3 float32
        Unit, world space, normals on the viewer's side. A coat normal that is not linked is the smooth shading normal.
    distribution : int, GGX or MULTI_GGX
    anisotropic_rotation : float32 [turns]
    Others : float32, the node's inputs, clamped here as Cycles does.
    """
    base_color = not_negative(base_color)
    clamped_color = (min(base_color[0], 1.0), min(base_color[1], 1.0), min(base_color[2], 1.0))
    specular_tint = not_negative(specular_tint)
    ior = max(ior, 1e-5)
    roughness = clamp01(roughness)
    metallic = clamp01(metallic)
    transmission = clamp01(transmission)
    alpha = clamp01(alpha)
    is_multiple = distribution == MULTI_GGX
    specular_n = valid_specular_normal(closures, lane, ng, wo, n)
    alpha_x = roughness * roughness
    alpha_y = alpha_x
    anisotropic = clamp01(anisotropic)
    if anisotropic > 0.0:
        aspect = math.sqrt(1.0 - anisotropic * 0.9)
        alpha_x /= aspect
        alpha_y *= aspect
        tangent = rotate_tangent(tangent, n, anisotropic_rotation)
    reflects = closures.flags[lane] & CLOSURE_NO_REFLECTIVE_CAUSTICS == 0

    if alpha < 1.0:
        add_transparent(closures, lane, scale(weight, 1.0 - alpha))
        weight = scale(weight, alpha)

    coat_weight = max(coat_weight, 0.0)
    if sheen_weight > WEIGHT_CUTOFF:
        blend = min(coat_weight, 1.0)
        sheen_n = normalize(add(scale(n, 1.0 - blend), scale(coat_normal, blend)))
        sheen_color = scale(multiply(weight, not_negative(sheen_tint)), sheen_weight)
        weight = append_sheen(closures, tables, lane, sheen_color, weight, wo, sheen_n, clamp01(sheen_roughness))

    if coat_weight > WEIGHT_CUTOFF:
        coat_n = valid_specular_normal(closures, lane, ng, wo, coat_normal)
        coat_ior = max(coat_ior, 1.0)
        if reflects:
            coat_alpha = clamp01(coat_roughness)
            coat_alpha *= coat_alpha
            mean = fresnel_mean(coat_ior)
            mean_color = (mean, mean, mean)
            weight = add_layer(
                closures,
                tables,
                lane,
                GLOSSY_DIELECTRIC,
                weight,
                coat_weight,
                wo,
                coat_n,
                True,
                coat_alpha,
                coat_alpha,
                n,
                coat_ior,
                mean_color,
                mean_color,
                mean_color,
            )
        if coat_tint[0] != 1.0 or coat_tint[1] != 1.0 or coat_tint[2] != 1.0:
            weight = absorb_in_coat(weight, dot(wo, coat_n), coat_weight, coat_ior, not_negative(coat_tint))

    add_emission(closures, lane, scale(multiply(emission_color, weight), emission_strength))

    if metallic > WEIGHT_CUTOFF:
        if reflects:
            f0 = clamped_color
            b = (
                f82_b(f0[0], min(specular_tint[0], 1.0)),
                f82_b(f0[1], min(specular_tint[1], 1.0)),
                f82_b(f0[2], min(specular_tint[2], 1.0)),
            )
            fresnel = (f82_mean(f0[0], b[0]), f82_mean(f0[1], b[1]), f82_mean(f0[2], b[2]))
            add_layer(
                closures,
                tables,
                lane,
                GLOSSY_F82,
                weight,
                metallic,
                wo,
                specular_n,
                is_multiple,
                alpha_x,
                alpha_y,
                tangent,
                1.0,
                f0,
                b,
                fresnel,
            )
        weight = scale(weight, 1.0 - metallic)

    f0_real = f0_of_eta(ior)
    if transmission > WEIGHT_CUTOFF:
        tint = (math.sqrt(clamped_color[0]), math.sqrt(clamped_color[1]), math.sqrt(clamped_color[2]))
        append_glass(
            closures,
            tables,
            lane,
            scale(weight, transmission),
            wo,
            specular_n,
            is_multiple,
            roughness * roughness,
            ior,
            is_backfacing,
            scale(specular_tint, f0_real),
            (1.0, 1.0, 1.0),
            tint,
        )
        weight = scale(weight, 1.0 - transmission)

    eta = ior
    specular_level = max(specular_level, 0.0)
    if specular_level != 0.5:
        f0_real *= 2.0 * specular_level
        eta = eta_of_f0(f0_real)
        if ior < 1.0:
            eta = 1.0 / eta
    if reflects and eta != 1.0:
        f0 = scale(specular_tint, f0_real)
        f0 = (clamp01(f0[0]), clamp01(f0[1]), clamp01(f0[2]))
        weight = add_layer(
            closures,
            tables,
            lane,
            GLOSSY_SCHLICK,
            weight,
            1.0,
            wo,
            specular_n,
            is_multiple,
            alpha_x,
            alpha_y,
            tangent,
            eta,
            f0,
            f0,
            blend_to_white(f0, interface_mean_blend(eta)),
        )

    diffuse_weight = multiply(weight, base_color)
    diffuse_roughness = clamp01(diffuse_roughness)
    if diffuse_roughness < WEIGHT_CUTOFF:
        append_closure(closures, lane, DIFFUSE, diffuse_weight, n)
    else:
        add_oren_nayar(closures, lane, diffuse_weight, base_color, n, diffuse_roughness)
