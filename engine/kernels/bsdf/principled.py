# SPDX-License-Identifier: GPL-3.0-or-later
"""Principled BSDF: sheen over coat over (metal, glass, or dielectric specular over diffuse)."""

import math

from engine.jit import kernel
from engine.kernels.bsdf.closures import append_closure, store_color
from engine.kernels.bsdf.diffuse import add_emission, add_oren_nayar, add_transparent
from engine.kernels.bsdf.energy import attenuate_below, preserve_energy, scale_by_albedo
from engine.kernels.bsdf.fresnel import eta_of_f0, f0_of_eta, f82_b, f82_mean, fresnel_mean, interface_mean_blend
from engine.kernels.bsdf.glossy import append_glass, append_microfacet, rotate_tangent
from engine.kernels.bsdf.kinds import (
    CLOSURE_NO_REFLECTIVE_CAUSTICS,
    DIFFUSE,
    F0,
    F0_REAL,
    F82_B,
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
def add_coat(closures, tables, lane, weight, wo, n, coat_weight, roughness, ior, tint):
    """Clear dielectric layer; returns the weight it leaves to what is below.

    The tint is what is absorbed along a path of the layer's thickness at perpendicular incidence, raised to the length
    of the refracted view path (Beer's law).
    """
    if closures.flags[lane] & CLOSURE_NO_REFLECTIVE_CAUSTICS == 0:
        alpha = roughness * roughness
        i = append_microfacet(
            closures, lane, GLOSSY_DIELECTRIC, scale(weight, coat_weight), n, alpha, alpha, n, ior
        )
        if i >= 0:
            mean = scale_by_albedo(closures, tables, lane, i, GLOSSY_DIELECTRIC, wo)
            fresnel = fresnel_mean(ior)
            preserve_energy(closures, tables, lane, i, GLOSSY_DIELECTRIC, wo, (fresnel, fresnel, fresnel))
            weight = attenuate_below(closures, lane, i, GLOSSY_DIELECTRIC, mean, weight)
    if tint[0] != 1.0 or tint[1] != 1.0 or tint[2] != 1.0:
        cos_o = dot(wo, n)
        path_length = 1.0 / math.sqrt(max(1.0 - (1.0 - cos_o * cos_o) / (ior * ior), 1e-6))
        weight = (
            weight[0] * (1.0 + coat_weight * (tint[0] ** path_length - 1.0)),
            weight[1] * (1.0 + coat_weight * (tint[1] ** path_length - 1.0)),
            weight[2] * (1.0 + coat_weight * (tint[2] ** path_length - 1.0)),
        )
    return weight


@kernel
def add_metal(closures, tables, lane, weight, wo, n, is_multiple, alpha_x, alpha_y, tangent, color, edge_tint):
    """Conductor with the F82 Fresnel curve: `color` at perpendicular incidence, `edge_tint` near 82 degrees."""
    i = append_microfacet(closures, lane, GLOSSY_F82, weight, n, alpha_x, alpha_y, tangent, 1.0)
    if i < 0:
        return
    b = (
        f82_b(color[0], min(edge_tint[0], 1.0)),
        f82_b(color[1], min(edge_tint[1], 1.0)),
        f82_b(color[2], min(edge_tint[2], 1.0)),
    )
    store_color(closures, lane, i, F0, color)
    store_color(closures, lane, i, F82_B, b)
    scale_by_albedo(closures, tables, lane, i, GLOSSY_F82, wo)
    if is_multiple:
        fresnel = (f82_mean(color[0], b[0]), f82_mean(color[1], b[1]), f82_mean(color[2], b[2]))
        preserve_energy(closures, tables, lane, i, GLOSSY_F82, wo, fresnel)


@kernel
def add_specular(closures, tables, lane, weight, wo, n, is_multiple, alpha_x, alpha_y, tangent, eta, f0):
    """Dielectric reflection whose Fresnel term runs from `f0` to 1; returns the weight left below."""
    i = append_microfacet(closures, lane, GLOSSY_SCHLICK, weight, n, alpha_x, alpha_y, tangent, eta)
    if i < 0:
        return weight
    f0_real = f0_of_eta(eta)
    f0 = (clamp01(f0[0]), clamp01(f0[1]), clamp01(f0[2]))
    closures.param[lane, i, F0_REAL] = f0_real
    store_color(closures, lane, i, F0, f0)
    mean = scale_by_albedo(closures, tables, lane, i, GLOSSY_SCHLICK, wo)
    if is_multiple:
        s = interface_mean_blend(eta, f0_real)
        fresnel = (f0[0] + (1.0 - f0[0]) * s, f0[1] + (1.0 - f0[1]) * s, f0[2] + (1.0 - f0[2]) * s)
        preserve_energy(closures, tables, lane, i, GLOSSY_SCHLICK, wo, fresnel)
    return attenuate_below(closures, lane, i, GLOSSY_SCHLICK, mean, weight)


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
        Unit, world space, normals on the viewer's side. A coat normal that is not linked is `n`.
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
        weight = add_coat(
            closures,
            tables,
            lane,
            weight,
            wo,
            coat_n,
            coat_weight,
            clamp01(coat_roughness),
            max(coat_ior, 1.0),
            not_negative(coat_tint),
        )

    add_emission(closures, lane, scale(multiply(emission_color, weight), emission_strength))

    if metallic > WEIGHT_CUTOFF:
        if reflects:
            metal_weight = scale(weight, metallic)
            add_metal(
                closures,
                tables,
                lane,
                metal_weight,
                wo,
                specular_n,
                is_multiple,
                alpha_x,
                alpha_y,
                tangent,
                clamped_color,
                specular_tint,
            )
        weight = scale(weight, 1.0 - metallic)

    f0 = f0_of_eta(ior)
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
            scale(specular_tint, f0),
            (1.0, 1.0, 1.0),
            tint,
        )
        weight = scale(weight, 1.0 - transmission)

    eta = ior
    specular_level = max(specular_level, 0.0)
    if specular_level != 0.5:
        f0 *= 2.0 * specular_level
        eta = eta_of_f0(f0)
        if ior < 1.0:
            eta = 1.0 / eta
    if reflects and eta != 1.0:
        f0_color = scale(specular_tint, f0)
        weight = add_specular(
            closures, tables, lane, weight, wo, specular_n, is_multiple, alpha_x, alpha_y, tangent, eta, f0_color
        )

    diffuse_weight = multiply(weight, base_color)
    diffuse_roughness = clamp01(diffuse_roughness)
    if diffuse_roughness < WEIGHT_CUTOFF:
        append_closure(closures, lane, DIFFUSE, diffuse_weight, n)
    else:
        add_oren_nayar(closures, lane, diffuse_weight, base_color, n, diffuse_roughness)
