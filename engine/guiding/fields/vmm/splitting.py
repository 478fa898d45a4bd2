# SPDX-License-Identifier: GPL-3.0-or-later
"""Lobes that stand for too much are split, lobes that are alike are merged.

Reference: Ruppert et al. 2020, "Robust Fitting of Parallax-Aware Mixtures for Path Guiding", section 5.
"""

from __future__ import annotations

import math

import numpy as np

from engine.guiding.fields.vmm.expectation import (
    UNEXPLAINED_PDF,
    clear_lobe,
    evaluate_lobes,
    kappa_of_cosine,
    load_lobes,
    set_lobe,
)
from engine.guiding.fields.vmm.field import (
    LOBE_INVERSE_DISTANCE,
    LOBE_KAPPA,
    LOBE_ROWS,
    LOBE_WEIGHT,
    LOBE_X,
    LOBE_Y,
    LOBE_Z,
    MAX_LOBES,
)
from engine.guiding.fields.vmm.numeric import spread
from engine.guiding.fields.vmm.store import (
    FIT_INVERSE_DISTANCE,
    FIT_PDF,
    FIT_WEIGHT,
    FIT_X,
    FIT_Y,
    FIT_Z,
    PARAMETER_MAX_KAPPA,
    PARAMETER_MERGE_THRESHOLD,
    PARAMETER_SPLIT_THRESHOLD,
    SPLIT_CHI,
    SPLIT_ROWS,
    SPLIT_WEIGHT,
    SPLIT_XX,
    SPLIT_XY,
    SPLIT_YY,
    STAT_DISTANCE_WEIGHT,
    STAT_INVERSE_DISTANCE,
    STAT_ROWS,
    STAT_WEIGHT,
    STAT_X,
    STAT_Y,
    STAT_Z,
    WORK_BITANGENT,
    WORK_CHI,
    WORK_COEFFICIENT,
    WORK_DENSITY,
    WORK_DISTANCE_WEIGHT,
    WORK_INVERSE_DISTANCE,
    WORK_IS_FREE,
    WORK_RESPONSIBILITY,
    WORK_TANGENT,
    WORK_WEIGHT,
    WORK_X,
    WORK_XX,
    WORK_XY,
    WORK_Y,
    WORK_YY,
    WORK_Z,
)
from engine.kernels.constants import FOUR_PI
from engine.kernels.vector import orthonormal_basis
from engine.runtime.jit import kernel

_EIGENVALUE_GAP = np.float32(1e-8)
#: Lobes narrower than this share of the largest kappa are not split.
_SPLIT_KAPPA_SHARE = np.float32(0.9)


