# SPDX-License-Identifier: GPL-3.0-or-later
"""What kernels read of the SD-tree: a binary tree over space, each leaf (region) of which has a quadtree of directions.

A `SdTreeField` never changes once made: the model makes a new one at every update.

References: Müller et al. 2017, "Practical Path Guiding for Efficient Light-Transport Simulation".
"""

from __future__ import annotations

import numpy as np

from engine.array_types import Float32Array, Int32Array, Uint8Array
from engine.kernels.binary_tree import LEAF
from engine.runtime.bundle import Bundle

# Columns of SdTreeField.quad_split: shares of a node's probability, none of which is 0 or 1.
#: Share of the lower half in phi.
SPLIT_PHI = 0
#: Share of the lower half in z, within the lower half in phi (+ 0) and within the upper (+ 1).
SPLIT_Z = 1
SPLIT_WIDTH = 3

#: Entry of `quad_child` where a quadrant is not divided further; no quadrant leads back to the root, which is node 0.
QUAD_LEAF = 0


class SdTreeField(Bundle):
    """Directional quadtrees by region: N spatial nodes, R regions, Q nodes of all quadtrees together.

    A quadtree covers the unit square of (phi / 2 pi, (z + 1) / 2), world space, which preserves area. Quadrant
    i + 2 j of a node is its i-th half in phi and its j-th in z.

    node_split : float32 (N,), world coordinate along the axis: below it the lower child, else the upper
    node_link : int32 (N, 2), columns of `binary_tree`; node 0 is the root, and halves alternate down to the leaves
    bounds : float32 (2, 3), lowest and highest corner in which the field is defined
    box : float32 (2, 3), the cube around the bounds that the tree divides
    extent : float32 (R, 3), size of each region's cell
    quad_root : int32 (R,), first node of each region's quadtree
    quad_split : float32 (Q, SPLIT_WIDTH), how probability divides between a node's quadrants
    quad_child : int32 (Q, 4), node of each quadrant, counted from the region's first; QUAD_LEAF = none
    fluence : float32 (R,), incident radiance (mean over channels) integrated over all directions
    is_ready : uint8 (R,), 0 = no light seen: use the BSDF (the quadtree is uniform)
    """

    node_split: Float32Array
    node_link: Int32Array
    bounds: Float32Array
    box: Float32Array
    extent: Float32Array
    quad_root: Int32Array
    quad_split: Float32Array
    quad_child: Int32Array
    fluence: Float32Array
    is_ready: Uint8Array


def no_sdtree_field() -> SdTreeField:
    """A field of one uniform region without extent, to stand where there is none."""
    return SdTreeField(
        node_split=np.zeros(1, np.float32),
        node_link=np.array([[LEAF, 0]], np.int32),
        bounds=np.zeros((2, 3), np.float32),
        box=np.zeros((2, 3), np.float32),
        extent=np.zeros((1, 3), np.float32),
        quad_root=np.zeros(1, np.int32),
        quad_split=np.full((1, SPLIT_WIDTH), 0.5, np.float32),
        quad_child=np.full((1, 4), QUAD_LEAF, np.int32),
        fluence=np.zeros(1, np.float32),
        is_ready=np.zeros(1, np.uint8),
    )


class SdTreeGuide(Bundle):
    """What lanes sample from, L lanes.

    tree : SdTreeField
    region : int32 (L,), whose quadtree
    fluence : float32 (L,), that region's
    """

    tree: SdTreeField
    region: Int32Array
    fluence: Float32Array


def allocate_sdtree_guide(lane_count: int, field: SdTreeField) -> SdTreeGuide:
    """`SdTreeGuide` of `lane_count` lanes on a field, all in its first region; `_replace` its tree by a newer one."""
    return SdTreeGuide(field, np.zeros(lane_count, np.int32), np.zeros(lane_count, np.float32))
