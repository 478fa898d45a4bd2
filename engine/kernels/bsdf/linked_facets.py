# SPDX-License-Identifier: GPL-3.0-or-later
"""Microfacet lobes whose kernels are linked (`linked.py`): Beckmann's facets, thin films, metals by n and k.

A lobe's model says its distribution, its Fresnel term and what tints what it reflects. Facets of glass are isotropic
until `stretch.py` makes them others.
"""

import math

import numpy as np

from engine.kernels.bsdf.beckmann import (
    approximate_lambda,
    beckmann_density,
    beckmann_lambda,
    sample_beckmann_normal,
)
from engine.kernels.bsdf.closures import average, read3, store_color
from engine.kernels.bsdf.conductor import (
    F82_COSINE,
    conductor_mean,
    f82_curve,
    fresnel_conductor,
    index_at,
    index_of_colors,
)
from engine.kernels.bsdf.fresnel import f0_of_eta, fresnel_dielectric
from engine.kernels.bsdf.kinds import (
    ALPHA_X,
    ALPHA_Y,
    DELTA_ALPHA_SQUARED,
    ENERGY_SCALE,
    ETA,
    F0,
    GLASS,
    GLOSSY_F82,
    GLOSSY_SCHLICK,
    LINKED_GLASS,
    LINKED_GLOSSY,
    LINKED_REFRACTION,
    REFLECTION_TINT,
    REFRACTION,
    TANGENT,
    TRANSMISSION_TINT,
)
from engine.kernels.bsdf.linked import (
    ADDRESS,
    CONDUCTOR,
    F82,
    FACETS,
    FILM_IOR,
    FILM_THICKNESS,
    FRESNEL_MASK,
    IS_BECKMANN,
    IS_DELTA,
    LEAST_THICKNESS,
    MODEL_MASK,
    NO_SAMPLE,
    REFLECTED,
    REFRACTED,
    SCHLICK,
    SELF,
    TANGENT_ANGLE,
    TINT,
    TINTS_BOTH,
    TINTS_MASK,
    TINTS_NO_REFLECTION,
    TINTS_REFLECTION,
    TINTS_REFRACTION,
    WAVE_STEP,
    WAVES,
    WITHOUT_FRESNEL,
    address_of,
    bits_of,
    real_of,
)
from engine.kernels.bsdf.lookup import FRESNEL_BLEND, SCHLICK_BLEND, read_table, read_volume
from engine.kernels.bsdf.microfacet import MIN_ETA_STEP, sample_ggx_normal
from engine.kernels.bsdf.thin_film import NO_WAVE, film_reflectance
from engine.kernels.constants import INV_PI
from engine.kernels.limits import at_least
from engine.kernels.vector import add, cross, dot, normalize, orthonormal_basis, scale, subtract, to_local, to_world
from engine.runtime.jit import kernel
from engine.state.lanes import CLOSURE_N, CLOSURE_SAMPLE_WEIGHT, CLOSURE_WEIGHT


@kernel
def set_address(param, lane, i, address):
    """Have a lobe carry an address, its model in the lowest bits."""
    param[lane, i, ADDRESS] = real_of(address)
    param[lane, i, ADDRESS + 1] = real_of(address >> 32)


@kernel
def wavelength_of(param, channels, lane, i, c):
    """Wavelength of a channel [nm]; `NO_WAVE` in RGB."""
    if len(channels) == 3:
        return NO_WAVE
    bits = bits_of(param[lane, i, WAVES + (c >> 1)])
    return np.float32((bits >> (16 * (c & 1))) & 65535) * WAVE_STEP


@kernel
def set_wavelengths(param, lane, i, first, second, third, fourth):
    """Give a lobe its path's wavelengths [nm]."""
    param[lane, i, WAVES] = real_of(int(first / WAVE_STEP) | int(second / WAVE_STEP) << 16)
    param[lane, i, WAVES + 1] = real_of(int(third / WAVE_STEP) | int(fourth / WAVE_STEP) << 16)


@kernel
def has_colors(model):
    """Whether F0 and TINT are colours, which have spectra."""
    return model >= FACETS and model & FRESNEL_MASK != CONDUCTOR


