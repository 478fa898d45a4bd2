# SPDX-License-Identifier: GPL-3.0-or-later
"""Panels of Simplify: what Blender itself simplifies, and culling. Cycles' texture limits are not among it."""

from __future__ import annotations

import bpy

from .panel_parts import RenderPanel


class NEURALGUIDE_PT_simplify(RenderPanel, bpy.types.Panel):  # noqa: N801 (Blender's convention)
    """Whether anything is simplified."""

    bl_label = "Simplify"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012

    def draw_header(self, context: bpy.types.Context) -> None:
        """Draw the switch."""
        self.layout.prop(context.scene.render, "use_simplify", text="")

    def draw(self, _context: bpy.types.Context) -> None:
        """Draw nothing: both parts have a panel."""


class NEURALGUIDE_PT_simplify_viewport(RenderPanel, bpy.types.Panel):  # noqa: N801
    """What viewports simplify."""

    bl_label = "Viewport"
    bl_parent_id = "NEURALGUIDE_PT_simplify"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw."""
        render = context.scene.render
        column = self.column()
        column.active = render.use_simplify
        column.prop(render, "simplify_subdivision", text="Max Subdivision")
        column.prop(render, "simplify_child_particles", text="Child Particles")
        if hasattr(render, "simplify_volumes"):
            column.prop(render, "simplify_volumes", text="Volume Resolution")
        if hasattr(render, "use_simplify_normals"):  # since Blender 4.1
            column.prop(render, "use_simplify_normals", text="Normals")


class NEURALGUIDE_PT_simplify_render(RenderPanel, bpy.types.Panel):  # noqa: N801
    """What renders simplify."""

    bl_label = "Render"
    bl_parent_id = "NEURALGUIDE_PT_simplify"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw."""
        render = context.scene.render
        column = self.column()
        column.active = render.use_simplify
        column.prop(render, "simplify_subdivision_render", text="Max Subdivision")
        column.prop(render, "simplify_child_particles_render", text="Child Particles")


class NEURALGUIDE_PT_simplify_culling(RenderPanel, bpy.types.Panel):  # noqa: N801
    """What renders leave out of objects that want it."""

    bl_label = "Culling"
    bl_parent_id = "NEURALGUIDE_PT_simplify"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Whether Cycles' add-on, whose settings these are, is on."""
        return super().poll(context) and hasattr(context.scene, "cycles")

    def draw(self, context: bpy.types.Context) -> None:
        """Draw."""
        settings = context.scene.cycles
        column = self.column()
        column.active = context.scene.render.use_simplify
        for switch, margin, heading in (
            ("use_camera_cull", "camera_cull_margin", "Camera Culling"),
            ("use_distance_cull", "distance_cull_margin", "Distance Culling"),
        ):
            row = column.row(heading=heading)
            row.prop(settings, switch, text="")
            part = row.column()
            part.active = getattr(settings, switch)
            part.prop(settings, margin, text="")


#: Parents first.
PANELS: tuple[type[bpy.types.Panel], ...] = (
    NEURALGUIDE_PT_simplify,
    NEURALGUIDE_PT_simplify_viewport,
    NEURALGUIDE_PT_simplify_render,
    NEURALGUIDE_PT_simplify_culling,
)
