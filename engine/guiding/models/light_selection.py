# SPDX-License-Identifier: GPL-3.0-or-later
"""Which lights each region samples: learned, so that lamps in other rooms and sky behind walls are left alone.

A light sample chooses a cluster k with probability P_k, then a point on its lights. With M_k the second moment of what
the point brings to the image, visibility included, the sample has the second moment sum of M_k / P_k, which is least
where P_k is in proportion to the square root of M_k. A record of contribution c, its cluster chosen with P_k, adds
c^2 P_k to the estimate of M_k, however P_k was learned. The probabilities are made from earlier iterations only, and
those of no cluster are 0 that the light tree would choose, so the expected image does not change.

References: Vevoda, Kondapaneni and Krivanek 2018, "Bayesian Online Regression for Adaptive Direct Illumination
Sampling"; moments instead of means as in Rath et al. 2020, "Variance-Aware Path Guiding".
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from engine.array_types import Float32Array, Int32Array
from engine.guiding.fields.vmm.regions import RegionTree
from engine.guiding.records.vertices import VertexRecords
from engine.runtime.jit import kernel
from engine.state.lights import LightSelection, no_selection

#: What an iteration's sums count for in the next.
DECAY = 0.8
#: Records with a contribution that the mean shape of all regions stands for in each, and of all records.
_PRIOR_COUNT = 4.0
_PRIOR_DRAWN = 16.0
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
def _add_records(records, leaf, total, sums, drawn, tree_moment, known):
    """Add records to their regions' sums, none with more than its share.

    Parameters
    ----------
    leaf : int32 (N,), -1 = none
    total : float64 (R,), scratch, zeroed
    sums, drawn, tree_moment, known : see `LightSelectionModel`
    """
    for adds in range(2):
        for row in range(leaf.shape[0]):
            region = leaf[row]
            cluster = records.light_cluster[row]
            pmf = np.float64(records.light_pmf[row])
            squared = np.float64(records.light_squared[row])
            # Written so that NaN fails.
            if region < 0 or cluster < 0 or not pmf > 0.0 or not squared < 1e30:
                continue
            moment = squared * pmf
            if adds == 0:
                total[region] += moment
                continue
            moment = min(moment, _OUTLIER_SHARE * total[region])
            tree_pmf = np.float64(records.tree_pmf[row])
            sums[region, cluster] += moment
            drawn[region, cluster] += tree_pmf / pmf
            # What the tree would have left to scattering costs what it costs here.
            tree_moment[region] += moment / (tree_pmf if tree_pmf > 0.0 else pmf)
            known[region] += 1.0 if moment > 0.0 else 0.0


class LightSelectionModel:
    """Learns probabilities of clusters for regions; update it after every update of these.

    Parameters
    ----------
    is_possible : bool (C,) or (S, C)
        Which clusters can be sampled at all; by each light tree, where lights are linked.
    region_count : int
        Regions that there are already.

    Attributes
    ----------
    sums : float64 (R, C), estimates of M_k, by region
    drawn : float64 (R, C), how often the tree would have chosen each cluster
    tree_moment : float64 (R,), second moment of the light samples had they gone by the tree
    known : float64 (R,), number of records with a contribution
    share : float, of the regions that choose by what they have learned
    """

    def __init__(self, is_possible: npt.NDArray[np.bool_], region_count: int = 1) -> None:
        self._trees = np.atleast_2d(is_possible)
        is_possible = self._trees.any(axis=0)
        self._even = is_possible / max(int(is_possible.sum()), 1)
        self.sums = np.zeros((region_count, len(is_possible)))
        self.drawn = np.zeros((region_count, len(is_possible)))
        self.tree_moment = np.zeros(region_count)
        self.known = np.zeros(region_count)
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
        for name in ("sums", "drawn", "tree_moment", "known"):
            faded = DECAY * getattr(self, name)
            setattr(self, name, regions.inherited(faded, share=0.5) if are_updated else faded)
        total = np.zeros(len(self.sums))
        _add_records(records, leaf, total, self.sums, self.drawn, self.tree_moment, self.known)

    def probabilities(self) -> tuple[Float32Array, np.ndarray]:
        """Probability of each cluster, (R, C), and which regions it pays in, bool (R,)."""
        total, known = self.sums.sum(axis=1), self.known
        mean_shape = self.sums.sum(axis=0) / max(self.sums.sum(), 1e-300)
        mean_drawn = self.drawn.sum(axis=0) / max(self.drawn.sum(), 1e-300)
        one_record = total / np.maximum(known, 1.0)
        learned = np.sqrt(self.sums + _PRIOR_COUNT * one_record[:, None] * mean_shape)
        learned /= np.maximum(learned.sum(axis=1), 1e-300)[:, None]
        drawn = (self.drawn + _PRIOR_DRAWN * mean_drawn) / (self.drawn.sum(axis=1)[:, None] + _PRIOR_DRAWN)
        drawn /= np.maximum(drawn.sum(axis=1), 1e-300)[:, None]
        doubt = (_TREE_SHARE + (1.0 - _TREE_SHARE) * _DOUBT_COUNT / (known + _DOUBT_COUNT))[:, None]
        mixed = (1.0 - _EVEN_SHARE) * ((1.0 - doubt) * learned + doubt * drawn) + _EVEN_SHARE * self._even
        mixed /= mixed.sum(axis=1)[:, None]
        if len(self._trees) > 1:
            mixed = self._within_trees(mixed)
        moment = (self.sums / np.maximum(mixed, 1e-300)).sum(axis=1)
        pays = (known >= _LEAST_COUNT) & (self.tree_moment >= _LEAST_BENEFIT * moment)
        saved = (self.tree_moment - moment)[pays].sum()
        if not saved > _LEAST_SAVED * self.tree_moment.sum():
            pays[:] = False
        return mixed, pays

    def _within_trees(self, probability: np.ndarray) -> np.ndarray:
        """Probabilities (R, C) of clusters among those of the same light tree."""
        shares = np.zeros_like(probability)
        for is_in_tree in self._trees:
            total = probability[:, is_in_tree].sum(axis=1, keepdims=True)
            shares[:, is_in_tree] = probability[:, is_in_tree] / np.maximum(total, 1e-300)
        return shares

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
        table = np.full(len(pays), -1, np.int32)
        table[pays] = np.arange(int(pays.sum()))
        # A region has a row for each light tree.
        by_tree = (probability[pays][:, None] * self._trees).reshape(-1, probability.shape[1])
        cumulative = np.zeros((len(by_tree), probability.shape[1] + 1), np.float32)
        cumulative[:, 1:] = np.cumsum(by_tree, axis=1)
        # What comes behind a tree's last cluster has no probability.
        cumulative[cumulative >= cumulative[:, -1:]] = 1.0
        self.share = float(pays.mean())
        return LightSelection(**regions.published._asdict(), table=table, cumulative=cumulative)
