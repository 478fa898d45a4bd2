# SPDX-License-Identifier: GPL-3.0-or-later
"""Fitting one region's mixture to the samples of an iteration: weighted MAP-EM, split, merge, distances.

A region keeps the sufficient statistics of what it has seen; every iteration's samples are added to them and the older
ones fade. A fit reads nothing outside its region and goes through samples in their order, so results do not depend on
who computes what when.

References: Ruppert et al. 2020, "Robust Fitting of Parallax-Aware Mixtures for Path Guiding", sections 4 and 5.
"""

from __future__ import annotations

import math

import numpy as np

from engine.array_types import Float32Array, Int32Array, Uint8Array
from engine.guiding.fields.vmm.field import (
    LOBE_COEFFICIENT,
    LOBE_INVERSE_DISTANCE,
    LOBE_KAPPA,
    LOBE_ROWS,
    LOBE_WEIGHT,
    LOBE_X,
    LOBE_Y,
    LOBE_Z,
    MAX_LOBES,
)
from engine.guiding.fields.vmm.numeric import UNIFORM_KAPPA, exp_nonpositive, spread
from engine.kernels.constants import FLOAT_MAX
from engine.kernels.vector import orthonormal_basis
from engine.runtime.bundle import Bundle
from engine.runtime.jit import kernel

_FOUR_PI = np.float32(4.0 * np.pi)

# Columns of the samples of a batch, sorted by region.
SAMPLE_P = 0
SAMPLE_DIRECTION = 3
SAMPLE_DISTANCE = 6
SAMPLE_PDF = 7
#: Incident radiance (mean over channels) / pdf.
SAMPLE_WEIGHT = 8
#: Up to four channels.
SAMPLE_RADIANCE = 9
SAMPLE_WIDTH = 13

# Rows of RegionStore.statistics, sums over what a region has seen, in units of samples.
STAT_WEIGHT = 0
#: Weighted sum of directions.
STAT_X = 1
STAT_Y = 2
STAT_Z = 3
#: Numerator and denominator of the inverse distance.
STAT_DISTANCE_WEIGHT = 4
STAT_INVERSE_DISTANCE = 5
STAT_ROWS = 6

# Rows of RegionStore.split_statistics: sums since the last check for splits.
SPLIT_CHI = 0
SPLIT_WEIGHT = 1
#: Second moments in the tangent plane at the lobe's mean.
SPLIT_XX = 2
SPLIT_XY = 3
SPLIT_YY = 4
SPLIT_ROWS = 5

# Columns of RegionStore.moments: samples in the leaf since it was made, their mean, squared deviations.
MOMENT_COUNT = 0
MOMENT_MEAN = 1
MOMENT_SQUARED = 4
MOMENT_WIDTH = 7

# Columns of RegionStore.totals.
#: Sum of sample weights (incident radiance / pdf), and of samples, the black ones included.
TOTAL_FLUENCE = 0
TOTAL_COUNT = 1
#: Samples since the last check for splits and merges.
TOTAL_SINCE_SPLIT = 2
TOTAL_SINCE_MERGE = 3
TOTAL_WIDTH = 4

# Entries of the parameter array.
PARAMETER_MAX_ITERATIONS = 0
PARAMETER_FIRST_ITERATIONS = 1
PARAMETER_TOLERANCE = 2
PARAMETER_INITIAL_LOBES = 3
PARAMETER_INITIAL_KAPPA = 4
PARAMETER_WEIGHT_PRIOR = 5
PARAMETER_COSINE_PRIOR = 6
PARAMETER_MAX_KAPPA = 7
PARAMETER_SPLIT_THRESHOLD = 8
PARAMETER_SPLIT_INTERVAL = 9
PARAMETER_MERGE_THRESHOLD = 10
PARAMETER_MERGE_INTERVAL = 11
PARAMETER_REFIT_ITERATIONS = 12
PARAMETER_MIN_SAMPLES = 13
#: Older statistics are multiplied by this at every update, and never stand for more samples than the limit.
PARAMETER_DECAY = 14
PARAMETER_STATISTICS_LIMIT = 15
#: A sample brighter than all but three others may hold this share of a batch's weight, no more.
PARAMETER_WEIGHT_SHARE = 16
PARAMETER_MIN_PDF = 17
PARAMETER_WIDTH = 18