@kernel
def _film(param, channels, lane, i, block, c, cos_h, n, k, f82):
    return film_reflectance(
        block, c, wavelength_of(param, channels, lane, i, c), cos_h, param[lane, i, FILM_THICKNESS],
        param[lane, i, FILM_IOR], n, k, f82,
    )  # fmt: skip


@kernel
def _reflectance(param, channels, lane, i, block, model, cos_h, blend, c):
    """Fresnel term of a facet for a channel; `blend` is that of Schlick's without a film, from F0 to white."""
    fresnel = model & FRESNEL_MASK
    has_film = param[lane, i, FILM_THICKNESS] > LEAST_THICKNESS
    if fresnel == CONDUCTOR:
        if len(channels) == 3:
            n, k = param[lane, i, F0 + c], param[lane, i, TINT + c]
        else:
            wavelength = wavelength_of(param, channels, lane, i, c)
            n = index_at(param, lane, i, F0, wavelength)
            k = index_at(param, lane, i, TINT, wavelength)
        if has_film:
            return _film(param, channels, lane, i, block, c, cos_h, n, k, np.float32(-1.0))
        return fresnel_conductor(cos_h, n, k)
    f0 = param[lane, i, F0 + c]
    if fresnel == F82:
        b = param[lane, i, TINT + c]
        if not has_film:
            return f82_curve(f0, b, cos_h)
        f82 = f82_curve(f0, b, F82_COSINE)
        n, k = index_of_colors(f0, f82)
        return _film(param, channels, lane, i, block, c, cos_h, n, k, f82)
    if not has_film:
        return f0 + (1.0 - f0) * blend
    eta = param[lane, i, ETA]
    f = _film(param, channels, lane, i, block, c, cos_h, eta, np.float32(-1.0), np.float32(-1.0))
    real = f0_of_eta(eta)
    if real > 1e-5:
        # The nearer to what the surface reflects straight on, the more F0 has to say (Cycles).
        s = min(max((1.0 - f) / (1.0 - real), 0.0), 1.0)
        f *= 1.0 + (f0 / real - 1.0) * s
    return f


@kernel
def facet_colors(param, channels, lane, i, block, kind, model, cos_h):
    """What a facet reflects and what it refracts, by channel, and the (negative) cosine of the refracted direction."""
    reflected, cos_t = np.float32(1.0), np.float32(0.0)
    if kind != LINKED_GLOSSY or model & FRESNEL_MASK == SCHLICK:
        reflected, cos_t = fresnel_dielectric(cos_h, param[lane, i, ETA])
    black = np.float32(0.0)
    if model & FRESNEL_MASK == WITHOUT_FRESNEL:
        if kind == LINKED_GLOSSY:
            white = np.float32(1.0)
            return white, white, white, white, black, black, black, black, cos_t
        through = np.float32(1.0) if reflected < 1.0 else black
        return black, black, black, black, through, through, through, through, cos_t
    real = f0_of_eta(param[lane, i, ETA])
    blend = min(max((reflected - real) / max(1.0 - real, 1e-6), 0.0), 1.0)
    r0, t0 = _tinted(param, channels, lane, i, block, kind, model, cos_h, blend, 0)
    r1, t1 = _tinted(param, channels, lane, i, block, kind, model, cos_h, blend, 1)
    r2, t2 = _tinted(param, channels, lane, i, block, kind, model, cos_h, blend, 2)
    r3, t3 = black, black
    if len(channels) > 3:
        r3, t3 = _tinted(param, channels, lane, i, block, kind, model, cos_h, blend, 3)
    if reflected >= 1.0:
        # Total reflection, whatever a film has to say.
        t0, t1, t2, t3 = black, black, black, black
    return r0, r1, r2, r3, t0, t1, t2, t3, cos_t


