# SPDX-License-Identifier: GPL-3.0-or-later
"""Mixtures of normalised anisotropic spherical Gaussians (NASG) from a network's outputs.

A lobe with axes x, y, z has the density, with g = (1 + v.z) / 2, L = log g and q = a (v.x)^2 / (1 - (v.z)^2),

    exp(2 lambda (g^(1 + q) - 1)) g^q / K = sqrt(1 + a) / (4 pi spread(lambda)) exp(2 lambda expm1((1 + q) L) + q L)

so with a = 0 it is a von Mises-Fisher lobe. All depends on d = v - z (or v + z, whichever is shorter): 1 - g, g, q and
log g follow from |d|^2 and d.x without cancellation, in the narrowest lobes too.

At v = z the density is 1 / K. At v = -z it has no limit: along the meridian at azimuth phi it falls to 0 like
g^(a cos(phi)^2), but to exp(-2 lambda) / K where cos(phi) = 0. (Appendix A of the paper adds an epsilon to q, for a
limit of 0 everywhere; in float32 the factor g^epsilon is 1 until far below the rounding of v.) Here g is held above
LEAST_GAP, in logarithm and azimuth alike, and the value at -z itself is exp(-2 lambda) / K: samples that round to -z
have a density.

Outputs of a lobe, raw and unbounded, in the order of the NASG_* columns:

==========================  ====================================================================================
logit                       as in `engine.guiding.neural.networks.lobes.vmf`
logarithm of lambda         clamped like that of kappa
logarithm of a              clamped to [LOG_A_LOW, LOG_A_HIGH]
cos theta                   2 sigmoid - 1 = tanh(output / 2)
sin phi, cos phi            the same each, then normalised as a pair; (0, 1) if shorter than the root of LEAST_PAIR
sin tau, cos tau            likewise
==========================  ====================================================================================

A lobe with a NaN among its outputs is uniform, with a logit of 0. `engine.guiding.neural.worker.lobes` decodes
likewise.

References
----------
Huang et al. 2024, "Online Neural Path Guiding with Normalized Anisotropic Spherical Gaussians", Eqs. (10) to (13),
table 2, appendices A to C. The paper does not say how its pairs of sine and cosine come to unit length.
"""

import math

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from engine.array_types import Float32Array, Int32Array
from engine.guiding.fields.vmm.numeric import spread
from engine.guiding.fields.vmm.query import EVEN_SHARE
from engine.guiding.neural.networks.lobes.vmf import (
    LOG_KAPPA_HIGH,
    LOG_KAPPA_LOW,
    LOGIT_HIGH,
    LOGIT_LOW,
    exp_clamped,
    turn,
    valid_fluence,
)
from engine.kernels.constants import INV_FOUR_PI, ONE_MINUS_EPSILON
from engine.kernels.exponential import exp_nonpositive
from engine.kernels.vector import cross
from engine.runtime.bundle import Bundle
from engine.runtime.jit import kernel

#: Outputs a lobe.
NASG_OUTPUTS = 8
# Columns of a lobe's outputs
NASG_LOGIT = 0
NASG_LOG_LAMBDA = 1
NASG_LOG_A = 2
NASG_COS_THETA = 3
NASG_SIN_PHI = 4
NASG_COS_PHI = 5
NASG_SIN_TAU = 6
NASG_COS_TAU = 7

LOG_LAMBDA_LOW = LOG_KAPPA_LOW
LOG_LAMBDA_HIGH = LOG_KAPPA_HIGH
#: Up to 33 times as long as wide.
LOG_A_LOW = np.float32(-10.0)
LOG_A_HIGH = np.float32(7.0)
#: Squared length below which a pair of sine and cosine says nothing.
LEAST_PAIR = np.float32(1e-8)
#: g is held above: |cos| < 1 - 2^-23, the last float32 below 1.
LEAST_GAP = np.float32(2.0**-24)
#: |v - z|^2 / 4 is held above where the azimuth is asked for; there it does not matter.
LEAST_SQUARED = np.float32(1e-20)

# Rows of NasgLobes.lobes
NASG_COEFFICIENT = 0
NASG_LAMBDA = 1
NASG_A = 2
NASG_Z = 3
NASG_X = 6
NASG_WEIGHT = 9
NASG_ROWS = 10

