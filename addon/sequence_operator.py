# SPDX-License-Identifier: GPL-3.0-or-later
"""The operator that denoises a sequence of frames, and where users find it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import bpy
from bpy_extras.io_utils import ImportHelper

from .denoise_sequence import FOLDER, REACH, SequenceDenoiser, find_frames
from .exr_layers import LayersError
from .log import log_failure
from .shared_settings import thread_count

#: How soon the next frame begins, so that Blender can draw between [s].
_PAUSE = 0.01


class NEURALGUIDE_OT_denoise_sequence(bpy.types.Operator, ImportHelper):  # noqa: N801 (Blender's convention)
    """Denoise a sequence of rendered OpenEXR MultiLayer files over time, so that it flickers less.
    It needs the passes Vector and Denoising Data. Choose any frame; all frames of the sequence are taken"""

    bl_idname = "neuralguide.denoise_sequence"
    bl_label = "Denoise Sequence"
    filename_ext = ".exr"
    filter_glob: bpy.props.StringProperty(default="*.exr", options={"HIDDEN"})  # type: ignore[valid-type]
    folder: bpy.props.StringProperty(  # type: ignore[valid-type]
        name="Folder", default=FOLDER,
        description="Where the denoised frames go, beside the frames unless it is a full path",
    )
    frames: bpy.props.CollectionProperty(  # type: ignore[valid-type]
        type=bpy.types.OperatorFileListElement, options={"HIDDEN", "SKIP_SAVE"},
        description="Names of the files to denoise, in order, beside the one that is chosen; none: all of its sequence",
    )
    reach: bpy.props.IntProperty(  # type: ignore[valid-type]
        name="Frames", default=REACH, min=0, max=32, soft_max=16,
        description="How many frames before, and as many after, help a frame",
    )

    def _start(self) -> SequenceDenoiser:
        path = Path(bpy.path.abspath(self.filepath)).absolute()
        paths = [path.parent / frame.name for frame in self.frames] or find_frames(path)
        threads = thread_count(bpy.context.scene)
        return SequenceDenoiser(paths, path.parent / bpy.path.abspath(self.folder), self.reach, threads)

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Denoise all frames: at once in background, else with a progress bar until Esc is pressed."""
        try:
            self._denoiser = self._start()
        except (LayersError, OSError) as error:
            return self._fail(error)
        self._written: Iterator[Path] = iter(self._denoiser)
        self._done = 0
        if bpy.app.background or context.window is None:
            while (status := self._next()) == {"RUNNING_MODAL"}:
                pass
            return status
        manager = context.window_manager
        manager.progress_begin(0, len(self._denoiser))
        self._timer = manager.event_timer_add(_PAUSE, window=context.window)
        manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """A frame at a time."""
        if event.type == "ESC":
            self.report({"WARNING"}, f"Stopped after {self._done} of {len(self._denoiser)} frames")
            status = {"CANCELLED"}
        elif event.type == "TIMER":
            status = self._next()
        else:
            return {"PASS_THROUGH"}
        manager = context.window_manager
        manager.progress_update(self._done)
        if status != {"RUNNING_MODAL"}:
            manager.event_timer_remove(self._timer)
            manager.progress_end()
        return status

    def _next(self) -> set[str]:
        """Denoise one frame; {'RUNNING_MODAL'} while more are to come."""
        try:
            path = next(self._written, None)
        except Exception as error:  # Blender would show a traceback
            return self._fail(error)
        if path is not None:
            self._done += 1
            self._last = path
            return {"RUNNING_MODAL"}
        for warning in self._denoiser.warnings:
            self.report({"WARNING"}, warning)
        self.report({"INFO"}, f"{self._done} frames are in {self._last.parent}")
        return {"FINISHED"}

    def _fail(self, error: Exception) -> set[str]:
        """Say what went wrong."""
        if isinstance(error, MemoryError):
            text = "out of memory: choose fewer Frames"
        elif isinstance(error, LayersError | OSError):
            text = str(error)
        else:
            log_failure("denoising a sequence")
            text = f"failed: {error}"
        self.report({"ERROR"}, text)
        return {"CANCELLED"}


def _draw(menu: Any, _context: bpy.types.Context) -> None:
    menu.layout.operator(NEURALGUIDE_OT_denoise_sequence.bl_idname, text="Denoise Sequence of Frames...")


def register() -> None:
    """Register the operator, and add it to the menu Render."""
    bpy.utils.register_class(NEURALGUIDE_OT_denoise_sequence)
    bpy.types.TOPBAR_MT_render.append(_draw)


def unregister() -> None:
    """Undo `register`."""
    bpy.types.TOPBAR_MT_render.remove(_draw)
    bpy.utils.unregister_class(NEURALGUIDE_OT_denoise_sequence)