@kernel
def _tinted(param, channels, lane, i, block, kind, model, cos_h, blend, c):
    """What one channel of a facet reflects and refracts."""
    f = _reflectance(param, channels, lane, i, block, model, cos_h, blend, c)
    if kind == LINKED_GLOSSY:
        return f, np.float32(0.0)
    tint = param[lane, i, TINT + c]
    tints = model & TINTS_MASK
    reflected, refracted = f, (1.0 - f) * tint
    if tints == TINTS_REFRACTION:
        reflected = np.float32(0.0)
    elif tints == TINTS_BOTH:
        reflected = f * tint
    elif tints == TINTS_REFLECTION:
        reflected = f * tint
        refracted = np.float32(0.0)
    return reflected, refracted


@kernel
def _reflection_pmf(colors):
    reflected = colors[0] + colors[1] + colors[2] + colors[3]
    total = reflected + colors[4] + colors[5] + colors[6] + colors[7]
    return reflected / total if total > 0.0 else np.float32(-1.0)


@kernel
def frame_of(param, lane, i, n):
    """Axes of a lobe's anisotropy."""
    tangent, bitangent = orthonormal_basis(n)
    if param[lane, i, ALPHA_X] != param[lane, i, ALPHA_Y]:
        angle = param[lane, i, TANGENT_ANGLE]
        tangent = add(scale(tangent, math.cos(angle)), scale(bitangent, math.sin(angle)))
        bitangent = cross(n, tangent)
    return tangent, bitangent


@kernel
def eval_facets(param, channels, lane, i, kind, n, wo, wi):
    """As the kernel EVALUATE of `linked.py`."""
    black = np.float32(0.0)
    nothing = (black, black, black, black, black)
    cos_o, cos_i = dot(n, wo), dot(n, wi)
    is_refracted = cos_i < 0.0
    alpha_x, alpha_y = param[lane, i, ALPHA_X], param[lane, i, ALPHA_Y]
    alpha_squared = alpha_x * alpha_y
    if cos_o <= 0.0 or cos_i == 0.0 or not alpha_squared > DELTA_ALPHA_SQUARED:
        return nothing
    if (is_refracted and kind == LINKED_GLOSSY) or (kind == LINKED_REFRACTION and not is_refracted):
        return nothing
    eta = param[lane, i, ETA] if is_refracted else np.float32(1.0)
    if is_refracted and abs(eta - 1.0) < MIN_ETA_STEP:
        return nothing
    h = (eta * wi[0] + wo[0], eta * wi[1] + wo[1], eta * wi[2] + wo[2])
    inverse_length = 1.0 / math.sqrt(max(dot(h, h), 1e-30))
    if dot(n, h) < 0.0:
        inverse_length = -inverse_length
    h = scale(h, inverse_length)
    cos_ho, cos_hi = dot(h, wo), dot(h, wi)
    if cos_ho <= 0.0 or (cos_hi >= 0.0 and is_refracted):
        return nothing
    address = address_of(param, lane, i)
    model = address & MODEL_MASK
    colors = facet_colors(param, channels, lane, i, address - model, kind, model, cos_ho)
    branch_pmf = _reflection_pmf(colors)
    if branch_pmf < 0.0:
        return nothing
    if is_refracted:
        branch_pmf = 1.0 - branch_pmf
    common = 0.25 / cos_o
    if is_refracted:
        common = eta * inverse_length * eta * inverse_length * abs(cos_ho * cos_hi) / cos_o
    tangent, bitangent = frame_of(param, lane, i, n)
    x, y, cos_h = dot(tangent, h), dot(bitangent, h), dot(n, h)
    across_o = (alpha_x * dot(tangent, wo), alpha_y * dot(bitangent, wo))
    across_i = (alpha_x * dot(tangent, wi), alpha_y * dot(bitangent, wi))
    stretched_o = (across_o[0] * across_o[0] + across_o[1] * across_o[1]) / (cos_o * cos_o)
    stretched_i = (across_i[0] * across_i[0] + across_i[1] * across_i[1]) / (cos_i * cos_i)
    x, y = x / alpha_x, y / alpha_y
    if model & IS_BECKMANN != 0:
        common *= beckmann_density(x, y, cos_h, alpha_squared)
        lambda_o = beckmann_lambda(stretched_o)
        masking = 1.0 + approximate_lambda(stretched_o) + approximate_lambda(stretched_i)
    else:
        slope = x * x + y * y + cos_h * cos_h
        common *= INV_PI / (alpha_squared * slope * slope)
        lambda_o = 0.5 * math.sqrt(1.0 + stretched_o) - 0.5
        masking = 0.5 + lambda_o + 0.5 * math.sqrt(1.0 + stretched_i)
    value = param[lane, i, ENERGY_SCALE] * common / masking
    pdf = common * branch_pmf / (1.0 + lambda_o)
    if is_refracted:
        return colors[4] * value, colors[5] * value, colors[6] * value, colors[7] * value, pdf
    return colors[0] * value, colors[1] * value, colors[2] * value, colors[3] * value, pdf


