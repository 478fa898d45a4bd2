# SPDX-License-Identifier: GPL-3.0-or-later
"""Training one field for all frames of an animated sequence, before the first of them is rendered.

Frames spread over the sequence are visited in turns, each time for more samples: what a visit records trains the
network further, and the next visits are guided by it. The samples are no part of any picture, and have random numbers
of their own, so that frames are as unbiased as by any other field.

References
----------
Dong et al. 2024, "Efficient Neural Path Guiding with 4D Modeling", section 6.2 and Fig. 9.
"""

from __future__ import annotations

import math
import time
import zlib
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from engine.guiding.models.record_sink import RowSink
from engine.guiding.policy.rules import RULES
from engine.guiding.sources.sequence import SequenceField, begin_training, u_span, with_sequence_u
from engine.guiding.sources.sequence import TrainingFailed as TrainingFailed
from engine.methods import SOURCES
from engine.render.report import Progress
from engine.render.session import LoadCancelled, Session
from engine.scene.description import Frame, SceneDescription
from engine.scene.digest import light_digest
from engine.settings import RenderSettings

#: Frames of a sequence that its field is trained on, at most; all of them are in memory. Frames between these profit
#: only where little changes from one to the next (docs/results/sequences.md).
MOST_TRAINING_FRAMES = 32
#: Pixels of a frame that is visited: of larger pictures a smaller copy is traced, since no more records are kept.
MOST_PIXELS = RULES.records_per_iteration // 4
_INT32_MAX = 2**31 - 1


def sequence_problem(settings: RenderSettings) -> str:
    """Why these settings cannot render from a field trained before, '' if they can."""
    if not settings.is_guided:
        return "nothing is guided with these settings"
    if not SOURCES[settings.source].is_mixture:
        mixtures = ", ".join(source.name for source in SOURCES.values() if source.is_mixture)
        return f"{settings.source} is no neural mixture (choose one of {mixtures})"
    return ""


def training_frames(first: int, last: int) -> list[int]:
    """Frames from the first to the last one, both included, to train a field of them all on."""
    count = min(last - first + 1, MOST_TRAINING_FRAMES)
    return sorted({round(frame) for frame in np.linspace(first, last, count)})


def sees_time(settings: RenderSettings) -> bool:
    """Whether a network with these settings can tell times apart."""
    return settings.u_dimension in ("AUTO", "TIME") and settings.mixture_u != "NONE"


def has_changing_light(descriptions: Sequence[SceneDescription]) -> bool:
    """Whether anything but the camera changes, from frame to frame or within one."""
    if any(description.is_moving for description in descriptions):
        return True
    return len({light_digest(description) for description in descriptions}) > 1


def training_settings(settings: RenderSettings) -> RenderSettings:
    """Settings as far as a field depends on them: who has the same ones can be rendered from the same field."""
    # What is weighed or tried in a frame's own render has no part in training.
    return replace(
        settings, guiding_method=settings.source, samples=1, time_limit=0.0, seed=0, threads=0, guiding_trial=False,
        radiance_cache="OFF", sample_weighting="UNIFORM", strata=0, use_adaptive_sampling=False,
        adaptive_threshold=0.0, adaptive_min_samples=0, denoised_threshold=0.0,
    )


def visit_lengths(samples: int) -> list[int]:
    """Samples a pixel of a frame's visits: one iteration first, each time one more, and what is left in the last."""
    lengths = [min(samples, 1)]
    while (left := samples - sum(lengths)) > 0:
        following = 2 * lengths[-1] + 1
        lengths.append(following if left >= 3 * following else left)
    return lengths


