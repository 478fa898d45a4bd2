# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators that make files one after the other: at once in background, else with a progress bar until Esc."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import bpy

from .exr_layers import LayersError
from .log import log_failure

#: How soon the next file begins, so that Blender can draw between [s].
_PAUSE = 0.01


class FileMaker(Protocol):
    """What makes the files; iterating gives each once it is written."""

    #: What a user should know once all are made.
    warnings: list[str]

    def __len__(self) -> int:
        """How many there will be."""

    def __iter__(self) -> Iterator[Path]:
        """Make them."""


class FrameByFrame:
    """What such operators have in common; each says in `start` what makes its files."""

    #: What is done, for the log.
    doing = ""
    out_of_memory = "out of memory"

    if TYPE_CHECKING:

        def report(self, kind: set[str], text: str) -> None:
            """Blender's own."""

    def start(self, context: bpy.types.Context) -> FileMaker:
        """What makes the files; raises LayersError or OSError where that cannot be."""
        raise NotImplementedError

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Make all files."""
        try:
            self._maker = self.start(context)
        except (LayersError, OSError) as error:
            return self._fail(error)
        self._written: Iterator[Path] = iter(self._maker)
        self._done = 0
        if bpy.app.background or context.window is None:
            while (status := self._next()) == {"RUNNING_MODAL"}:
                pass
            return status
        manager = context.window_manager
        manager.progress_begin(0, len(self._maker))
        self._timer = manager.event_timer_add(_PAUSE, window=context.window)
        manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """A file at a time."""
        if event.type == "ESC":
            self.report({"WARNING"}, f"Stopped after {self._done} of {len(self._maker)} frames")
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
        """Make one file; {'RUNNING_MODAL'} while more are to come."""
        try:
            path = next(self._written, None)
        except Exception as error:  # Blender would show a traceback
            return self._fail(error)
        if path is not None:
            self._done += 1
            self._last = path
            return {"RUNNING_MODAL"}
        for warning in self._maker.warnings:
            self.report({"WARNING"}, warning)
        self.report({"INFO"}, f"{self._done} frames are in {self._last.parent}")
        return {"FINISHED"}

    def _fail(self, error: Exception) -> set[str]:
        """Say what went wrong."""
        if isinstance(error, MemoryError):
            text = self.out_of_memory
        elif isinstance(error, LayersError | OSError):
            text = str(error)
        else:
            log_failure(self.doing)
            text = f"failed: {error}"
        self.report({"ERROR"}, text)
        return {"CANCELLED"}
