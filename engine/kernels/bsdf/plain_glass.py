# SPDX-License-Identifier: GPL-3.0-or-later
"""The Glass and Glossy BSDF of most materials: one roughness and one refractive index all over, whatever the colour.

What follows from these alone is computed once a program (`fold_glass`, `fold_glossy`), as for the Principled BSDF
(`plain_principled.py`): a column of the albedo tables is a piecewise linear function of the cosine. The lobes are those
of `glossy.add_glass` and `glossy.add_glossy`, but for rounding.
"""

from collections.abc import Sequence

import numpy as np

from engine.array_types import Float32Array
from engine.kernels.bsdf.closures import append_closure, store_color
from engine.kernels.bsdf.fresnel import f0_of_eta, interface_mean_blend
from engine.kernels.bsdf.kinds import (
    ALPHA_X,
    ALPHA_Y,
    CLOSURE_NO_REFLECTIVE_CAUSTICS,
    CLOSURE_NO_REFRACTIVE_CAUSTICS,
    ENERGY_SCALE,
    ETA,
    F0,
    F0_REAL,
    GLASS,
    GLOSSY,
    REFLECTION_TINT,
    TRANSMISSION_TINT,
)
from engine.kernels.bsdf.lookup import FRESNEL_BLEND, GLASS_ALBEDO, GLASS_MEAN, GLOSSY_ALBEDO, GLOSSY_MEAN
from engine.kernels.bsdf.microfacet import fresnel_blend
from engine.kernels.bsdf.normals import safe_normal, valid_specular_normal
from engine.kernels.bsdf.piecewise import interpolate, value_between
from engine.kernels.memory import read3
from engine.kernels.vector import dot
from engine.runtime.jit import in_python, kernel
from engine.state.lanes import CLOSURE_SAMPLE_WEIGHT, CLOSURE_WEIGHT

_BLENDS = 16
_ALBEDOS = 32

# Columns of what `fold_glass` returns, for either side one after the other.
_ALPHA = 0
_ETA = 1
_F0_REAL = 2
_F0 = 3
_MEAN_BLEND = 4  # of the Fresnel term over the hemisphere
_SINGLE_MEAN = 5  # albedo of single scattering over the hemisphere
_BLEND = 6  # from F0 to white, by cosine
_SINGLE = _BLEND + _BLENDS  # albedo of single scattering, by cosine
_SIDE = _SINGLE + _BLENDS

# Columns of what `fold_glossy` returns.
_GLOSSY_ALPHA = 0
_GLOSSY_MEAN = 1
_GLOSSY_SINGLE = 2
_GLOSSY_WIDTH = _GLOSSY_SINGLE + _ALBEDOS

_f0_of_eta, _mean_blend = in_python(f0_of_eta), in_python(interface_mean_blend)


def fold_glass(data: Float32Array, roughness: float, ior: float, *, is_multiple: bool) -> tuple[float, ...]:
    """What `run_plain_glass` reads.

    Parameters
    ----------
    data : float32, `BsdfTables.data`
    is_multiple : bool, whether light that is scattered repeatedly between facets counts
    """
    real, one = np.float32, np.float32(1.0)
    rough = real(min(max(roughness, 0.0), 1.0))
    outside = real(max(ior, 1e-5))
    folded = np.zeros(2 * _SIDE, real)
    blends = data[FRESNEL_BLEND : FRESNEL_BLEND + _BLENDS**3].reshape(_BLENDS, _BLENDS, _BLENDS)
    for first, eta in ((0, outside), (_SIDE, one / outside)):
        z = np.sqrt(abs((eta - one) / (eta + one)))
        side = folded[first : first + _SIDE]
        side[_ALPHA] = rough * rough
        side[_ETA] = eta
        side[_F0_REAL] = _f0_of_eta(eta)
        side[_F0] = min(max(_f0_of_eta(outside), 0.0), 1.0)
        side[_MEAN_BLEND] = _mean_blend(eta)
        side[_BLEND:_SINGLE] = value_between(value_between(blends, rough).T, z)
        side[_SINGLE_MEAN] = side[_SINGLE:] = 1.0
        if is_multiple:
            inside = 1 if eta < 1.0 else 0
            size = _BLENDS**3
            singles = data[GLASS_ALBEDO + inside * size : GLASS_ALBEDO + (inside + 1) * size]
            singles = singles.reshape(_BLENDS, _BLENDS, _BLENDS)
            side[_SINGLE:] = np.maximum(value_between(value_between(singles, rough).T, z), real(1e-6))
            size = _BLENDS**2
            means = data[GLASS_MEAN + inside * size : GLASS_MEAN + (inside + 1) * size].reshape(_BLENDS, _BLENDS)
            side[_SINGLE_MEAN] = value_between(value_between(means, rough), z)
    return tuple(float(x) for x in folded)


def fold_glossy(data: Float32Array, roughness: float, *, is_multiple: bool) -> tuple[float, ...]:
    """What `run_plain_glossy` reads; arguments as `fold_glass`."""
    rough = np.float32(min(max(roughness, 0.0), 1.0))
    folded = np.ones(_GLOSSY_WIDTH, np.float32)
    folded[_GLOSSY_ALPHA] = rough * rough
    if is_multiple:
        folded[_GLOSSY_MEAN] = value_between(data[GLOSSY_MEAN : GLOSSY_MEAN + _ALBEDOS], rough)
        singles = data[GLOSSY_ALBEDO : GLOSSY_ALBEDO + _ALBEDOS**2].reshape(_ALBEDOS, _ALBEDOS)
        folded[_GLOSSY_SINGLE:] = np.maximum(value_between(singles, rough), np.float32(1e-6))
    return tuple(float(x) for x in folded)


