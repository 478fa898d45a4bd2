# SPDX-License-Identifier: GPL-3.0-or-later
"""Mixtures of von Mises-Fisher lobes (which normalised spherical Gaussians are too) from a network's outputs.

A decoded mixture is a lane of `GuideLobes`: what samples and evaluates the learned field's does so with these.

Outputs of a lobe, raw and unbounded, in the order of the VMF_* columns:

====================  ==========================================================================================
logit                 clamped to [LOGIT_LOW, LOGIT_HIGH]; softmax over lobes gives the weights
logarithm of kappa    clamped to [LOG_KAPPA_LOW, LOG_KAPPA_HIGH]
theta', phi'          polar angle pi sigmoid(theta'), azimuth 2 pi sigmoid(phi') of the mean, world axes
====================  ==========================================================================================

A lobe with a NaN among its outputs is uniform, with a logit of 0. `engine.guiding.neural.worker.lobes` decodes
likewise.

References
----------
Dong et al. 2023, "Neural Parametric Mixtures for Path Guiding", Eqs. (3), (4) and table 1. The cap of kappa is that of
Ruppert et al. 2020, narrower than the 15 of logarithm that implementations allow.
"""

import numpy as np

from engine.guiding.fields.vmm.field import (
    COSINE_FLUENCE,
    COSINE_KAPPA,
    COSINE_NORMAL,
    COSINE_RADIANCE,
    GUIDE_COEFFICIENT,
    GUIDE_KAPPA,
    GUIDE_WEIGHT,
    GUIDE_X,
    GUIDE_Y,
    GUIDE_Z,
)
from engine.guiding.fields.vmm.numeric import spread
from engine.guiding.fields.vmm.query import COSINE_LOBE_KAPPA, COSINE_LOBE_NORM, multiply_lobe
from engine.kernels.constants import INV_FOUR_PI
from engine.kernels.exponential import exp_nonpositive
from engine.runtime.jit import kernel

#: Outputs a lobe.
VMF_OUTPUTS = 4
# Columns of a lobe's outputs
VMF_LOGIT = 0
VMF_LOG_KAPPA = 1
VMF_THETA = 2
VMF_PHI = 3

LOGIT_LOW = np.float32(-10.0)
LOGIT_HIGH = np.float32(15.0)
#: kappa 1.0e-3 (what is wider is uniform anyway) to 3.3e4 (a lobe of a third of a degree).
LOG_KAPPA_LOW = np.float32(-6.9)
LOG_KAPPA_HIGH = np.float32(10.4)

#: Fluence is held below, so that its product with a density is a number.
_MOST_FLUENCE = np.float32(1e30)


@kernel
def exp_clamped(x, low, high):
    """exp of x clamped to [low, high], within +-87; relative error below 5e-7, free of calls and branches.

    NaN is not handled: the caller knows better what it should be.
    """
    clamped = min(max(x, low), high)
    inverse = exp_nonpositive(-abs(clamped))
    return inverse if clamped < 0.0 else 1.0 / inverse


@kernel
def valid_fluence(fluence):
    """`fluence` as a finite number that is not negative; 0 for NaN."""
    return min(fluence, _MOST_FLUENCE) if fluence > 0.0 else np.float32(0.0)


@kernel
def sin_half_turn(x):
    """sin(pi x) for x in [0, 1/2], relative error below 2e-7; the polynomial is a minimax fit."""
    squared = x * x
    p = 0.07756038755178452 * squared - 0.5982421040534973
    p = p * squared + 2.550069808959961
    p = p * squared - 5.167709827423096
    return x * (p * squared + 3.1415927410125732)


@kernel
def turn(x):
    """sin(2 pi x) and cos(2 pi x) for x in [0, 1/2], each within 3e-7."""
    sine = sin_half_turn(x)
    cosine = sin_half_turn(0.5 - x)
    return 2.0 * sine * cosine, (cosine - sine) * (cosine + sine)


@kernel
def _lesser_sigmoid(x):
    """The lesser of sigmoid(x) and 1 - sigmoid(x): nothing is lost close to either end."""
    e = exp_nonpositive(-abs(x))
    return e / (1.0 + e)


