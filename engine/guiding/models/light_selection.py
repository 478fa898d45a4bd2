# SPDX-License-Identifier: GPL-3.0-or-later
"""Which lights each region samples: learned, so that lamps in other rooms and sky behind walls are left alone.

Surfaces of a region that face different ways see different lights, so each of six directions has moments of its own, a
*row*. It has few records, so what the whole region has found stands for some more.

A light sample chooses a cluster k with probability P_k, then a point on its lights. With M_k the second moment of what
the point brings to the image, visibility included, the sample has the second moment sum of M_k / P_k, which is least
where P_k is in proportion to the square root of M_k. A record of contribution c, its cluster chosen with P_k, adds
c^2 P_k to the estimate of M_k, however P_k was learned. The probabilities are made from earlier iterations only, and
those of no cluster are 0 that the light tree would choose, so the expected image does not change.

References: Vevoda, Kondapaneni and Krivanek 2018, "Bayesian Online Regression for Adaptive Direct Illumination
Sampling"; moments instead of means as in Rath et al. 2020, "Variance-Aware Path Guiding".
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import numpy.typing as npt

from engine.array_types import Float32Array, Int32Array
from engine.guiding.fields.update import grown
from engine.guiding.fields.vmm.regions import RegionTree
from engine.guiding.records.vertices import VertexRecords
from engine.kernels.directions import axis_faced
from engine.kernels.vector import load
from engine.runtime.jit import kernel
from engine.state.lights import SELECTION_FACINGS, SELECTION_GUIDE_SIZE, LightSelection, no_selection

#: What an iteration's sums count for in the next.
DECAY = 0.8
#: Records with a contribution that the mean shape of all regions stands for in each, and of all records; and that a
#: region's shape stands for in each of its rows.
_PRIOR_COUNT = 1.0
_PRIOR_DRAWN = 16.0
_PRIOR_OF_REGION = 8.0
#: Share of the probability that goes by the tree, as the region's records have met it, where much is known, and number
#: of records with a contribution until which it is larger.
_TREE_SHARE = 0.1
_DOUBT_COUNT = 16.0
#: Share that all clusters have alike.
_EVEN_SHARE = 0.02
#: Largest share of a region's sum that a single record may have.
_OUTLIER_SHARE = np.float64(0.1)
#: Records with a contribution without which a region stays with the tree.
_LEAST_COUNT = 16.0
#: A region stays with the tree unless that has so many times the second moment.
_LEAST_BENEFIT = 1.15
#: Nothing is looked up at all unless so much of the light samples' second moment is saved.
_LEAST_SAVED = 0.03
#: Updates after which nothing more is learned if nothing has been saved.
_LAST_UPDATE = 6


@kernel
def _find_rows(leaf, normal, row_of, row_count, found):
    """Say which row each record belongs to, -1 = none, and number those that are new; returns how many there are."""
    for record in range(leaf.shape[0]):
        region = leaf[record]
        found[record] = -1
        if region < 0:
            continue
        key = region * SELECTION_FACINGS + axis_faced(load(normal, record))
        if row_of[key] < 0:
            row_of[key] = row_count
            row_count += 1
        found[record] = row_of[key]
    return row_count


@kernel
def _add_records(records, leaf, found, total, sums, drawn, tree_moment, known):
    """Add records to their rows' sums, none with more than its share of the region's.

    Parameters
    ----------
    leaf, found : int32 (N,), region and row, -1 = none
    total : float64 (R,), scratch, zeroed
    sums, drawn, tree_moment, known : see `LightSelectionModel`
    """
    for adds in range(2):
        for record in range(leaf.shape[0]):
            region, row = leaf[record], found[record]
            cluster = records.light_cluster[record]
            pmf = np.float64(records.light_pmf[record])
            squared = np.float64(records.light_squared[record])
            # Written so that NaN fails.
            if region < 0 or cluster < 0 or not pmf > 0.0 or not squared < 1e30:
                continue
            moment = squared * pmf
            if adds == 0:
                total[region] += moment
                continue
            moment = min(moment, _OUTLIER_SHARE * total[region])
            tree_pmf = np.float64(records.tree_pmf[record])
            sums[row, cluster] += moment
            drawn[row, cluster] += tree_pmf / pmf
            # What the tree would have left to scattering costs what it costs here.
            tree_moment[row] += moment / (tree_pmf if tree_pmf > 0.0 else pmf)
            known[row] += 1.0 if moment > 0.0 else 0.0


def selection_guide(cumulative: Float32Array) -> Int32Array:
    """`LightSelection.guide` of its cumulative probabilities."""
    steps = np.arange(SELECTION_GUIDE_SIZE + 1, dtype=np.float32) / np.float32(SELECTION_GUIDE_SIZE)
    guide = np.zeros((len(cumulative), len(steps)), np.int32)
    for line, row in zip(guide, cumulative, strict=True):
        line[:] = np.clip(np.searchsorted(row, steps, side="right") - 1, 0, len(row) - 2)
    return guide


class LightSelectionModel:
    """Learns probabilities of clusters for regions; update it after every update of these.

    Parameters
    ----------
    is_possible : bool (C,)
        Which clusters can be sampled at all.
    region_count : int
        Regions that there are already.

    Attributes
    ----------
    row_of : int32 (SELECTION_FACINGS R,), row of what a region knows of surfaces that face one way, -1 = nothing
    sums : float64 (N, C), estimates of M_k, by row
    drawn : float64 (N, C), how often the tree would have chosen each cluster
    tree_moment : float64 (N,), second moment of the light samples had they gone by the tree
    known : float64 (N,), number of records with a contribution
    share : float, of the regions that choose by what they have learned
    """

    def __init__(self, is_possible: npt.NDArray[np.bool_], region_count: int = 1) -> None:
        self._even = is_possible / max(int(is_possible.sum()), 1)
        self.row_of: Int32Array = np.full(region_count * SELECTION_FACINGS, -1, np.int32)
        self.sums = np.zeros((0, len(is_possible)))
        self.drawn = np.zeros((0, len(is_possible)))
        self.tree_moment = np.zeros(0)
        self.known = np.zeros(0)
        self.share = 0.0
        self._update_count = 0
        #: Nothing is learned any more.
        self.is_over = False

    def update(
        self, regions: RegionTree, records: VertexRecords, leaf: Int32Array, *, are_updated: bool = True
    ) -> None:
        """Learn from records.

        Parameters
        ----------
        leaf : int32 (R,)
            Region of each record, -1 = none.
        are_updated : bool
            Whether the records are those of the regions' last update; else it has been followed before.
        """
        if self.is_over:
            return
        self._carry_over(regions, regions.split_log if are_updated else ())
        found = np.empty(len(leaf), np.int32)
        row_count = int(_find_rows(leaf, records.normal, self.row_of, len(self.known), found))
        for name in ("sums", "drawn", "tree_moment", "known"):
            setattr(self, name, grown(getattr(self, name), row_count))
        total = np.zeros(regions.region_count)
        _add_records(records, leaf, found, total, self.sums, self.drawn, self.tree_moment, self.known)

    def _carry_over(self, regions: RegionTree, split_log: Iterable[npt.NDArray[np.int32]]) -> None:
        """Let earlier records count for less, and halves of regions that were cut have half of them each."""
        row_of = np.full((regions.region_count, SELECTION_FACINGS), -1, np.int32)
        row_of.reshape(-1)[: len(self.row_of)] = self.row_of
        source, share = list(range(len(self.known))), [DECAY] * len(self.known)
        for region, parent in split_log:
            for facing in np.flatnonzero(row_of[parent] >= 0):
                row = row_of[parent, facing]
                share[row] *= 0.5
                row_of[region, facing] = len(source)
                source.append(source[row])
                share.append(share[row])
        self.row_of = row_of.reshape(-1)
        rows, shares = np.array(source, np.int64), np.array(share)
        self.sums, self.drawn = self.sums[rows] * shares[:, None], self.drawn[rows] * shares[:, None]
        self.tree_moment, self.known = self.tree_moment[rows] * shares, self.known[rows] * shares

    def probabilities(self) -> tuple[Float32Array, np.ndarray]:
        """Probability of each cluster, (N, C), and which rows it pays for, bool (N,): all of a region, or none."""
        keys = np.flatnonzero(self.row_of >= 0)
        # Rows by region, where each region's begin, and which of these a row belongs to.
        rows = self.row_of[keys]
        _, begin, place = np.unique(keys // SELECTION_FACINGS, return_index=True, return_inverse=True)
        region_of = np.empty(len(rows), np.int64)
        region_of[rows] = place

        def by_region(sums: np.ndarray) -> np.ndarray:
            return np.add.reduceat(sums[rows], begin, axis=0) if len(rows) else sums

        sums, drawn, known = by_region(self.sums), by_region(self.drawn), by_region(self.known)
        mean_shape = sums.sum(axis=0) / max(sums.sum(), 1e-300)
        mean_drawn = drawn.sum(axis=0) / max(drawn.sum(), 1e-300)
        one_record = sums.sum(axis=1) / np.maximum(known, 1.0)
        sums = _normalized(sums + _PRIOR_COUNT * one_record[:, None] * mean_shape)
        drawn = _normalized(drawn + _PRIOR_DRAWN * mean_drawn)
        doubt = (_TREE_SHARE + (1.0 - _TREE_SHARE) * _DOUBT_COUNT / (known + _DOUBT_COUNT))[region_of, None]
        total = self.sums.sum(axis=1)
        one_record = np.where(total > 0.0, total / np.maximum(self.known, 1e-300), 1.0)
        learned = _normalized(np.sqrt(self.sums + _PRIOR_OF_REGION * one_record[:, None] * sums[region_of]))
        drawn = _normalized(self.drawn + _PRIOR_DRAWN * drawn[region_of])
        mixed = (1.0 - _EVEN_SHARE) * ((1.0 - doubt) * learned + doubt * drawn) + _EVEN_SHARE * self._even
        mixed = _normalized(mixed)
        moment = by_region((self.sums / np.maximum(mixed, 1e-300)).sum(axis=1))
        tree_moment = by_region(self.tree_moment)
        pays = (known >= _LEAST_COUNT) & (tree_moment >= _LEAST_BENEFIT * moment)
        saved = (tree_moment - moment)[pays].sum()
        if not saved > _LEAST_SAVED * tree_moment.sum():
            pays[:] = False
        return mixed, pays[region_of]

    def selection(self, regions: RegionTree) -> LightSelection:
        """What kernels choose by; ask once an update."""
        self.share = 0.0
        if self.is_over:
            return no_selection()
        probability, pays = self.probabilities()
        self._update_count += 1
        if not pays.any():
            self.is_over = self._update_count >= _LAST_UPDATE
            return no_selection()
        # By row, and of keys without one.
        place = np.full(len(pays) + 1, -1, np.int32)
        place[:-1][pays] = np.arange(int(pays.sum()))
        table = place[self.row_of]
        cumulative = np.zeros((int(pays.sum()), probability.shape[1] + 1), np.float32)
        cumulative[:, 1:] = np.cumsum(probability[pays], axis=1)
        cumulative[:, -1] = 1.0
        self.share = float((table.reshape(-1, SELECTION_FACINGS) >= 0).any(axis=1).mean())
        return LightSelection(
            **regions.published._asdict(), table=table, cumulative=cumulative, guide=selection_guide(cumulative)
        )


def _normalized(weights: np.ndarray) -> np.ndarray:
    """The same rows with a sum of one."""
    total: np.ndarray = np.maximum(weights.sum(axis=1), 1e-300)[:, None]
    return weights / total
