# SPDX-License-Identifier: GPL-3.0-or-later
"""Loads the engine while the user still works: a second less between the first F12 and its first picture."""

from __future__ import annotations

import threading
from typing import Any

import bpy

from .engine import NeuralGuideRenderEngine

_threads: list[threading.Thread] = []


def start() -> None:
    """Load the engine in a thread, once; not in background, where a render is about to load it anyway."""
    if not bpy.app.background:
        begin()


def begin() -> None:
    """`start`, in background too."""
    if _threads:
        return
    # No daemon: Blender must not take the interpreter away from under a half-loaded library.
    thread = threading.Thread(target=_load, name="warm up", daemon=False)
    _threads.append(thread)
    thread.start()


def _load() -> None:
    try:
        from engine.render.session import Session  # noqa: F401 (loaded, not used)
    except Exception:
        # Nobody asked for a picture yet. The render that does will stumble over the same thing and say so.
        return


@bpy.app.handlers.persistent
def _after_loading(*_args: Any) -> None:
    if any(scene.render.engine == NeuralGuideRenderEngine.bl_idname for scene in bpy.data.scenes):
        start()


def register() -> None:
    """Load the engine with every file that uses it; panels call `start` for those where it is chosen later."""
    bpy.app.handlers.load_post.append(_after_loading)


def unregister() -> None:
    """Wait for the thread, and stop looking at files."""
    if _after_loading in bpy.app.handlers.load_post:
        bpy.app.handlers.load_post.remove(_after_loading)
    while _threads:
        _threads.pop().join()
