# SPDX-License-Identifier: GPL-3.0-or-later
"""What kernels read of the learned field: regions of a kd-tree, each with a mixture of von Mises-Fisher lobes.

A `VmmField` never changes once made: the model makes a new one at every update.
"""

from __future__ import annotations

import numpy as np

from engine.array_types import Float32Array, Int32Array, Uint8Array
from engine.kernels.binary_tree import GRID_SIDE, LEAF
from engine.runtime.bundle import Bundle

MAX_LOBES = 16
NEIGHBOR_COUNT = 8

# Rows of VmmField.lobes and of the model's own lobes. Unused lobes have weight and coefficient 0.
LOBE_WEIGHT = 0
LOBE_KAPPA = 1
LOBE_X = 2
LOBE_Y = 3
LOBE_Z = 4
#: 1 / distance to where the lobe's light comes from, seen from the pivot; 0 = infinitely far.
LOBE_INVERSE_DISTANCE = 5
#: weight * C(kappa): the lobe's share of the density at its centre.
LOBE_COEFFICIENT = 6
LOBE_ROWS = 7


class VmmField(Bundle):
    """Mixtures by region, N tree nodes and R regions.

    node_split : float32 (N,), world coordinate along the axis: below it left, else right
    node_link : int32 (N, 2), columns of `binary_tree`; node 0 is the root
    bounds : float32 (2, 3), lowest and highest corner in which the field is defined
    grid : int32 (GRID_SIDE**3,), the smallest node that contains a cell of the bounds, in C order of x, y, z
    grid_scale : float32 (3,), cells per metre
    lobes : float32 (R, LOBE_ROWS, MAX_LOBES), incident radiance at the pivot as a density [sr^-1]
    lobe_count : int32 (R,)
    pivot : float32 (R, 3), mean position of the region's samples
    fluence : float32 (R,), incident radiance (mean over channels) integrated over all directions
    is_ready : uint8 (R,), 0 = never fitted: use the BSDF
    reach : float32 (R,), how far from a point the region to guide it with is looked for, along each axis [m]
    neighbors : int32 (R, NEIGHBOR_COUNT), ready regions with the closest pivots, itself first if ready, -1 = no more
    neighbor_pivots : float32 (R, 3, NEIGHBOR_COUNT), their pivots by axis; far away where there is none
    """

    node_split: Float32Array
    node_link: Int32Array
    bounds: Float32Array
    grid: Int32Array
    grid_scale: Float32Array
    lobes: Float32Array
    lobe_count: Int32Array
    pivot: Float32Array
    fluence: Float32Array
    is_ready: Uint8Array
    reach: Float32Array
    neighbors: Int32Array
    neighbor_pivots: Float32Array


def no_field() -> VmmField:
    """A field without mixtures, to stand where there is none."""
    return VmmField(
        node_split=np.zeros(1, np.float32),
        node_link=np.full((1, 2), LEAF, np.int32),
        bounds=np.zeros((2, 3), np.float32),
        grid=np.zeros(GRID_SIDE**3, np.int32),
        grid_scale=np.zeros(3, np.float32),
        lobes=np.zeros((1, LOBE_ROWS, MAX_LOBES), np.float32),
        lobe_count=np.zeros(1, np.int32),
        pivot=np.zeros((1, 3), np.float32),
        fluence=np.zeros(1, np.float32),
        is_ready=np.zeros(1, np.uint8),
        reach=np.zeros(1, np.float32),
        neighbors=np.full((1, NEIGHBOR_COUNT), -1, np.int32),
        neighbor_pivots=np.zeros((1, 3, NEIGHBOR_COUNT), np.float32),
    )


# Rows of GuideLobes.lobes
GUIDE_COEFFICIENT = 0
GUIDE_KAPPA = 1
GUIDE_X = 2
GUIDE_Y = 3
GUIDE_Z = 4
GUIDE_WEIGHT = 5
GUIDE_ROWS = 6
#: Cache lines of a lane's lobes.
GUIDE_LINES = GUIDE_ROWS * MAX_LOBES * 4 // 64

# Columns of GuideLobes.cosine: the lobe multiplied in, and what turns the density back into incident radiance.
COSINE_NORMAL = 0
COSINE_KAPPA = 3
COSINE_RADIANCE = 4
COSINE_FLUENCE = 5
COSINE_WIDTH = 6


class GuideLobes(Bundle):
    """Mixtures ready for sampling at given points, L lanes.

    lobes : float32 (L, GUIDE_ROWS, K), K a multiple of 8; unused lobes have weight and coefficient 0
    count : int32 (L,), lobes to look at, a multiple of 8
    cosine : float32 (L, COSINE_WIDTH)
    """

    lobes: Float32Array
    count: Int32Array
    cosine: Float32Array


def allocate_guide(lane_count: int) -> GuideLobes:
    """Zeroed `GuideLobes` for `lane_count` lanes."""
    return GuideLobes(
        np.zeros((lane_count, GUIDE_ROWS, MAX_LOBES), np.float32),
        np.zeros(lane_count, np.int32),
        np.zeros((lane_count, COSINE_WIDTH), np.float32),
    )
