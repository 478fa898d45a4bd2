# SPDX-License-Identifier: GPL-3.0-or-later
"""What a fit keeps of its regions, what it works in, and the columns and rows of both."""

from __future__ import annotations

import numpy as np

from engine.array_types import Float32Array, Int32Array, Uint8Array
from engine.guiding.fields.vmm.field import (
    LOBE_COEFFICIENT,
    LOBE_KAPPA,
    LOBE_ROWS,
    LOBE_WEIGHT,
    LOBE_X,
    LOBE_Z,
    MAX_LOBES,
)
from engine.runtime.bundle import Bundle

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
WORK_FALLOFF = 0  # -kappa / 2
WORK_COEFFICIENT = 1
WORK_X = 2
WORK_Y = 3
WORK_Z = 4
WORK_RESPONSIBILITY = 5
WORK_WEIGHT = 6  # sums of the expectation: weight, and weight * (direction - mean)
WORK_SUM_X = 7
WORK_SUM_Y = 8
WORK_SUM_Z = 9
WORK_TANGENT = 10  # 3 rows
WORK_BITANGENT = 13  # 3 rows
WORK_DENSITY = 16  # C(kappa)
WORK_DISTANCE_WEIGHT = 17
WORK_INVERSE_DISTANCE = 18
WORK_CHI = 19
WORK_XX = 20
WORK_XY = 21
WORK_YY = 22
WORK_IS_FREE = 23  # lobes that a masked fit may change
WORK_ROWS = 24

# Columns of FitScratch.samples.
FIT_X = 0
FIT_Y = 1
FIT_Z = 2
FIT_WEIGHT = 3
FIT_INVERSE_DISTANCE = 4
FIT_PDF = 5
FIT_WIDTH = 6


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
        np.zeros((sample_count, FIT_WIDTH), np.float32),
        np.zeros((WORK_ROWS, MAX_LOBES), np.float32),
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
