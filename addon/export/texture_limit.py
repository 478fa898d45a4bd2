# SPDX-License-Identifier: GPL-3.0-or-later
"""What Simplify allows textures: a number of texels along a side, and from Blender 5.2 on a share of their size."""

from __future__ import annotations

from typing import NamedTuple

from engine.scene.image import Image
from engine.scene.reduced_image import reduced, reduction

from ..versions import read_setting
from .context import ExportContext, cycles_property

_OFF = "OFF"


class TextureLimit(NamedTuple):
    """Most texels along a side, 0 = any; most of an image's size."""

    size: int = 0
    resolution: float = 1.0

    def apply(self, image: Image) -> Image:
        """The image at the size that is left to it."""
        height, width = image.pixels.shape[:2]
        return reduced(image, reduction(width, height, self.size, self.resolution))


def read_limit(context: ExportContext) -> TextureLimit:
    """What holds for the render, or for the window that the scene is exported for."""
    scene = context.scene
    if not scene.render.use_simplify:
        return TextureLimit()
    in_window = context.window is not None
    size = cycles_property(scene, "texture_limit" if in_window else "texture_limit_render", _OFF)
    resolution = read_setting(
        scene, "cycles.texture_resolution" if in_window else "cycles.texture_resolution_render"
    )
    return TextureLimit(0 if size == _OFF else int(size), float(resolution))
