# SPDX-License-Identifier: GPL-3.0-or-later
"""Mixing the light groups of frames for the command line: it names the files, and returns what went wrong."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import bpy

from .cli_files import say_files
from .light_mix_operator import make_mixer
from .light_mix_sequence import FOLDER


def mix_frames(scene: bpy.types.Scene, path: Path, threads: int, should_stop: Callable[[], bool]) -> str:
    """Mix the frames of which a file is one by the scene's factors, until `should_stop()`.

    Returns
    -------
    str
        What went wrong, '' where nothing did.

    Raises
    ------
    LayersError
        If the first frame cannot be mixed.
    """
    return say_files(make_mixer(scene, path, path.parent / FOLDER, threads), "mixing lights", should_stop)