@kernel
def observe_lobes(store, region, scratch, sample_count, scale, all_count):
    """Add to the region's sums for distances and splits what the samples say of the lobes as they are now.

    The divergence of a lobe is the chi-square of what it stands for, sum over samples of L^2 f / (I^2 p^2 q) - ...
    (Ruppert et al. 2020, Eq. 26); at a maximum the other terms are the lobe's weight.
    """
    count = load_lobes(store, region, scratch)
    for k in range(count):
        mean = (scratch.work[WORK_X, k], scratch.work[WORK_Y, k], scratch.work[WORK_Z, k])
        tangent, bitangent = orthonormal_basis(mean)
        for axis in range(3):
            scratch.work[WORK_TANGENT + axis, k] = tangent[axis]
            scratch.work[WORK_BITANGENT + axis, k] = bitangent[axis]
        for row in range(WORK_DISTANCE_WEIGHT, WORK_YY + 1):
            scratch.work[row, k] = 0.0
    total = np.float32(0.0)
    for row in range(sample_count):
        total += scratch.samples[row, FIT_WEIGHT]
    unit = np.float32(1.0) / total
    for row in range(sample_count):
        x = scratch.samples[row, FIT_X]
        y = scratch.samples[row, FIT_Y]
        z = scratch.samples[row, FIT_Z]
        pdf = evaluate_lobes(scratch, count, x, y, z)
        if not pdf > UNEXPLAINED_PDF:
            continue
        weight = scratch.samples[row, FIT_WEIGHT]
        inverse_distance = scratch.samples[row, FIT_INVERSE_DISTANCE]
        factor = weight * scale / pdf
        relative = weight * unit
        chi_factor = relative * relative * scratch.samples[row, FIT_PDF] / (pdf * pdf)
        for k in range(count):
            responsibility = scratch.work[WORK_RESPONSIBILITY, k]
            part = responsibility * factor
            density = part * responsibility * scratch.work[WORK_DENSITY, k]
            coefficient = scratch.work[WORK_COEFFICIENT, k]
            density = density / coefficient if coefficient > 0.0 else np.float32(0.0)
            u = (
                scratch.work[WORK_TANGENT, k] * x
                + scratch.work[WORK_TANGENT + 1, k] * y
                + scratch.work[WORK_TANGENT + 2, k] * z
            )
            v = (
                scratch.work[WORK_BITANGENT, k] * x
                + scratch.work[WORK_BITANGENT + 1, k] * y
                + scratch.work[WORK_BITANGENT + 2, k] * z
            )
            scratch.work[WORK_WEIGHT, k] += part
            scratch.work[WORK_DISTANCE_WEIGHT, k] += density
            scratch.work[WORK_INVERSE_DISTANCE, k] += density * inverse_distance
            scratch.work[WORK_CHI, k] += responsibility * chi_factor
            scratch.work[WORK_XX, k] += part * u * u
            scratch.work[WORK_XY, k] += part * u * v
            scratch.work[WORK_YY, k] += part * v * v
    for k in range(np.int64(store.lobe_count[region])):
        store.statistics[region, STAT_DISTANCE_WEIGHT, k] += scratch.work[WORK_DISTANCE_WEIGHT, k]
        store.statistics[region, STAT_INVERSE_DISTANCE, k] += scratch.work[WORK_INVERSE_DISTANCE, k]
        known = store.statistics[region, STAT_DISTANCE_WEIGHT, k]
        store.lobes[region, LOBE_INVERSE_DISTANCE, k] = (
            store.statistics[region, STAT_INVERSE_DISTANCE, k] / known if known > 1e-30 else 0.0
        )
        # Sums of squared shares of a batch's weight, times its samples, are means; times its samples again, sums.
        chi = scratch.work[WORK_CHI, k] * np.float32(all_count)
        store.split_statistics[region, SPLIT_CHI, k] += np.float32(all_count) * (
            chi - store.lobes[region, LOBE_WEIGHT, k]
        )
        store.split_statistics[region, SPLIT_WEIGHT, k] += scratch.work[WORK_WEIGHT, k]
        store.split_statistics[region, SPLIT_XX, k] += scratch.work[WORK_XX, k]
        store.split_statistics[region, SPLIT_XY, k] += scratch.work[WORK_XY, k]
        store.split_statistics[region, SPLIT_YY, k] += scratch.work[WORK_YY, k]


@kernel
def _split_lobe(store, region, k, other, parameters):
    """Replace lobe k by two, k and `other`, along the principal axis of its samples: 1 if done, 0 if it is refused."""
    weight = store.split_statistics[region, SPLIT_WEIGHT, k]
    if not weight > 0.0:
        return 0
    xx = store.split_statistics[region, SPLIT_XX, k] / weight
    xy = store.split_statistics[region, SPLIT_XY, k] / weight
    yy = store.split_statistics[region, SPLIT_YY, k] / weight
    half_gap = math.sqrt(0.25 * (xx - yy) * (xx - yy) + xy * xy)
    max_kappa = parameters[PARAMETER_MAX_KAPPA]
    if store.lobes[region, LOBE_KAPPA, k] >= _SPLIT_KAPPA_SHARE * max_kappa or not half_gap > 0.5 * _EIGENVALUE_GAP:
        return 0
    angle = 0.5 * math.atan2(2.0 * xy, xx - yy)
    mean = (store.lobes[region, LOBE_X, k], store.lobes[region, LOBE_Y, k], store.lobes[region, LOBE_Z, k])
    tangent, bitangent = orthonormal_basis(mean)
    # Two equal lobes, each as wide as the narrow axis, have these second moments when this far from their mean.
    sine = min(math.sqrt(2.0 * half_gap), 0.9)
    cosine = math.sqrt(1.0 - sine * sine)
    a = math.cos(angle) * sine
    b = math.sin(angle) * sine
    r = min(_mean_cosine(store.lobes[region, LOBE_KAPPA, k]) / cosine, 1.0)
    half = 0.5 * store.statistics[region, STAT_WEIGHT, k]
    for row in range(STAT_ROWS):
        store.statistics[region, row, k] *= 0.5
        store.statistics[region, row, other] = store.statistics[region, row, k]
    share = 0.5 * store.lobes[region, LOBE_WEIGHT, k]
    store.lobes[region, LOBE_INVERSE_DISTANCE, other] = store.lobes[region, LOBE_INVERSE_DISTANCE, k]
    for side in range(2):
        lobe = k if side == 0 else other
        sign = np.float32(1.0) if side == 0 else np.float32(-1.0)
        x = mean[0] * cosine + sign * (a * tangent[0] + b * bitangent[0])
        y = mean[1] * cosine + sign * (a * tangent[1] + b * bitangent[1])
        z = mean[2] * cosine + sign * (a * tangent[2] + b * bitangent[2])
        set_lobe(store, region, lobe, share, np.float64(x), np.float64(y), np.float64(z), r, half, parameters)
        _statistics_from_lobe(store, region, lobe)
    return 1


