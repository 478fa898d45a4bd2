# SPDX-License-Identifier: GPL-3.0-or-later
"""Oren-Nayar lobes that keep the energy, by Fujii's model."""

import math

import numpy as np

from engine.kernels.bsdf.closures import append_closure, store_color
from engine.kernels.bsdf.lobe import Lobe
from engine.kernels.bsdf.warp import sample_cosine
from engine.kernels.constants import HALF_PI, INV_PI, PI
from engine.kernels.limits import clamp_unit
from engine.kernels.vector import dot
from engine.runtime.jit import kernel
from engine.state.lanes import CLOSURE_KIND_PARAMS, CLOSURE_WEIGHT

OREN_NAYAR = 2

# Columns of Closures.param.
OREN_A = CLOSURE_KIND_PARAMS + 1
OREN_B = CLOSURE_KIND_PARAMS + 2
OREN_MULTIPLE = CLOSURE_KIND_PARAMS + 3  # 4 channels

#: Mean albedo of the sigma-dependent term: (2 pi - 5.6) / 3.
OREN_MEAN = np.float32((2.0 * math.pi - 5.6) / 3.0)


@kernel
def oren_nayar_g(cos_theta):
    """Directional albedo of the sigma-dependent term of Fujii's model, per unit B, as a function of the angle.

    References: OpenPBR specification 1.1, energy-preserving Oren-Nayar (E_F of Fujii's model).
    """
    if cos_theta < 1e-6:
        return (HALF_PI - 2.0 / 3.0) - cos_theta
    cos_theta = min(cos_theta, 1.0)
    sin_theta = math.sqrt(1.0 - cos_theta * cos_theta)
    return sin_theta * (math.acos(cos_theta) - 2.0 / 3.0 - sin_theta * cos_theta) + (2.0 / 3.0) * (
        sin_theta / cos_theta
    ) * (1.0 - sin_theta * sin_theta * sin_theta)


@kernel
def oren_nayar_f_cos(param, lane, i, n, wo, wi, cos_i):
    """Single scattering times cosine, and the factor on the OREN_MULTIPLE colour, for `cos_i` = n.wi > 0."""
    a = param[lane, i, OREN_A]
    b = param[lane, i, OREN_B]
    cos_o = max(dot(n, wo), 0.0)
    t = dot(wi, wo) - cos_i * cos_o
    if t > 0.0:
        t /= max(cos_i, cos_o)
    missing_i = 1.0 - (a * PI + b * oren_nayar_g(cos_i))
    missing_o = 1.0 - (a * PI + b * oren_nayar_g(cos_o))
    return cos_i * (a + b * t), cos_i * missing_i * missing_o


@kernel
def oren_nayar_multiple(albedo, mean, scale, tints_by_bounce):
    """Colour, over the lobe's weight, of light that scattered repeatedly between facets; by one channel's albedo."""
    albedo = min(max(albedo, 0.0), 1.0)
    first = albedo if tints_by_bounce else albedo * albedo
    return scale * first / (1.0 - albedo * (1.0 - mean))


@kernel
def add_oren_nayar(closures, lane, weight, color, n, roughness, tints_by_bounce):
    """Energy-preserving Oren-Nayar lobe.

    Parameters
    ----------
    weight, color : tuple of 3 float32
        Weight (colour included), and the colour alone, which saturates between bounces.
    roughness : float32
        sigma in [0, 1].
    tints_by_bounce : int or bool
        Whether light that two facets scatter has the colour twice, as from Blender 5.3 on; before, it had it thrice.

    References: Fujii 2012, "A tiny improvement of Oren-Nayar reflectance model"; OpenPBR specification 1.1.
    """
    i = append_closure(closures, lane, OREN_NAYAR, weight, n)
    if i >= 0:
        sigma = clamp_unit(roughness)
        a = 1.0 / (PI + sigma * (HALF_PI - 2.0 / 3.0))
        b = sigma * a
        closures.param[lane, i, OREN_A] = a
        closures.param[lane, i, OREN_B] = b
        mean = a * PI + OREN_MEAN * b
        scale = INV_PI * mean / max(1.0 - mean, 1e-20)
        multiple = (
            oren_nayar_multiple(color[0], mean, scale, tints_by_bounce),
            oren_nayar_multiple(color[1], mean, scale, tints_by_bounce),
            oren_nayar_multiple(color[2], mean, scale, tints_by_bounce),
        )
        store_color(closures.param, lane, i, OREN_MULTIPLE, multiple)


@kernel
def eval_oren_nayar(param, channels, lane, i, n, wo, wi, factor, out, row):
    """See `Lobe.evaluate`."""
    cos_i = dot(n, wi)
    if cos_i <= 0.0:
        return 0.0
    single, multiple = oren_nayar_f_cos(param, lane, i, n, wo, wi, cos_i)
    for c in range(len(channels)):
        f_cos = single + multiple * param[lane, i, OREN_MULTIPLE + c]
        out[row, c] += param[lane, i, CLOSURE_WEIGHT + c] * f_cos * factor
    return cos_i * INV_PI


LOBE = Lobe(OREN_NAYAR, eval_oren_nayar, sample_cosine, colors=(OREN_MULTIPLE,))
