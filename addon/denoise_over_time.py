# SPDX-License-Identifier: GPL-3.0-or-later
"""Denoising an animation over time: which scenes ask for it, whether it can be done, and what a render says of it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import bpy

from .shared_settings import layer_is_denoised, setting_value

if TYPE_CHECKING:
    from engine.scene.description import Notice


def problem(scene: bpy.types.Scene) -> str:
    """Why the frames of an animation of this scene cannot be denoised over time, '' if they can."""
    render = scene.render
    if render.image_settings.file_format != "OPEN_EXR_MULTILAYER":
        return "frames are not saved as OpenEXR MultiLayer"
    if render.use_motion_blur:
        return "motion blur leaves no vectors"
    if render.use_multiview:
        return "frames are stereo"
    if scene.frame_step != 1:
        return f"vectors lead to the next frame, and the frame step is {scene.frame_step}"
    return ""


def is_wanted(scene: bpy.types.Scene) -> bool:
    """Whether the scene asks for it; denoising is its precondition."""
    ours = getattr(scene, "neuralguide", None)  # None where the add-on only exports
    return ours is not None and ours.denoise_over_time and setting_value(scene, "use_denoising")


def needs_passes(scene: bpy.types.Scene, view_layer: bpy.types.ViewLayer) -> bool:
    """Whether a view layer gets Vector and Denoising Data for this, whatever its own switches say."""
    return is_wanted(scene) and not problem(scene) and layer_is_denoised(scene, view_layer, True)


def counts(scene: bpy.types.Scene) -> bool:
    """Whether an animation of the scene is to be denoised over time once it is rendered, and can be."""
    return scene.render.engine == "NEURALGUIDE" and is_wanted(scene) and not problem(scene)


def notices(scene: bpy.types.Scene) -> list[Notice]:
    """What a render has to say of it: one or none."""
    from engine.scene.description import Notice

    if not is_wanted(scene) or not (text := problem(scene)):
        return []
    return [Notice("Denoise Over Time", text, "frames are denoised one by one")]
