# SPDX-License-Identifier: GPL-3.0-or-later
"""Freestyle: the lines that Blender draws over a picture are strokes, which the engine renders.

Blender finds the lines once a view layer is rendered. It makes a scene of them, flat strokes before an orthographic
camera, and renders that with the settings of the scene: by the engine itself if `bl_use_custom_freestyle` says so, as
Cycles does, and else by EEVEE. Such a render is no render of the user's: it keeps no fields and reports nothing.
"""

from __future__ import annotations

import dataclasses

import bpy

from engine.settings import RenderSettings

#: Blender's name of the pass that has the lines alone.
PASS_NAME = "Freestyle"


def is_of_strokes(scene: bpy.types.Scene) -> bool:
    """Whether Blender has made a scene to draw lines: it belongs to no file."""
    return all(scene.original != other for other in bpy.data.scenes)


def stroke_settings(settings: RenderSettings) -> RenderSettings:
    """Settings for strokes: they glow in flat colours, so that there is nothing to learn, nor noise."""
    return dataclasses.replace(
        settings, guiding_method="OFF", radiance_cache="OFF", use_denoising=False, denoised_threshold=0.0,
        time_limit=0.0, spectral="OFF", caustics="PATHS",
    )


def has_pass(scene: bpy.types.Scene, view_layer: bpy.types.ViewLayer) -> bool:
    """Whether lines go into a pass of their own."""
    settings = getattr(view_layer, "freestyle_settings", None)
    return scene.render.use_freestyle and settings is not None and settings.as_render_pass
