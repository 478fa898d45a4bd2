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
