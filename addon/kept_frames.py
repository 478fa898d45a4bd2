# SPDX-License-Identifier: GPL-3.0-or-later
"""Frames that Blender renders, kept while they are unfinished, as the scene asks: F12, Render Animation, `blender -b`.

A frame goes on from its checkpoint by itself, if that fits. It is there next to the frame's file once the frame has
taken a minute, and goes when Blender has the whole frame.
"""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import bpy

from . import checkpoints, sequence
from .app_handlers import add_handlers, remove_handlers
from .ending_signals import Delay
from .frame_files import frame_paths
from .log import logger

if TYPE_CHECKING:
    from engine.scene.description import Notice, SceneDescription

#: A movie of frames that took so long could have been kept as pictures [s].
_LONG = 60.0


@dataclasses.dataclass(frozen=True)
class Kept:
    """What was kept of a frame that was cancelled: its number, and the file."""

    frame: int
    path: Path


class _Job:
    """What Blender renders now.

    scene_name : str, of the scene whose frame it is, '' while Blender has not said
    frame : FrameCheckpoints or None, those of the frame in work
    delay : Delay, signals that would have ended the process
    """

    def __init__(self, scene_name: str = "") -> None:
        self.scene_name = scene_name
        self.frame: checkpoints.FrameCheckpoints | None = None
        self.delay = Delay()


_job = _Job()
#: By scene.
_kept: dict[str, Kept] = {}


def kept_of(scene: bpy.types.Scene) -> Kept | None:
    """What the last render of a scene has kept; None: it was finished, or nothing is known."""
    return _kept.get(scene.name)


def _temporary_folder() -> Path:
    """The folder for temporary files, as the preferences have it."""
    return Path(bpy.app.tempdir).parent


def kept_path(scene: bpy.types.Scene, *, is_animation: bool) -> Path:
    """What names of checkpoints of a scene's current frame begin with.

    Frames of animations are kept next to where Blender saves them. Blender saves no others, so their folder need not
    be there: then they are kept in the folder for temporary files, where many scenes have frames of the same name.

    A movie's name has its first and last frame. Whoever goes on with one that was cut off begins with another, so that
    frames are called as the movie is without these.
    """
    render, frame = scene.render, scene.frame_current
    folder, own = _temporary_folder(), Path(bpy.data.filepath).stem or "unsaved"
    try:
        path = frame_paths(render, frame)[0].absolute()
    except RuntimeError:
        # Blender itself says so as soon as it saves the frame.
        path = folder / f"{frame:04d}"
    if render.is_movie_format:
        path = path.with_name(f"{_without_range(scene, path.name)}.{frame:04d}")
    is_nowhere = not path.parent.is_dir() or (not bpy.data.filepath and render.filepath.startswith("//"))
    if not is_animation and is_nowhere:
        path = folder / path.name
    return path.with_name(f"{own}_{path.name}") if path.parent == folder else path


def _without_range(scene: bpy.types.Scene, name: str) -> str:
    """The name of a movie without the frames that it has from Blender, which are not those of a preview here."""
    before, _, after = name.rpartition(f"{scene.frame_start:04d}-{scene.frame_end:04d}")
    return before + after


def _frame_of(engine: bpy.types.RenderEngine, depsgraph: bpy.types.Depsgraph) -> checkpoints.FrameCheckpoints | None:
    """The checkpoints of the frame in work; None: there are to be none."""
    if sequence.frame_range is not None:
        return checkpoints.commanded
    if _job.frame is None:
        scene = bpy.data.scenes.get(_job.scene_name) or depsgraph.scene
        asked = checkpoints.Wishes(resumes=True, is_patient=True).of_scene(scene)
        if asked.interval:
            path = kept_path(scene, is_animation=engine.is_animation)
            _job.frame = checkpoints.FrameCheckpoints(scene, path, asked, lambda text: _say(engine, text))
    return _job.frame


def begin_view(
    engine: bpy.types.RenderEngine, session: Any, settings: Any, depsgraph: bpy.types.Depsgraph, view: str,
    description: SceneDescription, show: Callable[[list[Notice]], None], *, is_wanted: bool, keeps_meshes: bool,
) -> None:
    """Have a session keep what it renders next, if that is wanted and the frame in work is to be kept.

    Parameters
    ----------
    session : Session
    settings : RenderSettings
        It gets these, or what they are for a frame that gets more samples.
    view : str
        In stereo, else ''.
    show : callable (list of Notice) -> None
    keeps_meshes : bool
        As of `Session.load`.
    """
    session.settings, session.checkpointing = settings, None
    frame = _frame_of(engine, depsgraph) if is_wanted else None
    if frame is not None:
        checkpointing = frame.begin(
            depsgraph, view, description, settings.seed, lambda notice: show([notice]), keeps_meshes=keeps_meshes
        )
        session.settings = frame.settings(checkpointing, settings)
        session.checkpointing = checkpointing


