# SPDX-License-Identifier: GPL-3.0-or-later
"""Fitting lobes to a region's samples: robust weights, expectation, maximisation.

Reference: Ruppert et al. 2020, "Robust Fitting of Parallax-Aware Mixtures for Path Guiding", section 4.
"""

from __future__ import annotations

import math

import numpy as np

from engine.guiding.fields.vmm.field import (
    LOBE_COEFFICIENT,
    LOBE_KAPPA,
    LOBE_ROWS,
    LOBE_WEIGHT,
    LOBE_X,
    LOBE_Y,
    LOBE_Z,
    MAX_LOBES,
)
from engine.guiding.fields.vmm.numeric import UNIFORM_KAPPA, exp_nonpositive, spread
from engine.guiding.fields.vmm.store import (
    FIT_INVERSE_DISTANCE,
    FIT_PDF,
    FIT_WEIGHT,
    FIT_X,
    FIT_Y,
    FIT_Z,
    PARAMETER_COSINE_PRIOR,
    PARAMETER_MAX_KAPPA,
    PARAMETER_TOLERANCE,
    PARAMETER_WEIGHT_PRIOR,
    PARAMETER_WEIGHT_SHARE,
    SAMPLE_DIRECTION,
    SAMPLE_DISTANCE,
    SAMPLE_P,
    SAMPLE_PDF,
    SAMPLE_WEIGHT,
    SPLIT_ROWS,
    STAT_ROWS,
    STAT_WEIGHT,
    STAT_X,
    STAT_Y,
    STAT_Z,
    WORK_COEFFICIENT,
    WORK_DENSITY,
    WORK_FALLOFF,
    WORK_IS_FREE,
    WORK_RESPONSIBILITY,
    WORK_SUM_X,
    WORK_SUM_Y,
    WORK_SUM_Z,
    WORK_WEIGHT,
    WORK_X,
    WORK_Y,
    WORK_Z,
)
from engine.kernels.constants import FLOAT_MAX, FOUR_PI
from engine.runtime.jit import kernel

#: A sample this unlikely under all lobes is evidence for a new one.
UNEXPLAINED_PDF = np.float32(1e-16)


@kernel
def kappa_of_cosine(r, max_kappa):
    """Concentration of the lobe whose mean vector has length r (Banerjee et al. 2005), float64."""
    return min(max((3.0 * r - r * r * r) / max(1.0 - r * r, 1e-12), 0.0), max_kappa)