_LN_2 = np.float32(math.log(2.0))


class NasgLobes(Bundle):
    """Mixtures ready for sampling at given points, L lanes.

    lobes : float32 (L, NASG_ROWS, K), K a multiple of 8: coefficient (weight times the density at the lobe's centre)
        [sr^-1], lambda, a, axes z and x (unit, orthogonal, world; three rows each), weight; unused lobes are 0
    count : int32 (L,), lobes to look at, a multiple of 8
    fluence : float32 (L,), incident radiance (mean over channels) integrated over all directions
    """

    lobes: Float32Array
    count: Int32Array
    fluence: Float32Array


def allocate_nasg(lane_count: int, lobe_count: int = 8) -> NasgLobes:
    """Zeroed `NasgLobes` of `lane_count` lanes with room for `lobe_count` lobes each."""
    return NasgLobes(
        np.zeros((lane_count, NASG_ROWS, (lobe_count + 7) & ~7), np.float32),
        np.zeros(lane_count, np.int32),
        np.zeros(lane_count, np.float32),
    )


@intrinsic
def _split(typing_context, x):
    """Exponent and rest of a float32 x > 0: x = 2**exponent * (1 + rest), 1 + rest in [sqrt(1/2), sqrt(2))."""

    def codegen(context, builder, signature, arguments):
        word = ir.IntType(32)
        bits = builder.bitcast(arguments[0], word)
        # What lies above the bits of sqrt(1/2), in whole exponents.
        exponent = builder.ashr(builder.sub(bits, ir.Constant(word, 0x3F3504F3)), ir.Constant(word, 23))
        mantissa = builder.bitcast(builder.sub(bits, builder.shl(exponent, ir.Constant(word, 23))), ir.FloatType())
        rest = builder.fsub(mantissa, ir.Constant(ir.FloatType(), 1.0))
        return cgutils.pack_array(builder, [builder.sitofp(exponent, ir.FloatType()), rest])

    return types.UniTuple(types.float32, 2)(types.float32), codegen


@kernel
def _log_complement(g, h):
    """log(g), given h = 1 - g too, g in [LEAST_GAP, 1]: relative error below 3e-7, next to g = 1 too.

    With s = f / (2 + f), log(1 + f) = 2 atanh(s); the polynomial is a minimax fit of what atanh has beyond s.
    """
    exponent, rest = _split(g)
    f = -h if exponent == 0.0 else rest
    s = f / (2.0 + f)
    squared = s * s
    p = 0.1479329913854599 * squared + 0.19994312524795532
    p = p * squared + 0.33333343267440796
    return 2.0 * (s + s * squared * p) + exponent * _LN_2


@kernel
def _expm1_nonpositive(x):
    """exp(x) - 1 for x <= 0, relative error below 6e-7; the polynomial is a minimax fit over [-1/2, 0]."""
    p = 0.001121634733863175 * x + 0.008187386207282543
    p = p * x + 0.041629090905189514
    p = p * x + 0.16666224598884583
    p = p * x + 0.4999998211860657
    near = x + x * x * p
    return near if x > -0.5 else exp_nonpositive(x) - 1.0


@kernel
def _tanh_half(x):
    """tanh(x / 2) = 2 sigmoid(x) - 1, precise next to 0."""
    e = _expm1_nonpositive(-abs(x))
    tanh = e / (2.0 + e)
    return tanh if x < 0.0 else -tanh


@kernel
def _unit_pair(sine, cosine):
    """Sine and cosine in their ratio, squares adding up to 1; (0, 1) if there is no ratio."""
    squared = sine * sine + cosine * cosine
    is_none = squared < LEAST_PAIR
    inverse_length = 1.0 / math.sqrt(1.0 if is_none else squared)
    return 0.0 if is_none else sine * inverse_length, 1.0 if is_none else cosine * inverse_length