#: A sample this unlikely under all lobes is evidence for a new one.
_UNEXPLAINED_PDF = np.float32(1e-16)
_EIGENVALUE_GAP = np.float32(1e-8)
#: Lobes narrower than this share of the largest kappa are not split.
_SPLIT_KAPPA_SHARE = np.float32(0.9)


class RegionStore(Bundle):
    """The model's own account of its regions, R rows of which the first are in use.

    lobes : float32 (R, LOBE_ROWS, MAX_LOBES)
    lobe_count : int32 (R,)
    statistics : float64 (R, STAT_ROWS, MAX_LOBES)
    split_statistics : float32 (R, SPLIT_ROWS, MAX_LOBES)
    moments : float64 (R, MOMENT_WIDTH)
    totals : float64 (R, TOTAL_WIDTH)
    pivot : float32 (R, 3)
    is_ready : uint8 (R,)
    """

    lobes: Float32Array
    lobe_count: Int32Array
    statistics: np.ndarray
    split_statistics: Float32Array
    moments: np.ndarray
    totals: np.ndarray
    pivot: Float32Array
    is_ready: Uint8Array


def allocate_store(row_count: int) -> RegionStore:
    """Zeroed `RegionStore`."""
    return RegionStore(
        np.zeros((row_count, LOBE_ROWS, MAX_LOBES), np.float32),
        np.zeros(row_count, np.int32),
        np.zeros((row_count, STAT_ROWS, MAX_LOBES), np.float64),
        np.zeros((row_count, SPLIT_ROWS, MAX_LOBES), np.float32),
        np.zeros((row_count, MOMENT_WIDTH), np.float64),
        np.zeros((row_count, TOTAL_WIDTH), np.float64),
        np.zeros((row_count, 3), np.float32),
        np.zeros(row_count, np.uint8),
    )


# Rows of FitScratch.work.
_WORK_FALLOFF = 0  # -kappa / 2
_WORK_COEFFICIENT = 1
_WORK_X = 2
_WORK_Y = 3
_WORK_Z = 4
_WORK_RESPONSIBILITY = 5
_WORK_WEIGHT = 6  # sums of the expectation: weight, and weight * (direction - mean)
_WORK_SUM_X = 7
_WORK_SUM_Y = 8
_WORK_SUM_Z = 9
_WORK_TANGENT = 10  # 3 rows
_WORK_BITANGENT = 13  # 3 rows
_WORK_DENSITY = 16  # C(kappa)
_WORK_DISTANCE_WEIGHT = 17
_WORK_INVERSE_DISTANCE = 18
_WORK_CHI = 19
_WORK_XX = 20
_WORK_XY = 21
_WORK_YY = 22
_WORK_IS_FREE = 23  # lobes that a masked fit may change
_WORK_ROWS = 24

# Columns of FitScratch.samples.
_FIT_X = 0
_FIT_Y = 1
_FIT_Z = 2
_FIT_WEIGHT = 3
_FIT_INVERSE_DISTANCE = 4
_FIT_PDF = 5
_FIT_WIDTH = 6


class FitScratch(Bundle):
    """One thread's workspace.

    samples : float32 (S, 6), the region's samples that are not black, as seen from its pivot
    work : float32 (24, MAX_LOBES)
    merge_cost : float32 (MAX_LOBES, MAX_LOBES)
    pool : float64 (4,), weight and weighted directions of samples that no lobe explains
    """

    samples: Float32Array
    work: Float32Array
    merge_cost: Float32Array
    pool: np.ndarray


