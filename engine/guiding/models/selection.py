# SPDX-License-Identifier: GPL-3.0-or-later
"""How often each region lets the guide propose a direction instead of the BSDF: learned, none where it does not pay.

For every region the second moment of what its vertices bring to the image is estimated for a row of guiding
probabilities at once, from the same records: a sample of contribution c = T f L W taken with weight W would have added
(T f L)^2 / q to the second moment under another density q, and c^2 / (W q) estimates the integral of that. A region is
guided where the variance it saves, over that of the image, is more than the time it takes, over that of the image. The
choice is between distributions and made from earlier iterations only, so the expected image does not change.

Müller 2019, "Path Guiding in Production", learns the probability by gradient descent on a divergence; a
row of candidates needs no step size, and the second moment is the error itself.
"""

from __future__ import annotations

import numpy as np

from engine.array_types import Float32Array, Int32Array
from engine.guiding.fields.state import State, require, take
from engine.guiding.fields.vmm.model import VmmModel
from engine.guiding.records.vertices import VertexRecords
from engine.kernels.constants import FLOAT_MAX
from engine.runtime.jit import kernel

#: Guiding probabilities to choose from; the first means: no guiding, not even a look-up.
PROBABILITIES = np.array([0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9], np.float32)
#: Of any region.
MAX_PROBABILITY = 0.95
#: What guiding a vertex costs, in rays: a little less than the time it takes, since roulette goes by what was learned
#: at guided vertices only (docs/decisions/mixture-field.md).
GUIDED_COST = 0.5
#: What an iteration's estimates count for in the next: fields change.
DECAY = 0.6
#: Records that the mean of all regions stands for in each: of those with a contribution, and of all.
_PRIOR_COUNT = 24.0
_PRIOR_VERTICES = 64.0
#: Largest share of a region's sum that a single record may have.
_OUTLIER_SHARE = 0.05
#: The probability by whose estimate outliers are told, and sums compared.
_REFERENCE = 5
#: More than a second moment is of that by the reference: densities below a share of the other one's do not count.
_MOST_RATIO = 1e4
#: Densities below this share of the other one's count as this: estimates, not bounds.
_LEAST_SHARE = np.float32(1e-3)


@kernel
def _second_moment(records, row, probability):
    """Estimate for one record under a guiding probability: float32."""
    guide_pdf = records.guide_pdf[row]
    bsdf_pdf = max(records.bsdf_pdf[row], _LEAST_SHARE * guide_pdf)
    source_pdf = probability * guide_pdf + (1.0 - probability) * bsdf_pdf
    return records.contribution_squared[row] * records.pdf[row] / source_pdf


@kernel
def _add_records(records, leaf, probabilities, totals, sums):
    """Add records to their regions' sums, none with more than its share.

    Parameters
    ----------
    leaf : int32 (R,), -1 = none
    probabilities : float32 (J,)
    totals : float64 (regions, 3)
        Scratch, zeroed: sum of estimates, of their squares, limit of one.
    sums : float64 (regions, J + 2)
        Sum of estimates by probability, effective number of them, number of records.
    """
    for round_ in range(2):
        for region in range(totals.shape[0]):
            limit = FLOAT_MAX
            if round_ == 1:
                limit = _OUTLIER_SHARE * totals[region, 0]
            totals[region, 0] = 0.0
            totals[region, 1] = 0.0
            totals[region, 2] = limit
        for row in range(leaf.shape[0]):
            region = leaf[row]
            # Written so that NaN fails: vertices that were not guided.
            if region < 0 or not records.guide_pdf[row] >= 0.0:
                continue
            estimate = _second_moment(records, row, probabilities[_REFERENCE])
            if estimate > 0.0 and estimate < 1e30:
                estimate = min(np.float64(estimate), totals[region, 2])
                totals[region, 0] += estimate
                totals[region, 1] += estimate * estimate
    last = probabilities.shape[0]
    for row in range(leaf.shape[0]):
        region = leaf[row]
        if region < 0 or not records.guide_pdf[row] >= 0.0:
            continue
        sums[region, last + 1] += 1.0
        estimate = _second_moment(records, row, probabilities[_REFERENCE])
        if not (estimate > 0.0 and estimate < 1e30):
            continue
        kept = min(1.0, totals[region, 2] / estimate)
        for j in range(probabilities.shape[0]):
            sums[region, j] += kept * _second_moment(records, row, probabilities[j])
    for region in range(totals.shape[0]):
        if totals[region, 1] > 0.0:
            sums[region, last] += totals[region, 0] * totals[region, 0] / totals[region, 1]