@kernel
def sample_facets(param, channels, lane, i, kind, n, wo, u0, u1, u2):
    """As the kernel SAMPLE of `linked.py`."""
    black = np.float32(0.0)
    if dot(n, wo) <= 0.0:
        return wo[0], wo[1], wo[2], np.float32(NO_SAMPLE), black, black, black, black, black
    address = address_of(param, lane, i)
    model = address & MODEL_MASK
    alpha_x, alpha_y = param[lane, i, ALPHA_X], param[lane, i, ALPHA_Y]
    is_delta = not alpha_x * alpha_y > DELTA_ALPHA_SQUARED
    h = n
    if not is_delta:
        tangent, bitangent = frame_of(param, lane, i, n)
        local_o = to_local(wo, tangent, bitangent, n)
        if model & IS_BECKMANN != 0:
            local = sample_beckmann_normal(local_o, alpha_x, alpha_y, u1, u2)
        else:
            local = sample_ggx_normal(local_o, alpha_x, alpha_y, u1, u2)
        h = to_world(local, tangent, bitangent, n)
    cos_ho = dot(h, wo)
    colors = facet_colors(param, channels, lane, i, address - model, kind, model, cos_ho)
    pmf = _reflection_pmf(colors)
    is_refracted = u0 >= pmf
    if is_refracted:
        pmf = 1.0 - pmf if pmf >= 0.0 else black
    along_h, along_wo = 2.0 * cos_ho, np.float32(1.0)
    if is_refracted:
        along_wo = 1.0 / param[lane, i, ETA]
        along_h = along_wo * cos_ho + colors[8]
        is_delta = is_delta or abs(along_wo - 1.0) < MIN_ETA_STEP
    wi = normalize(subtract(scale(h, along_h), scale(wo, along_wo)))
    if (dot(n, wi) < 0.0) != is_refracted or not pmf > 0.0:
        return wo[0], wo[1], wo[2], np.float32(NO_SAMPLE), black, black, black, black, black
    what = (REFRACTED if is_refracted else REFLECTED) | (IS_DELTA if is_delta else 0)
    if is_refracted:
        return wi[0], wi[1], wi[2], np.float32(what), pmf, colors[4], colors[5], colors[6], colors[7]
    return wi[0], wi[1], wi[2], np.float32(what), pmf, colors[0], colors[1], colors[2], colors[3]


@kernel
def albedo_of_facets(param, channels, data, lane, i, kind, wo):
    """As the kernel ALBEDO of `linked.py`: of a film and of n and k as if the surface were smooth (Cycles)."""
    address = address_of(param, lane, i)
    model = address & MODEL_MASK
    fresnel = model & FRESNEL_MASK
    n = read3(param, lane, i, CLOSURE_N)
    cos_o = dot(n, wo)
    colors = facet_colors(param, channels, lane, i, address - model, kind, model, cos_o)
    r0, r1, r2, r3 = colors[0], colors[1], colors[2], colors[3]
    has_table = (fresnel == SCHLICK or fresnel == F82) and not param[lane, i, FILM_THICKNESS] > LEAST_THICKNESS
    if has_table:
        roughness = math.sqrt(math.sqrt(param[lane, i, ALPHA_X] * param[lane, i, ALPHA_Y]))
        if fresnel == F82:
            blend = read_table(data, SCHLICK_BLEND, 16, cos_o, roughness)
        else:
            eta = param[lane, i, ETA]
            z = math.sqrt(abs((eta - 1.0) / (eta + 1.0)))
            blend = read_volume(data, FRESNEL_BLEND, 16, z, cos_o, roughness)
        as_f0 = SCHLICK | model & TINTS_MASK
        r0, _ = _tinted(param, channels, lane, i, 0, kind, as_f0, cos_o, blend, 0)
        r1, _ = _tinted(param, channels, lane, i, 0, kind, as_f0, cos_o, blend, 1)
        r2, _ = _tinted(param, channels, lane, i, 0, kind, as_f0, cos_o, blend, 2)
        if len(channels) > 3:
            r3, _ = _tinted(param, channels, lane, i, 0, kind, as_f0, cos_o, blend, 3)
    return r0, r1, r2, r3, colors[4], colors[5], colors[6], colors[7]


