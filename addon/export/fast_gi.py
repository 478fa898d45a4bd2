# SPDX-License-Identifier: GPL-3.0-or-later
"""Cycles' Fast GI Approximation: the scene's method and bounces, the world's share and objects' distances."""

from __future__ import annotations

import bpy

from engine.scene.fast_gi import FastGi

from ..shared_settings import follows_cycles
from .context import ExportContext, cycles_property
from .world import world_of


def export_fast_gi(context: ExportContext) -> FastGi:
    """What the scene wants, if it follows Cycles' settings; nothing without a world."""
    world = world_of(context)
    scene = context.scene
    if world is None or not follows_cycles(scene) or not cycles_property(scene, "use_fast_gi", False):
        return FastGi()
    # Also where the view layer leaves the world out.
    factor = context.finite(world.light_settings.ao_factor, 1.0, f"World {world.name}", "Factor of Ambient Occlusion")
    if factor == 0.0:
        return FastGi()
    if cycles_property(scene, "fast_gi_method", "REPLACE") == "ADD":
        return FastGi(added=factor)
    name = "ao_bounces_render" if context.window is None else "ao_bounces"
    return FastGi(bounces=cycles_property(scene, name, 1), background=factor)


def occlusion_distance(context: ExportContext, shown: bpy.types.Object, parent: bpy.types.Object) -> float:
    """How far short rays look that leave an object [m]: by itself, or by what instances it; 0 = as the world says."""
    for owner in (shown, parent):
        distance = context.finite(cycles_property(owner, "ao_distance", 0.0), 0.0, owner.name, "AO Distance")
        if distance != 0.0:
            return distance
    return 0.0