@kernel
def decode_vmf(raw, row, first, lobe_count, guide, lane, fluence):
    """Write the mixture that a row of outputs stands for into a lane of `guide`.

    Parameters
    ----------
    raw : float32 (N, W), a network's outputs, whatever they are
    row : int
    first : int
        Column of the first lobe's outputs; lobe k's begin at `first + k * VMF_OUTPUTS`.
    lobe_count : int, 1 to MAX_LOBES
    guide : GuideLobes
    lane : int
    fluence : float32, incident radiance (mean over channels) integrated over all directions, for `predict_vmm`
    """
    count = (lobe_count + 7) & ~7
    total = np.float32(0.0)
    for k in range(count):
        column = first + min(k, lobe_count - 1) * VMF_OUTPUTS
        logit = raw[row, column + VMF_LOGIT]
        log_kappa = raw[row, column + VMF_LOG_KAPPA]
        raw_theta = raw[row, column + VMF_THETA]
        raw_phi = raw[row, column + VMF_PHI]
        is_nan = logit != logit or log_kappa != log_kappa or raw_theta != raw_theta or raw_phi != raw_phi
        is_used = k < lobe_count
        raw_theta = 0.0 if is_nan else raw_theta
        raw_phi = 0.0 if is_nan else raw_phi

        share = _lesser_sigmoid(raw_theta)
        sin_theta = sin_half_turn(share)
        cos_theta = sin_half_turn(0.5 - share)
        cos_theta = -cos_theta if raw_theta > 0.0 else cos_theta
        sin_phi, cos_phi = turn(_lesser_sigmoid(raw_phi))
        sin_phi = -sin_phi if raw_phi > 0.0 else sin_phi

        kappa = 0.0 if is_nan else exp_clamped(log_kappa, LOG_KAPPA_LOW, LOG_KAPPA_HIGH)
        weight = exp_clamped(0.0 if is_nan else logit, LOGIT_LOW, LOGIT_HIGH)
        weight = weight if is_used else 0.0
        guide.lobes[lane, GUIDE_KAPPA, k] = kappa if is_used else 0.0
        guide.lobes[lane, GUIDE_X, k] = sin_theta * cos_phi if is_used else 0.0
        guide.lobes[lane, GUIDE_Y, k] = sin_theta * sin_phi if is_used else 0.0
        guide.lobes[lane, GUIDE_Z, k] = cos_theta if is_used else 0.0
        guide.lobes[lane, GUIDE_WEIGHT, k] = weight
        guide.lobes[lane, GUIDE_COEFFICIENT, k] = weight * INV_FOUR_PI / spread(kappa)
        total += weight
    scale = 1.0 / total
    for k in range(count):
        guide.lobes[lane, GUIDE_WEIGHT, k] *= scale
        guide.lobes[lane, GUIDE_COEFFICIENT, k] *= scale
    guide.count[lane] = count
    guide.cosine[lane, COSINE_NORMAL] = 0.0
    guide.cosine[lane, COSINE_NORMAL + 1] = 0.0
    guide.cosine[lane, COSINE_NORMAL + 2] = 1.0
    guide.cosine[lane, COSINE_KAPPA] = 0.0
    guide.cosine[lane, COSINE_FLUENCE] = valid_fluence(fluence)
    guide.cosine[lane, COSINE_RADIANCE] = valid_fluence(fluence)


@kernel
def multiply_cosine(guide, lane, n):
    """Multiply a decoded mixture, in place, with the lobe nearest to the clamped cosine about n.

    Parameters
    ----------
    guide : GuideLobes
    lane : int, of `decode_vmf`, not multiplied yet
    n : float32 tuple, unit, on the side that is lit; the mixture stays as it is if n is no direction

    References
    ----------
    Dong et al. 2023, section 4.3 (the cosine is a constant lobe). The product: `multiply_lobe`.
    """
    squared = n[0] * n[0] + n[1] * n[1] + n[2] * n[2]
    if not (squared > 0.5 and squared < 2.0):
        return
    count = np.int64(guide.count[lane])
    total = np.float32(0.0)
    for k in range(count):
        x = guide.lobes[lane, GUIDE_X, k]
        y = guide.lobes[lane, GUIDE_Y, k]
        z = guide.lobes[lane, GUIDE_Z, k]
        chord_x = x - n[0]
        chord_y = y - n[1]
        chord_z = z - n[2]
        mean, kappa, coefficient, weight = multiply_lobe(
            (x, y, z), guide.lobes[lane, GUIDE_KAPPA, k], guide.lobes[lane, GUIDE_COEFFICIENT, k],
            n, COSINE_LOBE_KAPPA, COSINE_LOBE_NORM, chord_x * chord_x + chord_y * chord_y + chord_z * chord_z,
        )
        guide.lobes[lane, GUIDE_X, k] = mean[0]
        guide.lobes[lane, GUIDE_Y, k] = mean[1]
        guide.lobes[lane, GUIDE_Z, k] = mean[2]
        guide.lobes[lane, GUIDE_KAPPA, k] = kappa
        guide.lobes[lane, GUIDE_COEFFICIENT, k] = coefficient
        guide.lobes[lane, GUIDE_WEIGHT, k] = weight
        total += weight
    scale = 1.0 / total if total > 0.0 else np.float32(0.0)
    for k in range(count):
        guide.lobes[lane, GUIDE_COEFFICIENT, k] *= scale
        guide.lobes[lane, GUIDE_WEIGHT, k] *= scale
    guide.cosine[lane, COSINE_NORMAL] = n[0]
    guide.cosine[lane, COSINE_NORMAL + 1] = n[1]
    guide.cosine[lane, COSINE_NORMAL + 2] = n[2]
    guide.cosine[lane, COSINE_KAPPA] = COSINE_LOBE_KAPPA
    guide.cosine[lane, COSINE_RADIANCE] = guide.cosine[lane, COSINE_FLUENCE] * total / COSINE_LOBE_NORM
