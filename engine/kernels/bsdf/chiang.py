# SPDX-License-Identifier: GPL-3.0-or-later
"""The Principled Hair BSDF of Chiang: a rough fibre of glass, with light that is reflected, passes, or is reflected
inside.

References
----------
Chiang, Bitterli, Tappan and Burley 2016, "A Practical and Controllable Hair and Fur Model for Production Path Tracing";
d'Eon et al. 2011, "An Energy-Conserving Hair Reflectance Model", for the distribution along the fibre.
"""

import math

import numpy as np

from engine.kernels.bsdf.closures import append_closure, read3, store_color
from engine.kernels.bsdf.fibre_color import absorption, color_fit, passed_along_radius
from engine.kernels.bsdf.fresnel import fresnel_dielectric
from engine.kernels.bsdf.hair import HAIR_TANGENT, fibre_tangent, safe_asin
from engine.kernels.bsdf.kinds import CHIANG, CHIANG_WIDTHS
from engine.kernels.bsdf.lobe import HairLobe
from engine.kernels.constants import PI
from engine.kernels.memory import read3 as read_operand
from engine.kernels.vector import add, cross, dot, normalize, scale
from engine.runtime.jit import kernel
from engine.state.lanes import CLOSURE_KIND_PARAMS, CLOSURE_WEIGHT

# Columns of Closures.param, behind the tangent.
_V, _V_FIRST, _S = CHIANG_WIDTHS, CHIANG_WIDTHS + 1, CHIANG_WIDTHS + 2
_ALPHA = CLOSURE_KIND_PARAMS + 7  # tilt of the scales [rad]
_ETA = CLOSURE_KIND_PARAMS + 8
_H = CLOSURE_KIND_PARAMS + 9  # where across the fibre the ray meets it, -1 to 1
#: What a fibre lets through along its radius: exp(-absorption), a colour.
_PASSED = CLOSURE_KIND_PARAMS + 10

_TWO_PI = np.float32(2.0 * math.pi)
_INV_TWO_PI = np.float32(0.5 / math.pi)
_SQRT_PI_8 = np.float32(math.sqrt(math.pi / 8.0))
_LOG_2_PI = np.float32(math.log(2.0 * math.pi))
_LN_2 = np.float32(math.log(2.0))


@kernel
def cos_of(sine):
    """Cosine, not negative, of an angle of this sine."""
    return math.sqrt(max(1.0 - sine * sine, 0.0))


@kernel
def _variance(x):
    """Variance along the fibre by roughness (Chiang et al. 2016, equation 7)."""
    x2 = x * x
    x5 = x2 * x2 * x
    x20 = x5 * x5 * x5 * x5
    root = 0.726 * x + 0.812 * x2 + 3.7 * x20
    return root * root


@kernel
def _logistic_scale(x):
    """Scale of the logistic distribution by roughness (equation 8)."""
    x2 = x * x
    x11 = x2 * x2 * x2 * x2 * x2 * x
    return (0.265 * x + 1.194 * x2 + 5.372 * x11 * x11) * _SQRT_PI_8


@kernel(forceinline=True)
def run_chiang(closures, tables, lane, view, weight, memory, code, pc):
    """Instruction `weight, color or absorption, tint, melanin, redness, its randomness, roughness along, around, its
    randomness, coat, offset, ior, random, edge | FIBRE_*`; the edge is of the triangle that is no strand.
    """
    random = 2.0 * (memory[code[pc + 14]] - 0.5)
    varied = 1.0 + random * memory[code[pc + 10]]
    along, around = memory[code[pc + 8]] * varied, memory[code[pc + 9]] * varied
    sigma = absorption(code[pc + 16], memory, code, pc, random, around)
    i = append_closure(closures, lane, CHIANG, (weight, weight, weight), view.ns)
    if i < 0:
        return
    param = closures.param
    along, around = min(max(along, 0.001), 1.0), min(max(around, 0.001), 1.0)
    first = min(max((1.0 - min(max(memory[code[pc + 11]], 0.0), 1.0)) * along, 0.001), 1.0)
    x = fibre_tangent(view, read_operand(memory, code[pc + 15]))
    y = normalize(cross(x, view.wo))
    param[lane, i, _V] = _variance(along)
    param[lane, i, _V_FIRST] = _variance(first)
    param[lane, i, _S] = _logistic_scale(around)
    param[lane, i, _ALPHA] = -memory[code[pc + 12]]
    param[lane, i, _ETA] = max(memory[code[pc + 13]], 1.0 + 1e-4)
    param[lane, i, _H] = min(max(dot(cross(view.ng, x), normalize(cross(x, y))), -1.0), 1.0)
    store_color(param, lane, i, _PASSED, passed_along_radius(sigma))
    for k in range(3):
        param[lane, i, HAIR_TANGENT + k] = x[k]


