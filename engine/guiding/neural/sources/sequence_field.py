# SPDX-License-Identifier: GPL-3.0-or-later
"""A neural mixture that knows a span of many frames (`engine.guiding.sources.sequence`): trained once, every frame is
rendered by it.

References
----------
Dong et al. 2024, "Efficient Neural Path Guiding with 4D Modeling", section 6.2 ("Rendering Animated Sequences").
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from engine.guiding.models.record_sink import RowSink
from engine.guiding.models.source_model import TrainedSource
from engine.guiding.neural.networks.mixture.inference import make_mixture_network
from engine.guiding.neural.networks.mixture.shape import MixtureSettings, MixtureShape, selection_blend
from engine.guiding.neural.networks.radiance import Snapshot
from engine.guiding.neural.sources import network_design
from engine.guiding.neural.trainer.handle import NetworkTrainer
from engine.guiding.neural.trainer.status import TrainerState
from engine.guiding.sources.sequence import TrainingFailed, u_span, with_sequence_u
from engine.scene.description import SceneDescription
from engine.settings import RenderSettings

#: Steps of training for each sample a pixel of a visit; fewer if there are too few records for so many.
_STEPS_PER_SAMPLE = 16
#: Steps between two looks at whether to stop.
_STEPS_AT_ONCE = 16
_POLL_SECONDS = 0.05


@dataclass(frozen=True)
class MixtureSequence:
    """What was learned of a sequence; immutable, for any number of frames at the same time.

    span : (float, float) [frames], what u goes over
    u_dimension : 'TIME', or 'NONE' where the network tells no frame from the other
    shape : MixtureShape
    snapshot : Snapshot
    samples : samples a pixel that it was trained on, of all frames together
    frame_count : frames that these were of
    """

    span: tuple[float, float]
    u_dimension: str
    shape: MixtureShape
    snapshot: Snapshot
    samples: float
    frame_count: int

    def source(self, settings: RenderSettings, description: SceneDescription) -> TrainedSource:
        """What to render a frame by (`Session.render`).

        Raises
        ------
        ValueError
            If the settings ask for another network.
        """
        if network_design(with_sequence_u(settings, self.u_dimension)).shape != self.shape:
            raise ValueError(f"the sequence's field is no {settings.source} of these settings: train it anew")
        network = make_mixture_network(
            self.shape, self.snapshot, selection_blend(self.samples), u_span(description, self.span)
        )
        return TrainedSource(network, self.u_dimension, f"{settings.source}: {self}")

    def __str__(self) -> str:
        return (
            f"trained once for times {self.span[0]:g} to {self.span[1]:g}, on {self.frame_count} frames, "
            f"{self.samples:g} samples a pixel in all, {self.snapshot.step} steps, loss {self.snapshot.loss:.3g}"
        )


class MixtureSequenceTraining:
    """The network in training (`engine.guiding.sources.sequence.SequenceTraining`)."""

    def __init__(
        self, settings: RenderSettings, u_dimension: str, *, seed: int, frame_count: int, thread_count: int
    ) -> None:
        design = network_design(settings)
        assert isinstance(design.shape, MixtureShape)
        self._shape, self._u_dimension = design.shape, u_dimension
        self._snapshot: Snapshot | None = None
        self._samples = 0.0
        self._step_limit = 0
        how = design.training
        assert isinstance(how, MixtureSettings)
        # Records of all frames must fit side by side.
        how = replace(
            how, submission_rows=max(min(how.submission_rows, how.buffer_rows // frame_count), 1),
            device=settings.training_device,
        )
        self._trainer = NetworkTrainer(
            self._shape, seed=seed, deterministic=settings.deterministic, on_command=True, thread_count=thread_count,
            settings=how,
        )
        self._trainer.start()

    def source(self, u: tuple[float, float]) -> TrainedSource:
        """What a visit is guided by: the newest snapshot."""
        network = None
        if self._snapshot is not None:
            network = make_mixture_network(self._shape, self._snapshot, selection_blend(self._samples), u)
        return TrainedSource(network, self._u_dimension)

    def train(self, sink: RowSink, samples: int, poll: Callable[[], None]) -> None:
        """Train on what a visit has recorded."""
        self._samples += samples
        rows = np.concatenate(sink.rows or [np.zeros((0, self._shape.row_width), np.float32)])
        trainer = self._trainer
        while trainer.status.state is TrainerState.STARTING:
            poll()
            time.sleep(_POLL_SECONDS)
        trainer.submit(rows, len(rows))
        goal = self._step_limit + _STEPS_PER_SAMPLE * samples
        while self._step_limit < goal:
            self._step_limit = min(self._step_limit + _STEPS_AT_ONCE, goal)
            self._snapshot = trainer.train_until(self._step_limit) or self._snapshot
            poll()
            status = trainer.status
            if status.state is TrainerState.DEAD:
                raise TrainingFailed(status.message)
            if status.step < self._step_limit:
                # Too few records for more.
                self._step_limit = status.step
                break

    def field(self, span: tuple[float, float], frame_count: int) -> MixtureSequence:
        """What has been learned."""
        if self._snapshot is None:
            raise TrainingFailed("there was no light to learn from")
        return MixtureSequence(span, self._u_dimension, self._shape, self._snapshot, self._samples, frame_count)

    def close(self) -> None:
        """End the worker."""
        self._trainer.close()


def begin_training(
    settings: RenderSettings, u_dimension: str, *, seed: int, frame_count: int, thread_count: int
) -> MixtureSequenceTraining:
    """Start the worker, and return at once."""
    return MixtureSequenceTraining(
        settings, u_dimension, seed=seed, frame_count=frame_count, thread_count=thread_count
    )
