# SPDX-License-Identifier: GPL-3.0-or-later
"""Loads the engine while the user still works: a second less between the first F12 and its first picture.

After an installation, a process of its own has Python's byte code of all that a render loads made, once.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import threading
from importlib.util import cache_from_source
from pathlib import Path
from typing import Any

import bpy

import engine as engine_package

from .engine import NeuralGuideRenderEngine

_SERVICE = "render.byte_code"
#: Where byte code of this module lies, that of all others does.
_LAST = Path(engine_package.__file__).parent / "render" / "loaded_whole.py"
#: What loading takes on a slow machine [s].
_PATIENCE = 20.0

_threads: list[threading.Thread] = []
_children: list[Any] = []


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


def needs_byte_code() -> bool:
    """Whether byte code is missing, and can be kept."""
    if sys.dont_write_bytecode:
        return False
    return not os.path.isfile(cache_from_source(str(_LAST))) and os.access(_LAST.parent, os.W_OK)


def make_byte_code() -> None:
    """Start the process that makes it, if it is missing."""
    if _children or not needs_byte_code():
        return
    from engine.processes.child import Child
    from engine.processes.interpreter import find_interpreter

    interpreter = find_interpreter()
    if interpreter is not None:
        with contextlib.suppress(OSError):
            _children.append(Child(interpreter, _SERVICE, {}, has_answers=False, has_same_path=True))


@bpy.app.handlers.persistent
def _after_loading(*_args: Any) -> None:
    if any(scene.render.engine == NeuralGuideRenderEngine.bl_idname for scene in bpy.data.scenes):
        start()


def register() -> None:
    """Load the engine with every file that uses it; panels call `start` for those where it is chosen later."""
    bpy.app.handlers.load_post.append(_after_loading)
    make_byte_code()


def unregister() -> None:
    """Wait for the thread and the process, and stop looking at files."""
    if _after_loading in bpy.app.handlers.load_post:
        bpy.app.handlers.load_post.remove(_after_loading)
    while _threads:
        _threads.pop().join()
    while _children:
        child = _children.pop()
        # Who installs and leaves at once has byte code next time.
        with contextlib.suppress(subprocess.TimeoutExpired):
            child.process.wait(timeout=_PATIENCE)
        child.close(is_patient=False)
        child.release()
