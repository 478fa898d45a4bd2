# SPDX-License-Identifier: GPL-3.0-or-later
"""Movies as textures."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from benchmarks.scenes.movie_files import write_movie
from benchmarks.scenes.registry import scene
from benchmarks.scenes.studio import Nodes, Socket, Surface
from benchmarks.scenes.textures import asymmetric_pixels, boards


@scene("textured-movie")
def textured_movie() -> None:
    """Frames of a movie: the scene's own, cyclic, offset, before the first and after the last, and without refresh."""
    path = Path(bpy.app.tempdir or tempfile.gettempdir()) / "textured-movie.avi"
    levels = np.arange(1, 7)[:, None, None, None] / 6.0
    write_movie(path, np.rint(255.0 * levels * asymmetric_pixels()[..., :3]).astype(np.uint8))
    movie = bpy.data.images.load(str(path))
    bpy.context.scene.frame_set(4)

    def surface(**user: Any) -> Surface:
        def build(nodes: Nodes) -> Socket:
            texture = nodes.node("TexImage", {"image": movie}, Vector=nodes("TexCoord", output="UV"))
            for key, value in {"frame_duration": 6, "use_auto_refresh": True, **user}.items():
                setattr(texture.image_user, key, value)
            return nodes("BsdfDiffuse", Color=texture.outputs["Color"])

        return build

    boards([
        surface(),
        surface(frame_duration=3, use_cyclic=True),
        surface(frame_start=2, frame_offset=-1),
        surface(frame_start=9),
        surface(frame_offset=8),
        surface(frame_start=2, use_auto_refresh=False),
    ])