def allocate_scratch(sample_count: int) -> FitScratch:
    """`FitScratch` for regions of at most `sample_count` samples."""
    return FitScratch(
        np.zeros((sample_count, _FIT_WIDTH), np.float32),
        np.zeros((_WORK_ROWS, MAX_LOBES), np.float32),
        np.zeros((MAX_LOBES, MAX_LOBES), np.float32),
        np.zeros(4, np.float64),
    )


def _fibonacci_directions(count: int) -> np.ndarray:
    """Evenly spread unit directions, float32 (count, 3)."""
    k = np.arange(count) + 0.5
    z = 1.0 - 2.0 * k / count
    phi = np.pi * (1.0 + np.sqrt(5.0)) * k
    sine = np.sqrt(1.0 - z**2)
    return np.stack([sine * np.cos(phi), sine * np.sin(phi), z], 1).astype(np.float32)


def start_mixture(lobe_count: int, kappa: float) -> Float32Array:
    """Lobes of a region that knows nothing yet, evenly spread: float32 (LOBE_ROWS, MAX_LOBES)."""
    lobes = np.zeros((LOBE_ROWS, MAX_LOBES), np.float32)
    lobes[LOBE_WEIGHT, :lobe_count] = 1.0 / lobe_count
    lobes[LOBE_KAPPA, :lobe_count] = kappa
    lobes[LOBE_X : LOBE_Z + 1, :lobe_count] = _fibonacci_directions(lobe_count).T
    lobes[LOBE_COEFFICIENT, :lobe_count] = kappa / (2.0 * np.pi * -np.expm1(-2.0 * kappa)) / lobe_count
    return lobes


@kernel
def _kappa_of_cosine(r, max_kappa):
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
                inverse_distance = 1.0 / math.sqrt(squared)
                x = ex * inverse_distance
                y = ey * inverse_distance
                z = ez * inverse_distance
        scratch.samples[count, _FIT_X] = x
        scratch.samples[count, _FIT_Y] = y
        scratch.samples[count, _FIT_Z] = z
        scratch.samples[count, _FIT_WEIGHT] = weight
        scratch.samples[count, _FIT_INVERSE_DISTANCE] = inverse_distance
        scratch.samples[count, _FIT_PDF] = batch[row, SAMPLE_PDF]
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
    total -= max(top_a - fourth, 0.0) + max(top_b - fourth, 0.0) + max(top_c - fourth, 0.0) + max(top_d - fourth, 0.0)
    limit = max(fourth, parameters[PARAMETER_WEIGHT_SHARE] * total)
    total = 0.0
    for k in range(count):
        scratch.samples[k, _FIT_WEIGHT] = min(np.float64(scratch.samples[k, _FIT_WEIGHT]), limit)
        total += np.float64(scratch.samples[k, _FIT_WEIGHT])
    return count, total


@kernel
def _load_lobes(store, region, scratch):
    """Prepare the scratch for an expectation: constants of the lobes, zeroed sums. Returns the padded lobe count."""
    count = (np.int64(store.lobe_count[region]) + 7) & ~7
    for k in range(count):
        kappa = store.lobes[region, LOBE_KAPPA, k]
        scratch.work[_WORK_FALLOFF, k] = -0.5 * kappa
        scratch.work[_WORK_DENSITY, k] = 1.0 / (_FOUR_PI * spread(kappa))
        scratch.work[_WORK_COEFFICIENT, k] = store.lobes[region, LOBE_COEFFICIENT, k]
        scratch.work[_WORK_X, k] = store.lobes[region, LOBE_X, k]
        scratch.work[_WORK_Y, k] = store.lobes[region, LOBE_Y, k]
        scratch.work[_WORK_Z, k] = store.lobes[region, LOBE_Z, k]
        scratch.work[_WORK_WEIGHT, k] = 0.0
        scratch.work[_WORK_SUM_X, k] = 0.0
        scratch.work[_WORK_SUM_Y, k] = 0.0
        scratch.work[_WORK_SUM_Z, k] = 0.0
    return count