@kernel
def gather_samples(batch, start, stop, store, region, parameters, scratch):
    """Copy a region's samples that are not black to the scratch, reprojected to its pivot, with robust weights.

    A weight far above all others is cut: a single firefly would otherwise outweigh them. Several that are as bright
    stay, they may be the first glimpses of a lamp.
    Returns how many there are and the sum of their weights.
    """
    count = 0
    total = np.float64(0.0)
    lowest = np.float64(FLOAT_MAX)
    top_a = np.float64(0.0)
    top_b = np.float64(0.0)
    top_c = np.float64(0.0)
    top_d = np.float64(0.0)
    for row in range(start, stop):
        weight = batch[row, SAMPLE_WEIGHT]
        if weight <= 0.0:
            continue
        distance = batch[row, SAMPLE_DISTANCE]
        x = batch[row, SAMPLE_DIRECTION]
        y = batch[row, SAMPLE_DIRECTION + 1]
        z = batch[row, SAMPLE_DIRECTION + 2]
        inverse_distance = np.float32(0.0)
        if distance > 0.0 and distance < 1e30:
            ex = x * distance + (batch[row, SAMPLE_P] - store.pivot[region, 0])
            ey = y * distance + (batch[row, SAMPLE_P + 1] - store.pivot[region, 1])
            ez = z * distance + (batch[row, SAMPLE_P + 2] - store.pivot[region, 2])
            squared = ex * ex + ey * ey + ez * ez
            if squared > 1e-6 * distance * distance:
                inverse_distance = np.float32(1.0 / math.sqrt(squared))
                x = ex * inverse_distance
                y = ey * inverse_distance
                z = ez * inverse_distance
        scratch.samples[count, FIT_X] = x
        scratch.samples[count, FIT_Y] = y
        scratch.samples[count, FIT_Z] = z
        scratch.samples[count, FIT_WEIGHT] = weight
        scratch.samples[count, FIT_INVERSE_DISTANCE] = inverse_distance
        scratch.samples[count, FIT_PDF] = batch[row, SAMPLE_PDF]
        count += 1
        total += np.float64(weight)
        lowest = min(lowest, np.float64(weight))
        # Keep the four largest: the new one pushes out the least of them.
        kept = np.float64(weight)
        if kept > min(top_a, top_b, top_c, top_d):
            kept, top_a = min(kept, top_a), max(kept, top_a)
            kept, top_b = min(kept, top_b), max(kept, top_b)
            kept, top_c = min(kept, top_c), max(kept, top_c)
            top_d = max(kept, top_d)
    if count == 0:
        return count, total
    # The three brightest are cut to the fourth, unless that is darker than their share of the rest.
    fourth = min(top_a, top_b, top_c, top_d) if count > 3 else lowest
    none = np.float64(0.0)
    total -= (
        max(top_a - fourth, none) + max(top_b - fourth, none) + max(top_c - fourth, none) + max(top_d - fourth, none)
    )
    limit = max(fourth, parameters[PARAMETER_WEIGHT_SHARE] * total)
    total = np.float64(0.0)
    for k in range(count):
        scratch.samples[k, FIT_WEIGHT] = min(np.float64(scratch.samples[k, FIT_WEIGHT]), limit)
        total += np.float64(scratch.samples[k, FIT_WEIGHT])
    return count, total


@kernel
def load_lobes(store, region, scratch):
    """Prepare the scratch for an expectation: constants of the lobes, zeroed sums. Returns the padded lobe count."""
    count = (np.int64(store.lobe_count[region]) + 7) & ~7
    for k in range(count):
        kappa = store.lobes[region, LOBE_KAPPA, k]
        scratch.work[WORK_FALLOFF, k] = -0.5 * kappa
        scratch.work[WORK_DENSITY, k] = 1.0 / (FOUR_PI * spread(kappa))
        scratch.work[WORK_COEFFICIENT, k] = store.lobes[region, LOBE_COEFFICIENT, k]
        scratch.work[WORK_X, k] = store.lobes[region, LOBE_X, k]
        scratch.work[WORK_Y, k] = store.lobes[region, LOBE_Y, k]
        scratch.work[WORK_Z, k] = store.lobes[region, LOBE_Z, k]
        scratch.work[WORK_WEIGHT, k] = 0.0
        scratch.work[WORK_SUM_X, k] = 0.0
        scratch.work[WORK_SUM_Y, k] = 0.0
        scratch.work[WORK_SUM_Z, k] = 0.0
    return count


@kernel
def evaluate_lobes(scratch, count, x, y, z):
    """Density of the mixture at a direction; each lobe's part goes to the scratch."""
    pdf = np.float32(0.0)
    for k in range(count):
        dx = x - scratch.work[WORK_X, k]
        dy = y - scratch.work[WORK_Y, k]
        dz = z - scratch.work[WORK_Z, k]
        falloff = scratch.work[WORK_FALLOFF, k] * (dx * dx + dy * dy + dz * dz)
        part = scratch.work[WORK_COEFFICIENT, k] * exp_nonpositive(falloff)
        scratch.work[WORK_RESPONSIBILITY, k] = part
        pdf += part
    return pdf