@kernel
def _log_bessel(x):
    """Logarithm of the modified Bessel function of the first kind, order 0."""
    if x > 12.0:
        # One term more than Cycles has, whose lobes lose up to half a percent there.
        return x + 0.125 / x - 0.5 * (_LOG_2_PI + math.log(x))
    square = 0.25 * x * x
    term = 1.0 + 0.0 * x
    total = term
    for k in range(1, 22):
        order = np.float32(k)
        term *= square / (order * order)
        total += term
    return math.log(total)


@kernel
def longitudinal(sin_i, cos_i, sin_o, cos_o, v):
    """Distribution along the fibre, over the sphere (d'Eon et al. 2011, equation 7)."""
    inverse = 1.0 / v
    log_bessel = _log_bessel(cos_i * cos_o * inverse)
    sine = sin_i * sin_o * inverse
    if v <= 0.1:
        return math.exp(log_bessel - sine - inverse + _LN_2 + math.log(0.5 * inverse))
    return math.exp(log_bessel - sine) / (2.0 * math.sinh(inverse) * v)


@kernel
def sample_longitudinal(sin_o, cos_o, v, u0, u1):
    """Sine of an angle to the normal plane that `longitudinal` is the distribution of."""
    u0 = min(max(u0, 1e-5), 1.0)
    fac = 1.0 + v * math.log(u0 + (1.0 - u0) * math.exp(-2.0 / v))
    return min(max(-fac * sin_o + cos_of(fac) * math.cos(_TWO_PI * u1) * cos_o, -1.0), 1.0)


@kernel
def _logistic_cdf(x, s):
    return 1.0 / (1.0 + math.exp(min(-x / s, 80.0)))


@kernel
def _around(phi, p, s, gamma_o, gamma_t):
    """Distribution around the fibre: a logistic one within a turn, about where a smooth fibre sends light."""
    x = phi - (2.0 * p * gamma_t - 2.0 * gamma_o + p * PI)
    x -= _TWO_PI * math.floor((x + PI) / _TWO_PI)
    e = math.exp(-abs(x) / s)
    return e / (s * (1.0 + e) * (1.0 + e)) / (1.0 - 2.0 * _logistic_cdf(-PI, s))


@kernel
def _tilted(sin_o, cos_o, alpha, p):
    """Sine and cosine of the viewer's angle, by what the scales tilt light of the order p."""
    turn = -2.0 * alpha if p == 0 else (alpha if p == 1 else 4.0 * alpha)
    if p > 2:
        turn = 0.0 * alpha
    sine, cosine = math.sin(turn), math.cos(turn)
    return sin_o * cosine + cos_o * sine, abs(cos_o * cosine - sin_o * sine)


@kernel
def _variance_of(param, lane, i, p):
    if p == 0:
        return param[lane, i, _V_FIRST]
    return param[lane, i, _V] * (0.25 if p == 1 else 4.0)


@kernel
def _geometry(param, lane, i, sin_o, cos_o):
    """Angles of a ray outside and inside, the share that is reflected, and how far it goes inside, in radii."""
    eta, h = param[lane, i, _ETA], param[lane, i, _H]
    cos_t = cos_of(sin_o / eta)
    gamma_t = safe_asin(h * cos_o / math.sqrt(eta * eta - sin_o * sin_o))
    reflected, _ = fresnel_dielectric(cos_o * cos_of(h), eta)
    return safe_asin(h), gamma_t, reflected, 2.0 * math.cos(gamma_t) / cos_t


@kernel
def _share(passed, reflected, p):
    """What of a channel leaves a smooth fibre by the order p: R, TT, TRT and all the rest."""
    through = (1.0 - reflected) * (1.0 - reflected) * passed
    if p == 0:
        return reflected
    if p == 1:
        return through
    if p == 2:
        return through * passed * reflected
    again = passed * reflected
    return through * again * again / max(1.0 - again, 1e-6)


@kernel
def _energy(param, channels, lane, i, reflected, way, p):
    """Mean of `_share` over the channels."""
    total = 0.0
    for c in range(len(channels)):
        total += _share(param[lane, i, _PASSED + c] ** way, reflected, p)
    return total / np.float32(len(channels))


