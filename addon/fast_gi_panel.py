# SPDX-License-Identifier: GPL-3.0-or-later
"""Panel of Cycles' Fast GI Approximation."""

from __future__ import annotations

import bpy

from .panel_parts import RenderPanel
from .shared_settings import follows_cycles


class NEURALGUIDE_PT_light_paths_fast_gi(RenderPanel, bpy.types.Panel):  # noqa: N801 (Blender's convention)
    """What stands for the light of later bounces: Cycles' own settings, and the world's."""

    bl_label = "Fast GI Approximation"
    bl_parent_id = "NEURALGUIDE_PT_light_paths"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Whether Cycles' settings count."""
        return super().poll(context) and follows_cycles(context.scene)

    def draw_header(self, context: bpy.types.Context) -> None:
        """Draw the switch."""
        self.layout.prop(context.scene.cycles, "use_fast_gi", text="")

    def draw(self, context: bpy.types.Context) -> None:
        """Draw."""
        settings, world = context.scene.cycles, context.scene.world
        column = self.column()
        column.active = settings.use_fast_gi
        column.prop(settings, "fast_gi_method", text="Method")
        if world is not None:
            column.prop(world.light_settings, "ao_factor", text="AO Factor")
            column.prop(world.light_settings, "distance", text="AO Distance")
        if settings.fast_gi_method == "REPLACE":
            column.prop(settings, "ao_bounces", text="Viewport Bounces")
            column.prop(settings, "ao_bounces_render", text="Render Bounces")
