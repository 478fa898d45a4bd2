# SPDX-License-Identifier: GPL-3.0-or-later
"""Directional albedo of microfacet lobes, and what several scatterings between facets add to them."""

import math

from engine.jit import kernel
from engine.kernels.bsdf.closures import average, closure_weight, store_color
from engine.kernels.bsdf.fresnel import f0_of_eta
from engine.kernels.bsdf.kinds import (
    ALPHA_X,
    ALPHA_Y,
    ENERGY_SCALE,
    ETA,
    F0,
    GLASS,
    GLOSSY,
    GLOSSY_DIELECTRIC,
    GLOSSY_F82,
    GLOSSY_SCHLICK,
    REFLECTION_TINT,
    REFRACTION,
    TRANSMISSION_TINT,
)
from engine.kernels.bsdf.lookup import read_plane, read_row, read_volume
from engine.kernels.bsdf.microfacet import channel_reflectance, fresnel_blend
from engine.kernels.vector import dot
from engine.state import CLOSURE_N, CLOSURE_SAMPLE_WEIGHT, CLOSURE_WEIGHT

#: Samples of the refractive index in BsdfTables.
ETA_COUNT = 16


@kernel
def eta_coordinate(eta):
    """Table coordinate of a refractive index, the same for eta and 1 / eta."""
    return math.sqrt(abs((eta - 1.0) / (eta + 1.0)))


@kernel
def roughness_of(closures, lane, i):
    """Table coordinate of a lobe's roughness."""
    return math.sqrt(math.sqrt(closures.param[lane, i, ALPHA_X] * closures.param[lane, i, ALPHA_Y]))


@kernel
def albedo_blends(closures, tables, lane, i, kind, wo):
    """What `reflected_albedo` and `transmitted_albedo` need, for all channels."""
    param = closures.param
    n = (param[lane, i, CLOSURE_N], param[lane, i, CLOSURE_N + 1], param[lane, i, CLOSURE_N + 2])
    cos_o = dot(n, wo)
    at_view, cos_t = fresnel_blend(closures, lane, i, kind, cos_o)
    mean = at_view
    eta = param[lane, i, ETA]
    if kind == GLOSSY_F82:
        mean = read_plane(tables.schlick_blend, 0, cos_o, roughness_of(closures, lane, i))
    elif kind == GLOSSY_SCHLICK or kind == GLASS or (kind == GLOSSY_DIELECTRIC and eta > 1.0):
        roughness = roughness_of(closures, lane, i)
        mean = read_volume(tables.fresnel_blend, 0, ETA_COUNT, eta_coordinate(eta), cos_o, roughness)
        if kind == GLOSSY_DIELECTRIC:
            f0 = f0_of_eta(eta)
            mean = f0 + (1.0 - f0) * mean
    return at_view, mean


@kernel
def reflected_albedo(closures, lane, i, kind, mean, c):
    """Estimated albedo of a lobe's reflection without its weight, channel `c`."""
    param = closures.param
    if kind == REFRACTION:
        return 0.0
    if kind == GLOSSY or kind == GLOSSY_DIELECTRIC:
        return mean
    f0 = param[lane, i, F0 + c]
    f = f0 + (1.0 - f0) * mean
    return f * param[lane, i, REFLECTION_TINT + c] if kind == GLASS else f


@kernel
def transmitted_albedo(closures, lane, i, kind, at_view, c):
    """Estimated albedo of a lobe's refraction without its weight, channel `c`."""
    if kind == GLASS:
        f = channel_reflectance(closures, lane, i, kind, at_view, c)
        return (1.0 - f) * closures.param[lane, i, TRANSMISSION_TINT + c]
    if kind == REFRACTION:
        return 0.0 if at_view >= 1.0 else 1.0
    return 0.0


@kernel
def scale_by_albedo(closures, tables, lane, i, kind, wo):
    """Multiply a lobe's sample weight by its mean albedo; returns the `mean` of `albedo_blends`."""
    at_view, mean = albedo_blends(closures, tables, lane, i, kind, wo)
    total = 0.0
    for c in range(3):
        total += reflected_albedo(closures, lane, i, kind, mean, c)
        total += transmitted_albedo(closures, lane, i, kind, at_view, c)
    closures.param[lane, i, CLOSURE_SAMPLE_WEIGHT] *= total * (1.0 / 3.0)
    return mean


@kernel
def multiple_bounces(fresnel, single_mean, missing):
    """1 plus the energy of further bounces for one channel; colours far above 1 must not make the series diverge."""
    return 1.0 + missing * fresnel * single_mean / max(1.0 - fresnel * (1.0 - single_mean), 1e-2)


@kernel
def preserve_energy(closures, tables, lane, i, kind, wo, mean_fresnel):
    """Scale a lobe up by what single scattering loses, coloured by the Fresnel term of further bounces.

    `mean_fresnel` : tuple of 3 float32, cosine-weighted mean of the Fresnel term.

    References: Kulla and Conty 2017 for the multiple-bounce Fresnel; scaling single scattering instead of adding a lobe
    after Turquin 2019, "Practical multiple scattering compensation for microfacet models".
    """
    param = closures.param
    n = (param[lane, i, CLOSURE_N], param[lane, i, CLOSURE_N + 1], param[lane, i, CLOSURE_N + 2])
    cos_o = dot(n, wo)
    roughness = roughness_of(closures, lane, i)
    if kind == GLASS:
        eta = param[lane, i, ETA]
        side = 1 if eta < 1.0 else 0
        z = eta_coordinate(eta)
        single = read_volume(tables.glass_albedo, side * ETA_COUNT, ETA_COUNT, z, cos_o, roughness)
        single_mean = read_plane(tables.glass_mean, side, z, roughness)
    else:
        single = read_plane(tables.glossy_albedo, 0, cos_o, roughness)
        single_mean = read_row(tables.glossy_mean, roughness)
    missing = (1.0 - single) / max(single, 1e-6)
    energy_scale = 1.0 + missing
    param[lane, i, ENERGY_SCALE] = energy_scale
    darkening = (
        multiple_bounces(mean_fresnel[0], single_mean, missing) / energy_scale,
        multiple_bounces(mean_fresnel[1], single_mean, missing) / energy_scale,
        multiple_bounces(mean_fresnel[2], single_mean, missing) / energy_scale,
    )
    weight = closure_weight(closures, lane, i)
    weight = (weight[0] * darkening[0], weight[1] * darkening[1], weight[2] * darkening[2])
    store_color(closures, lane, i, CLOSURE_WEIGHT, weight)
    param[lane, i, CLOSURE_SAMPLE_WEIGHT] *= average(darkening)


@kernel
def attenuate_below(closures, lane, i, kind, mean, weight):
    """Weight left to the layers below lobe `i` of weight up to `weight`: by the channel the lobe reflects most."""
    share = 0.0
    for c in range(3):
        if weight[c] > 0.0:
            albedo = closures.param[lane, i, CLOSURE_WEIGHT + c] * reflected_albedo(closures, lane, i, kind, mean, c)
            share = max(share, albedo / weight[c])
    left = min(max(1.0 - share, 0.0), 1.0)
    return weight[0] * left, weight[1] * left, weight[2] * left