def alpha_of_glass(folded: Sequence[float]) -> float:
    """Alpha of the facets that `fold_glass` was told of."""
    return folded[_ALPHA]


def alpha_of_glossy(folded: Sequence[float]) -> float:
    """Alpha of the facets that `fold_glossy` was told of."""
    return folded[_GLOSSY_ALPHA]


@kernel
def _darken(param, lane, i, single, single_mean, fresnel):
    """Weigh a lobe for light that is scattered repeatedly, as `energy.finish_lobe` does; returns the mean factor.

    Parameters
    ----------
    single, single_mean : float32, albedo of single scattering, for this cosine and over the hemisphere
    fresnel : tuple of 3 float32, cosine-weighted mean of the Fresnel term
    """
    missing_mean = 1.0 - single_mean
    total = 0.0
    for c in range(3):
        bounces = fresnel[c] * single_mean / max(1.0 - fresnel[c] * missing_mean, 1e-2)
        # (1 + missing * bounces) / (1 + missing), where single is 1 / (1 + missing).
        darkening = single + (1.0 - single) * bounces
        param[lane, i, CLOSURE_WEIGHT + c] *= darkening
        total += darkening
    param[lane, i, ENERGY_SCALE] = 1.0 / single
    return total * (1.0 / 3.0)


@kernel(forceinline=True)
def run_plain_glass(closures, tables, lane, view, weight, memory, code, pc):
    """Instruction `weight, normal, color, folded`: GLASS with the inputs that `fold_glass` was given."""
    reflects = closures.flags[lane] & CLOSURE_NO_REFLECTIVE_CAUSTICS == 0
    refracts = closures.flags[lane] & CLOSURE_NO_REFRACTIVE_CAUSTICS == 0
    if not reflects and not refracts:
        return
    n = valid_specular_normal(closures, lane, view.ng, view.wo, safe_normal(read3(memory, code[pc + 3]), view.ns))
    color = read3(memory, code[pc + 4])
    side = code[pc + 5] + (_SIDE if view.is_backfacing else 0)
    i = append_closure(closures, lane, GLASS, (weight, weight, weight), n)
    if i < 0:
        return
    tint = (max(color[0], 0.0), max(color[1], 0.0), max(color[2], 0.0))
    black = (0.0, 0.0, 0.0)
    reflection = tint if reflects else black
    transmission = tint if refracts else black
    f0 = memory[side + _F0]
    param = closures.param
    store_color(param, lane, i, F0, (f0, f0, f0))
    store_color(param, lane, i, REFLECTION_TINT, reflection)
    store_color(param, lane, i, TRANSMISSION_TINT, transmission)
    param[lane, i, ALPHA_X] = memory[side + _ALPHA]
    param[lane, i, ALPHA_Y] = memory[side + _ALPHA]
    param[lane, i, ETA] = memory[side + _ETA]
    param[lane, i, ENERGY_SCALE] = 1.0
    param[lane, i, F0_REAL] = memory[side + _F0_REAL]
    cos_o = dot(n, view.wo)
    refracted, _ = fresnel_blend(param, lane, i, GLASS, cos_o)
    reflectance = f0 + (1.0 - f0) * interpolate(memory, side + _BLEND, _BLENDS, cos_o)
    transmittance = (1.0 - f0) * (1.0 - refracted)
    total = 0.0
    for c in range(3):
        total += reflectance * reflection[c] + transmittance * transmission[c]
    single = interpolate(memory, side + _SINGLE, _BLENDS, cos_o)
    if single != 1.0:
        # Most of the colour is the transmitted light's.
        fresnel = transmission
        if transmission[0] == 0.0 and transmission[1] == 0.0 and transmission[2] == 0.0:
            mean = f0 + (1.0 - f0) * memory[side + _MEAN_BLEND]
            fresnel = (mean * reflection[0], mean * reflection[1], mean * reflection[2])
        total *= _darken(param, lane, i, single, memory[side + _SINGLE_MEAN], fresnel)
    param[lane, i, CLOSURE_SAMPLE_WEIGHT] = weight * total * (1.0 / 3.0)


@kernel(forceinline=True)
def run_plain_glossy(closures, tables, lane, view, weight, memory, code, pc):
    """Instruction `weight, normal, color, folded`: GLOSSY, isotropic, with the inputs that `fold_glossy` was given."""
    if closures.flags[lane] & CLOSURE_NO_REFLECTIVE_CAUSTICS != 0:
        return
    n = valid_specular_normal(closures, lane, view.ng, view.wo, safe_normal(read3(memory, code[pc + 3]), view.ns))
    color = read3(memory, code[pc + 4])
    folded = code[pc + 5]
    i = append_closure(closures, lane, GLOSSY, (weight * color[0], weight * color[1], weight * color[2]), n)
    if i < 0:
        return
    param = closures.param
    param[lane, i, ALPHA_X] = memory[folded + _GLOSSY_ALPHA]
    param[lane, i, ALPHA_Y] = memory[folded + _GLOSSY_ALPHA]
    param[lane, i, ETA] = 1.0
    param[lane, i, ENERGY_SCALE] = 1.0
    param[lane, i, F0_REAL] = 0.0
    single = interpolate(memory, folded + _GLOSSY_SINGLE, _ALBEDOS, dot(n, view.wo))
    if single != 1.0:
        fresnel = (max(color[0], 0.0), max(color[1], 0.0), max(color[2], 0.0))
        param[lane, i, CLOSURE_SAMPLE_WEIGHT] *= _darken(
            param, lane, i, single, memory[folded + _GLOSSY_MEAN], fresnel
        )