@kernel
def _evaluate_lobes(scratch, count, x, y, z):
    """Density of the mixture at a direction; each lobe's part goes to the scratch."""
    pdf = np.float32(0.0)
    for k in range(count):
        dx = x - scratch.work[_WORK_X, k]
        dy = y - scratch.work[_WORK_Y, k]
        dz = z - scratch.work[_WORK_Z, k]
        falloff = scratch.work[_WORK_FALLOFF, k] * (dx * dx + dy * dy + dz * dz)
        part = scratch.work[_WORK_COEFFICIENT, k] * exp_nonpositive(falloff)
        scratch.work[_WORK_RESPONSIBILITY, k] = part
        pdf += part
    return pdf


@kernel
def _expect(scratch, count, sample_count, scale):
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
        x = scratch.samples[row, _FIT_X]
        y = scratch.samples[row, _FIT_Y]
        z = scratch.samples[row, _FIT_Z]
        weight = scratch.samples[row, _FIT_WEIGHT] * scale
        pdf = _evaluate_lobes(scratch, count, x, y, z)
        if not pdf > _UNEXPLAINED_PDF:
            scratch.pool[0] += weight
            scratch.pool[1] += weight * x
            scratch.pool[2] += weight * y
            scratch.pool[3] += weight * z
            continue
        log_sum += weight * math.log(pdf)
        weight_sum += weight
        factor = weight / pdf
        for k in range(count):
            part = scratch.work[_WORK_RESPONSIBILITY, k] * factor
            scratch.work[_WORK_WEIGHT, k] += part
            scratch.work[_WORK_SUM_X, k] += part * (x - scratch.work[_WORK_X, k])
            scratch.work[_WORK_SUM_Y, k] += part * (y - scratch.work[_WORK_Y, k])
            scratch.work[_WORK_SUM_Z, k] += part * (z - scratch.work[_WORK_Z, k])
    return log_sum / max(weight_sum, 1e-30)


@kernel
def _set_lobe(store, region, k, weight, x, y, z, r, sample_weight, parameters):
    """Write a lobe from the sum of its directions (float64), of which r is the mean's length before the prior."""
    prior = parameters[PARAMETER_COSINE_PRIOR]
    r = r * sample_weight / (prior + sample_weight)
    length = math.sqrt(x * x + y * y + z * z)
    kappa = _kappa_of_cosine(r, parameters[PARAMETER_MAX_KAPPA])
    if kappa < UNIFORM_KAPPA or not length > 0.0:
        kappa = 0.0
    if length > 0.0:
        store.lobes[region, LOBE_X, k] = x / length
        store.lobes[region, LOBE_Y, k] = y / length
        store.lobes[region, LOBE_Z, k] = z / length
    store.lobes[region, LOBE_KAPPA, k] = kappa
    store.lobes[region, LOBE_WEIGHT, k] = weight
    store.lobes[region, LOBE_COEFFICIENT, k] = weight / (_FOUR_PI * spread(np.float32(kappa)))


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
        is_free = not is_masked or scratch.work[_WORK_IS_FREE, k] > 0.0
        if is_free:
            free_count += 1
            total += scratch.work[_WORK_WEIGHT, k]
            mass += store.lobes[region, LOBE_WEIGHT, k]
            if not is_masked:
                total += store.statistics[region, STAT_WEIGHT, k]
    if not is_masked:
        mass = 1.0
    for k in range(lobe_count):
        if is_masked and not scratch.work[_WORK_IS_FREE, k] > 0.0:
            continue
        new = np.float64(scratch.work[_WORK_WEIGHT, k])
        weight = new
        x = np.float64(scratch.work[_WORK_SUM_X, k]) + new * scratch.work[_WORK_X, k]
        y = np.float64(scratch.work[_WORK_SUM_Y, k]) + new * scratch.work[_WORK_Y, k]
        z = np.float64(scratch.work[_WORK_SUM_Z, k]) + new * scratch.work[_WORK_Z, k]
        if not is_masked:
            weight += store.statistics[region, STAT_WEIGHT, k]
            x += store.statistics[region, STAT_X, k]
            y += store.statistics[region, STAT_Y, k]
            z += store.statistics[region, STAT_Z, k]
        r = min(math.sqrt(x * x + y * y + z * z) / weight, 1.0) if weight > 0.0 else 0.0
        share = mass * (prior + weight) / (prior * free_count + total)
        _set_lobe(store, region, k, share, x, y, z, r, share * total / mass, parameters)