def note_view(
    engine: bpy.types.RenderEngine, session: Any, scene: bpy.types.Scene, report: Any,
    show: Callable[[list[Notice]], None],
) -> None:
    """Say what is kept of a view that was rendered, and what could not be."""
    from engine.scene.description import Notice

    is_long = report.render_seconds >= _LONG
    if is_long and engine.is_animation and scene.render.is_movie_format and scene.neuralguide.keep_unfinished:
        problem = "a movie that is cut off goes on with the frame in work alone, and in another file"
        show([Notice("Movie", problem, "render long frames to pictures, each of which is whole")])
    checkpointing = session.checkpointing
    if sequence.frame_range is not None or checkpointing is None:
        return
    _kept.pop(scene.name, None)
    # It may have been cancelled once it was rendered, while it was denoised.
    checkpointing.is_finished = checkpointing.is_finished and not report.cancelled
    if checkpointing.is_written and not checkpointing.is_finished:
        kept = _kept[scene.name] = Kept(scene.frame_current, checkpointing.plan.path)
        _say(engine, f"frame {kept.frame} is kept as far as it came, in {kept.path}: rendered again, it goes on")
        if engine.is_animation and scene.render.is_movie_format:
            _say(engine, _of_movie(kept.frame))


def _of_movie(frame: int) -> str:
    """What to do about a movie that was cut off in a frame."""
    if is_asked_to_end():
        return "the movie so far is lost, since this process ends before Blender has closed its file"
    return (
        f"the movie ends before frame {frame}, and cannot be gone on with: rename its file, set Start to {frame}, "
        f"render the rest to a second movie, and join the two"
    )


def _say(engine: bpy.types.RenderEngine, text: str) -> None:
    engine.report({"INFO"}, text)
    if bpy.app.background:
        logger.info(text)


def delaying_end(scene: bpy.types.Scene) -> contextlib.AbstractContextManager[None]:
    """Within it a signal that would end a process without windows has what is rendered cancelled, and kept first."""
    is_wanted = bpy.app.background and scene.neuralguide.keep_unfinished
    return _job.delay.until_over() if is_wanted else contextlib.nullcontext()


def is_asked_to_end() -> bool:
    """Whether such a signal has come."""
    return _job.delay.number != 0


def forget_frame(scene: bpy.types.Scene) -> tuple[list[Path], list[Path]]:
    """Remove what is kept of a scene's current frame; returns files that are gone, and those that are still there."""
    paths = {kept_path(scene, is_animation=is_animation) for is_animation in (False, True)}
    found = [item for path in paths for item in checkpoints.files_of(path)]
    left = [item for item in found if not checkpoints.remove(item)]
    kept = kept_of(scene)
    if kept is not None and not kept.path.exists():
        del _kept[scene.name]
    return [item for item in found if item not in left], left


# -- what Blender tells -----------------------------------------------------------------------------------------------


def _leave() -> None:
    if _job.frame is not None:
        _job.frame.close()


@bpy.app.handlers.persistent
def _begin_frame(scene: bpy.types.Scene, *_args: Any) -> None:
    global _job
    _leave()
    _job = _Job(scene.name)


@bpy.app.handlers.persistent
def _end_frame(*_args: Any) -> None:
    """Blender has the frame, and has saved it if it was to; a still that was cancelled comes here too."""
    global _job
    if _job.frame is not None and _job.frame.is_finished:
        _job.frame.finish()
    _leave()
    _job = _Job()


@bpy.app.handlers.persistent
def _end_job(*_args: Any) -> None:
    global _job
    _leave()
    _job = _Job()


@bpy.app.handlers.persistent
def _forget(*_args: Any) -> None:
    _kept.clear()


def _handlers() -> list[tuple[list[Any], Any]]:
    handlers = bpy.app.handlers
    return [
        (handlers.render_pre, _begin_frame), (handlers.render_post, _end_frame), (handlers.render_complete, _end_job),
        (handlers.render_cancel, _end_job), (handlers.load_pre, _forget),
    ]  # fmt: skip


def register() -> None:
    """Look at the frames that Blender renders."""
    add_handlers(_handlers())


def unregister() -> None:
    """Stop looking."""
    remove_handlers(_handlers())
    _end_job()
    _forget()
