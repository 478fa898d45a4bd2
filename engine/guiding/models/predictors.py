# SPDX-License-Identifier: GPL-3.0-or-later
"""What weighs candidates better than the guide's own lobes: a table by region, or what a process beside it trains."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from typing import Protocol, cast

from engine.guiding.fields.state import State
from engine.guiding.fields.table import TableField, TableModel
from engine.guiding.fields.vmm.model import VmmModel
from engine.guiding.models.candidate_model import CandidateModel
from engine.guiding.models.report import GuidingReport
from engine.guiding.records.vertices import VertexRecords
from engine.methods import METHODS, TRAINED_PREDICTORS, TrainedPredictor, rungs_of
from engine.ris.orca import CandidateCosts
from engine.scene.description import Notice
from engine.settings import RenderSettings

#: Packages whose modules are found by name: kernels that were compiled for one are compiled anew when it changes
#: (`engine.runtime.sources`).
FOUND_BY_NAME = ("..neural.models",)


@dataclass(frozen=True)
class Predictions:
    """What weighs the candidates of an iteration; without both the guide's own lobes do.

    table : TableField or None; model : CandidateModel or None
    """

    table: TableField | None = None
    model: CandidateModel | None = None


class Predictor:
    """Learns incident radiance from the records of each iteration; this one learns nothing.

    Attributes
    ----------
    is_asynchronous : bool
        Learning goes on beside the render: it takes time from all paths, and the image depends on the clock.
    part : str
        Part of a learned field that holds its state.
    candidate_costs : CandidateCosts
        Before there is anything to measure.
    """

    is_asynchronous = False
    part = ""
    candidate_costs = CandidateCosts()

    def __init__(self, settings: RenderSettings, report: GuidingReport, notices: list[Notice]) -> None:
        self._settings, self._report, self._notices = settings, report, notices

    @property
    def has_begun(self) -> bool:
        """Whether it learns, or did."""
        return False

    @property
    def is_ready(self) -> bool:
        """Whether it knows enough to be compared with coarser ones."""
        return False

    @property
    def update_count(self) -> int:
        """Iterations that it has learned from, of what learns between iterations."""
        return 0

    @property
    def step_count(self) -> int:
        """Steps of training so far, of what a process trains."""
        return 0

    @property
    def is_learning(self) -> bool:
        """Whether a process trains it that has not yet learned all that there is to learn from."""
        return False

    @property
    def predictions(self) -> Predictions:
        """What it has learned."""
        return Predictions()

    def begin(self, region_count: int) -> None:
        """Learn from now on; `region_count` regions has the mixture field."""

    def resume(self, state: State, region_count: int) -> bool:
        """Go on from what `state` gave in another render, if it fits this one; whether it does.

        Raises
        ------
        StateError
            If the arrays are no state of a predictor.
        """
        return False

    def state(self) -> State:
        """All that it knows, as arrays; empty if it knows nothing, or nothing that can be kept."""
        return {}

    def learn_regions(self, mixture: VmmModel, executor: ThreadPoolExecutor | None, thread_count: int) -> None:
        """Learn from the batch that the mixture field was fitted to."""

    def learn(self, records: VertexRecords, row_count: int, samples: float, iteration: int) -> None:
        """Learn from the records of `samples` samples a pixel, of the `iteration`-th iteration."""

    def rehearsal(self, mixture: VmmModel) -> Predictions:
        """Predictions to call kernels with, of a mixture field of few records."""
        return Predictions()

    def training_share(self, thread_count: int) -> float:
        """Processor time that training took since it was last asked, as a share of all there was."""
        return 0.0

    def drop(self) -> None:
        """Forget what was learned."""

    def close(self) -> None:
        """Stop learning; what was learned stays."""


class TablePredictor(Predictor):
    """A directional table for each region of the mixture field; it can be dropped and begun anew."""

    part = "table"

    _table: TableModel | None = None

    @property
    def has_begun(self) -> bool:
        return self._table is not None

    @property
    def is_ready(self) -> bool:
        return self._table is not None and self._table.update_count > 0

    @property
    def update_count(self) -> int:
        return 0 if self._table is None else self._table.update_count

    @property
    def predictions(self) -> Predictions:
        return Predictions(table=None if self._table is None else self._table.field)

    def begin(self, region_count: int) -> None:
        self._table = TableModel(region_count, self._settings.channel_count)

    def resume(self, state: State, region_count: int) -> bool:
        if not TableModel.is_state(state, self._settings.channel_count):
            return False
        self._table = TableModel.of_state(state, region_count, self._settings.channel_count)
        return True

    def state(self) -> State:
        return {} if self._table is None else self._table.state()

    def learn_regions(self, mixture: VmmModel, executor: ThreadPoolExecutor | None, thread_count: int) -> None:
        if self._table is not None:
            self._table.update(mixture, executor, thread_count)

    def rehearsal(self, mixture: VmmModel) -> Predictions:
        table = TableModel(channel_count=self._settings.channel_count)
        table.update(mixture)
        return Predictions(table=table.field)

    def drop(self) -> None:
        self._table = None


class Implementation(Protocol):
    """A module that `engine.methods.TRAINED_PREDICTORS` names."""

    def make_predictor(self, settings: RenderSettings, report: GuidingReport, notices: list[Notice]) -> Predictor:
        """What learns; it has not begun."""

    def unlearned_model(self, settings: RenderSettings) -> CandidateModel:
        """What knows nothing, of the type that it will have."""

    def check_state(self, state: State) -> None:
        """Raise `StateError` unless `Predictor.resume` can read it."""


def _implementation(name: str) -> Implementation:
    return cast(Implementation, import_module(TRAINED_PREDICTORS[name].implementation, __package__))


class DeferredPredictor(Predictor):
    """Stands for a predictor that a process trains until that begins: only then its modules are loaded."""

    is_asynchronous = True

    def __init__(
        self, record: TrainedPredictor, settings: RenderSettings, report: GuidingReport, notices: list[Notice]
    ) -> None:
        super().__init__(settings, report, notices)
        self._record = record
        self._made: Predictor | None = None
        self.part, self.candidate_costs = record.part, CandidateCosts(per_candidate=record.candidate_cost)

    def _make(self) -> Predictor:
        if self._made is None:
            made = _implementation(self._record.name).make_predictor
            self._made = made(self._settings, self._report, self._notices)
        return self._made

    @property
    def has_begun(self) -> bool:
        return self._made is not None and self._made.has_begun

    @property
    def is_ready(self) -> bool:
        return self._made is not None and self._made.is_ready

    @property
    def step_count(self) -> int:
        return 0 if self._made is None else self._made.step_count

    @property
    def is_learning(self) -> bool:
        return self._made is not None and self._made.is_learning

    @property
    def predictions(self) -> Predictions:
        return Predictions() if self._made is None else self._made.predictions

    def begin(self, region_count: int) -> None:
        self._make().begin(region_count)

    def resume(self, state: State, region_count: int) -> bool:
        return bool(state) and self._make().resume(state, region_count)

    def state(self) -> State:
        return {} if self._made is None else self._made.state()

    def learn(self, records: VertexRecords, row_count: int, samples: float, iteration: int) -> None:
        if self._made is not None:
            self._made.learn(records, row_count, samples, iteration)

    def training_share(self, thread_count: int) -> float:
        return 0.0 if self._made is None else self._made.training_share(thread_count)

    def drop(self) -> None:
        if self._made is not None:
            self._made.drop()

    def close(self) -> None:
        if self._made is not None:
            self._made.close()


def _make_trained(
    record: TrainedPredictor, settings: RenderSettings, report: GuidingReport, notices: list[Notice]
) -> Predictor:
    # Who names it has its kernels loaded before the first sample, with all others.
    if _names(settings, record.name):
        return _implementation(record.name).make_predictor(settings, report, notices)
    return DeferredPredictor(record, settings, report, notices)


def _names(settings: RenderSettings, predictor: str) -> bool:
    """Whether the method weighs by a predictor from its first sample on."""
    return settings.is_guided and METHODS[rungs_of(settings.method)[0]].predictor == predictor


def unlearned_model(settings: RenderSettings) -> CandidateModel | None:
    """What a render that trains what predicts links its kernels for before it has learned; None: it may never train."""
    for name in TRAINED_PREDICTORS:
        if _names(settings, name):
            return _implementation(name).unlearned_model(settings)
    return None


def check_trained(name: str, state: State) -> None:
    """Raise unless the predictor of TRAINED_PREDICTORS can go on from arrays.

    Raises
    ------
    StateError
        If the arrays are no state of it.
    """
    _implementation(name).check_state(state)


#: By the names that `engine.methods.Method.predictor` gives.
PREDICTORS: dict[str, Callable[[RenderSettings, GuidingReport, list[Notice]], Predictor]] = {
    "": Predictor,
    "TABLE": TablePredictor,
    **{name: partial(_make_trained, record) for name, record in TRAINED_PREDICTORS.items()},
}