@kernel
def _add_statistics(store, region, scratch):
    """Add the last expectation's sums to what the region keeps."""
    for k in range(np.int64(store.lobe_count[region])):
        new = np.float64(scratch.work[_WORK_WEIGHT, k])
        store.statistics[region, STAT_WEIGHT, k] += new
        store.statistics[region, STAT_X, k] += scratch.work[_WORK_SUM_X, k] + new * scratch.work[_WORK_X, k]
        store.statistics[region, STAT_Y, k] += scratch.work[_WORK_SUM_Y, k] + new * scratch.work[_WORK_Y, k]
        store.statistics[region, STAT_Z, k] += scratch.work[_WORK_SUM_Z, k] + new * scratch.work[_WORK_Z, k]


@kernel
def _clear_lobe(store, region, k):
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
        k = 0
        for j in range(MAX_LOBES):
            if store.lobes[region, LOBE_WEIGHT, j] < store.lobes[region, LOBE_WEIGHT, k]:
                k = j
    else:
        store.lobe_count[region] = k + 1
    _clear_lobe(store, region, k)
    total = pooled
    for j in range(np.int64(store.lobe_count[region])):
        total += store.statistics[region, STAT_WEIGHT, j] + scratch.work[_WORK_WEIGHT, j]
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
    _set_lobe(store, region, k, share, x, y, z, min(r, 0.8), pooled, parameters)


@kernel
def fit_lobes(store, region, scratch, sample_count, scale, parameters, max_iterations, is_masked):
    """Expectation and maximisation in turn until the likelihood stands still.

    Unless masked, the sums are added to the region's statistics. Returns the mean log density of the last expectation.
    """
    previous = 0.0
    log_density = 0.0
    for iteration in range(max_iterations):
        count = _load_lobes(store, region, scratch)
        log_density = _expect(scratch, count, sample_count, scale)
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