@kernel
def decode_nasg(raw, row, first, lobe_count, guide, lane, fluence):
    """Write the mixture that a row of outputs stands for into a lane of `guide`.

    Parameters
    ----------
    raw : float32 (N, W), a network's outputs, whatever they are
    row : int
    first : int
        Column of the first lobe's outputs; lobe k's begin at `first + k * NASG_OUTPUTS`.
    lobe_count : int, 1 to what `guide` has room for
    guide : NasgLobes
    lane : int
    fluence : float32, incident radiance (mean over channels) integrated over all directions, for `predict_nasg`
    """
    count = (lobe_count + 7) & ~7
    total = np.float32(0.0)
    for k in range(count):
        column = first + min(k, lobe_count - 1) * NASG_OUTPUTS
        is_nan = False
        for output in range(NASG_OUTPUTS):
            is_nan = is_nan or raw[row, column + output] != raw[row, column + output]
        is_used = k < lobe_count
        raw_theta = 0.0 if is_nan else raw[row, column + NASG_COS_THETA]
        # tanh(x / 2), and 1 / cosh(x / 2) without the square root of its cancellation.
        cos_theta = _tanh_half(raw_theta)
        e = exp_nonpositive(-0.5 * abs(raw_theta))
        sin_theta = 2.0 * e / (1.0 + e * e)
        sin_phi, cos_phi = _unit_pair(
            0.0 if is_nan else _tanh_half(raw[row, column + NASG_SIN_PHI]),
            0.0 if is_nan else _tanh_half(raw[row, column + NASG_COS_PHI]),
        )
        sin_tau, cos_tau = _unit_pair(
            0.0 if is_nan else _tanh_half(raw[row, column + NASG_SIN_TAU]),
            0.0 if is_nan else _tanh_half(raw[row, column + NASG_COS_TAU]),
        )
        sharpness = 0.0 if is_nan else exp_clamped(raw[row, column + NASG_LOG_LAMBDA], LOG_LAMBDA_LOW, LOG_LAMBDA_HIGH)
        a = 0.0 if is_nan else exp_clamped(raw[row, column + NASG_LOG_A], LOG_A_LOW, LOG_A_HIGH)
        weight = exp_clamped(0.0 if is_nan else raw[row, column + NASG_LOGIT], LOGIT_LOW, LOGIT_HIGH)
        weight = weight if is_used else 0.0
        guide.lobes[lane, NASG_LAMBDA, k] = sharpness if is_used else 0.0
        guide.lobes[lane, NASG_A, k] = a if is_used else 0.0
        # Eq. (13)
        guide.lobes[lane, NASG_Z, k] = cos_phi * sin_theta if is_used else 0.0
        guide.lobes[lane, NASG_Z + 1, k] = sin_phi * sin_theta if is_used else 0.0
        guide.lobes[lane, NASG_Z + 2, k] = cos_theta if is_used else 0.0
        guide.lobes[lane, NASG_X, k] = cos_theta * cos_phi * cos_tau - sin_phi * sin_tau if is_used else 0.0
        guide.lobes[lane, NASG_X + 1, k] = cos_theta * sin_phi * cos_tau + cos_phi * sin_tau if is_used else 0.0
        guide.lobes[lane, NASG_X + 2, k] = -sin_theta * cos_tau if is_used else 0.0
        guide.lobes[lane, NASG_WEIGHT, k] = weight
        # Eq. (12)
        guide.lobes[lane, NASG_COEFFICIENT, k] = weight * INV_FOUR_PI * math.sqrt(1.0 + a) / spread(sharpness)
        total += weight
    scale = 1.0 / total
    for k in range(count):
        guide.lobes[lane, NASG_WEIGHT, k] *= scale
        guide.lobes[lane, NASG_COEFFICIENT, k] *= scale
    guide.count[lane] = count
    guide.fluence[lane] = valid_fluence(fluence)


