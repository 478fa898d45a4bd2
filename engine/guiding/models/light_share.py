# SPDX-License-Identifier: GPL-3.0-or-later
"""How often each region samples lights: learned, seldom where no light is to be seen.

Choosing a light, weighing it and tracing its shadow ray takes a good part of a path's time, and behind a door ajar it
finds nothing. Taken with probability q, a light sample of second moment D adds D / q to the variance and saves time in
proportion to 1 - q: the efficiency 1 / (variance x cost) of the image is best at q = sqrt(D / cost of the sample x cost
of a path / variance of the image), as for candidates (Rath et al. 2025, Eq. (13)) and for splitting (Rath et al. 2022,
"EARS: Efficiency-Aware Russian Roulette and Splitting"). The shares are made from earlier iterations only, and what is
taken counts for what is not, so the expected image does not change.
"""

from __future__ import annotations

import numpy as np

from engine.array_types import Float32Array, Int32Array
from engine.guiding.fields.state import State, require, take
from engine.guiding.fields.vmm.model import VmmModel
from engine.guiding.records.vertices import VertexRecords

#: What a light sample costs, in rays (docs/decisions/roulette-and-light-sampling.md).
LIGHT_COST = 0.4
#: Lights are sampled at least this often: where none was seen one may still shine, and should not be seen too rarely.
LEAST_SHARE = 0.3
#: What an iteration's sums count for in the next.
DECAY = 0.6
#: Records that the mean of all regions stands for in each.
_PRIOR_COUNT = 8.0


class LightShareModel:
    """Learns a share for the regions of a `VmmModel`; update it after every update of that model.

    Attributes
    ----------
    share : float32 (R,), probability of sampling a light, by region
    """

    def __init__(self) -> None:
        # Sum of squared contributions, number of records.
        self._sums = np.zeros((1, 2))
        self.share: Float32Array = np.ones(1, np.float32)

    @classmethod
    def of_state(cls, state: State, region_count: int) -> LightShareModel:
        """The model that `state` was asked of, on so many regions.

        Raises
        ------
        StateError
            If the arrays are no state of a model.
        """
        model = cls()
        model._sums = take(state, "sums", np.float64, (region_count, 2))
        model.share = take(state, "share", np.float32, (region_count,))
        require((model._sums >= 0.0).all(), "sums of squares are negative")
        is_share = (model.share >= np.float32(LEAST_SHARE)) & (model.share <= 1.0)
        require(is_share.all(), f"a share of light samples is not from {LEAST_SHARE} to 1")
        return model

    def state(self) -> State:
        """All that it knows, as arrays."""
        return {"sums": self._sums.copy(), "share": self.share.copy()}

    def update(
        self, model: VmmModel, records: VertexRecords, leaf: Int32Array, *, variance: float, ray_count: float
    ) -> None:
        """Learn from the records that the model's last update took.

        Parameters
        ----------
        leaf : int32 (R,)
            Region of each record, -1 = none.
        variance : float
            Variance of a sample of a pixel, mean over the image, weighted as the records' contributions are.
        ray_count : float
            Cost of a path in rays.
        """
        count = model.region_count
        sums = model.inherited(DECAY * self._sums, share=0.5)
        squared = records.light_squared[: len(leaf)]
        known = (leaf >= 0) & np.isfinite(squared)
        sums[:, 0] += np.bincount(leaf[known], weights=squared[known], minlength=count)
        sums[:, 1] += np.bincount(leaf[known], minlength=count)
        self._sums = sums
        # The mean square from which on a light is sampled always; all larger ones are alike.
        most = LIGHT_COST * variance / max(ray_count, 1e-20)
        if not most > 0.0 or not sums[:, 1].any():
            self.share = np.ones(count, np.float32)
            return
        prior = sums[:, 0].sum() / sums[:, 1].sum()
        moment = (sums[:, 0] + _PRIOR_COUNT * prior) / (sums[:, 1] + _PRIOR_COUNT)
        best = np.sqrt(np.minimum(moment, most) / most)
        self.share = np.clip(best, LEAST_SHARE, 1.0).astype(np.float32)