@kernel
def _mean_cosine(kappa):
    """Length of the mean vector of a lobe: coth(kappa) - 1 / kappa, float64."""
    k = np.float64(kappa)
    if k < 0.01:
        return k / 3.0
    decayed = math.exp(-2.0 * k)
    return (1.0 + decayed) / (1.0 - decayed) - 1.0 / k


@kernel
def _statistics_from_lobe(store, region, k):
    """Make a lobe's direction statistics those of the lobe itself."""
    length = store.statistics[region, STAT_WEIGHT, k] * _mean_cosine(store.lobes[region, LOBE_KAPPA, k])
    store.statistics[region, STAT_X, k] = length * store.lobes[region, LOBE_X, k]
    store.statistics[region, STAT_Y, k] = length * store.lobes[region, LOBE_Y, k]
    store.statistics[region, STAT_Z, k] = length * store.lobes[region, LOBE_Z, k]


@kernel
def split_lobes(store, region, scratch, observed_count, parameters):
    """Split the lobes that fit worst, as far as there is room; marks the new ones free. Returns how many were split."""
    split_count = 0
    for k in range(MAX_LOBES):
        scratch.work[WORK_IS_FREE, k] = 0.0
    old_count = np.int64(store.lobe_count[region])
    threshold = parameters[PARAMETER_SPLIT_THRESHOLD] * observed_count
    for _attempt in range(old_count):
        worst = -1
        for k in range(old_count):
            chi = store.split_statistics[region, SPLIT_CHI, k]
            if chi > threshold and (worst < 0 or chi > store.split_statistics[region, SPLIT_CHI, worst]):
                worst = k
        if worst < 0 or store.lobe_count[region] == MAX_LOBES:
            break
        other = np.int64(store.lobe_count[region])
        if _split_lobe(store, region, worst, other, parameters) == 1:
            store.lobe_count[region] = other + 1
            scratch.work[WORK_IS_FREE, worst] = 1.0
            scratch.work[WORK_IS_FREE, other] = 1.0
            split_count += 1
        store.split_statistics[region, SPLIT_CHI, worst] = 0.0
    for row in range(SPLIT_ROWS):
        for k in range(MAX_LOBES):
            store.split_statistics[region, row, k] = 0.0
    return split_count


@kernel
def _log_integral(x, y, z):
    """log of the integral over the sphere of exp(a . w), less |a|; and |a|."""
    length = math.sqrt(x * x + y * y + z * z)
    return math.log(np.float64(FOUR_PI) * np.float64(spread(np.float32(length)))), length


@kernel
def _merge_cost(store, region, i, j, parameters):
    """Chi-square of one lobe standing for two: integral of (f_i + f_j)^2 / f_ij, less the weight of f_ij.

    References: Ruppert et al. 2020, Eq. 24.
    """
    weight_i = np.float64(store.lobes[region, LOBE_WEIGHT, i])
    weight_j = np.float64(store.lobes[region, LOBE_WEIGHT, j])
    weight = weight_i + weight_j
    if not weight > 0.0:
        return 0.0
    kappa_i = np.float64(store.lobes[region, LOBE_KAPPA, i])
    kappa_j = np.float64(store.lobes[region, LOBE_KAPPA, j])
    share_i = weight_i / weight * _mean_cosine(kappa_i)
    share_j = weight_j / weight * _mean_cosine(kappa_j)
    x = share_i * store.lobes[region, LOBE_X, i] + share_j * store.lobes[region, LOBE_X, j]
    y = share_i * store.lobes[region, LOBE_Y, i] + share_j * store.lobes[region, LOBE_Y, j]
    z = share_i * store.lobes[region, LOBE_Z, i] + share_j * store.lobes[region, LOBE_Z, j]
    r = math.sqrt(x * x + y * y + z * z)
    kappa = kappa_of_cosine(r, parameters[PARAMETER_MAX_KAPPA])
    scale = kappa / r if r > 0.0 else 0.0
    log_norm = -math.log(np.float64(FOUR_PI) * np.float64(spread(np.float32(kappa)))) - kappa
    cost = np.float64(0.0)
    for pair in range(3):
        a = i if pair < 2 else j
        b = i if pair == 0 else j
        kappa_a = kappa_i if pair < 2 else kappa_j
        kappa_b = kappa_i if pair == 0 else kappa_j
        product = (weight_i if pair < 2 else weight_j) * (weight_i if pair == 0 else weight_j)
        product = 2.0 * product if pair == 1 else product
        log_integral, length = _log_integral(
            kappa_a * store.lobes[region, LOBE_X, a] + kappa_b * store.lobes[region, LOBE_X, b] - scale * x,
            kappa_a * store.lobes[region, LOBE_Y, a] + kappa_b * store.lobes[region, LOBE_Y, b] - scale * y,
            kappa_a * store.lobes[region, LOBE_Z, a] + kappa_b * store.lobes[region, LOBE_Z, b] - scale * z,
        )
        norm_a = -math.log(np.float64(FOUR_PI) * np.float64(spread(np.float32(kappa_a)))) - kappa_a
        norm_b = -math.log(np.float64(FOUR_PI) * np.float64(spread(np.float32(kappa_b)))) - kappa_b
        exponent = norm_a + norm_b - log_norm + log_integral + length
        cost += product / weight * math.exp(min(exponent, 700.0))
    return cost - weight


