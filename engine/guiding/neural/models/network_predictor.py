# SPDX-License-Identifier: GPL-3.0-or-later
"""The radiance network in a render: learned beside it, and what weighs candidates by it."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from engine.guiding.fields.state import State, StateError, take
from engine.guiding.fields.vmm.model import VmmModel
from engine.guiding.models.predictors import Predictions, Predictor
from engine.guiding.models.report import GuidingReport
from engine.guiding.neural.models.network_backend import NetworkBackend
from engine.guiding.neural.models.radiance_model import RadianceModel
from engine.guiding.neural.networks.onnx_files.files import (
    NetworkFileError,
    StoredNetwork,
    network_from_onnx,
    network_to_onnx,
)
from engine.guiding.neural.networks.radiance import Snapshot, network_shape
from engine.guiding.neural.networks.radiance_query import make_network_field, no_network
from engine.guiding.neural.trainer.handle import NetworkTrainer
from engine.guiding.neural.trainer.status import TrainerState, TrainerStatus
from engine.guiding.records.vertices import VertexRecords, as_records, as_records_by_quarter
from engine.methods import TRAINED_PREDICTORS
from engine.ris.orca import CandidateCosts
from engine.scene.description import Notice
from engine.settings import RenderSettings

#: The state's array that holds the bytes of an `.onnx` file.
_FILE = "onnx"
_RECORD = TRAINED_PREDICTORS["NETWORK"]


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
    part = _RECORD.part
    candidate_costs = CandidateCosts(per_candidate=_RECORD.candidate_cost)

    _trainer: NetworkTrainer | None = None
    _snapshot: Snapshot | None = None
    _model: RadianceModel | None = None
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
        return self._model is not None

    @property
    def step_count(self) -> int:
        return 0 if self._trainer is None else self._trainer.status.step

    @property
    def is_learning(self) -> bool:
        return self._trainer is not None and self._trainer.is_learning

    @property
    def predictions(self) -> Predictions:
        return Predictions(model=self._model)

    def begin(self, region_count: int) -> None:
        self._report.has_trained = True
        settings = self._settings
        self._trainer = NetworkTrainer(
            self._shape, seed=settings.seed, training_share=settings.training_share,
            deterministic=settings.deterministic, first=self._snapshot,
            settings=replace(self._shape.training_settings, device=settings.training_device),
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
        field = make_network_field(self._shape, snapshot)
        self._model = RadianceModel(field, self._backend.take(snapshot, field))

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
            if self._model is not None:
                effect = "what it had learned stays in use"
            self._notices.append(Notice("Guiding / radiance network", status.message, effect))
            trainer.close()
            self._trainer = None

    def _note(self) -> TrainerStatus:
        """Put the worker's state into the report."""
        assert self._trainer is not None
        status = self._trainer.status
        self._report.training_seconds = status.seconds
        self._report.worker = status.words
        if self._model is not None:
            self._report.network_backend = self._backend.words
        self._notices.extend(self._backend.take_notices())
        return status

    def rehearsal(self, mixture: VmmModel) -> Predictions:
        return Predictions(model=unlearned_model(self._settings))

    def training_share(self, thread_count: int) -> float:
        if self._trainer is None:
            return 0.0
        now, seconds = time.perf_counter(), self._trainer.status.seconds
        since, before = self._asked
        self._asked = now, seconds
        return min((seconds - before) / max((now - since) * thread_count, 1e-9), 1.0)

    def drop(self) -> None:
        self.close()
        self._model = self._snapshot = None

    def close(self) -> None:
        if self._trainer is not None:
            self._note()
            self._trainer.close()
            self._trainer = None


def make_predictor(settings: RenderSettings, report: GuidingReport, notices: list[Notice]) -> NetworkPredictor:
    """What learns; it has not begun."""
    return NetworkPredictor(settings, report, notices)


def unlearned_model(settings: RenderSettings) -> RadianceModel:
    """A network that knows nothing, of the type that it will have."""
    return RadianceModel(no_network(network_shape(settings)))


def check_state(state: State) -> None:
    """Raise `StateError` unless a render can go on from it."""
    stored_network(state)
