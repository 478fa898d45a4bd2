# SPDX-License-Identifier: GPL-3.0-or-later
"""The state of a mixture field: tree, mixtures and what they were fitted to, as arrays and back.

Arrays may come from a file. Kernels raise nothing and check no index, and a density that is not the one directions are
drawn from would make pictures wrong. So what does not hang together is refused here.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from engine.array_types import Int32Array
from engine.guiding.fields.state import State, require, take
from engine.guiding.fields.vmm.field import (
    LOBE_COEFFICIENT,
    LOBE_INVERSE_DISTANCE,
    LOBE_KAPPA,
    LOBE_ROWS,
    LOBE_WEIGHT,
    LOBE_X,
    LOBE_Z,
    MAX_LOBES,
)
from engine.guiding.fields.vmm.store import MOMENT_WIDTH, SPLIT_ROWS, STAT_ROWS, TOTAL_WIDTH, RegionStore
from engine.guiding.fields.vmm.tree import TreeNodes
from engine.kernels.binary_tree import LEAF, NODE_AXIS, NODE_CHILD

#: How far float32 may be off where numbers follow from others.
_ROUNDING = 1e-3
#: Densities of wider lobes are those of no direction.
_LEAST_KAPPA = 1e-2


@dataclass(frozen=True)
class VmmState:
    """What a `VmmModel` knows.

    tree : TreeNodes, the nodes in use
    store : RegionStore, the regions in use
    region_leaf : int32 (R,), each region's node
    record_count : records that it was learned from
    """

    tree: TreeNodes
    store: RegionStore
    region_leaf: Int32Array
    record_count: int

    def arrays(self) -> State:
        """Copies of all arrays."""
        arrays = {
            **self.tree._asdict(),
            **self.store._asdict(),
            "region_leaf": self.region_leaf,
            "record_count": np.array([self.record_count], np.int64),
        }
        return {name: np.array(array, order="C") for name, array in arrays.items()}

    @classmethod
    def of_arrays(cls, state: State, max_kappa: float) -> VmmState:
        """The state that `arrays` gave.

        Parameters
        ----------
        state : State
        max_kappa : float
            Of the sharpest lobe that there may be.

        Raises
        ------
        StateError
            If it is none that kernels could work on.
        """
        tree = TreeNodes(
            take(state, "node_split", np.float32, (None,)),
            take(state, "node_link", np.int32, (None, 2)),
            take(state, "node_depth", np.int32, (None,)),
            take(state, "bounds", np.float32, (2, 3)),
        )
        region_leaf = take(state, "region_leaf", np.int32, (None,))
        count = len(region_leaf)
        store = RegionStore(
            take(state, "lobes", np.float32, (count, LOBE_ROWS, MAX_LOBES)),
            take(state, "lobe_count", np.int32, (count,)),
            take(state, "statistics", np.float64, (count, STAT_ROWS, MAX_LOBES)),
            take(state, "split_statistics", np.float32, (count, SPLIT_ROWS, MAX_LOBES)),
            take(state, "moments", np.float64, (count, MOMENT_WIDTH)),
            take(state, "totals", np.float64, (count, TOTAL_WIDTH)),
            take(state, "pivot", np.float32, (count, 3)),
            take(state, "is_ready", np.uint8, (count,)),
        )
        record_count = int(take(state, "record_count", np.int64, (1,))[0])
        require(record_count >= 0, "record_count is negative")
        _check_tree(tree, region_leaf)
        _check_store(store, max_kappa)
        return cls(tree, store, region_leaf, record_count)


def _check_tree(tree: TreeNodes, region_leaf: Int32Array) -> None:
    """Raise unless the nodes are one tree whose leaves have the regions, one each."""
    count = len(tree.node_split)
    require(count > 0 and len(tree.node_link) == count == len(tree.node_depth), "the tree's arrays differ in length")
    require((tree.bounds[0] <= tree.bounds[1]).all(), "bounds are not ordered")
    axis, child = tree.node_link[:, NODE_AXIS], tree.node_link[:, NODE_CHILD]
    require(((axis >= LEAF) & (axis <= 2)).all(), "the tree divides along an axis that there is not")
    is_leaf = axis == LEAF
    lower = child[~is_leaf]
    # Children come after their parents, so that every walk ends.
    require((lower > np.flatnonzero(~is_leaf)).all(), "the tree goes in circles")
    require(
        np.array_equal(np.sort(np.concatenate([lower, lower + 1])), np.arange(1, count)), "the tree is not whole"
    )
    regions = child[is_leaf]
    require(np.array_equal(np.sort(regions), np.arange(len(region_leaf))), "leaves and regions are not the same")
    require(np.array_equal(region_leaf[regions], np.flatnonzero(is_leaf)), "regions have other leaves than the tree")


def _check_store(store: RegionStore, max_kappa: float) -> None:
    """Raise unless the mixtures are densities, drawn from by the weights that they are evaluated by."""
    lobes, is_ready = store.lobes.astype(np.float64), store.is_ready != 0
    require(((store.lobe_count >= 0) & (store.lobe_count <= MAX_LOBES)).all(), "a region has too many lobes")
    is_used = np.arange(MAX_LOBES) < store.lobe_count[:, None]
    weight, kappa, coefficient = (lobes[:, row] for row in (LOBE_WEIGHT, LOBE_KAPPA, LOBE_COEFFICIENT))
    require((weight >= 0.0).all() and (weight[~is_used] == 0.0).all(), "a lobe has a weight that it must not have")
    require(
        (np.abs(weight.sum(axis=1)[is_ready] - 1.0) < _ROUNDING * MAX_LOBES).all(), "weights of lobes are not shares"
    )
    require(((kappa >= 0.0) & (kappa <= max_kappa * (1.0 + _ROUNDING))).all(), "a lobe is too sharp")
    require((coefficient[~is_used] == 0.0).all(), "a lobe that is not in use has a density")
    wide = np.maximum(kappa, _LEAST_KAPPA)
    norm = wide / (2.0 * np.pi * -np.expm1(-2.0 * wide))
    is_right = np.abs(coefficient - weight * norm) <= 2.0 * _LEAST_KAPPA * weight * norm + 1e-30
    require((is_right | ~is_used).all(), "a lobe's density is not that of its shape")
    length = np.linalg.norm(lobes[:, LOBE_X : LOBE_Z + 1], axis=1)
    require((np.abs(length - 1.0) < _ROUNDING)[is_used].all(), "a lobe's direction is none")
    require((lobes[:, LOBE_INVERSE_DISTANCE] >= 0.0).all(), "a lobe's light is at no distance")
    require((store.totals >= 0.0).all() and (store.moments[:, 0] >= 0.0).all(), "counts are negative")
