# SPDX-License-Identifier: GPL-3.0-or-later
"""What a scene's Cycles settings ask for and the engine does not have: each is named, none ignored in silence."""

from __future__ import annotations

from typing import TYPE_CHECKING

import bpy

from .shared_settings import follows_cycles, layer_is_denoised, setting_value
from .versions import read_setting

if TYPE_CHECKING:
    from engine.scene.description import Notice


def _is_set_on(group: bpy.types.PropertyGroup, name: str) -> bool:
    """Whether a switch was turned on by hand; older Blenders may not have it."""
    return hasattr(group, name) and bool(group.is_property_set(name) and getattr(group, name))


def unsupported_settings(scene: bpy.types.Scene, view_layer: bpy.types.ViewLayer) -> list[Notice]:
    """Notices of a scene that follows Cycles' settings; none of one that does not."""
    from engine.scene.description import Notice

    if not follows_cycles(scene):
        return []
    cycles = scene.cycles
    is_denoised = layer_is_denoised(scene, view_layer, setting_value(scene, "use_denoising"))
    found = []
    for is_asked, problem, fallback in (
        (
            is_denoised and cycles.denoiser == "OPTIX",
            "denoising by OptiX is not supported",
            "Open Image Denoise takes the noise out",
        ),
        (
            # Where it is on by default nobody has asked.
            is_denoised and _is_set_on(cycles, "denoising_use_gpu"),
            "denoising on the GPU is not supported",
            "the CPU denoises",
        ),
        (
            getattr(cycles, "use_sample_subset", False),  # Blender 3.4 has none
            "a subset of samples is not supported",
            "samples from the first to the last",
        ),
        (
            cycles.direct_light_sampling_type != "MULTIPLE_IMPORTANCE_SAMPLING",
            "sampling light in one way only is not supported",
            "lights are sampled, and met by scattered paths too",
        ),
        (
            cycles.film_transparent_glass and setting_value(scene, "film_transparent"),
            "transparent glass is not supported",
            "glass hides the background",
        ),
        (
            read_setting(scene, "cycles.use_pixel_jitter"),
            "pixel jitter is not supported",
            "the same places in the pixel in every frame",
        ),
        (cycles.shading_system, "Open Shading Language is not supported", "built-in nodes alone"),
        (cycles.device == "GPU", "rendering on the GPU is not supported", "the CPU renders"),
    ):
        if is_asked:
            found.append(Notice(scene.name, problem, fallback))
    return found
