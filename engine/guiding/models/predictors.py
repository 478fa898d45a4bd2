# SPDX-License-Identifier: GPL-3.0-or-later
"""What weighs candidates better than the guide's own lobes: a table by region, or the radiance network."""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from engine.guiding.fields.state import State, StateError, take
from engine.guiding.fields.table import TableField, TableModel
from engine.guiding.fields.vmm.model import VmmModel
from engine.guiding.models.network_backend import NetworkBackend
from engine.guiding.models.report import GuidingReport
from engine.guiding.networks.onnx_files.files import (
    NetworkFileError,
    StoredNetwork,
    network_from_onnx,
    network_to_onnx,
)
from engine.guiding.networks.onnx_session import RadianceSession
from engine.guiding.networks.radiance import Snapshot, network_shape
from engine.guiding.networks.radiance_query import NetworkField, make_network_field, no_network
from engine.guiding.records.vertices import VertexRecords, as_records, as_records_by_quarter
from engine.guiding.trainer.handle import NetworkTrainer, TrainerState, TrainerStatus
from engine.ris.orca import CandidateCosts
from engine.scene.description import Notice
from engine.settings import RenderSettings

#: The state's array that holds the bytes of an `.onnx` file.
_FILE = "onnx"
#: Of a candidate that a network weighs, in rays (docs/decisions/candidates.md).
_NEURAL_CANDIDATE_COST = 0.4


@dataclass(frozen=True)
class Predictions:
    """What weighs the candidates of an iteration; without both the guide's own lobes do.

    table : TableField or None; network : NetworkField or None
    session : RadianceSession or None, what asks the same network if not the kernel
    """

    table: TableField | None = None
    network: NetworkField | None = None
    session: RadianceSession | None = None


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


def stored_network(state: State) -> StoredNetwork:
    """The network that `NetworkPredictor.state` holds.

    Raises
    ------
    StateError
        If the arrays hold none.
    """
    try:
        return network_from_onnx(take(state, _FILE, np.uint8, (None,)).tobytes())
    except NetworkFileError as error:
        raise StateError(f"its network cannot be used: {error}") from error


class NetworkPredictor(Predictor):
    """The radiance network, trained in a process of its own; begun once in a render."""

    is_asynchronous = True
    part = "network"
    candidate_costs = CandidateCosts(per_candidate=_NEURAL_CANDIDATE_COST)

    _trainer: NetworkTrainer | None = None
    _snapshot: Snapshot | None = None
    _field: NetworkField | None = None
    _session: RadianceSession | None = None
    #: When training was last asked for its time, and that time.
    _asked = 0.0, 0.0

    def __init__(self, settings: RenderSettings, report: GuidingReport, notices: list[Notice]) -> None:
        super().__init__(settings, report, notices)
        self._shape = network_shape(settings)
        self._backend = NetworkBackend(settings, self._shape)

    @property
    def has_begun(self) -> bool:
        return self._report.has_trained

    @property
    def is_ready(self) -> bool:
        return self._field is not None

    @property
    def predictions(self) -> Predictions:
        return Predictions(network=self._field, session=self._session)

    def begin(self, region_count: int) -> None:
        self._report.has_trained = True
        settings = self._settings
        self._trainer = NetworkTrainer(
            self._shape, seed=settings.seed, training_share=settings.training_share,
            deterministic=settings.deterministic, first=self._snapshot,
        )
        self._trainer.start()
        self._asked = time.perf_counter(), 0.0

    def resume(self, state: State, region_count: int) -> bool:
        if not state:
            return False
        stored = stored_network(state)
        if stored.shape != self._shape:
            return False
        self._take(stored.snapshot)
        return True

    def state(self) -> State:
        if self._snapshot is None:
            return {}
        return {_FILE: np.frombuffer(network_to_onnx(StoredNetwork(self._shape, self._snapshot)), np.uint8)}

    def _take(self, snapshot: Snapshot) -> None:
        """Weigh candidates by a snapshot from now on."""
        self._snapshot = snapshot
        self._field = make_network_field(self._shape, snapshot)
        self._session = self._backend.take(snapshot, self._field)

    def learn(self, records: VertexRecords, row_count: int, samples: float, iteration: int) -> None:
        trainer = self._trainer
        if trainer is None:
            return
        if row_count:
            light = as_records_by_quarter(records, row_count) if self._shape.by_quarter else as_records(records)
            trainer.submit(light, row_count)
        if self._settings.deterministic:
            snapshot = trainer.train_until(iteration * self._settings.training_steps)
        else:
            snapshot = trainer.poll()
        if snapshot is not None:
            self._take(snapshot)
            self._report.snapshot_count += 1
            self._report.network_loss = snapshot.loss
            self._report.network_step = snapshot.step
        status = self._note()
        if status.state is TrainerState.DEAD:
            # What it has taught stays in use.
            effect = "the statistical field weighs the candidates"
            if self._field is not None:
                effect = "what it had learned stays in use"
            self._notices.append(Notice("Guiding / radiance network", status.message, effect))
            trainer.close()
            self._trainer = None

    def _note(self) -> TrainerStatus:
        """Put the worker's state into the report."""
        assert self._trainer is not None
        status = self._trainer.status
        self._report.training_seconds = status.seconds
        self._report.worker = f"{status.state.value} {status.message}".strip()
        if self._field is not None:
            self._report.network_backend = self._backend.words
        self._notices.extend(self._backend.take_notices())
        return status

    def rehearsal(self, mixture: VmmModel) -> Predictions:
        return Predictions(network=no_network(network_shape(self._settings)))

    def training_share(self, thread_count: int) -> float:
        if self._trainer is None:
            return 0.0
        now, seconds = time.perf_counter(), self._trainer.status.seconds
        since, before = self._asked
        self._asked = now, seconds
        return min((seconds - before) / max((now - since) * thread_count, 1e-9), 1.0)

    def drop(self) -> None:
        self.close()
        self._field = self._session = self._snapshot = None

    def close(self) -> None:
        if self._trainer is not None:
            self._note()
            self._trainer.close()
            self._trainer = None


#: By the names that `engine.methods.Method.predictor` gives.
PREDICTORS: dict[str, type[Predictor]] = {"": Predictor, "TABLE": TablePredictor, "NETWORK": NetworkPredictor}
