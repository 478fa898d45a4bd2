# SPDX-License-Identifier: GPL-3.0-or-later
"""An image editor in Blender's window. Needs bpy."""

from __future__ import annotations

from typing import Any


def image_editor(image: Any) -> Any:
    """Turn the window's first area into an image editor that shows an image; returns its space."""
    import bpy

    area = bpy.context.window_manager.windows[0].screen.areas[0]
    area.type = "IMAGE_EDITOR"
    space = area.spaces.active
    space.image = image
    return space


def pixels_of(image: Any) -> Any:
    """Pixels of an image, float32 (height, width, 4), row 0 at the bottom."""
    import numpy as np

    pixels = np.empty(image.size[0] * image.size[1] * 4, np.float32)
    image.pixels.foreach_get(pixels)
    return pixels.reshape(image.size[1], image.size[0], 4)
