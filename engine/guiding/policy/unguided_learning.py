# SPDX-License-Identifier: GPL-3.0-or-later
"""What a render learns that guides no directions: which paths to end, and which lights to sample.

A few samples a pixel teach enough: from then on nothing is recorded, and no thread waits.
"""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from engine.guiding.fields.update import make_runner
from engine.guiding.fields.vmm.leaves import find_leaves
from engine.guiding.fields.vmm.regions import RegionTree
from engine.guiding.models.light_selection import LightSelectionModel
from engine.guiding.models.report import GuidingReport
from engine.guiding.policy.costs import IterationCosts
from engine.guiding.policy.guidance import Guidance
from engine.guiding.policy.iterations import RecordBudget
from engine.guiding.policy.roulette_learning import RouletteModel
from engine.guiding.policy.rules import RULES, Rules
from engine.guiding.policy.trial import Part
from engine.guiding.records.of_unit import UnitRecords
from engine.guiding.records.vertices import VertexRecords, allocate_vertex_records, as_records, join_records
from engine.ris.orca import pixel_weights
from engine.scene.description import Notice
from engine.settings import RenderSettings
from engine.state.film import FilmTile
from engine.state.lights import LightSelection, no_selection
from engine.state.unit import CURRENT, Unit, UnitCosts

_REHEARSED_RECORDS = 16


def learns_after(samples: int, *, lights_pay: bool, rules: Rules = RULES) -> bool:
    """Whether more is to be learned once so many samples a pixel have been rendered.

    Parameters
    ----------
    samples : int
    lights_pay : bool
        Whether lights are sampled by what was learned.
    rules : Rules
    """
    return samples < (rules.lights_samples if lights_pay else rules.learned_samples)


def unguided_budget(
    settings: RenderSettings, paths_per_sample: int, unit_pixels: int, *, learns_lights: bool, rules: Rules = RULES
) -> RecordBudget:
    """How many records iterations take that guide nothing; parameters are those of `RecordBudget`."""
    wanted = rules.unguided_records
    if learns_lights:
        wanted = min(int(rules.unguided_records_share * paths_per_sample * settings.samples) + 1, wanted)
    return RecordBudget(paths_per_sample, unit_pixels, wanted, rules)


class LightsByRegion:
    """Which lights regions sample, where there are no regions but those for it.

    Parameters
    ----------
    is_possible : bool (C,)
        Which of the scene's clusters of lights can be sampled at all.

    Attributes
    ----------
    selection : LightSelection
        What kernels choose by.
    """

    def __init__(self, is_possible: npt.NDArray[np.bool_]) -> None:
        self._is_possible = is_possible
        self._regions: RegionTree | None = None
        self._model = LightSelectionModel(is_possible)
        self.selection: LightSelection = no_selection()

    @property
    def share(self) -> float:
        """Of the regions that choose by what they have learned."""
        return self._model.share

    def learn(self, records: VertexRecords, row_count: int) -> None:
        """Take an iteration's records."""
        if not row_count:
            return
        position = records.position[:row_count]
        if self._regions is None:
            self._regions = RegionTree(np.stack([position.min(axis=0), position.max(axis=0)]))
        regions = self._regions
        regions.update(as_records(records), row_count, make_runner(None, 1))
        leaf = np.full(row_count, -1, np.int32)
        find_leaves(regions.published, position, leaf)
        self._model.update(regions, records, leaf)
        self.selection = self._model.selection(regions)

    def rehearse(self) -> None:
        """Load (or compile) the kernels of learning by learning from nothing in particular."""
        records = allocate_vertex_records(_REHEARSED_RECORDS)
        records.position[:] = np.arange(_REHEARSED_RECORDS)[:, None]
        LightsByRegion(self._is_possible).learn(records, _REHEARSED_RECORDS)