@kernel
def _observe_lobes(store, region, scratch, sample_count, scale, all_count):
    """Add to the region's sums for distances and splits what the samples say of the lobes as they are now.

    The divergence of a lobe is the chi-square of what it stands for, sum over samples of L^2 f / (I^2 p^2 q) - ...
    (Ruppert et al. 2020, Eq. 26); at a maximum the other terms are the lobe's weight.
    """
    count = _load_lobes(store, region, scratch)
    for k in range(count):
        mean = (scratch.work[_WORK_X, k], scratch.work[_WORK_Y, k], scratch.work[_WORK_Z, k])
        tangent, bitangent = orthonormal_basis(mean)
        for axis in range(3):
            scratch.work[_WORK_TANGENT + axis, k] = tangent[axis]
            scratch.work[_WORK_BITANGENT + axis, k] = bitangent[axis]
        for row in range(_WORK_DISTANCE_WEIGHT, _WORK_YY + 1):
            scratch.work[row, k] = 0.0
    total = np.float32(0.0)
    for row in range(sample_count):
        total += scratch.samples[row, _FIT_WEIGHT]
    unit = np.float32(1.0) / total
    for row in range(sample_count):
        x = scratch.samples[row, _FIT_X]
        y = scratch.samples[row, _FIT_Y]
        z = scratch.samples[row, _FIT_Z]
        pdf = _evaluate_lobes(scratch, count, x, y, z)
        if not pdf > _UNEXPLAINED_PDF:
            continue
        weight = scratch.samples[row, _FIT_WEIGHT]
        inverse_distance = scratch.samples[row, _FIT_INVERSE_DISTANCE]
        factor = weight * scale / pdf
        relative = weight * unit
        chi_factor = relative * relative * scratch.samples[row, _FIT_PDF] / (pdf * pdf)
        for k in range(count):
            responsibility = scratch.work[_WORK_RESPONSIBILITY, k]
            part = responsibility * factor
            density = part * responsibility * scratch.work[_WORK_DENSITY, k]
            coefficient = scratch.work[_WORK_COEFFICIENT, k]
            density = density / coefficient if coefficient > 0.0 else np.float32(0.0)
            u = (
                scratch.work[_WORK_TANGENT, k] * x
                + scratch.work[_WORK_TANGENT + 1, k] * y
                + scratch.work[_WORK_TANGENT + 2, k] * z
            )
            v = (
                scratch.work[_WORK_BITANGENT, k] * x
                + scratch.work[_WORK_BITANGENT + 1, k] * y
                + scratch.work[_WORK_BITANGENT + 2, k] * z
            )
            scratch.work[_WORK_WEIGHT, k] += part
            scratch.work[_WORK_DISTANCE_WEIGHT, k] += density
            scratch.work[_WORK_INVERSE_DISTANCE, k] += density * inverse_distance
            scratch.work[_WORK_CHI, k] += responsibility * chi_factor
            scratch.work[_WORK_XX, k] += part * u * u
            scratch.work[_WORK_XY, k] += part * u * v
            scratch.work[_WORK_YY, k] += part * v * v
    for k in range(np.int64(store.lobe_count[region])):
        store.statistics[region, STAT_DISTANCE_WEIGHT, k] += scratch.work[_WORK_DISTANCE_WEIGHT, k]
        store.statistics[region, STAT_INVERSE_DISTANCE, k] += scratch.work[_WORK_INVERSE_DISTANCE, k]
        known = store.statistics[region, STAT_DISTANCE_WEIGHT, k]
        store.lobes[region, LOBE_INVERSE_DISTANCE, k] = (
            store.statistics[region, STAT_INVERSE_DISTANCE, k] / known if known > 1e-30 else 0.0
        )
        # Sums of squared shares of a batch's weight, times its samples, are means; times its samples again, sums.
        chi = scratch.work[_WORK_CHI, k] * np.float32(all_count)
        store.split_statistics[region, SPLIT_CHI, k] += np.float32(all_count) * (
            chi - store.lobes[region, LOBE_WEIGHT, k]
        )
        store.split_statistics[region, SPLIT_WEIGHT, k] += scratch.work[_WORK_WEIGHT, k]
        store.split_statistics[region, SPLIT_XX, k] += scratch.work[_WORK_XX, k]
        store.split_statistics[region, SPLIT_XY, k] += scratch.work[_WORK_XY, k]
        store.split_statistics[region, SPLIT_YY, k] += scratch.work[_WORK_YY, k]


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
        _set_lobe(store, region, lobe, share, np.float64(x), np.float64(y), np.float64(z), r, half, parameters)
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
        scratch.work[_WORK_IS_FREE, k] = 0.0
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
            scratch.work[_WORK_IS_FREE, worst] = 1.0
            scratch.work[_WORK_IS_FREE, other] = 1.0
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
    return math.log(np.float64(_FOUR_PI) * np.float64(spread(np.float32(length)))), length


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
    kappa = _kappa_of_cosine(r, parameters[PARAMETER_MAX_KAPPA])
    scale = kappa / r if r > 0.0 else 0.0
    log_norm = -math.log(np.float64(_FOUR_PI) * np.float64(spread(np.float32(kappa)))) - kappa
    cost = 0.0
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
        norm_a = -math.log(np.float64(_FOUR_PI) * np.float64(spread(np.float32(kappa_a)))) - kappa_a
        norm_b = -math.log(np.float64(_FOUR_PI) * np.float64(spread(np.float32(kappa_b)))) - kappa_b
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
    _set_lobe(store, region, i, weight, x, y, z, r, seen, parameters)
    store.lobes[region, LOBE_INVERSE_DISTANCE, i] = (inverse_i + inverse_j) / weight if weight > 0.0 else 0.0
    last = np.int64(store.lobe_count[region]) - 1
    for row in range(LOBE_ROWS):
        store.lobes[region, row, j] = store.lobes[region, row, last]
    for row in range(STAT_ROWS):
        store.statistics[region, row, j] = store.statistics[region, row, last]
    for row in range(SPLIT_ROWS):
        store.split_statistics[region, row, j] = store.split_statistics[region, row, last]
    _clear_lobe(store, region, last)
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
def move_pivot(store, region):
    """Move a region's pivot to its samples' mean; lobes and their statistics turn to keep pointing to their light."""
    x = np.float32(store.moments[region, MOMENT_MEAN])
    y = np.float32(store.moments[region, MOMENT_MEAN + 1])
    z = np.float32(store.moments[region, MOMENT_MEAN + 2])
    offset_x = store.pivot[region, 0] - x
    offset_y = store.pivot[region, 1] - y
    offset_z = store.pivot[region, 2] - z
    for k in range(np.int64(store.lobe_count[region])):
        inverse_distance = store.lobes[region, LOBE_INVERSE_DISTANCE, k]
        if inverse_distance <= 0.0:
            continue
        mx = store.lobes[region, LOBE_X, k] + offset_x * inverse_distance
        my = store.lobes[region, LOBE_Y, k] + offset_y * inverse_distance
        mz = store.lobes[region, LOBE_Z, k] + offset_z * inverse_distance
        squared = mx * mx + my * my + mz * mz
        if not (squared > 1e-2 and squared < 1e4):
            continue
        scale = 1.0 / math.sqrt(squared)
        store.lobes[region, LOBE_X, k] = mx * scale
        store.lobes[region, LOBE_Y, k] = my * scale
        store.lobes[region, LOBE_Z, k] = mz * scale
        store.lobes[region, LOBE_INVERSE_DISTANCE, k] = inverse_distance * scale
        store.statistics[region, STAT_INVERSE_DISTANCE, k] *= scale
        sx = store.statistics[region, STAT_X, k]
        sy = store.statistics[region, STAT_Y, k]
        sz = store.statistics[region, STAT_Z, k]
        seen = math.sqrt(sx * sx + sy * sy + sz * sz)
        store.statistics[region, STAT_X, k] = seen * store.lobes[region, LOBE_X, k]
        store.statistics[region, STAT_Y, k] = seen * store.lobes[region, LOBE_Y, k]
        store.statistics[region, STAT_Z, k] = seen * store.lobes[region, LOBE_Z, k]
    store.pivot[region, 0] = x
    store.pivot[region, 1] = y
    store.pivot[region, 2] = z