@kernel
def _frame(param, lane, i, wo):
    """The fibre's axes: along it, across to the viewer, and towards the viewer's opposite."""
    x = read3(param, lane, i, HAIR_TANGENT)
    y = normalize(cross(x, wo))
    return x, y, normalize(cross(x, y))


@kernel
def eval_chiang(param, channels, lane, i, n, wo, wi, factor, out, row):
    """See `Lobe.evaluate`."""
    x, y, z = _frame(param, lane, i, wo)
    sin_o, sin_i = dot(wo, x), dot(wi, x)
    cos_o, cos_i = cos_of(sin_o), cos_of(sin_i)
    gamma_o, gamma_t, reflected, way = _geometry(param, lane, i, sin_o, cos_o)
    phi = math.atan2(dot(wi, z), dot(wi, y)) - math.atan2(dot(wo, z), dot(wo, y))
    whole, pdf = 0.0, 0.0
    for p in range(4):
        whole += _energy(param, channels, lane, i, reflected, way, p)
    if not whole > 0.0:
        return 0.0
    for p in range(4):
        sin_p, cos_p = _tilted(sin_o, cos_o, param[lane, i, _ALPHA], p)
        lobe = longitudinal(sin_i, cos_i, sin_p, cos_p, _variance_of(param, lane, i, p))
        if p < 3:
            lobe *= _around(phi, np.float32(p), param[lane, i, _S], gamma_o, gamma_t)
        else:
            lobe *= _INV_TWO_PI
        pdf += lobe * _energy(param, channels, lane, i, reflected, way, p) / whole
        for c in range(len(channels)):
            share = _share(param[lane, i, _PASSED + c] ** way, reflected, p)
            out[row, c] += param[lane, i, CLOSURE_WEIGHT + c] * lobe * share * factor
    return pdf


@kernel
def sample_chiang(param, channels, lane, i, wo, u0, u1, u2):
    """See `HairLobe.sample`."""
    x, y, z = _frame(param, lane, i, wo)
    sin_o = dot(wo, x)
    cos_o = cos_of(sin_o)
    gamma_o, gamma_t, reflected, way = _geometry(param, lane, i, sin_o, cos_o)
    whole = 0.0
    for p in range(4):
        whole += _energy(param, channels, lane, i, reflected, way, p)
    left = u0 * whole
    order = 0
    energy = _energy(param, channels, lane, i, reflected, way, 0)
    while order < 3 and left >= energy:
        left -= energy
        order += 1
        energy = _energy(param, channels, lane, i, reflected, way, order)
    v = _variance_of(param, lane, i, order)
    sin_p, cos_p = _tilted(sin_o, cos_o, param[lane, i, _ALPHA], order)
    sin_i = sample_longitudinal(sin_p, cos_p, v, left / max(energy, 1e-30), u2)
    cos_i = cos_of(sin_i)
    phi = math.atan2(dot(wo, z), dot(wo, y))
    if order < 3:
        s = param[lane, i, _S]
        least = _logistic_cdf(-PI, s)
        q = min(max(u1 * (1.0 - 2.0 * least) + least, 1e-30), 1.0)
        at = -s * math.log(max(1.0 / q - 1.0, 1e-30))
        p = np.float32(order)
        phi += min(max(at, -PI), PI) + 2.0 * p * gamma_t - 2.0 * gamma_o + p * PI
    else:
        phi += _TWO_PI * u1
    across = add(scale(y, math.cos(phi)), scale(z, math.sin(phi)))
    return normalize(add(scale(across, cos_i), scale(x, sin_i)))


@kernel
def chiang_roughness(param, lane, i):
    """As Cycles gives it: the variance of what is reflected first."""
    return param[lane, i, _V_FIRST]


@kernel
def chiang_albedo(param, lane, i, wo, c):
    """As Cycles gives it: the colour of many such fibres by the variance along them, and what is reflected first."""
    sin_o, h = dot(read3(param, lane, i, HAIR_TANGENT), wo), param[lane, i, _H]
    reflected, _ = fresnel_dielectric(cos_of(sin_o) * cos_of(h), param[lane, i, _ETA])
    sigma = -math.log(max(param[lane, i, _PASSED + c], 1e-30))
    return math.exp(-math.sqrt(max(sigma, 0.0)) * color_fit(param[lane, i, _V])) + reflected


LOBE = HairLobe(CHIANG, eval_chiang, sample_chiang, chiang_roughness, chiang_albedo, (_PASSED,))