@kernel
def _merge_pair(store, region, i, j, parameters):
    """Make lobe i stand for i and j, and the last lobe take j's place."""
    inverse_i = store.lobes[region, LOBE_WEIGHT, i] * store.lobes[region, LOBE_INVERSE_DISTANCE, i]
    inverse_j = store.lobes[region, LOBE_WEIGHT, j] * store.lobes[region, LOBE_INVERSE_DISTANCE, j]
    weight = np.float64(store.lobes[region, LOBE_WEIGHT, i]) + store.lobes[region, LOBE_WEIGHT, j]
    for row in range(STAT_ROWS):
        store.statistics[region, row, i] += store.statistics[region, row, j]
    for row in range(SPLIT_ROWS):
        store.split_statistics[region, row, i] += store.split_statistics[region, row, j]
    x = store.statistics[region, STAT_X, i]
    y = store.statistics[region, STAT_Y, i]
    z = store.statistics[region, STAT_Z, i]
    seen = store.statistics[region, STAT_WEIGHT, i]
    r = min(math.sqrt(x * x + y * y + z * z) / seen, 1.0) if seen > 0.0 else 0.0
    set_lobe(store, region, i, weight, x, y, z, r, seen, parameters)
    store.lobes[region, LOBE_INVERSE_DISTANCE, i] = (inverse_i + inverse_j) / weight if weight > 0.0 else 0.0
    last = np.int64(store.lobe_count[region]) - 1
    for row in range(LOBE_ROWS):
        store.lobes[region, row, j] = store.lobes[region, row, last]
    for row in range(STAT_ROWS):
        store.statistics[region, row, j] = store.statistics[region, row, last]
    for row in range(SPLIT_ROWS):
        store.split_statistics[region, row, j] = store.split_statistics[region, row, last]
    clear_lobe(store, region, last)
    store.lobe_count[region] = last


@kernel
def merge_lobes(store, region, scratch, parameters):
    """Merge the most alike pairs of lobes while one lobe stands for both well enough. Returns how many were merged."""
    merged = 0
    changed = -1
    while store.lobe_count[region] > 1:
        lobe_count = np.int64(store.lobe_count[region])
        best_i = -1
        best_j = -1
        best = parameters[PARAMETER_MERGE_THRESHOLD]
        for i in range(lobe_count):
            for j in range(i + 1, lobe_count):
                # Costs of pairs that the last merger left alone are known.
                if merged == 0 or i == changed or j == changed:
                    scratch.merge_cost[i, j] = _merge_cost(store, region, i, j, parameters)
                if scratch.merge_cost[i, j] < best:
                    best = np.float64(scratch.merge_cost[i, j])
                    best_i = i
                    best_j = j
        if best_i < 0:
            break
        _merge_pair(store, region, best_i, best_j, parameters)
        # The last lobe moved to row best_j.
        last = lobe_count - 1
        for k in range(last):
            if k < best_j:
                scratch.merge_cost[k, best_j] = scratch.merge_cost[k, last]
            elif k > best_j:
                scratch.merge_cost[best_j, k] = scratch.merge_cost[k, last]
        changed = best_i
        merged += 1
    return merged


@kernel
def settle_split(store, region, scratch):
    """Give lobes just split and fitted the statistics that they stand for."""
    mass = 0.0
    total = 0.0
    for k in range(np.int64(store.lobe_count[region])):
        if scratch.work[WORK_IS_FREE, k] > 0.0:
            mass += store.lobes[region, LOBE_WEIGHT, k]
            total += store.statistics[region, STAT_WEIGHT, k]
    for k in range(np.int64(store.lobe_count[region])):
        if scratch.work[WORK_IS_FREE, k] > 0.0 and mass > 0.0:
            store.statistics[region, STAT_WEIGHT, k] = total * store.lobes[region, LOBE_WEIGHT, k] / mass
            _statistics_from_lobe(store, region, k)
