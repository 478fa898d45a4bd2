# SPDX-License-Identifier: GPL-3.0-or-later
"""The state of a mixture field: tree, mixtures and what they were fitted to, as arrays and back.

Arrays may come from a file. Kernels raise nothing and check no index, and a density that is not the one directions are
drawn from would make pictures wrong. So what does not hang together is refused here.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from engine.array_types import Float32Array, Int32Array
from engine.guiding.fields.state import MOST, State, require, take
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
from engine.guiding.fields.vmm.store import (
    MOMENT_COUNT,
    MOMENT_MEAN,
    MOMENT_SQUARED,
    MOMENT_WIDTH,
    SPLIT_ROWS,
    SPLIT_WEIGHT,
    STAT_DISTANCE_WEIGHT,
    STAT_INVERSE_DISTANCE,
    STAT_ROWS,
    STAT_WEIGHT,
    STAT_X,
    STAT_Z,
    TOTAL_COUNT,
    TOTAL_FLUENCE,
    TOTAL_WIDTH,
    RegionStore,
)
from engine.guiding.fields.vmm.tree import TreeNodes
from engine.kernels.binary_tree import LEAF, NODE_AXIS, NODE_CHILD

#: How far float32 may be off where numbers follow from others.
_ROUNDING = 1e-3
#: Densities of wider lobes are those of no direction.
_LEAST_KAPPA = 1e-2
#: Light that is nearer is at no distance [m^-1]: what follows from it is finite in float32 in any scene.
_MOST_NEARNESS = 1e12
#: Samples that anything can have seen.
_MOST_COUNT = 1e15


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
            Kappa of the sharpest lobe that there may be.

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
        _check_store(store, tree.bounds, max_kappa)
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


def _check_store(store: RegionStore, bounds: Float32Array, max_kappa: float) -> None:
    """Raise unless the mixtures are densities that are drawn from, and what they were fitted to can be gone on from."""
    for problem, is_so in _faults(store, max_kappa).items():
        require(not is_so.any(), problem)
    weight, direction = store.statistics[:, STAT_WEIGHT], store.statistics[:, STAT_X : STAT_Z + 1]
    length = np.linalg.norm(direction, axis=1)
    require((weight >= 0.0).all() and (weight <= _MOST_COUNT).all(), "a lobe has seen what it cannot have seen")
    require((length <= weight * (1.0 + _ROUNDING) + _ROUNDING).all(), "directions are longer than their weights")
    rest = store.statistics[:, STAT_DISTANCE_WEIGHT : STAT_INVERSE_DISTANCE + 1]
    require((rest >= 0.0).all(), "a lobe's light is at no distance")
    require((store.split_statistics[:, SPLIT_WEIGHT] >= 0.0).all(), "sums of weights are negative")
    count, mean = store.moments[:, MOMENT_COUNT], store.moments[:, MOMENT_MEAN:MOMENT_SQUARED]
    counts = np.concatenate([count, *store.totals[:, TOTAL_COUNT:].T])
    require((counts >= 0.0).all() and (counts <= _MOST_COUNT).all(), "counts are none")
    margin = _ROUNDING * (np.abs(bounds).max() + (bounds[1] - bounds[0]).max())
    is_ready = store.is_ready != 0
    for place in (mean[count > 0.0], store.pivot[is_ready]):
        is_inside = (place >= bounds[0] - margin) & (place <= bounds[1] + margin)
        require(is_inside.all(), "a region lies outside the bounds")
    require((store.moments[:, MOMENT_SQUARED:] >= 0.0).all(), "sums of squares are negative")


def unsound_regions(store: RegionStore, max_kappa: float) -> npt.NDArray[np.bool_]:
    """Which regions have a mixture that is no density, or that directions would be drawn from by another one, (R,)."""
    return np.logical_or.reduce(list(_faults(store, max_kappa).values()))


def _faults(store: RegionStore, max_kappa: float) -> dict[str, npt.NDArray[np.bool_]]:
    """What may be wrong with a region's mixture, and for which regions it is, (R,). Written so that NaN is wrong."""
    lobes, is_ready = store.lobes.astype(np.float64), store.is_ready != 0
    is_used = np.arange(MAX_LOBES) < store.lobe_count[:, None]
    weight, kappa, coefficient, nearness = (
        lobes[:, row] for row in (LOBE_WEIGHT, LOBE_KAPPA, LOBE_COEFFICIENT, LOBE_INVERSE_DISTANCE)
    )
    with np.errstate(all="ignore"):
        has_shares = (np.abs(weight.sum(axis=1) - 1.0) < _ROUNDING * MAX_LOBES) | ~is_ready
        wide = np.maximum(kappa, _LEAST_KAPPA)
        norm = wide / (2.0 * np.pi * -np.expm1(-2.0 * wide))
        is_right = np.abs(coefficient - weight * norm) <= 2.0 * _LEAST_KAPPA * weight * norm + 1e-30
        length = np.linalg.norm(lobes[:, LOBE_X : LOBE_Z + 1], axis=1)
        fluence = store.totals[:, TOTAL_FLUENCE] / np.maximum(store.totals[:, TOTAL_COUNT], 1.0)
        has_weights = (weight >= 0.0) & (is_used | (weight == 0.0))
        is_lobe = (kappa >= 0.0) & (kappa <= max_kappa * (1.0 + _ROUNDING))
        is_direction = (np.abs(length - 1.0) < _ROUNDING) | ~is_used
        is_near = (nearness >= 0.0) & (nearness <= _MOST_NEARNESS)
        has_fluence = (fluence >= 0.0) & (fluence <= MOST)
    return {
        "a region has too many lobes": (store.lobe_count < 0) | (store.lobe_count > MAX_LOBES),
        "a lobe has a weight that it must not have": ~has_weights.all(axis=1),
        "weights of lobes are not shares": ~has_shares,
        "a lobe is too sharp": ~is_lobe.all(axis=1),
        "a lobe that is not in use has a density": ~((coefficient == 0.0) | is_used).all(axis=1),
        "a lobe's density is not that of its shape": ~(is_right | ~is_used).all(axis=1),
        "a lobe's direction is none": ~is_direction.all(axis=1),
        "a lobe's light is at no distance": ~is_near.all(axis=1),
        "a region has no place": ~np.isfinite(store.pivot).all(axis=1),
        "a region's light is none": ~has_fluence,
    }