class UnguidedLearner:
    """Owns what is learned in a render that guides nothing.

    Parameters
    ----------
    settings : RenderSettings
        By which roulette or lights are learned.
    paths_per_sample : int
        Pixels of the image.
    unit_pixels : int
        Of the largest unit of work.
    light_clusters : bool (C,), optional
        Which of the scene's clusters of lights can be sampled; None: nothing is learned about lights.
    rules : Rules
    """

    #: Nothing outlives the render.
    wants_last = False
    known_samples = 0.0

    def __init__(
        self, settings: RenderSettings, paths_per_sample: int, unit_pixels: int,
        light_clusters: npt.NDArray[np.bool_] | None = None, rules: Rules = RULES,
    ) -> None:
        self._rules = rules
        self.settings = settings
        self.notices: list[Notice] = []
        self.report = GuidingReport(method="OFF")
        self.parts = [Part(0, 1, CURRENT)]
        self._roulette = RouletteModel(rules) if settings.learns_roulette else None
        self._lights = None if light_clusters is None else LightsByRegion(light_clusters)
        self.is_over = False
        self._budget = unguided_budget(
            settings, paths_per_sample, unit_pixels, learns_lights=self._lights is not None, rules=rules
        )

    def weight(self, _first_sample: int, _arm: int) -> float:
        """Weight in the image of each sample of an iteration."""
        return 1.0

    def narrow(self, pixel_count: int, _expected_paths: float) -> None:
        """Take how many pixels the next iteration has."""
        self._budget.paths_per_sample = pixel_count

    def rehearse(self) -> Guidance:
        """Load (or compile) the kernels of learning."""
        if self._roulette is not None:
            self._roulette.rehearse()
        if self._lights is not None:
            self._lights.rehearse()
        return Guidance(self.settings, 0)

    def first(self) -> Guidance:
        """Guidance of the first iteration: none. Lights are not learned from it: what a sample brings to a pixel is
        judged by the pixel's value, which nobody knows."""
        return self._guidance(0 if self._roulette is None else self._budget.threshold(1), None)

    def _guidance(self, threshold: int, weights: np.ndarray | None) -> Guidance:
        """What paths go by, given the weights of the film's pixels."""
        lights = None if self._lights is None else self._lights.selection
        guidance = Guidance(self.settings, threshold, pixel_weight=weights, lights=lights)
        return guidance if self._roulette is None else self._roulette.complete(guidance, weights)

    def learn(
        self, units: Sequence[UnitRecords], recorded_share: float, sums: FilmTile, size: tuple[int, int],
        costs: IterationCosts, next_range: tuple[int, int], *, is_whole: bool = True,
    ) -> Guidance:
        """Learn from an iteration, and say how to go on; see `Learner.learn`."""
        started = time.perf_counter()
        records, row_count = join_records([unit.vertices for unit in units])
        self.report.record_count += row_count
        if row_count:
            self._budget.count(row_count + costs.dropped_records, recorded_share * costs.path_count)
        mean = sums.radiance / np.maximum(sums.weight, 1e-20)[:, None]
        weights = pixel_weights(mean.reshape(*size, -1))
        if self._roulette is not None and next_range[0] <= self._rules.learned_samples:
            self._roulette.learn(records, row_count, sums, weights, costs)
        if self._lights is not None:
            self._lights.learn(records, row_count)
            self.report.lights_share = self._lights.share
        self.report.field_seconds += time.perf_counter() - started
        self.parts = [Part(*next_range, CURRENT)]
        has_lights = self._lights is not None and self._lights.share > 0.0
        self.is_over = not learns_after(next_range[0], lights_pay=has_lights, rules=self._rules)
        return self._guidance(0 if self.is_over else self._budget.threshold(next_range[1]), weights)

    def keep(self, units: Sequence[UnitRecords]) -> None:
        """There is nobody else who learns."""

    def compare(self, unit: Unit, film: FilmTile, costs: UnitCosts) -> None:
        """There is nothing to compare."""

    def close(self) -> None:
        """There is nothing to end."""
