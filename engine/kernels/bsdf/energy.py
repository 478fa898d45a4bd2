# SPDX-License-Identifier: GPL-3.0-or-later
"""Directional albedo of microfacet lobes, and what several scatterings between facets add to them."""

import math

from engine.kernels.bsdf.closures import average, read3, store_color
from engine.kernels.bsdf.fresnel import f0_of_eta
from engine.kernels.bsdf.kinds import (
    ALPHA_X,
    ALPHA_Y,
    ENERGY_SCALE,
    ETA,
    F0,
    GLASS,
    GLOSSY_DIELECTRIC,
    GLOSSY_F82,
    GLOSSY_SCHLICK,
    REFRACTION,
)
from engine.kernels.bsdf.lookup import (
    FRESNEL_BLEND,
    GLASS_ALBEDO,
    GLASS_MEAN,
    GLOSSY_ALBEDO,
    GLOSSY_MEAN,
    SCHLICK_BLEND,
    read_table,
    read_volume,
)
from engine.kernels.bsdf.microfacet import fresnel_blend, lobe_color
from engine.kernels.vector import dot
from engine.runtime.jit import kernel
from engine.state.lanes import CLOSURE_N, CLOSURE_SAMPLE_WEIGHT, CLOSURE_WEIGHT


@kernel
def albedo_blends(param, data, lane, i, kind, wo, looks_up_transmission):
    """Shared part of a lobe's estimated albedo: of reflection (table), of refraction (as if smooth).

    With `looks_up_transmission` glass lets through what the table says that it does not reflect, as in Cycles 5.2.
    `data` is BsdfTables.data. The first goes into `reflected_albedo`, the second into `lobe_color`.
    """
    cos_o = dot(read3(param, lane, i, CLOSURE_N), wo)
    refracted = 0.0
    if kind != GLOSSY_SCHLICK and kind != GLOSSY_F82:
        refracted, _ = fresnel_blend(param, lane, i, kind, cos_o)
    reflected = refracted
    eta = param[lane, i, ETA]
    roughness = math.sqrt(math.sqrt(param[lane, i, ALPHA_X] * param[lane, i, ALPHA_Y]))
    if kind == GLOSSY_F82:
        reflected = read_table(data, SCHLICK_BLEND, 16, cos_o, roughness)
    elif kind == GLOSSY_SCHLICK or kind == GLASS or (kind == GLOSSY_DIELECTRIC and eta > 1.0):
        z = math.sqrt(abs((eta - 1.0) / (eta + 1.0)))
        reflected = read_volume(data, FRESNEL_BLEND, 16, z, cos_o, roughness)
        if kind == GLOSSY_DIELECTRIC:
            f0 = f0_of_eta(eta)
            reflected = f0 + (1.0 - f0) * reflected
        if kind == GLASS and looks_up_transmission != 0:
            refracted = reflected
    return reflected, refracted


@kernel
def reflected_albedo(param, lane, i, kind, reflected, c):
    """Estimated albedo of a lobe's reflection without its weight, channel `c`."""
    if kind == REFRACTION:
        return 0.0
    if kind == GLOSSY_F82:
        # The F82 term is left out, as in Cycles.
        f0 = param[lane, i, F0 + c]
        return f0 + (1.0 - f0) * reflected
    return lobe_color(param, lane, i, kind, reflected, False, c)


@kernel
def finish_lobe(param, data, lane, i, kind, wo, is_multiple, fresnel):
    """Weigh a microfacet lobe's selection by its albedo and, if `is_multiple`, make up for single scattering.

    The lobe is scaled up by what single scattering loses, coloured by the Fresnel term of further bounces.

    Parameters
    ----------
    fresnel : tuple of 3 float32, cosine-weighted mean of the Fresnel term.

    Returns
    -------
    Estimated albedo of its reflection, weight included, RGB.

    References: Kulla and Conty 2017, "Revisiting Physically Based Shading at Imageworks", for the multiple-bounce
    Fresnel term; scaling instead of adding a lobe after Turquin 2019, "Practical multiple scattering compensation for
    microfacet models".
    """
    # Whatever passes show: here it decides how often the lobe is picked, and nothing else.
    reflected, refracted = albedo_blends(param, data, lane, i, kind, wo, 0)
    r = reflected_albedo(param, lane, i, kind, reflected, 0)
    g = reflected_albedo(param, lane, i, kind, reflected, 1)
    b = reflected_albedo(param, lane, i, kind, reflected, 2)
    total = r + g + b
    if kind == GLASS:
        for c in range(3):
            total += lobe_color(param, lane, i, kind, refracted, True, c)
    weight = read3(param, lane, i, CLOSURE_WEIGHT)
    sample_weight = param[lane, i, CLOSURE_SAMPLE_WEIGHT] * total * (1.0 / 3.0)
    if is_multiple:
        cos_o = dot(read3(param, lane, i, CLOSURE_N), wo)
        roughness = math.sqrt(math.sqrt(param[lane, i, ALPHA_X] * param[lane, i, ALPHA_Y]))
        single = 1.0
        single_mean = 1.0
        if kind == GLASS:
            eta = param[lane, i, ETA]
            z = math.sqrt(abs((eta - 1.0) / (eta + 1.0)))
            side = 1 if eta < 1.0 else 0
            single = read_volume(data, GLASS_ALBEDO + side * 4096, 16, z, cos_o, roughness)
            single_mean = read_table(data, GLASS_MEAN + side * 256, 16, z, roughness)
        else:
            single = read_table(data, GLOSSY_ALBEDO, 32, cos_o, roughness)
            # A single row: y = 0 never reads the next.
            single_mean = read_table(data, GLOSSY_MEAN, 32, 0.0, roughness)
        missing = (1.0 - single) / max(single, 1e-6)
        param[lane, i, ENERGY_SCALE] = 1.0 + missing
        # A colour far above 1 must not make the series of bounces diverge.
        missing_mean = 1.0 - single_mean
        darkening = (
            (1.0 + missing * fresnel[0] * single_mean / max(1.0 - fresnel[0] * missing_mean, 1e-2)) / (1.0 + missing),
            (1.0 + missing * fresnel[1] * single_mean / max(1.0 - fresnel[1] * missing_mean, 1e-2)) / (1.0 + missing),
            (1.0 + missing * fresnel[2] * single_mean / max(1.0 - fresnel[2] * missing_mean, 1e-2)) / (1.0 + missing),
        )
        weight = (weight[0] * darkening[0], weight[1] * darkening[1], weight[2] * darkening[2])
        store_color(param, lane, i, CLOSURE_WEIGHT, weight)
        sample_weight *= average(darkening)
    param[lane, i, CLOSURE_SAMPLE_WEIGHT] = sample_weight
    return weight[0] * r, weight[1] * g, weight[2] * b