@kernel
def _is_black(color):
    return color[0] == 0.0 and color[1] == 0.0 and color[2] == 0.0


@kernel
def make_facets(closures, tables, lane, i, wo, model, thickness, film_ior):
    """As the kernel CHANGE of `linked.py`."""
    param = closures.param
    kind = closures.kind[lane, i]
    n = read3(param, lane, i, CLOSURE_N)
    if model < FACETS:
        # Ashikhmin and Shirley's lobe.
        closures.kind[lane, i] = LINKED_GLOSSY
        _keep_angle(param, lane, i, n)
        set_address(param, lane, i, tables.linked[SELF] | model)
        return read3(param, lane, i, CLOSURE_WEIGHT)
    fresnel = model & FRESNEL_MASK
    changed = LINKED_GLOSSY
    if kind == GLASS:
        changed, fresnel = LINKED_GLASS, SCHLICK
        reflection = read3(param, lane, i, REFLECTION_TINT)
        transmission = read3(param, lane, i, TRANSMISSION_TINT)
        if _is_black(transmission):
            model |= TINTS_REFLECTION
        elif _is_black(reflection):
            store_color(param, lane, i, TINT, transmission)
        else:
            is_same = reflection[0] == transmission[0] and reflection[1] == transmission[1]
            is_same = is_same and reflection[2] == transmission[2]
            model |= TINTS_BOTH if is_same else TINTS_NO_REFLECTION
            store_color(param, lane, i, TINT, transmission)
    elif kind == REFRACTION:
        changed = LINKED_REFRACTION
    elif kind == GLOSSY_SCHLICK:
        fresnel = SCHLICK
    elif kind == GLOSSY_F82 and fresnel != CONDUCTOR:
        fresnel = F82
    if changed == LINKED_GLOSSY:
        _keep_angle(param, lane, i, n)
    closures.kind[lane, i] = changed
    param[lane, i, FILM_THICKNESS] = thickness if thickness > LEAST_THICKNESS else np.float32(0.0)
    param[lane, i, FILM_IOR] = min(at_least(film_ior, 1e-5), 1e5)
    set_address(param, lane, i, tables.linked[SELF] | model | fresnel)
    albedo = albedo_of_facets(param, closures.channels, tables.data, lane, i, changed, wo)
    weight = read3(param, lane, i, CLOSURE_WEIGHT)
    share = average((albedo[0] + albedo[4], albedo[1] + albedo[5], albedo[2] + albedo[6]))
    # A film may reflect nothing straight on: what it does elsewhere is to be found all the same.
    param[lane, i, CLOSURE_SAMPLE_WEIGHT] = average(weight) * max(share, 0.01)
    return weight[0] * albedo[0], weight[1] * albedo[1], weight[2] * albedo[2]


@kernel
def _keep_angle(param, lane, i, n):
    """The direction of anisotropy as an angle; colours that lie where vectors did are not looked at."""
    angle = np.float32(0.0)
    if param[lane, i, ALPHA_X] != param[lane, i, ALPHA_Y]:
        first, second = orthonormal_basis(n)
        tangent = read3(param, lane, i, TANGENT)
        angle = math.atan2(dot(tangent, second), dot(tangent, first))
    param[lane, i, TANGENT_ANGLE] = angle


@kernel
def mean_of_metal(n, k):
    """`conductor_mean` of three channels."""
    return conductor_mean(n[0], k[0]), conductor_mean(n[1], k[1]), conductor_mean(n[2], k[2])
