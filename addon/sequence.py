# SPDX-License-Identifier: GPL-3.0-or-later
"""One field for all frames of an animation: when it is trained, where it is kept, and whether it still fits."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import bpy

from .log import logger

if TYPE_CHECKING:
    from engine.guiding.models.source_model import TrainedSource
    from engine.guiding.sources.sequence import SequenceField
    from engine.scene.description import Notice, SceneDescription
    from engine.settings import RenderSettings

#: First and last frame of the animation, where they are not those of the scene: the command line renders each frame as
#: an animation of its own.
frame_range: tuple[int, int] | None = None

_SUBJECT = "Sequence Field"
_FALLBACK = "each frame learns by itself"


@dataclasses.dataclass
class _Kept:
    """What is known of a view layer's sequence.

    key : what the field depends on besides the scene
    field : None while there is none
    problem : why there is none for this render job, '' if that is not so
    seen : digest of each frame as it was when it was trained on or rendered
    is_repeatable : whether a frame looks the same each time that Blender goes there; else `seen` says nothing
    """

    key: Any
    field: SequenceField | None = None
    problem: str = ""
    seen: dict[float, Any] = dataclasses.field(default_factory=dict)
    is_repeatable: bool = True

    def fits(self, key: Any, frame: float, digest: Any) -> bool:
        """Whether this is about the same animation; remembers the frame."""
        is_same = self.seen.setdefault(frame, digest) == digest
        return self.key == key and (is_same or not self.is_repeatable)


#: By names of scene and view layer.
_kept: dict[tuple[str, str], _Kept] = {}


class SequencePlan:
    """What a frame is rendered by, if not by what it learns itself.

    notices : what the user should know
    """

    def __init__(self, settings: RenderSettings, *notices: Notice) -> None:
        self.notices = list(notices)
        self._settings = settings
        self._kept: _Kept | None = None
        self._span = (0.0, 0.0)
        self._samples = 0
        self._descriptions: list[SceneDescription] = []

    def follow(
        self, kept: _Kept, span: tuple[float, float], samples: int, descriptions: list[SceneDescription]
    ) -> None:
        """Render by what is kept; train it on `descriptions` first, if there are any."""
        self._kept, self._span, self._samples, self._descriptions = kept, span, samples, descriptions

    @property
    def must_train(self) -> bool:
        """Whether `train` has anything to do."""
        return bool(self._descriptions)

    def train(self, on_progress: Callable[[Any], None], should_cancel: Callable[[], bool]) -> list[Notice]:
        """Train the field; returns what went wrong.

        Raises
        ------
        LoadCancelled
            Soon after `should_cancel()` was true; the next frame begins anew.
        """
        from engine.render.sequence import TrainingFailed, train_sequence
        from engine.scene.description import Notice

        assert self._kept is not None
        descriptions, self._descriptions = self._descriptions, []
        try:
            self._kept.field = train_sequence(
                self._settings, descriptions, self._span, samples=self._samples, on_progress=on_progress,
                should_cancel=should_cancel,
            )
        except (TrainingFailed, ValueError) as failure:
            # What is wrong with another frame must not keep this one from being rendered.
            self._kept.problem = str(failure)
            return [Notice(_SUBJECT, str(failure), _FALLBACK)]
        logger.info(f"the sequence's field: {self._kept.field}")
        return []

    def source(self, description: SceneDescription) -> TrainedSource | None:
        """What directions are drawn from in a frame; None: it learns by itself."""
        if self._kept is None or self._kept.field is None:
            return None
        return self._kept.field.source(self._settings, description)


def make_plan(
    depsgraph: bpy.types.Depsgraph,
    settings: RenderSettings,
    description: SceneDescription,
    *,
    engine: bpy.types.RenderEngine,
    cache: Any,
    should_cancel: Callable[[], bool],
) -> SequencePlan | None:
    """Find out what a frame is rendered by, and export what has to be trained on.

    Parameters
    ----------
    description : SceneDescription
        The frame, as it was exported.
    cache : ExportCache

    Returns
    -------
    SequencePlan or None
        None where the scene does not ask for a sequence's field.

    Raises
    ------
    ExportCancelled
        Once `should_cancel()` is true.
    """
    scene = depsgraph.scene_eval
    if not scene.neuralguide.sequence_field:
        return None
    from engine.render.sequence import (
        has_changing_light,
        sees_time,
        sequence_problem,
        training_frames,
        training_settings,
    )
    from engine.scene.description import Notice
    from engine.scene.digest import camera_digest, light_digest

    from .export import export_frames

    first, last = frame_range or (scene.frame_start, scene.frame_end)
    frame = description.frame_current
    problem = sequence_problem(settings)
    if not problem and first >= last:
        problem = "the animation has one frame only"
    if not problem and not first <= frame <= last:
        problem = f"frame {frame:g} is outside of the animation, frames {first} to {last}"
    if problem:
        return SequencePlan(settings, Notice(_SUBJECT, problem, _FALLBACK))

    opening, closing = description.shutter or (frame, frame)
    span = (first + opening - frame, last + closing - frame)
    frames = training_frames(first, last)
    samples = max(scene.neuralguide.sequence_samples // len(frames), 1)
    key = (training_settings(settings), samples, span)
    owner = (scene.name, depsgraph.view_layer_eval.name)
    digest = (light_digest(description), camera_digest(description))
    kept = _kept.get(owner)
    if kept is not None and kept.fits(key, frame, digest):
        if kept.problem:
            return SequencePlan(settings, Notice(_SUBJECT, kept.problem, _FALLBACK))
        if kept.field is not None:
            plan = SequencePlan(settings)
            plan.follow(kept, span, samples, [])
            return plan

    _kept.pop(owner, None)
    try:
        descriptions = export_frames(depsgraph, frames, engine=engine, cache=cache, should_cancel=should_cancel)
    except ValueError as error:
        _kept[owner] = _Kept(key, problem=str(error))
        return SequencePlan(settings, Notice(_SUBJECT, str(error), _FALLBACK))
    kept = _kept[owner] = _Kept(key)
    for item in descriptions:
        kept.seen[item.frame_current] = (light_digest(item), camera_digest(item))
    # Simulations that are not baked depend on where Blender was before: they would be trained for again and again.
    kept.is_repeatable = kept.fits(key, frame, digest)
    is_changing = has_changing_light(descriptions)
    if not is_changing and len(set(kept.seen.values())) == 1:
        kept.problem = "nothing is animated"
        return SequencePlan(settings, Notice(_SUBJECT, kept.problem, _FALLBACK))
    plan = SequencePlan(settings)
    plan.follow(kept, span, samples, descriptions)
    if is_changing and not sees_time(settings):
        problem = "the network does not see the time: choose experiment.mixture_u, for example Planes"
        plan.notices.append(Notice(_SUBJECT, problem, "one mixture for all frames"))
    return plan


@bpy.app.handlers.persistent
def _try_again(*_args: Any) -> None:
    """A new render job: what was a problem may have been mended. The command line's frames are one job to the user."""
    if frame_range is None:
        for owner in [owner for owner, kept in _kept.items() if kept.problem]:
            del _kept[owner]


@bpy.app.handlers.persistent
def forget(*_args: Any) -> None:
    """Free all fields."""
    _kept.clear()


def register() -> None:
    """Have fields freed when another file is opened, and problems looked at again in another job."""
    bpy.app.handlers.load_pre.append(forget)
    bpy.app.handlers.render_init.append(_try_again)


def unregister() -> None:
    """Free all fields."""
    for handlers, handler in ((bpy.app.handlers.load_pre, forget), (bpy.app.handlers.render_init, _try_again)):
        if handler in handlers:
            handlers.remove(handler)
    forget()
