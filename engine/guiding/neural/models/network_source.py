# SPDX-License-Identifier: GPL-3.0-or-later
"""A source of directions that is a network, trained in a process of its own while the image is rendered."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from engine.guiding.models.record_sink import training_rows
from engine.guiding.models.source_model import SourceModel
from engine.guiding.neural.networks.radiance import Snapshot, TrainableShape, TrainingSettings
from engine.guiding.neural.trainer.handle import NetworkTrainer
from engine.guiding.neural.trainer.status import TrainerState
from engine.guiding.records.vertices import VertexRecords, compensate
from engine.runtime.bundle import Bundle
from engine.scene.description import Notice
from engine.settings import RenderSettings


@dataclass(frozen=True)
class NetworkDesign:
    """A network that gives directions.

    Attributes
    ----------
    shape : MixtureShape, FlowShape or another TrainableShape
    training : TrainingSettings, of the shape's kind
    make_field : callable (Snapshot, float) -> Bundle
        What kernels read, of what was trained on so many samples a pixel.
    compensates_rows : bool
        Rows say what BSDF sampling leaves over (`compensate`).
    """

    shape: TrainableShape
    training: TrainingSettings
    make_field: Callable[[Snapshot, float], Bundle]
    compensates_rows: bool = False


class NetworkSource(SourceModel):
    """A network, trained in a process of its own."""

    is_asynchronous = True
    has_stand_in = True

    def __init__(self, settings: RenderSettings, design: NetworkDesign) -> None:
        super().__init__()
        self._name = settings.source
        self._is_deterministic = settings.deterministic
        self._training_steps = settings.training_steps
        self._design = design
        self._guiding_probability = settings.guiding_probability
        #: By which a wavelength is picked for each row, where the network sees one.
        self._wavelengths = (
            np.random.Generator(np.random.Philox(settings.seed)) if settings.u_dimension == "WAVELENGTH" else None
        )
        self._samples = 0.0
        self._step_limit = 0
        self._snapshot_count = 0
        self._state = ""
        self._trainer: NetworkTrainer | None = NetworkTrainer(
            design.shape, seed=settings.seed, training_share=settings.training_share,
            deterministic=settings.deterministic,
            settings=replace(design.training, device=settings.training_device),
        )
        self._trainer.start()

    @property
    def step_count(self) -> int:
        return 0 if self._trainer is None else self._trainer.status.step

    @property
    def is_learning(self) -> bool:
        return self._trainer is not None and self._trainer.is_learning

    def learn(
        self, records: VertexRecords, row_count: int, samples: float, recorded_share: float,
        executor: ThreadPoolExecutor, thread_count: int,
    ) -> None:
        self._samples += samples
        trainer = self._trainer
        if trainer is None:
            return
        if self._design.compensates_rows:
            records = compensate(records, row_count, self._guiding_probability)
        rows = training_rows(records, row_count, wavelengths=self._wavelengths)
        if len(rows):
            trainer.submit(rows, len(rows))
        if self._is_deterministic:
            self._step_limit += self._training_steps
            snapshot = trainer.train_until(self._step_limit)
        else:
            snapshot = trainer.poll()
        if snapshot is not None:
            self._snapshot_count += 1
            self.field = self._design.make_field(snapshot, self._samples)
        status = trainer.status
        self._note(trainer)
        if status.state is TrainerState.DEAD:
            effect = "the mixture field guides instead" if self.field is None else "what it had learned stays in use"
            self.notices.append(Notice(f"Guiding / {self._name}", status.message, effect))
            trainer.close()
            self._trainer = None

    def _note(self, trainer: NetworkTrainer) -> None:
        status = trainer.status
        self.seconds = status.seconds
        self._state = f"{status.step} steps, loss {status.loss:.3g}, worker {status.words}"

    def describe(self) -> str:
        return f"{self._name}: {self._snapshot_count} snapshots, {self._state}"

    def close(self) -> None:
        if self._trainer is not None:
            self._note(self._trainer)
            self._trainer.close()
            self._trainer = None