class SelectionModel:
    """Learns a guiding probability for the regions of a `VmmModel`; update it after every update of that model.

    Parameters
    ----------
    first : float
        Probability of all regions while nothing is known.

    Attributes
    ----------
    probability : float32 (R,), by region
    benefit : float32 (R,), second moment with BSDF sampling over that with this probability, by region: an estimate, 1
        where there is none
    sums : float64 (R, J + 2), what all of it follows from, by region: sum of the estimates of the second moment for
        each of PROBABILITIES, the effective number of them, the number of records
    """

    def __init__(self, first: float) -> None:
        self._first = np.float32(first)
        self.sums = np.zeros((1, len(PROBABILITIES) + 2))
        self.probability: Float32Array = np.full(1, first, np.float32)
        self.benefit: Float32Array = np.ones(1, np.float32)

    @classmethod
    def of_state(cls, state: State, first: float, region_count: int) -> SelectionModel:
        """The model that `state` was asked of, on so many regions.

        Raises
        ------
        StateError
            If the arrays are no state of a model.
        """
        model = cls(first)
        model.sums = take(state, "sums", np.float64, (region_count, len(PROBABILITIES) + 2))
        model.probability = take(state, "probability", np.float32, (region_count,))
        model.benefit = take(state, "benefit", np.float32, (region_count,))
        require((model.sums >= 0.0).all() and (model.benefit >= 0.0).all(), "sums of squares are negative")
        # Below one, so that the BSDF covers what the guide has not seen.
        is_share = (model.probability >= 0.0) & (model.probability <= MAX_PROBABILITY)
        require(is_share.all(), f"a guiding probability is not from 0 to {MAX_PROBABILITY}")
        return model

    def state(self) -> State:
        """All that it knows, as arrays."""
        return {"sums": self.sums.copy(), "probability": self.probability.copy(), "benefit": self.benefit.copy()}

    @property
    def promise(self) -> float:
        """Second moment of all regions without guiding over that with their probabilities: an estimate, 1 where there
        is none."""
        unguided = self.sums[:, 0]
        guided = float((unguided / np.maximum(self.benefit, np.float32(1e-20))).sum())
        return float(unguided.sum()) / guided if guided > 0.0 else 1.0

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
        # Both halves keep the ratios, and yield to what they see themselves.
        sums = model.inherited(DECAY * self.sums, share=0.5)
        _add_records(records, leaf, PROBABILITIES, np.zeros((len(sums), 3)), sums)
        self.sums = sums
        self.probability, self.benefit = self._choose(GUIDED_COST * variance / max(ray_count, 1.0))

    def _choose(self, least_benefit: float) -> tuple[Float32Array, Float32Array]:
        """The best probability of each region and its benefit, the mean of all standing in where little is known.

        Parameters
        ----------
        least_benefit : float
            Variance that a guided vertex must save.
        """
        moments, known, vertices = self.sums[:, :-2], self.sums[:, -2], self.sums[:, -1]
        if not known.any():
            return np.full(len(known), self._first, np.float32), np.ones(len(known), np.float32)
        reference = moments[:, _REFERENCE]
        reference = np.maximum(reference, 1e-300)
        ratio = np.minimum(moments, _MOST_RATIO * reference[:, None]) / reference[:, None]
        mean = (known[:, None] * ratio).sum(0) / known.sum()
        ratio = (known[:, None] * ratio + _PRIOR_COUNT * mean) / (known[:, None] + _PRIOR_COUNT)
        by_vertex = (reference + _PRIOR_VERTICES * reference.sum() / vertices.sum()) / (vertices + _PRIOR_VERTICES)
        best = ratio[:, 1:].argmin(1) + 1
        saved = by_vertex * (ratio[:, 0] - ratio[np.arange(len(best)), best])
        best = np.where(saved > least_benefit, best, 0)
        benefit = ratio[:, 0] / np.maximum(ratio[np.arange(len(best)), best], 1e-20)
        return PROBABILITIES[best], benefit.astype(np.float32)
