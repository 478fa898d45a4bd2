# SPDX-License-Identifier: GPL-3.0-or-later
"""Choosing one of a vertex's candidates: colour target, defensive resampling, contribution weight.

References: Rath, Manzi et al. 2025, "Neural Resampling with Optimized Candidate Allocation", Eqs. (4), (6), (8); Talbot
2005, "Importance Resampling for Global Illumination".
"""

import math

from engine.kernels.constants import FLOAT_MAX, FLOAT_MIN
from engine.runtime.jit import kernel


@kernel
def product_target(throughput, lane, f_cos, radiance, row, channels, is_scalar):
    """Expected contribution of a candidate to the image, Eq. (6).

    Parameters
    ----------
    throughput : float32 (L, C), of the path before the vertex
    f_cos, radiance : float32 (N, C), BSDF times cosine and predicted incident radiance of candidate `row`
    is_scalar : bool
        Leave colour out: the product of the three means, for comparisons.

    Returns
    -------
    float32, 0 where the prediction is negative, infinite or not a number
    """
    count = len(channels)
    target = 0.0
    if is_scalar:
        mean_f = 0.0
        mean_radiance = 0.0
        for c in range(count):
            mean_f += f_cos[row, c]
            mean_radiance += radiance[row, c]
        target = mean_f * mean_radiance
    else:
        for c in range(count):
            target += throughput[lane, c] * f_cos[row, c] * radiance[row, c]
    # Written so that NaN fails.
    if not (target > 0.0 and target < FLOAT_MAX):
        return 0.0
    return target


@kernel
def resample(target, source_pdf, is_valid, first, count, alpha, u):
    """Pick one of the candidates `first` to `first + count`.

    The defensive target of Eq. (8) with the source density as the second strategy makes the probability of candidate i
    P_i = alpha w_i / sum(w) + (1 - alpha) / (number of valid candidates), w = target / source_pdf. Whatever the
    targets are, every valid candidate can be picked, so f / (count * source_pdf * P) is unbiased; P >= (1 - alpha) /
    count bounds its second moment by that of source sampling over (1 - alpha).

    Parameters
    ----------
    target, source_pdf : float32 (N,)
        Source density [sr^-1].
    is_valid : uint8 (N,)
        The BSDF is not black; other candidates count, and are never picked.
    alpha : float32 in [0, 1]
    u : float32 in [0, 1)

    Returns
    -------
    picked : int
        -1 if no candidate is valid.
    contribution_weight : float32 [sr]
        1 / (count * source_pdf * P), Eq. (4).
    """
    weight_sum = 0.0
    valid_count = 0
    for i in range(first, first + count):
        if is_valid[i] != 0:
            valid_count += 1
            weight_sum += target[i] / source_pdf[i]
    if valid_count == 0:
        return -1, 0.0
    share = alpha
    inverse_sum = 0.0
    if weight_sum > FLOAT_MIN and weight_sum < FLOAT_MAX:
        inverse_sum = 1.0 / weight_sum
    else:
        share = 0.0
    defensive = (1.0 - share) / valid_count
    picked = -1
    picked_probability = 0.0
    left = u
    for i in range(first, first + count):
        if is_valid[i] == 0:
            continue
        probability = share * (target[i] / source_pdf[i]) * inverse_sum + defensive
        if probability > 0.0:
            # Rounding may leave a little behind the last one: it takes it.
            picked = i
            picked_probability = probability
            if left < probability:
                break
            left -= probability
    if picked < 0 or not math.isfinite(picked_probability):
        return -1, 0.0
    return picked, 1.0 / (count * source_pdf[picked] * picked_probability)