@kernel
def expect(scratch, count, sample_count, scale):
    """Expectation: sums of weights and directions by lobe. Returns the weighted mean of the log density.

    Directions are summed relative to the lobe's mean, which keeps narrow lobes exact in float32.
    """
    scratch.pool[0] = 0.0
    scratch.pool[1] = 0.0
    scratch.pool[2] = 0.0
    scratch.pool[3] = 0.0
    log_sum = 0.0
    weight_sum = 0.0
    for row in range(sample_count):
        x = scratch.samples[row, FIT_X]
        y = scratch.samples[row, FIT_Y]
        z = scratch.samples[row, FIT_Z]
        weight = scratch.samples[row, FIT_WEIGHT] * scale
        pdf = evaluate_lobes(scratch, count, x, y, z)
        if not pdf > UNEXPLAINED_PDF:
            scratch.pool[0] += weight
            scratch.pool[1] += weight * x
            scratch.pool[2] += weight * y
            scratch.pool[3] += weight * z
            continue
        log_sum += weight * math.log(pdf)
        weight_sum += weight
        factor = weight / pdf
        for k in range(count):
            part = scratch.work[WORK_RESPONSIBILITY, k] * factor
            scratch.work[WORK_WEIGHT, k] += part
            scratch.work[WORK_SUM_X, k] += part * (x - scratch.work[WORK_X, k])
            scratch.work[WORK_SUM_Y, k] += part * (y - scratch.work[WORK_Y, k])
            scratch.work[WORK_SUM_Z, k] += part * (z - scratch.work[WORK_Z, k])
    return log_sum / max(weight_sum, 1e-30)


@kernel
def set_lobe(store, region, k, weight, x, y, z, r, sample_weight, parameters):
    """Write a lobe from the sum of its directions (float64), of which r is the mean's length before the prior."""
    prior = parameters[PARAMETER_COSINE_PRIOR]
    r = r * sample_weight / (prior + sample_weight)
    length = math.sqrt(x * x + y * y + z * z)
    kappa = kappa_of_cosine(r, parameters[PARAMETER_MAX_KAPPA])
    if kappa < UNIFORM_KAPPA or not length > 0.0:
        kappa = 0.0
    if length > 0.0:
        store.lobes[region, LOBE_X, k] = x / length
        store.lobes[region, LOBE_Y, k] = y / length
        store.lobes[region, LOBE_Z, k] = z / length
    store.lobes[region, LOBE_KAPPA, k] = kappa
    store.lobes[region, LOBE_WEIGHT, k] = weight
    store.lobes[region, LOBE_COEFFICIENT, k] = weight / (FOUR_PI * spread(np.float32(kappa)))


@kernel
def _maximize(store, region, scratch, parameters, is_masked):
    """Maximisation with priors on weights and concentrations, over old statistics and the new sums.

    When masked, lobes that are not free stay, and the free ones share their present weight and forget older statistics.
    """
    lobe_count = np.int64(store.lobe_count[region])
    prior = parameters[PARAMETER_WEIGHT_PRIOR]
    total = 0.0
    mass = 0.0
    free_count = 0
    for k in range(lobe_count):
        is_free = not is_masked or scratch.work[WORK_IS_FREE, k] > 0.0
        if is_free:
            free_count += 1
            total += scratch.work[WORK_WEIGHT, k]
            mass += store.lobes[region, LOBE_WEIGHT, k]
            if not is_masked:
                total += store.statistics[region, STAT_WEIGHT, k]
    if not is_masked:
        mass = 1.0
    for k in range(lobe_count):
        if is_masked and not scratch.work[WORK_IS_FREE, k] > 0.0:
            continue
        new = np.float64(scratch.work[WORK_WEIGHT, k])
        weight = new
        x = np.float64(scratch.work[WORK_SUM_X, k]) + new * scratch.work[WORK_X, k]
        y = np.float64(scratch.work[WORK_SUM_Y, k]) + new * scratch.work[WORK_Y, k]
        z = np.float64(scratch.work[WORK_SUM_Z, k]) + new * scratch.work[WORK_Z, k]
        if not is_masked:
            weight += store.statistics[region, STAT_WEIGHT, k]
            x += store.statistics[region, STAT_X, k]
            y += store.statistics[region, STAT_Y, k]
            z += store.statistics[region, STAT_Z, k]
        r = min(math.sqrt(x * x + y * y + z * z) / weight, 1.0) if weight > 0.0 else 0.0
        share = mass * (prior + weight) / (prior * free_count + total)
        set_lobe(store, region, k, share, x, y, z, r, share * total / mass, parameters)


