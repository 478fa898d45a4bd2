# SPDX-License-Identifier: GPL-3.0-or-later
"""Shows how far a render is: in Blender's status, in a terminal, and where there is no picture yet."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from typing import Any

import bpy

from .frame_parts import place, total_fraction
from .progress import TerminalBar, status_line
from .waiting_picture import WaitingPicture


@contextlib.contextmanager
def shown_progress(
    engine: bpy.types.RenderEngine, depsgraph: bpy.types.Depsgraph, shown: str, layers_done: int, view: str = "",
    waiting: WaitingPicture | None = None,
) -> Iterator[Callable[[Any], None]]:
    """What to tell the session's progress to, so that the user sees it.

    Parameters
    ----------
    shown : str
        What is rendered.
    layers_done : int
        View layers of the frame that are rendered by now.
    view : str
        In stereo, else ''.
    waiting : WaitingPicture, optional
    """
    from engine.render.report import peak_memory

    bar = TerminalBar() if bpy.app.background else None
    shown_place = place(depsgraph, view)
    title = f"Frame {depsgraph.scene.frame_current} {shown}"

    def on_progress(progress: Any) -> None:
        fraction = total_fraction(depsgraph.scene, layers_done, progress.fraction)
        engine.update_progress(fraction)
        if waiting is not None:
            waiting.update(progress)
        if bar is not None:
            bar.update(title, fraction, progress)
        else:
            engine.update_stats("", status_line(progress, shown_place, peak_memory()))

    try:
        yield on_progress
    finally:
        if bar is not None:
            bar.close()