@kernel
def eval_nasg(guide, lane, wi):
    """Density of `sample_nasg` at unit direction wi: float32 [sr^-1], 0 if wi is NaN.

    References
    ----------
    Huang et al. 2024, Eqs. (10) and (12).
    """
    pdf = np.float32(0.0)
    for k in range(guide.count[lane]):
        z_x = guide.lobes[lane, NASG_Z, k]
        z_y = guide.lobes[lane, NASG_Z + 1, k]
        z_z = guide.lobes[lane, NASG_Z + 2, k]
        is_front = wi[0] * z_x + wi[1] * z_y + wi[2] * z_z >= 0.0
        sign = 1.0 if is_front else -1.0
        x = wi[0] - sign * z_x
        y = wi[1] - sign * z_y
        z = wi[2] - sign * z_z
        squared = 0.25 * (x * x + y * y + z * z)
        along = (
            x * guide.lobes[lane, NASG_X, k]
            + y * guide.lobes[lane, NASG_X + 1, k]
            + z * guide.lobes[lane, NASG_X + 2, k]
        )
        # The shorter and the longer one of g and 1 - g.
        short = max(squared, LEAST_SQUARED if is_front else LEAST_GAP)
        long = 1.0 - short
        q = guide.lobes[lane, NASG_A, k] * min(along * along / (4.0 * short * long), 1.0)
        log_g = _log_complement(long if is_front else short, short if is_front else long)
        decay = 2.0 * guide.lobes[lane, NASG_LAMBDA, k] * _expm1_nonpositive((1.0 + q) * log_g) + q * log_g
        pdf += guide.lobes[lane, NASG_COEFFICIENT, k] * exp_nonpositive(decay)
    return pdf if pdf >= 0.0 else np.float32(0.0)


@kernel
def sample_nasg(guide, lane, u0, u1, u2):
    """Draw a unit direction from a lane of `guide`: float32 tuple.

    Parameters
    ----------
    guide : NasgLobes
    lane : int
    u0, u1, u2 : float32 in [0, 1): which lobe, how far from its centre, which way

    References
    ----------
    Huang et al. 2024, appendix C; its two hemispheres are the two halves of u2 here.
    """
    chosen = 0
    left = u0
    for k in range(guide.count[lane]):
        weight = guide.lobes[lane, NASG_WEIGHT, k]
        if weight > 0.0:
            chosen = k
            if left < weight:
                break
        left -= weight
    sharpness = guide.lobes[lane, NASG_LAMBDA, chosen]
    a = guide.lobes[lane, NASG_A, chosen]
    # 1 - g^(1 + q), by inversion.
    below = 1.0 - u1
    if sharpness > 0.0:
        inside = min(below * 2.0 * sharpness * spread(sharpness), ONE_MINUS_EPSILON)
        below = min(-0.5 * _log_complement(1.0 - inside, inside) / sharpness, 1.0)
    # tan(phi) = sqrt(1 + a) tan(rho), and 1 + q = (1 + a) / (1 + a sin(rho)^2).
    sin_rho, cos_rho = turn(min(u2, 1.0 - u2))
    sin_rho = -sin_rho if u2 > 0.5 else sin_rho
    stretch = 1.0 + a * sin_rho * sin_rho
    log_g = _log_complement(max(1.0 - below, LEAST_GAP), below) * stretch / (1.0 + a)
    h = -_expm1_nonpositive(log_g)
    sine = 2.0 * math.sqrt(h * (1.0 - h) / stretch)
    along_x = sine * cos_rho
    along_y = sine * sin_rho * math.sqrt(1.0 + a)
    along_z = 1.0 - 2.0 * h
    axis_z = (
        guide.lobes[lane, NASG_Z, chosen],
        guide.lobes[lane, NASG_Z + 1, chosen],
        guide.lobes[lane, NASG_Z + 2, chosen],
    )
    axis_x = (
        guide.lobes[lane, NASG_X, chosen],
        guide.lobes[lane, NASG_X + 1, chosen],
        guide.lobes[lane, NASG_X + 2, chosen],
    )
    axis_y = cross(axis_z, axis_x)
    return (
        along_x * axis_x[0] + along_y * axis_y[0] + along_z * axis_z[0],
        along_x * axis_x[1] + along_y * axis_y[1] + along_z * axis_z[1],
        along_x * axis_x[2] + along_y * axis_y[2] + along_z * axis_z[2],
    )


@kernel
def predict_nasg(guide, lane, wi, guide_pdf):
    """Incident radiance (mean over channels) along unit direction wi, given `guide_pdf` = `eval_nasg` there.

    Fluence times density, part of it held even, for the reason of `predict_vmm`.
    """
    return guide.fluence[lane] * ((1.0 - EVEN_SHARE) * guide_pdf + EVEN_SHARE * INV_FOUR_PI)