@kernel
def _add_statistics(store, region, scratch):
    """Add the last expectation's sums to what the region keeps."""
    for k in range(np.int64(store.lobe_count[region])):
        new = np.float64(scratch.work[WORK_WEIGHT, k])
        store.statistics[region, STAT_WEIGHT, k] += new
        store.statistics[region, STAT_X, k] += scratch.work[WORK_SUM_X, k] + new * scratch.work[WORK_X, k]
        store.statistics[region, STAT_Y, k] += scratch.work[WORK_SUM_Y, k] + new * scratch.work[WORK_Y, k]
        store.statistics[region, STAT_Z, k] += scratch.work[WORK_SUM_Z, k] + new * scratch.work[WORK_Z, k]


@kernel
def clear_lobe(store, region, k):
    """Make lobe k unused."""
    for row in range(LOBE_ROWS):
        store.lobes[region, row, k] = 0.0
    for row in range(STAT_ROWS):
        store.statistics[region, row, k] = 0.0
    for row in range(SPLIT_ROWS):
        store.split_statistics[region, row, k] = 0.0


@kernel
def _add_pooled_lobe(store, region, scratch, parameters):
    """Give the samples that no lobe explains one of their own; it replaces the weakest when all are in use."""
    pooled = scratch.pool[0]
    k = np.int64(store.lobe_count[region])
    if k == MAX_LOBES:
        k = np.int64(0)
        for j in range(MAX_LOBES):
            if store.lobes[region, LOBE_WEIGHT, j] < store.lobes[region, LOBE_WEIGHT, k]:
                k = np.int64(j)
    else:
        store.lobe_count[region] = k + 1
    clear_lobe(store, region, k)
    total = pooled
    for j in range(np.int64(store.lobe_count[region])):
        total += store.statistics[region, STAT_WEIGHT, j] + scratch.work[WORK_WEIGHT, j]
    share = pooled / total
    for j in range(np.int64(store.lobe_count[region])):
        store.lobes[region, LOBE_WEIGHT, j] *= 1.0 - share
        store.lobes[region, LOBE_COEFFICIENT, j] *= 1.0 - share
    x = scratch.pool[1]
    y = scratch.pool[2]
    z = scratch.pool[3]
    r = min(math.sqrt(x * x + y * y + z * z) / pooled, 1.0)
    # A first guess, wide enough to catch its samples: the next maximisation sees what it explains.
    store.lobes[region, LOBE_Z, k] = 1.0
    set_lobe(store, region, k, share, x, y, z, min(r, 0.8), pooled, parameters)


@kernel
def fit_lobes(store, region, scratch, sample_count, scale, parameters, max_iterations, is_masked):
    """Expectation and maximisation in turn until the likelihood stands still.

    Unless masked, the sums are added to the region's statistics. Returns the mean log density of the last expectation.
    """
    previous = 0.0
    log_density = 0.0
    for iteration in range(max_iterations):
        count = load_lobes(store, region, scratch)
        log_density = expect(scratch, count, sample_count, scale)
        if scratch.pool[0] > 0.0 and not is_masked and iteration + 1 < max_iterations:
            _add_pooled_lobe(store, region, scratch, parameters)
            continue
        _maximize(store, region, scratch, parameters, is_masked)
        change = abs(log_density - previous)
        if iteration > 0 and change < parameters[PARAMETER_TOLERANCE] * (1.0 + abs(log_density)):
            break
        previous = log_density
    if not is_masked:
        _add_statistics(store, region, scratch)
    return log_density
