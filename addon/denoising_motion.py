# SPDX-License-Identifier: GPL-3.0-or-later
"""Passes of motion for denoisers (Blender 5.3): which view layers ask for them, and which have them."""

from __future__ import annotations

import bpy


def asks_for_motion(view_layer: bpy.types.ViewLayer) -> bool:
    """Whether a view layer asks for them, as in Cycles along with Denoising Data; never before Blender 5.3."""
    cycles = getattr(view_layer, "cycles", None)
    return bool(
        getattr(cycles, "denoising_store_passes", False) and getattr(cycles, "denoising_store_motion_passes", False)
    )


def has_motion(scene: bpy.types.Scene, view_layer: bpy.types.ViewLayer) -> bool:
    """Whether a view layer of `scene` has them: as in Cycles, not where there is motion blur."""
    is_blurred = scene.render.use_motion_blur and getattr(view_layer, "use_motion_blur", True)
    return asks_for_motion(view_layer) and not is_blurred
