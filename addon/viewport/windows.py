# SPDX-License-Identifier: GPL-3.0-or-later
"""All windows in rendered shading: a timer that has them drawn when there is something new, and their end."""

from __future__ import annotations

import atexit
import contextlib
import weakref
from typing import Any

import bpy

#: Looks at the processes [s]: while pictures come, and while none will.
_BUSY_SECONDS = 1.0 / 60.0
_IDLE_SECONDS = 0.25

_windows: list[tuple[weakref.ref[Any], Any]] = []


def open_window(engine: bpy.types.RenderEngine) -> Any:
    """The view of an engine that has just been made; it ends with the engine, which it must not hold."""
    from .window_view import WindowView

    view = WindowView()
    _windows.append((weakref.ref(engine), view))
    # Blender's engine is gone by then: nothing of it may be touched.
    weakref.finalize(engine, _close, view)
    wake()
    return view


def _close(view: Any) -> None:
    _windows[:] = [entry for entry in _windows if entry[1] is not view]
    view.close()


def wake() -> None:
    """Look at the processes, soon and often."""
    if bpy.app.timers.is_registered(_tick):
        bpy.app.timers.unregister(_tick)
    bpy.app.timers.register(_tick, first_interval=_BUSY_SECONDS)


def _tick() -> float | None:
    is_busy = False
    for reference, view in list(_windows):
        engine = reference()
        if engine is None:
            continue
        redraw, will_change = view.tick()
        is_busy |= will_change
        if redraw:
            # Blender may have freed it a moment ago.
            with contextlib.suppress(ReferenceError):
                engine.tag_redraw()
    if is_busy:
        return _BUSY_SECONDS
    from . import host

    uses_us = any(scene.render.engine == "NEURALGUIDE" for scene in bpy.data.scenes)
    has_spare = host.drop_spare(whatever=not uses_us)
    return _IDLE_SECONDS if _windows or has_spare else None


@bpy.app.handlers.persistent
def close_all(*_args: Any) -> None:
    """End all processes; windows that are still there start new ones."""
    import sys

    # Not loaded, nothing to end.
    host = sys.modules.get(f"{__package__}.host")
    if host is not None:
        host.close_all()


def register() -> None:
    """Processes end with their file."""
    bpy.app.handlers.load_pre.append(close_all)
    atexit.register(close_all)


def unregister() -> None:
    """End them now."""
    if bpy.app.timers.is_registered(_tick):
        bpy.app.timers.unregister(_tick)
    if close_all in bpy.app.handlers.load_pre:
        bpy.app.handlers.load_pre.remove(close_all)
    atexit.unregister(close_all)
    close_all()
    _windows.clear()
