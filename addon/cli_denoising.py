# SPDX-License-Identifier: GPL-3.0-or-later
"""Denoising frames over time for the command line: it names the files, and returns what went wrong."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import bpy

from . import console
from .cli_files import say_files
from .denoise_after_render import frames_to_denoise
from .denoise_sequence import FOLDER, SequenceDenoiser
from .exr_layers import LayersError
from .frame_files import is_finished


def denoise_frames(paths: Sequence[Path], threads: int, should_stop: Callable[[], bool]) -> str:
    """Denoise frames until `should_stop()`; returns what went wrong, '' where nothing did.

    Raises
    ------
    LayersError
        If the first frame cannot be denoised.
    """
    denoiser = SequenceDenoiser(paths, paths[0].parent / FOLDER, threads=threads)
    return say_files(denoiser, "denoising over time", should_stop)


def denoise_animation(
    scene: bpy.types.Scene, frames: Sequence[int], threads: int, should_stop: Callable[[], bool]
) -> str:
    """Make denoised copies of frames that were rendered; other processes may still have some of them to do.

    Returns
    -------
    str
        What went wrong, '' where nothing did.
    """
    render = scene.render
    files = {frame: path for frame in frames if is_finished(path := Path(render.frame_path(frame=frame)))}
    paths = frames_to_denoise(scene, files)
    try:
        return denoise_frames(paths, threads, should_stop) if paths else ""
    except (LayersError, OSError) as error:
        console.complain(f"denoising over time: {error}")
        return str(error)
