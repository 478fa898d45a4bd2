# SPDX-License-Identifier: GPL-3.0-or-later
"""What the view layer's passes ask of the export."""

from __future__ import annotations

from engine.scene.passes import Aov, PassSettings

from ..denoise_over_time import needs_passes
from ..denoising_motion import asks_for_motion, has_motion
from ..versions import BACKGROUND_VECTORS, LOOKED_UP_TRANSMISSION, is_newer, is_since
from .context import ExportContext
from .world import world_of

#: Mist's exponent by Blender's names.
_FALLOFF = {"QUADRATIC": 2.0, "LINEAR": 1.0, "INVERSE_QUADRATIC": 0.5}


def read_requests(context: ExportContext) -> None:
    """Note in `context` what else than the picture needs must be exported."""
    layer = context.view_layer
    context.aovs = {aov.name: aov.type == "COLOR" for aov in layer.aovs if aov.is_valid}
    context.wants_assets = layer.use_pass_cryptomatte_asset
    # Viewports have no passes, and stay at their frame.
    is_final = context.depsgraph.mode == "RENDER"
    is_asked = layer.use_pass_vector or needs_passes(context.scene, layer) or has_motion(context.scene, layer)
    context.wants_vectors = is_final and is_asked and not context.is_blurred
    if layer.use_pass_vector and context.is_blurred:
        problem = "has a Vector pass, which is empty where there is motion blur"
        context.notice(f"View layer {layer.name}", problem, "zeros, as in Cycles")
    if asks_for_motion(layer) and not has_motion(context.scene, layer):
        problem = "asks for motion for denoisers, which there is not where there is motion blur"
        context.notice(f"View layer {layer.name}", problem, "no such passes, as in Cycles")


def export_pass_settings(context: ExportContext) -> PassSettings:
    """Settings of the passes, all but what moves."""
    layer = context.view_layer
    cycles = getattr(layer, "cycles", None)
    settings = PassSettings(
        alpha_threshold=context.finite(
            layer.pass_alpha_threshold, 0.5, f"View layer {layer.name}", "Alpha Threshold"
        ),
        aovs=tuple(Aov(name, is_color) for name, is_color in context.aovs.items()),
        background_moves=is_since(BACKGROUND_VECTORS) and not is_newer(BACKGROUND_VECTORS),
        looks_up_transmission=is_since(LOOKED_UP_TRANSMISSION),
        follows_mirrors=getattr(cycles, "denoising_pass_follow_reflections", True),
        weighs_by_roughness=getattr(cycles, "denoising_pass_use_albedo_roughness_weighting", True),
    )
    shown = world_of(context)
    if shown is not None:
        # Also where the view layer leaves the world out.
        settings.occlusion_distance = context.finite(
            shown.light_settings.distance, settings.occlusion_distance, f"World {shown.name}",
            "Distance of Ambient Occlusion",
        )
    world = context.scene.world
    if world is not None:
        mist = world.mist_settings
        subject = f"World {world.name}"
        settings.mist_start = context.finite(mist.start, settings.mist_start, subject, "Start of the mist")
        settings.mist_depth = context.finite(mist.depth, settings.mist_depth, subject, "Depth of the mist")
        settings.mist_falloff = _FALLOFF[mist.falloff]
    return settings