@kernel
def fade_region(store, region, factor):
    """Multiply what a region has seen by `factor`."""
    for row in range(STAT_ROWS):
        for k in range(MAX_LOBES):
            store.statistics[region, row, k] *= factor
    store.totals[region, TOTAL_FLUENCE] *= factor
    store.totals[region, TOTAL_COUNT] *= factor


@kernel
def _settle_split(store, region, scratch):
    """Give lobes just split and fitted the statistics that they stand for."""
    mass = 0.0
    total = 0.0
    for k in range(np.int64(store.lobe_count[region])):
        if scratch.work[_WORK_IS_FREE, k] > 0.0:
            mass += store.lobes[region, LOBE_WEIGHT, k]
            total += store.statistics[region, STAT_WEIGHT, k]
    for k in range(np.int64(store.lobe_count[region])):
        if scratch.work[_WORK_IS_FREE, k] > 0.0 and mass > 0.0:
            store.statistics[region, STAT_WEIGHT, k] = total * store.lobes[region, LOBE_WEIGHT, k] / mass
            _statistics_from_lobe(store, region, k)


@kernel
def fit_regions(batch, rows, regions, first, last, store, start_lobes, parameters, scratch):
    """Learn from a sorted batch: the part of an update that one thread does.

    Parameters
    ----------
    batch : float32 (M, SAMPLE_WIDTH)
    rows : int64 (regions, 2), each region's rows of the batch
    regions : int32 (B,), regions to fit: entries [first, last)
    store : RegionStore
    start_lobes : float32 (LOBE_ROWS, MAX_LOBES), of `start_mixture`
    parameters : float64 (PARAMETER_WIDTH,)
    scratch : FitScratch
    """
    for entry in range(first, last):
        region = np.int64(regions[entry])
        start = rows[region, 0]
        stop = rows[region, 1]
        all_count = stop - start
        move_pivot(store, region)
        count, weight_sum = gather_samples(batch, start, stop, store, region, parameters, scratch)
        known = 0.0
        for k in range(np.int64(store.lobe_count[region])):
            known += store.statistics[region, STAT_WEIGHT, k]
        limit = parameters[PARAMETER_STATISTICS_LIMIT] / max(known, 1.0)
        fade_region(store, region, min(parameters[PARAMETER_DECAY], limit))
        store.totals[region, TOTAL_FLUENCE] += weight_sum
        store.totals[region, TOTAL_COUNT] += all_count
        is_new = store.is_ready[region] == 0
        if count == 0 or (is_new and count < parameters[PARAMETER_MIN_SAMPLES]):
            continue
        iterations = parameters[PARAMETER_MAX_ITERATIONS]
        if is_new:
            for row in range(LOBE_ROWS):
                for k in range(MAX_LOBES):
                    store.lobes[region, row, k] = start_lobes[row, k]
            store.lobe_count[region] = np.int64(parameters[PARAMETER_INITIAL_LOBES])
            store.is_ready[region] = 1
            iterations = parameters[PARAMETER_FIRST_ITERATIONS]

        # Every batch counts by its samples, whatever their radiance.
        scale = np.float32(count / weight_sum)
        is_masked = False
        for _stage in range(2):
            fit_lobes(store, region, scratch, count, scale, parameters, np.int64(iterations), is_masked)
            if is_masked:
                _settle_split(store, region, scratch)
                break
            _observe_lobes(store, region, scratch, count, scale, all_count)
            store.totals[region, TOTAL_SINCE_SPLIT] += all_count
            if store.totals[region, TOTAL_SINCE_SPLIT] < parameters[PARAMETER_SPLIT_INTERVAL]:
                break
            split_count = split_lobes(store, region, scratch, store.totals[region, TOTAL_SINCE_SPLIT], parameters)
            store.totals[region, TOTAL_SINCE_SPLIT] = 0.0
            # The new lobes are fitted to the samples at hand, all others fixed.
            is_masked = True
            iterations = parameters[PARAMETER_REFIT_ITERATIONS]
            if split_count == 0:
                break
        store.totals[region, TOTAL_SINCE_MERGE] += all_count
        if store.totals[region, TOTAL_SINCE_MERGE] >= parameters[PARAMETER_MERGE_INTERVAL]:
            merge_lobes(store, region, scratch, parameters)
            store.totals[region, TOTAL_SINCE_MERGE] = 0.0


@kernel
def copy_regions(store, split_log, share):
    """Give regions made by a cut their parent's mixture; both keep `share` of what it has seen.

    Parameters
    ----------
    store : RegionStore
    split_log : int32 (S, 2), new region and its parent, in the order of the cuts
    share : float
    """
    for k in range(split_log.shape[0]):
        region = split_log[k, 0]
        parent = split_log[k, 1]
        fade_region(store, parent, share)
        for lobe in range(MAX_LOBES):
            for row in range(LOBE_ROWS):
                store.lobes[region, row, lobe] = store.lobes[parent, row, lobe]
            for row in range(STAT_ROWS):
                store.statistics[region, row, lobe] = store.statistics[parent, row, lobe]
            for row in range(SPLIT_ROWS):
                store.split_statistics[region, row, lobe] = 0.0
                store.split_statistics[parent, row, lobe] = 0.0
        for column in range(TOTAL_WIDTH):
            store.totals[region, column] = store.totals[parent, column]
        store.lobe_count[region] = store.lobe_count[parent]
        store.is_ready[region] = store.is_ready[parent]
        for axis in range(3):
            store.pivot[region, axis] = store.pivot[parent, axis]
