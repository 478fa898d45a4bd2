# SPDX-License-Identifier: GPL-3.0-or-later
"""What is learned by region whatever the method: the mixture field, how often to guide, how often to sample lights."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np

from engine.array_types import Float32Array, Int32Array
from engine.guiding.fields.vmm.field import VmmField
from engine.guiding.fields.vmm.leaves import find_leaves
from engine.guiding.fields.vmm.model import VmmModel
from engine.guiding.models.light_share import LightShareModel
from engine.guiding.models.selection import SelectionModel
from engine.guiding.records.vertices import VertexRecords, as_records
from engine.ris.orca import VarianceDeltas, mean_by_region


class RegionModels:
    """The mixture field, and what is learned by its regions.

    Parameters
    ----------
    records : VertexRecords
        The first there are: their bounds are the field's.
    row_count : int
    guiding_probability : float
        Of all regions while nothing is known.
    """

    def __init__(self, records: VertexRecords, row_count: int, guiding_probability: float) -> None:
        position = records.position[:row_count]
        bounds = np.stack([position.min(axis=0), position.max(axis=0)])
        self.mixture = VmmModel(bounds)
        self.selection = SelectionModel(guiding_probability)
        self.light_share = LightShareModel()
        self._guiding_probability = guiding_probability
        self._max_distance = 2.0 * float(np.linalg.norm(bounds[1] - bounds[0]))
        self._deltas = VarianceDeltas()

    @property
    def field(self) -> VmmField:
        """The mixture field."""
        return self.mixture.field

    def fit(
        self, records: VertexRecords, row_count: int, executor: ThreadPoolExecutor | None = None, thread_count: int = 1
    ) -> None:
        """Fit the mixture field; distances of the records are cut to twice the size of the scene."""
        np.minimum(records.distance, self._max_distance, out=records.distance)
        self.mixture.update(as_records(records), row_count, executor, thread_count)

    def add_deltas(self, records: VertexRecords, row_count: int) -> None:
        """Take what the records say of the variance that resampling saves (Rath et al. 2025, Eq. 19)."""
        self._deltas.add(records.position[:row_count], records.benefit[:row_count])

    def learn_shares(
        self, records: VertexRecords, row_count: int, *, variance: float, ray_count: float, was_guided: bool
    ) -> None:
        """Learn guiding probability and light share from the records that `fit` took.

        Parameters
        ----------
        variance : float
            Of a sample of a pixel, mean over the image, weighted as the records' contributions are.
        ray_count : float
            Cost of a path in rays.
        was_guided : bool
            Whether the paths were guided: else it is not known what light sampling brought (`log_arrival`).
        """
        leaf = self._leaves(records.position[:row_count])
        self.selection.update(self.mixture, records, leaf, variance=variance, ray_count=ray_count)
        if not was_guided:
            records.light_squared[:row_count] = np.nan
        self.light_share.update(self.mixture, records, leaf, variance=variance, ray_count=ray_count)

    def variance_deltas(self) -> Float32Array:
        """Mean of the deltas by region, float32 (R,); NaN where there are too few."""
        position, estimate = self._deltas.gathered()
        leaf = self._leaves(position)
        return mean_by_region(leaf, estimate, len(self.field.is_ready))

    def probability(self, *, is_learned: bool) -> Float32Array:
        """Guiding probability by region, float32 (R,): learned, or that of the settings everywhere."""
        if is_learned:
            return self.selection.probability
        return np.full(self.mixture.region_count, self._guiding_probability, np.float32)

    def _leaves(self, position: Float32Array) -> Int32Array:
        leaf = np.full(len(position), -1, np.int32)
        if len(position):
            find_leaves(self.field, position, leaf)
        return leaf
