# SPDX-License-Identifier: GPL-3.0-or-later
"""Denoising an animation over time once Blender has rendered its last frame.

Nothing that is rendered waits for it or is changed by it. The files of a job's frames are noted as Blender writes them;
when the job is done, `denoise_sequence` makes denoised copies.
"""

from __future__ import annotations

import dataclasses
import time
from pathlib import Path
from typing import Any

import bpy

from . import sequence
from .app_handlers import add_handlers, remove_handlers
from .denoise_over_time import counts
from .denoise_sequence import FOLDER, SequenceDenoiser
from .exr_layers import LayersError
from .log import log_failure, logger
from .output_files import was_written
from .shared_settings import thread_count

#: How often it is looked whether Blender has ended a job [s].
_PAUSE = 0.5
_BY_HAND = "Render > Denoise Sequence of Frames does it"


def _denoise(paths: list[Path], threads: int) -> None:
    """Denoise frames that were rendered, and say what goes wrong."""
    try:
        denoiser = SequenceDenoiser(paths, paths[0].parent / FOLDER, threads=threads)
        for path in denoiser:
            logger.info(f"denoised over time: {path}")
    except (LayersError, OSError) as error:
        failure = str(error)
    except MemoryError:
        failure = "out of memory"
    except Exception as error:  # whatever it is, what was rendered is there
        log_failure("denoising over time")
        failure = f"failed: {error}"
    else:
        for warning in denoiser.warnings:
            logger.warning(f"denoising over time: {warning}")
        return
    logger.error(f"denoising over time: {failure}. All frames are there as they were rendered")


def frames_to_denoise(scene: bpy.types.Scene, written: dict[int, Path]) -> list[Path]:
    """Files of the frames that a job's animation consists of, in order; says why where there are none.

    Parameters
    ----------
    written : dict of Path
        By frame: what the job has written. Frames that were left as they were, since they are there, come in beside.
    """
    frames = dict(written)
    if not scene.render.use_overwrite:
        for frame in range(scene.frame_start, scene.frame_end + 1):
            path = Path(scene.render.frame_path(frame=frame))
            if was_written(path, 0.0):
                frames.setdefault(frame, path)
    order = sorted(frames)
    if len(order) < 2:
        logger.warning(f"denoising over time: one frame was rendered. Once all are there, {_BY_HAND}")
        return []
    if missing := sorted(set(range(order[0], order[-1])) - set(order)):
        logger.warning(f"denoising over time: frame {missing[0]} is not there. Once it is, {_BY_HAND}")
        return []
    return [frames[frame] for frame in order]


@dataclasses.dataclass
class _Job:
    """What is rendered between `render_init` and its end: since when [s since the epoch], and files by frame."""

    started: float
    written: dict[int, Path] = dataclasses.field(default_factory=dict)


_job = _Job(0.0)


def _counts(scene: bpy.types.Scene) -> bool:
    """Whether to look at this job; the command line, whose frames are one job to the user, looks after them itself."""
    return sequence.frame_range is None and counts(scene)


@bpy.app.handlers.persistent
def _begin(*_args: Any) -> None:
    global _job
    _job = _Job(time.time())


@bpy.app.handlers.persistent
def _note_frame(scene: bpy.types.Scene, *_args: Any) -> None:
    frame = scene.frame_current
    path = Path(scene.render.frame_path(frame=frame))
    # A still that is saved has another name.
    if _counts(scene) and was_written(path, _job.started):
        _job.written[frame] = path


@bpy.app.handlers.persistent
def _end(scene: bpy.types.Scene, *_args: Any) -> None:
    written, _job.written = _job.written, {}
    if not written or not _counts(scene):
        return
    paths = frames_to_denoise(scene, written)
    if not paths:
        return
    if not bpy.app.background:
        # Handlers run in the thread of the job, operators do not.
        bpy.app.timers.register(lambda: _start_operator(paths), first_interval=_PAUSE)
        return
    _denoise(paths, thread_count(scene))


@bpy.app.handlers.persistent
def _cancel(scene: bpy.types.Scene, *_args: Any) -> None:
    written, _job.written = _job.written, {}
    if written and _counts(scene):
        logger.warning(f"denoising over time: the render was cancelled. {_BY_HAND} for the frames that are there")


def _start_operator(paths: list[Path]) -> float | None:
    """Have the operator denoise frames, with a progress bar; asked again by Blender until the job has ended."""
    if bpy.app.is_job_running("RENDER"):
        return _PAUSE
    manager = bpy.context.window_manager
    if not manager.windows:
        return None
    with bpy.context.temp_override(window=manager.windows[0]):
        try:
            bpy.ops.neuralguide.denoise_sequence(
                "EXEC_DEFAULT", filepath=str(paths[0]), frames=[{"name": path.name} for path in paths]
            )
        except RuntimeError as error:
            text = str(error).strip()
            logger.error(text)
            manager.popup_menu(lambda menu, _: menu.layout.label(text=text), title="Denoise Over Time", icon="ERROR")
    return None


def _handlers() -> list[tuple[list[Any], Any]]:
    handlers = bpy.app.handlers
    return [
        (handlers.render_init, _begin), (handlers.render_write, _note_frame), (handlers.render_complete, _end),
        (handlers.render_cancel, _cancel),
    ]  # fmt: skip


def register() -> None:
    """Look at what is rendered."""
    add_handlers(_handlers())


def unregister() -> None:
    """Stop looking."""
    remove_handlers(_handlers())
