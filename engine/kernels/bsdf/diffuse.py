# SPDX-License-Identifier: GPL-3.0-or-later
"""Lambert, Oren-Nayar and translucent lobes, and the closures that are no lobes."""

import math

import numpy as np

from engine.kernels.bsdf.closures import append_closure, average, store_color
from engine.kernels.bsdf.kinds import (
    DIFFUSE,
    OREN_A,
    OREN_B,
    OREN_MULTIPLE,
    OREN_NAYAR,
    TRANSLUCENT,
    TRANSPARENT,
    WEIGHT_CUTOFF,
)
from engine.kernels.constants import HALF_PI, INV_PI, PI
from engine.kernels.vector import dot
from engine.runtime.jit import kernel
from engine.state.lanes import CLOSURE_SAMPLE_WEIGHT, CLOSURE_WEIGHT

#: Roughness below which the Diffuse BSDF is Lambert's (Cycles).
MIN_DIFFUSE_ROUGHNESS = np.float32(1e-5)
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
def oren_nayar_multiple(albedo, mean, scale):
    """Colour of light that scattered more than once between facets, for one channel's albedo."""
    albedo = min(max(albedo, 0.0), 1.0)
    return scale * albedo * albedo / (1.0 - albedo * (1.0 - mean))


@kernel
def add_oren_nayar(closures, lane, weight, color, n, roughness):
    """Energy-preserving Oren-Nayar lobe.

    Parameters
    ----------
    weight, color : tuple of 3 float32
        Weight (colour included), and the colour alone, which saturates between bounces.
    roughness : float32
        sigma in [0, 1].

    References: Fujii 2012, "A tiny improvement of Oren-Nayar reflectance model"; OpenPBR specification 1.1.
    """
    i = append_closure(closures, lane, OREN_NAYAR, weight, n)
    if i >= 0:
        sigma = min(max(roughness, 0.0), 1.0)
        a = 1.0 / (PI + sigma * (HALF_PI - 2.0 / 3.0))
        b = sigma * a
        closures.param[lane, i, OREN_A] = a
        closures.param[lane, i, OREN_B] = b
        mean = a * PI + OREN_MEAN * b
        scale = INV_PI * mean / max(1.0 - mean, 1e-20)
        multiple = (
            oren_nayar_multiple(color[0], mean, scale),
            oren_nayar_multiple(color[1], mean, scale),
            oren_nayar_multiple(color[2], mean, scale),
        )
        store_color(closures.param, lane, i, OREN_MULTIPLE, multiple)


@kernel
def add_diffuse(closures, lane, weight, n, roughness, color=None):
    """Lobe of the Diffuse BSDF: Lambert at roughness 0, else `add_oren_nayar`.

    `weight` includes the colour. `color` is the colour alone, used between facets if rough; None = `weight`.
    """
    if roughness < MIN_DIFFUSE_ROUGHNESS:
        append_closure(closures, lane, DIFFUSE, weight, n)
    elif color is None:
        add_oren_nayar(closures, lane, weight, weight, n, roughness)
    else:
        add_oren_nayar(closures, lane, weight, color, n, roughness)


@kernel
def add_translucent(closures, lane, weight, n):
    """Lambert's lobe behind the surface; `n` as `ensure_valid_specular_reflection` returns it."""
    append_closure(closures, lane, TRANSLUCENT, weight, n)


@kernel
def add_transparent(closures, lane, weight):
    """Let light straight through; all transparent closures of a lane share one lobe."""
    sample_weight = abs(average(weight))
    if not (sample_weight >= WEIGHT_CUTOFF):
        return
    for c in range(3):
        closures.transparency[lane, c] += weight[c]
    for i in range(closures.count[lane]):
        if closures.kind[lane, i] == TRANSPARENT:
            for c in range(3):
                closures.param[lane, i, CLOSURE_WEIGHT + c] += weight[c]
            closures.param[lane, i, CLOSURE_SAMPLE_WEIGHT] += sample_weight
            return
    ns = closures.ns
    append_closure(closures, lane, TRANSPARENT, weight, (ns[lane, 0], ns[lane, 1], ns[lane, 2]))


@kernel
def add_holdout(closures, lane, weight):
    """Punch a hole into alpha: adds the mean weight to `Closures.holdout`."""
    closures.holdout[lane] += average(weight)


@kernel
def add_emission(closures, lane, weight):
    """Emit `weight` as radiance."""
    for c in range(3):
        closures.emission[lane, c] += weight[c]
