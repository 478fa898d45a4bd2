# SPDX-License-Identifier: GPL-3.0-or-later
"""Files of frames that several processes render between them: which are finished, and who is at those that are not.

An empty file says that somebody has begun a frame, as Blender's Placeholders do. Whoever begins it here also locks the
file while the frame is rendered. The system frees the lock when the process ends, however it ends, so that what a
killed process leaves behind is nobody's.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Sequence
from pathlib import Path

import bpy

from engine.processes.file_locks import lock

from .output_files import is_whole, was_interrupted

#: No picture is shorter, and shorter files do not even tell their format.
_LEAST_BYTES = 24


def frame_paths(render: bpy.types.RenderSettings, frame: int) -> list[Path]:
    """The files that a frame is saved to: one, or in stereo one for each eye where the format has no room for both.

    Raises
    ------
    RuntimeError
        If Blender cannot make out the output path, saying why.
    """
    views: list[bpy.types.SceneRenderView] = []
    if render.use_multiview and render.image_settings.views_format == "INDIVIDUAL":
        names = ("left", "right") if render.views_format == "STEREO_3D" else tuple(render.views.keys())
        views = [view for view in render.views if view.use and view.name in names]
    if not views:
        return [Path(render.frame_path(frame=frame))]
    return [Path(render.frame_path(frame=frame, view=view.name)) for view in views]


def is_finished(path: Path) -> bool:
    """Whether a file is a frame: whole, and of a render that nobody has interrupted."""
    try:
        return path.stat().st_size >= _LEAST_BYTES and is_whole(path) and not was_interrupted(path)
    except OSError:
        return False


class FrameClaim:
    """The right to render a frame, held until `release`.

    Parameters
    ----------
    paths : sequence of Path
        Its files.
    makes_placeholders : bool
        Whether there is to be an empty file where there is none. Without, only files that are there can be claimed.
    """

    def __init__(self, paths: Sequence[Path], *, makes_placeholders: bool) -> None:
        self._paths = paths
        self._flags = os.O_RDWR | (os.O_CREAT if makes_placeholders else 0)
        self._held: list[tuple[Path, int]] = []

    def take(self) -> bool:
        """Claim the frame; False: another process renders it.

        Raises
        ------
        OSError
            If a file cannot be made, or not be written.
        """
        for path in self._paths:
            try:
                is_taken = self._take(path)
            except FileNotFoundError:
                if self._flags & os.O_CREAT:
                    raise
                continue
            if not is_taken:
                self.release()
                return False
        return True

    def _take(self, path: Path) -> bool:
        if self._flags & os.O_CREAT:
            path.parent.mkdir(parents=True, exist_ok=True)
        while True:
            file = os.open(path, self._flags, 0o666)
            if not lock(file):
                os.close(file)
                return False
            try:
                if os.path.samestat(os.fstat(file), path.stat()):
                    self._held.append((path, file))
                    return True
            except FileNotFoundError:
                pass
            # Whoever had it has given it up meanwhile, and its file is gone.
            os.close(file)

    def release(self) -> None:
        """Let others have the frame; what is still empty goes."""
        for path, file in self._held:
            with contextlib.suppress(OSError):
                if os.fstat(file).st_size == 0:
                    path.unlink()
            os.close(file)
        self._held = []