def train_sequence(
    settings: RenderSettings,
    descriptions: Sequence[SceneDescription],
    span: tuple[float, float],
    *,
    samples: int,
    on_progress: Callable[[Progress], None] | None = None,
    should_cancel: Callable[[], bool] | None = None,
) -> SequenceField:
    """Train a field on some frames of a sequence.

    Parameters
    ----------
    settings : RenderSettings
        Those that frames will be rendered with.
    descriptions : sequence of SceneDescription
        Frames spread over the sequence, its first and last one among them.
    span : (float, float) [frames]
        When the first frame's shutter opens and the last one's closes.
    samples : int
        Samples a pixel of each of these frames, or of a smaller copy of it.
    on_progress, should_cancel : callable, optional
        Called in this thread only, often.

    Raises
    ------
    ValueError
        If the settings have no neural mixture, or the span is empty.
    TrainingFailed
        If the training process is lost, or has seen no light.
    LoadCancelled
        Soon after `should_cancel()` was true.
    """
    problem = sequence_problem(settings)
    if problem:
        raise ValueError(f"a sequence's field cannot be trained: {problem}")
    if not span[1] > span[0]:
        raise ValueError(f"a sequence from frame {span[0]:g} to {span[1]:g} has no length: give it two frames or more")
    u_dimension = "TIME" if sees_time(settings) and has_changing_light(descriptions) else "NONE"
    training = _Training(settings, u_dimension, len(descriptions), on_progress, should_cancel)
    visits = [(description, length) for length in visit_lengths(samples) for description in descriptions]
    try:
        done = 0
        for visit, (description, length) in enumerate(visits):
            training.announce(done / (samples * len(descriptions)), description, visit, len(visits))
            training.visit(description, length, u_span(description, span), visit)
            done += length
    finally:
        training.close()
    return training.field(span, len(descriptions))


class _Training:
    """The field in training, and the session that renders what it is trained on."""

    def __init__(
        self, settings: RenderSettings, u_dimension: str, frame_count: int,
        on_progress: Callable[[Progress], None] | None, should_cancel: Callable[[], bool] | None,
    ) -> None:
        self._settings = with_sequence_u(training_settings(settings), u_dimension)
        self._settings = replace(self._settings, threads=settings.threads)
        self._seed = settings.seed
        self._on_progress = on_progress
        self._should_cancel = should_cancel
        self._started = time.perf_counter()
        self._progress = Progress(0.0, 0, 0, 0.0, None, 0.0, "")
        self._session = Session(self._settings)
        self._training = begin_training(
            self._settings, u_dimension, seed=settings.seed, frame_count=frame_count,
            thread_count=self._session.thread_count,
        )
        self.field = self._training.field

    def announce(self, fraction: float, description: SceneDescription, visit: int, visit_count: int) -> None:
        """Say what is to follow."""
        message = (
            f"Training the sequence's field: frame {description.frame_current:g} ({visit + 1} of {visit_count} visits)"
        )
        self._progress = replace(self._progress, fraction=fraction, message=message)
        self._poll()

    def _poll(self, detail: str = "") -> None:
        if self._should_cancel is not None and self._should_cancel():
            raise LoadCancelled
        if self._on_progress is not None:
            elapsed = time.perf_counter() - self._started
            fraction = self._progress.fraction
            remaining = elapsed * (1.0 - fraction) / fraction if fraction > 0.0 else None
            message = detail or self._progress.message
            self._on_progress(replace(self._progress, message=message, elapsed=elapsed, remaining=remaining))

    def visit(self, description: SceneDescription, samples: int, u: tuple[float, float], number: int) -> None:
        """Render a frame for a few samples, and train on what they recorded."""
        # Random numbers that no other visit has, and no frame.
        seed = zlib.crc32(f"training {self._seed} {number}".encode()) & _INT32_MAX
        session = self._session
        session.settings = replace(self._settings, samples=samples, seed=seed)
        session.load(
            replace(description, frame=shrunk(description.frame)),
            # Compiling kernels, which takes a minute, comes before everything else.
            on_progress=lambda progress: self._poll("" if number else progress.message),
            should_cancel=self._should_cancel,
        )
        sink = RowSink(u)
        result = session.render(
            on_progress=lambda _progress: self._poll(), should_cancel=self._should_cancel,
            source=self._training.source(u), sink=sink,
        )
        if result.report.cancelled:
            raise LoadCancelled
        self._training.train(sink, samples, self._poll)

    def close(self) -> None:
        """End the worker and free the scene."""
        self._training.close()
        self._session.close()


def shrunk(frame: Frame) -> Frame:
    """A frame whose region has no more pixels than records are kept of; the frame itself if it has not anyway."""
    x0, y0, x1, y1 = frame.region
    factor = math.sqrt((x1 - x0) * (y1 - y0) / MOST_PIXELS)
    if factor <= 1.0:
        return frame
    left, bottom, right, top = (math.floor(edge / factor) for edge in frame.region)
    width, height = max(round(frame.width / factor), right, 1), max(round(frame.height / factor), top, 1)
    region = (left, bottom, min(max(right, left + 1), width), min(max(top, bottom + 1), height))
    return replace(frame, width=width, height=height, region=region)
