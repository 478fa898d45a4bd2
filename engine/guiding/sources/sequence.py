# SPDX-License-Identifier: GPL-3.0-or-later
"""One field for many frames, as renders see it: what trains it, and what frames are rendered by.

To what learns, u is the time in the span, from the opening of the first frame's shutter to the closing of the last
one's. A path's own time, which goes over one shutter, is mapped to the part of the span that its frame is.

References
----------
Dong et al. 2024, "Efficient Neural Path Guiding with 4D Modeling", section 6.2 ("Rendering Animated Sequences").
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from importlib import import_module
from typing import Protocol, cast

from engine.guiding.models.record_sink import RowSink
from engine.guiding.models.source_model import TrainedSource
from engine.methods import SEQUENCE_TRAINING
from engine.scene.description import SceneDescription
from engine.settings import RenderSettings


class TrainingFailed(Exception):
    """No field could be trained; the message says why."""


class SequenceField(Protocol):
    """What was learned of a sequence; immutable, for any number of frames at the same time."""

    def source(self, settings: RenderSettings, description: SceneDescription) -> TrainedSource:
        """What to render a frame by (`Session.render`).

        Raises
        ------
        ValueError
            If the settings ask for another one.
        """


class SequenceTraining(Protocol):
    """A field in training; frames are visited one after the other."""

    def source(self, u: tuple[float, float]) -> TrainedSource:
        """What a visit is guided by, whose shutter opens and closes at these u."""

    def train(self, sink: RowSink, samples: int, poll: Callable[[], None]) -> None:
        """Train on what a visit of so many samples a pixel has recorded; calls `poll` often.

        Raises
        ------
        TrainingFailed
            If the process that trains is lost.
        """

    def field(self, span: tuple[float, float], frame_count: int) -> SequenceField:
        """What has been learned of so many frames within a span [frames].

        Raises
        ------
        TrainingFailed
            If that is nothing.
        """

    def close(self) -> None:
        """End the process that trains."""


class _Implementation(Protocol):
    """The module that `engine.methods.SEQUENCE_TRAINING` names."""

    def begin_training(
        self, settings: RenderSettings, u_dimension: str, *, seed: int, frame_count: int, thread_count: int
    ) -> SequenceTraining:
        """What `begin_training` of this module returns."""


def begin_training(
    settings: RenderSettings, u_dimension: str, *, seed: int, frame_count: int, thread_count: int
) -> SequenceTraining:
    """Start a process that trains a field on so many frames, and return at once.

    Parameters
    ----------
    settings : RenderSettings
        Of what is rendered to train on, a source of mixtures among them.
    u_dimension : str
        'TIME', or 'NONE' where the field is to tell no frame from the other.
    """
    module = cast(_Implementation, import_module(SEQUENCE_TRAINING, __package__))
    return module.begin_training(
        settings, u_dimension, seed=seed, frame_count=frame_count, thread_count=thread_count
    )


def with_sequence_u(settings: RenderSettings, u_dimension: str) -> RenderSettings:
    """Settings for a field that was or will be trained before a frame is rendered: 'TIME' as u, or 'NONE'."""
    # Nothing is trained within a frame that strata could help with.
    return replace(settings.with_u(u_dimension), strata=0)


def u_span(description: SceneDescription, span: tuple[float, float]) -> tuple[float, float]:
    """u at the opening and the closing of a frame's shutter, each in [0, 1].

    Parameters
    ----------
    span : (float, float) [frames]
        What u goes over; the second is the later one.
    """
    first, last = span
    times = description.shutter or (description.frame_current, description.frame_current)
    opening, closing = (min(max((time - first) / (last - first), 0.0), 1.0) for time in times)
    return opening, closing
