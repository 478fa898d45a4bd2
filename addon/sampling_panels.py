# SPDX-License-Identifier: GPL-3.0-or-later
"""Panels of sampling, in Cycles' order: viewport and render apart, lights, and what is better left alone."""

from __future__ import annotations

import bpy

from engine.denoise.library import problem as denoiser_problem

from . import denoise_over_time, warm_up
from .panel_parts import RenderPanel, add_shared, draw_presets, draw_section, draw_shared
from .shared_settings import follows_cycles, has_cycles, setting_value


def _draw_samples(layout: bpy.types.UILayout, scene: bpy.types.Scene, kind: str) -> None:
    """Noise threshold and numbers of samples; `kind` is `"preview_"` for viewports, `""` for renders."""
    switch = f"use_{kind}adaptive_sampling"
    is_adaptive = setting_value(scene, switch)
    row = layout.column(align=True, heading="Noise Threshold").row(align=True)
    add_shared(row, scene, switch, text="")
    threshold = row.row()
    threshold.active = is_adaptive
    add_shared(threshold, scene, f"{kind}adaptive_threshold", text="")
    draw_shared(layout, scene, f"{kind}samples", text="Max Samples" if is_adaptive else "Samples")
    if is_adaptive:
        draw_shared(layout, scene, f"{kind}adaptive_min_samples", text="Min Samples")


class NEURALGUIDE_PT_sampling(RenderPanel, bpy.types.Panel):  # noqa: N801 (Blender's convention)
    """Whose settings count, and whether light has wavelengths."""

    bl_label = "Sampling"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw."""
        warm_up.start()
        scene = context.scene
        settings = scene.neuralguide
        column = self.column()
        if has_cycles(scene):
            column.prop(settings, "use_cycles_settings")
            if not settings.use_cycles_settings:
                column.operator("neuralguide.copy_cycles_settings")
        column.prop(settings, "spectral")
        column.prop(settings, "caustics")


class NEURALGUIDE_PT_sampling_viewport(RenderPanel, bpy.types.Panel):  # noqa: N801
    """How long a viewport goes on."""

    bl_label = "Viewport"
    bl_parent_id = "NEURALGUIDE_PT_sampling"

    def draw_header_preset(self, context: bpy.types.Context) -> None:
        """Draw the button for Cycles' presets."""
        draw_presets(self.layout, context.scene, "CYCLES_PT_viewport_sampling_presets")

    def draw(self, context: bpy.types.Context) -> None:
        """Draw."""
        _draw_samples(self.column(), context.scene, "preview_")


class NEURALGUIDE_PT_sampling_render(RenderPanel, bpy.types.Panel):  # noqa: N801
    """How long a render goes on."""

    bl_label = "Render"
    bl_parent_id = "NEURALGUIDE_PT_sampling"

    def draw_header_preset(self, context: bpy.types.Context) -> None:
        """Draw the button for Cycles' presets."""
        draw_presets(self.layout, context.scene, "CYCLES_PT_sampling_presets")

    def draw(self, context: bpy.types.Context) -> None:
        """Draw."""
        column = self.column()
        _draw_samples(column, context.scene, "")
        draw_shared(column, context.scene, "time_limit")


class _DenoisePanel(RenderPanel):
    """What takes the noise out; `kind` is `"preview_"` for viewports, `""` for renders."""

    bl_label = "Denoise"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012
    kind = ""

    def draw_header(self, context: bpy.types.Context) -> None:
        """Draw the switch."""
        row = self.layout.row()  # type: ignore[attr-defined]
        row.active = not denoiser_problem()
        draw_shared(row, context.scene, f"use_{self.kind}denoising", text="")

    def draw(self, context: bpy.types.Context) -> None:
        """Draw."""
        scene, kind, problem = context.scene, self.kind, denoiser_problem()
        column = self.column()
        if problem:
            # A label is one line.
            for part in problem.split(": "):
                column.label(text=part)
        column.active = not problem and setting_value(scene, f"use_{kind}denoising")
        draw_shared(column, scene, f"{kind}denoising_input_passes", text="Passes")
        if setting_value(scene, f"{kind}denoising_input_passes") != "RGB":
            draw_shared(column, scene, f"{kind}denoising_prefilter", text="Prefilter")
        draw_shared(column, scene, f"{kind}denoising_quality", text="Quality")
        if kind:
            draw_shared(column, scene, f"{kind}denoising_start_sample", text="Start Sample")
            return
        column.prop(scene.neuralguide, "denoised_threshold")
        column.prop(scene.neuralguide, "denoise_over_time")
        if denoise_over_time.is_wanted(scene) and (text := denoise_over_time.problem(scene)):
            column.label(text=f"Not over time: {text}", icon="ERROR")
        row = self.layout.row()  # type: ignore[attr-defined]
        row.active = not problem
        row.operator("neuralguide.denoise_sequence", text="Denoise Sequence of Frames...")


class _ViewportDenoisePanel(_DenoisePanel):
    kind = "preview_"


class NEURALGUIDE_PT_sampling_viewport_denoise(_ViewportDenoisePanel, bpy.types.Panel):  # noqa: N801
    """What takes the noise out of a viewport."""

    bl_parent_id = "NEURALGUIDE_PT_sampling_viewport"


class NEURALGUIDE_PT_sampling_render_denoise(_DenoisePanel, bpy.types.Panel):  # noqa: N801
    """What takes the noise out of the finished picture."""

    bl_parent_id = "NEURALGUIDE_PT_sampling_render"


class NEURALGUIDE_PT_sampling_lights(RenderPanel, bpy.types.Panel):  # noqa: N801
    """How lights are sampled."""

    bl_label = "Lights"
    bl_parent_id = "NEURALGUIDE_PT_sampling"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012

    def draw(self, context: bpy.types.Context) -> None:
        """Draw."""
        draw_section(self.column(), context.scene, "Lights")


class NEURALGUIDE_PT_sampling_advanced(RenderPanel, bpy.types.Panel):  # noqa: N801
    """What is better left alone."""

    bl_label = "Advanced"
    bl_parent_id = "NEURALGUIDE_PT_sampling"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012

    def draw(self, context: bpy.types.Context) -> None:
        """Draw."""
        scene = context.scene
        column = self.column()
        row = column.row(align=True)
        draw_shared(row, scene, "seed")
        draw_shared(row, scene, "use_animated_seed", text="", icon="TIME")
        for name in ("min_light_bounces", "min_transparent_bounces"):
            draw_shared(column, scene, name)
        if follows_cycles(scene) and any(layer.samples > 0 for layer in scene.view_layers):
            column.prop(scene.cycles, "use_layer_samples")


#: Parents first, in the order of the properties editor.
PANELS: tuple[type[bpy.types.Panel], ...] = (
    NEURALGUIDE_PT_sampling,
    NEURALGUIDE_PT_sampling_viewport,
    NEURALGUIDE_PT_sampling_viewport_denoise,
    NEURALGUIDE_PT_sampling_render,
    NEURALGUIDE_PT_sampling_render_denoise,
    NEURALGUIDE_PT_sampling_lights,
    NEURALGUIDE_PT_sampling_advanced,
)
