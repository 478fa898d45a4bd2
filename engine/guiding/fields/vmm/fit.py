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

from engine.guiding.fields.vmm.expectation import fit_lobes, gather_samples
from engine.guiding.fields.vmm.field import LOBE_INVERSE_DISTANCE, LOBE_ROWS, LOBE_X, LOBE_Y, LOBE_Z, MAX_LOBES
from engine.guiding.fields.vmm.splitting import merge_lobes, observe_lobes, settle_split, split_lobes
from engine.guiding.fields.vmm.store import (
    MOMENT_MEAN,
    PARAMETER_DECAY,
    PARAMETER_FIRST_ITERATIONS,
    PARAMETER_INITIAL_LOBES,
    PARAMETER_MAX_ITERATIONS,
    PARAMETER_MERGE_INTERVAL,
    PARAMETER_MIN_SAMPLES,
    PARAMETER_REFIT_ITERATIONS,
    PARAMETER_SPLIT_INTERVAL,
    PARAMETER_STATISTICS_LIMIT,
    SPLIT_ROWS,
    STAT_INVERSE_DISTANCE,
    STAT_ROWS,
    STAT_WEIGHT,
    STAT_X,
    STAT_Y,
    STAT_Z,
    TOTAL_COUNT,
    TOTAL_FLUENCE,
    TOTAL_SINCE_MERGE,
    TOTAL_SINCE_SPLIT,
    TOTAL_WIDTH,
)
from engine.runtime.jit import kernel


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
                settle_split(store, region, scratch)
                break
            observe_lobes(store, region, scratch, count, scale, all_count)
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
