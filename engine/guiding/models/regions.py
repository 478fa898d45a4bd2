# SPDX-License-Identifier: GPL-3.0-or-later
"""What is learned by region whatever the method: the mixture field, how often to guide, how often to sample lights, and
which.

Surfaces and collisions with media share the mixtures, but not the choices: what pays at the one may cost at the other
(docs/decisions/guiding-in-media.md). Arrays of choices hold the regions' rows for surfaces, and behind them, once there
are any collisions, those for media.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import numpy.typing as npt

from engine.array_types import Float32Array, Int32Array
from engine.guiding.fields.state import State, part, prefixed, require, take
from engine.guiding.fields.vmm.field import VmmField
from engine.guiding.fields.vmm.leaves import find_leaves
from engine.guiding.fields.vmm.model import VmmModel
from engine.guiding.models.light_selection import LightSelectionModel
from engine.guiding.models.light_share import LightShareModel
from engine.guiding.models.selection import SelectionModel
from engine.guiding.records.collisions import is_collision
from engine.guiding.records.vertices import VertexRecords, as_records
from engine.ris.orca import VarianceDeltas, mean_by_region
from engine.state.lights import LightSelection

#: Estimates of what resampling saves that a state holds, at most.
_KEPT_DELTAS = 1 << 16


def _bounds(records: VertexRecords, row_count: int) -> np.ndarray:
    """Lowest and highest corner of the records, float32 (2, 3)."""
    position = records.position[:row_count]
    return np.stack([position.min(axis=0), position.max(axis=0)])


def _reach(bounds: np.ndarray) -> float:
    """Distances that tell apart where light comes from: up to twice the size of the scene [m]."""
    return 2.0 * float(np.linalg.norm(bounds[1] - bounds[0]))


class CollisionChoices:
    """What is chosen by region at collisions with media: how often to guide, and how many candidates to draw.

    selection : SelectionModel
    deltas : VarianceDeltas
    """

    def __init__(self, selection: SelectionModel) -> None:
        self.selection = selection
        self.deltas = VarianceDeltas()


def without_surfaces(probability: Float32Array, region_count: int) -> Float32Array:
    """Guiding probabilities of `RegionModels.probability` for guiding media alone."""
    kept = probability.copy()
    kept[:region_count] = 0.0
    return kept


def _deltas_state(deltas: VarianceDeltas) -> State:
    """What is known of the variance that resampling saves, as arrays, thinned."""
    position, estimate = deltas.gathered()
    step = -(-len(position) // _KEPT_DELTAS) or 1
    return {
        "deltas.position": np.ascontiguousarray(position[::step]),
        "deltas.estimate": np.ascontiguousarray(estimate[::step]),
    }


def _take_deltas(state: State, deltas: VarianceDeltas) -> None:
    """Add what `_deltas_state` has written."""
    position = take(state, "deltas.position", np.float32, (None, 3))
    deltas.add(position, take(state, "deltas.estimate", np.float32, (len(position),)))


class RegionModels:
    """The mixture field, and what is learned by its regions.

    Parameters
    ----------
    mixture : VmmModel
    selection : SelectionModel
    light_share : LightShareModel
    guiding_probability : float
        Probability of all regions while nothing is known.
    max_distance : float [m]
        Records' distances are cut to this.
    """

    def __init__(
        self, mixture: VmmModel, selection: SelectionModel, light_share: LightShareModel, guiding_probability: float,
        max_distance: float,
    ) -> None:
        self.mixture, self.selection, self.light_share = mixture, selection, light_share
        self._guiding_probability = guiding_probability
        self._max_distance = max_distance
        self._deltas = VarianceDeltas()
        self._collisions: CollisionChoices | None = None
        self._light_selection: LightSelectionModel | None = None

    @classmethod
    def of_records(cls, records: VertexRecords, row_count: int, guiding_probability: float) -> RegionModels:
        """Models that know nothing, in the bounds of the first records that there are."""
        bounds = _bounds(records, row_count)
        return cls(
            VmmModel(bounds), SelectionModel(guiding_probability), LightShareModel(), guiding_probability,
            _reach(bounds),
        )

    @classmethod
    def of_state(
        cls, state: State, guiding_probability: float, field: VmmField | None = None
    ) -> RegionModels:
        """The models that `state` was asked of.

        Parameters
        ----------
        field : VmmField, optional
            As `VmmModel.of_state`.

        Raises
        ------
        StateError
            If the arrays are no state of such models.
        """
        mixture = VmmModel.of_state(part(state, "mixture"), field=field)
        count = mixture.region_count
        max_distance = float(take(state, "max_distance", np.float64, (1,))[0])
        require(max_distance >= 0.0, "max_distance is negative")
        models = cls(
            mixture, SelectionModel.of_state(part(state, "selection"), guiding_probability, count),
            LightShareModel.of_state(part(state, "light_share"), count), guiding_probability,
            max_distance,
        )
        _take_deltas(state, models._deltas)
        collisions = part(state, "collisions")
        if collisions:
            selection = SelectionModel.of_state(part(collisions, "selection"), guiding_probability, count)
            models._collisions = CollisionChoices(selection)
            _take_deltas(collisions, models._collisions.deltas)
        return models

    def state(self) -> State:
        """All that is known, as arrays."""
        collisions = self._collisions
        of_collisions = {} if collisions is None else {
            **prefixed("selection", collisions.selection.state()), **_deltas_state(collisions.deltas),
        }
        return {
            **prefixed("mixture", self.mixture.state()),
            **prefixed("selection", self.selection.state()),
            **prefixed("light_share", self.light_share.state()),
            "max_distance": np.array([self._max_distance]),
            **_deltas_state(self._deltas),
            **prefixed("collisions", of_collisions),
        }

    def begin_light_selection(self, is_possible: npt.NDArray[np.bool_]) -> None:
        """Learn from here on which clusters of lights to sample.

        Parameters
        ----------
        is_possible : bool (C,)
            Which of the scene's clusters can be sampled at all.
        """
        self._light_selection = LightSelectionModel(is_possible, self.mixture.region_count)

    def widen(self, records: VertexRecords, row_count: int) -> None:
        """Reach as far as these records, which another view may have made; `fit` comes next."""
        bounds = _bounds(records, row_count)
        self.mixture.widen(bounds)
        self._max_distance = max(self._max_distance, _reach(bounds))

    @property
    def knows_media(self) -> bool:
        """Whether there were collisions to learn from."""
        return self._collisions is not None

    @property
    def promises(self) -> tuple[float, float]:
        """Second moment without guiding over that with the regions' probabilities, on surfaces and within media: an
        estimate, 1 where nothing is known."""
        return self.selection.promise, 1.0 if self._collisions is None else self._collisions.selection.promise

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
        if self._collisions is None and is_collision(records, row_count).any():
            self._collisions = CollisionChoices(SelectionModel(self._guiding_probability))

    def add_deltas(self, records: VertexRecords, row_count: int) -> None:
        """Take what the records say of the variance that resampling saves (Rath et al. 2025, Eq. 19)."""
        of_surfaces = ~is_collision(records, row_count)
        position, benefit = records.position[:row_count], records.benefit[:row_count]
        self._deltas.add(position[of_surfaces], benefit[of_surfaces])
        if self._collisions is not None:
            self._collisions.deltas.add(position[~of_surfaces], benefit[~of_surfaces])

    def learn_shares(
        self, records: VertexRecords, row_count: int, *, variance: float, ray_count: float, was_guided: bool
    ) -> None:
        """Learn guiding probability, light share and light selection from the records that `fit` took.

        Parameters
        ----------
        variance : float
            Variance of a sample of a pixel, mean over the image, weighted as the records' contributions are.
        ray_count : float
            Cost of a path in rays.
        was_guided : bool
            Whether the paths were guided: light shares are for those.
        """
        leaf = self._leaves(records.position[:row_count])
        of_surfaces = leaf
        if self._collisions is not None:
            of_media = is_collision(records, row_count)
            of_surfaces = np.where(of_media, np.int32(-1), leaf)
            self._collisions.selection.update(
                self.mixture, records, np.where(of_media, leaf, np.int32(-1)), variance=variance, ray_count=ray_count
            )
        self.selection.update(self.mixture, records, of_surfaces, variance=variance, ray_count=ray_count)
        if self._light_selection is not None:
            self._light_selection.update(self.mixture.regions, records, leaf)
        if not was_guided:
            records.light_squared[:row_count] = np.nan
        self.light_share.update(self.mixture, records, leaf, variance=variance, ray_count=ray_count)

    def learn_lights(self, records: VertexRecords, row_count: int) -> None:
        """Learn light selection alone, in the regions that there are."""
        if self._light_selection is not None:
            leaf = self._leaves(records.position[:row_count])
            self._light_selection.update(self.mixture.regions, records, leaf, are_updated=False)

    def choose_lights(self) -> LightSelection | None:
        """How likely regions choose each cluster of lights; None once nothing is learned about lights any more."""
        if self._light_selection is None:
            return None
        selection = self._light_selection.selection(self.mixture.regions)
        return None if self._light_selection.is_over else selection

    @property
    def lights_share(self) -> float:
        """Share of the regions that choose lights by what they have learned."""
        return 0.0 if self._light_selection is None else self._light_selection.share

    def variance_deltas(self) -> Float32Array:
        """Mean of the deltas by region and by kind of vertex, float32 (R or 2 R,); NaN where there are too few."""
        means = [self._mean_deltas(self._deltas)]
        if self._collisions is not None:
            means.append(self._mean_deltas(self._collisions.deltas))
        return np.concatenate(means)

    def _mean_deltas(self, deltas: VarianceDeltas) -> Float32Array:
        position, estimate = deltas.gathered()
        return mean_by_region(self._leaves(position), estimate, len(self.field.is_ready))

    def probability(self, *, is_learned: bool) -> Float32Array:
        """Guiding probability by region and by kind of vertex, float32 (R or 2 R,): learned, or that of the settings
        everywhere."""
        selections = [self.selection] if self._collisions is None else [self.selection, self._collisions.selection]
        if is_learned:
            return np.concatenate([selection.probability for selection in selections])
        return np.full(self.mixture.region_count * len(selections), self._guiding_probability, np.float32)

    def _leaves(self, position: Float32Array) -> Int32Array:
        leaf = np.full(len(position), -1, np.int32)
        if len(position):
            find_leaves(self.field, position, leaf)
        return leaf
