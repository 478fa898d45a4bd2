# SPDX-License-Identifier: GPL-3.0-or-later
"""Panels: our settings, and Blender's own and Cycles' panels that mean the same here."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import bpy

from engine.settings import EXPERIMENT_SECTIONS

from . import guiding_panels, preferences, sampling_panels, simplify_panels
from .dispersion import can_disperse, disperses_by_node
from .engine import NeuralGuideRenderEngine
from .fast_gi_panel import NEURALGUIDE_PT_light_paths_fast_gi
from .panel_parts import RenderPanel, draw_presets, draw_section, draw_shared
from .passes import requested_mattes
from .shared_settings import setting_value

_ENGINE = NeuralGuideRenderEngine.bl_idname

#: Panels of Blender that name things we do not do.
_EXCLUDED_PANELS = {
    "RENDER_PT_gpencil",
    "VIEWLAYER_PT_filter",
    "VIEWLAYER_PT_layer_passes",
    # Cycles draws its own of these.
    "DATA_PT_area",
    "DATA_PT_light",
    "DATA_PT_spot",
    "DATA_PT_falloff_curve",
    "DATA_PT_camera_dof",
    "DATA_PT_preview",
    "MATERIAL_PT_context_material",
    "MATERIAL_PT_preview",
    "NODE_DATA_PT_light",
    "NODE_DATA_PT_spot",
    "OBJECT_PT_visibility",
    "WORLD_PT_preview",
    # We draw our own.
    "RENDER_PT_simplify",
}

#: Panels that Blender keeps for its own engines, and of which all works.
_ADDED_PANELS = {"VIEWLAYER_PT_override"}

#: Cycles' panels for data that both engines read, parents first.
_CYCLES_PANELS = (
    "CYCLES_PT_context_material",
    "CYCLES_MATERIAL_PT_preview",
    "CYCLES_LIGHT_PT_preview",
    "CYCLES_WORLD_PT_preview",
    "CYCLES_MATERIAL_PT_surface",
    "CYCLES_MATERIAL_PT_settings",
    "CYCLES_MATERIAL_PT_settings_surface",
    "CYCLES_LIGHT_PT_light",
    "CYCLES_LIGHT_PT_nodes",
    "CYCLES_LIGHT_PT_beam_shape",
    "CYCLES_LIGHT_PT_settings",
    "CYCLES_WORLD_PT_surface",
    "CYCLES_WORLD_PT_ray_visibility",
    "CYCLES_WORLD_PT_settings",
    "CYCLES_WORLD_PT_settings_surface",
    "CYCLES_WORLD_PT_settings_light_group",
    "CYCLES_CAMERA_PT_dof",
    "CYCLES_CAMERA_PT_dof_aperture",
    "CYCLES_RENDER_PT_override",  # Blender 3 and 4: later it is VIEWLAYER_PT_override
    "CYCLES_OBJECT_PT_motion_blur",
    "CYCLES_OBJECT_PT_visibility",
    "CYCLES_OBJECT_PT_visibility_ray_visibility",
    "CYCLES_OBJECT_PT_visibility_culling",
    "CYCLES_OBJECT_PT_shading",  # Blender 3 and 4: later it is OBJECT_PT_shading
    "CYCLES_OBJECT_PT_shading_gi_approximation",
    "CYCLES_OBJECT_PT_lightgroup",
    "CYCLES_RENDER_PT_bake",
    "CYCLES_RENDER_PT_bake_influence",
    "CYCLES_RENDER_PT_bake_selected_to_active",
    "CYCLES_RENDER_PT_bake_output",
    "CYCLES_RENDER_PT_bake_output_margin",
)


class NEURALGUIDE_PT_light_paths(RenderPanel, bpy.types.Panel):  # noqa: N801
    """How far light is followed."""

    bl_label = "Light Paths"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012

    def draw_header_preset(self, context: bpy.types.Context) -> None:
        """Draw the button for Cycles' presets."""
        draw_presets(self.layout, context.scene, "CYCLES_PT_integrator_presets")

    def draw(self, context: bpy.types.Context) -> None:
        """Draw."""
        column = self.column()
        for names in (
            ("max_bounces",),
            ("diffuse_bounces", "glossy_bounces", "transmission_bounces", "volume_bounces"),
            ("transparent_max_bounces",),
            ("clamp_direct", "clamp_indirect"),
            ("filter_glossy",),
            ("use_caustics_reflective", "use_caustics_refractive"),
        ):
            part = column.column(align=True)
            for name in names:
                draw_shared(part, context.scene, name)


class NEURALGUIDE_PT_motion_blur(RenderPanel, bpy.types.Panel):  # noqa: N801
    """When the shutter is open: Blender's own settings, as Cycles reads them."""

    bl_label = "Motion Blur"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012

    def draw_header(self, context: bpy.types.Context) -> None:
        """Draw the switch."""
        self.layout.prop(context.scene.render, "use_motion_blur", text="")

    def draw(self, context: bpy.types.Context) -> None:
        """Draw."""
        render = context.scene.render
        column = self.column()
        column.active = render.use_motion_blur
        # Cycles' own in older Blenders.
        owner = render if hasattr(render, "motion_blur_position") else getattr(context.scene, "cycles", None)
        if owner is not None:
            column.prop(owner, "motion_blur_position", text="Position")
        column.prop(render, "motion_blur_shutter")
        cycles = getattr(context.scene, "cycles", None)
        if cycles is not None:
            column.prop(cycles, "rolling_shutter_type", text="Rolling Shutter")
            part = column.column()
            part.active = render.use_motion_blur and cycles.rolling_shutter_type != "NONE"
            part.prop(cycles, "rolling_shutter_duration", text="Row Duration")


class NEURALGUIDE_PT_motion_blur_curve(RenderPanel, bpy.types.Panel):  # noqa: N801
    """How the shutter opens and closes."""

    bl_label = "Shutter Curve"
    bl_parent_id = "NEURALGUIDE_PT_motion_blur"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012

    def draw(self, context: bpy.types.Context) -> None:
        """Draw."""
        render = context.scene.render
        column = self.column()
        column.active = render.use_motion_blur
        column.template_curve_mapping(render, "motion_blur_shutter_curve")
        row = column.row(align=True)
        for shape, icon in (
            ("SMOOTH", "SMOOTHCURVE"),
            ("ROUND", "SPHERECURVE"),
            ("ROOT", "ROOTCURVE"),
            ("SHARP", "SHARPCURVE"),
            ("LINE", "LINCURVE"),
            ("MAX", "NOCURVE"),
        ):
            row.operator("render.shutter_curve_preset", icon=icon, text="").shape = shape


class NEURALGUIDE_PT_film(RenderPanel, bpy.types.Panel):  # noqa: N801
    """Exposure, filter, background."""

    bl_label = "Film"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012

    def draw(self, context: bpy.types.Context) -> None:
        """Draw."""
        scene = context.scene
        column = self.column()
        for name in ("film_exposure", "film_transparent", "pixel_filter"):
            draw_shared(column, scene, name)
        if setting_value(scene, "pixel_filter") != "BOX":
            draw_shared(column, scene, "filter_width")


class NEURALGUIDE_PT_performance(RenderPanel, bpy.types.Panel):  # noqa: N801
    """Threads and what is kept between frames, by Blender's settings as Cycles reads them; memory for textures."""

    bl_label = "Performance"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012

    def draw(self, context: bpy.types.Context) -> None:
        """Draw."""
        scene = context.scene
        render, ours = scene.render, scene.neuralguide
        column = self.column()
        if ours.threads == 0:
            column.prop(render, "threads_mode")
            part = column.column()
            part.enabled = render.threads_mode == "FIXED"
            part.prop(render, "threads")
        else:
            row = column.row(align=True)
            row.prop(ours, "threads")
            row.operator("neuralguide.follow_cycles_setting", text="", icon="X").setting = "threads"
        column.prop(render, "use_persistent_data")
        column.prop(ours, "keep_unfinished")
        part = column.column()
        part.active = ours.keep_unfinished
        part.prop(ours, "keep_film")
        row = column.row()
        row.prop(ours, "texture_memory")
        if ours.texture_memory == 0:
            row.label(text="Automatic")


class NEURALGUIDE_PT_experiments(RenderPanel, bpy.types.Panel):  # noqa: N801
    """Settings for experiments, by section."""

    bl_label = "Experiments"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Only where the preferences ask for it."""
        return super().poll(context) and preferences.shows_experiments(context)

    def draw(self, context: bpy.types.Context) -> None:
        """Draw."""
        column = self.column()
        for section in EXPERIMENT_SECTIONS:
            part = column.column()
            part.label(text=section)
            draw_section(part, context.scene, section)


class NEURALGUIDE_PT_filter(RenderPanel, bpy.types.Panel):  # noqa: N801
    """What the view layer shows, of what this engine has."""

    bl_label = "Filter"
    bl_context = "view_layer"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012 (Blender's convention)

    def draw(self, context: bpy.types.Context) -> None:
        """Draw."""
        layer = context.view_layer
        column = self.column()
        include = column.column(heading="Include")
        include.prop(layer, "use_sky", text="Environment")
        include.prop(layer, "use_solid", text="Surfaces")
        use = column.column(heading="Use")
        use.active = context.scene.render.use_motion_blur
        use.prop(layer, "use_motion_blur", text="Motion Blur")


class NEURALGUIDE_PT_passes(RenderPanel, bpy.types.Panel):  # noqa: N801
    """Passes of the view layer."""

    bl_label = "Passes"
    bl_context = "view_layer"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw."""
        layer = context.view_layer
        column = self.column()
        data = column.column(heading="Data", align=True)
        for name, text in (
            ("use_pass_z", "Depth"),
            ("use_pass_mist", "Mist"),
            ("use_pass_position", "Position"),
            ("use_pass_normal", "Normal"),
            ("use_pass_uv", "UV"),
            ("use_pass_object_index", "Object Index"),
            ("use_pass_material_index", "Material Index"),
        ):
            data.prop(layer, name, text=text)
        vector = data.column()
        vector.active = not context.scene.render.use_motion_blur
        vector.prop(layer, "use_pass_vector", text="Vector")
        if hasattr(layer, "cycles"):
            data.prop(layer.cycles, "denoising_store_passes", text="Denoising Data")
        if hasattr(getattr(layer, "cycles", None), "denoising_store_motion_passes"):
            motion = data.column()
            motion.active = layer.cycles.denoising_store_passes and not context.scene.render.use_motion_blur
            motion.prop(layer.cycles, "denoising_store_motion_passes", text="Denoising Motion")
        column.prop(layer, "pass_alpha_threshold")
        for lobes in ("diffuse", "glossy", "transmission"):
            light = column.column(heading=lobes.capitalize(), align=True)
            for kind in ("direct", "indirect", "color"):
                light.prop(layer, f"use_pass_{lobes}_{kind}", text=kind.capitalize())
        if hasattr(layer, "cycles"):
            light = column.column(heading="Volume", align=True)
            light.prop(layer.cycles, "use_pass_volume_direct", text="Direct")
            light.prop(layer.cycles, "use_pass_volume_indirect", text="Indirect")
        light = column.column(heading="Light", align=True)
        light.prop(layer, "use_pass_emit", text="Emission")
        light.prop(layer, "use_pass_environment", text="Environment")
        light.prop(layer, "use_pass_ambient_occlusion", text="Ambient Occlusion")
        if hasattr(layer, "cycles"):
            light.prop(layer.cycles, "use_pass_shadow_catcher", text="Shadow Catcher")
        light.prop(layer.neuralguide, "use_pass_albedo")
        quality = column.column(heading="Quality", align=True)
        quality.prop(layer.neuralguide, "use_pass_sample_count")
        quality.prop(layer.neuralguide, "use_pass_variance")
        quality.prop(layer.neuralguide, "use_pass_candidate_count")
        quality.prop(layer.neuralguide, "use_pass_guiding_benefit")


class NEURALGUIDE_PT_passes_cryptomatte(RenderPanel, bpy.types.Panel):  # noqa: N801
    """Which Cryptomattes there are, and how many levels they have."""

    bl_label = "Cryptomatte"
    bl_context = "view_layer"
    bl_parent_id = "NEURALGUIDE_PT_passes"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw."""
        layer = context.view_layer
        column = self.column()
        column.prop(layer, "use_pass_cryptomatte_object", text="Object")
        column.prop(layer, "use_pass_cryptomatte_material", text="Material")
        column.prop(layer, "use_pass_cryptomatte_asset", text="Asset")
        levels = column.column()
        levels.active = bool(requested_mattes(layer))
        levels.prop(layer, "pass_cryptomatte_depth", text="Levels")


class NEURALGUIDE_PT_passes_aov(RenderPanel, bpy.types.Panel):  # noqa: N801
    """Passes that AOV Output nodes fill."""

    bl_label = "Shader AOV"
    bl_context = "view_layer"
    bl_parent_id = "NEURALGUIDE_PT_passes"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw."""
        layer = context.view_layer
        column = self.column()
        row = column.row()
        row.template_list("VIEWLAYER_UL_aov", "aovs", layer, "aovs", layer, "active_aov_index", rows=3)
        buttons = row.column(align=True)
        buttons.operator("scene.view_layer_add_aov", icon="ADD", text="")
        buttons.operator("scene.view_layer_remove_aov", icon="REMOVE", text="")
        if layer.active_aov is not None and not layer.active_aov.is_valid:
            column.label(text="Another pass has this name", icon="ERROR")


class NEURALGUIDE_PT_light_groups(RenderPanel, bpy.types.Panel):  # noqa: N801
    """Light groups of the view layer: a pass each."""

    bl_label = "Light Groups"
    bl_context = "view_layer"
    bl_parent_id = "NEURALGUIDE_PT_passes"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012

    def draw(self, context: bpy.types.Context) -> None:
        """Draw."""
        layer = context.view_layer
        row = self.layout.row()
        row.template_list(
            "UI_UL_list", "lightgroups", layer, "lightgroups", layer, "active_lightgroup_index", rows=3
        )
        buttons = row.column(align=True)
        buttons.operator("scene.view_layer_add_lightgroup", icon="ADD", text="")
        buttons.operator("scene.view_layer_remove_lightgroup", icon="REMOVE", text="")
        buttons.separator()
        buttons.menu("VIEWLAYER_MT_lightgroup_sync", icon="DOWNARROW_HLT", text="")
        self.layout.operator_menu_enum("neuralguide.make_light_groups", "by")


class NEURALGUIDE_PT_dispersion(RenderPanel, bpy.types.Panel):  # noqa: N801
    """How a material's refraction depends on the wavelength."""

    bl_label = "Dispersion"
    bl_context = "material"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Only for materials that refract."""
        return super().poll(context) and context.material is not None and can_disperse(context.material)

    def draw(self, context: bpy.types.Context) -> None:
        """Draw."""
        settings = context.material.neuralguide
        column = self.column()
        if disperses_by_node(context.material):
            column.label(text="As its Principled BSDF says", icon="INFO")
            return
        column.prop(settings, "dispersion", text="Kind")
        if settings.dispersion == "ABBE":
            column.prop(settings, "abbe_number")
        elif settings.dispersion == "CAUCHY":
            column.prop(settings, "cauchy_a")
            column.prop(settings, "cauchy_b")


def _compatible_panels() -> Iterator[type[bpy.types.Panel]]:
    """Blender's own panels that work with this engine."""
    for panel in bpy.types.Panel.__subclasses__():
        is_for_all = "BLENDER_RENDER" in getattr(panel, "COMPAT_ENGINES", ())
        if panel.__name__ in _ADDED_PANELS or (is_for_all and not _is_excluded(panel)):
            yield panel


def _is_excluded(panel: type[bpy.types.Panel] | None) -> bool:
    """Whether a panel, or one that it is a part of, names what we do not do."""
    while panel is not None:
        if panel.__name__ in _EXCLUDED_PANELS:
            return True
        panel = getattr(bpy.types, getattr(panel, "bl_parent_id", ""), None)
    return False


class _ContextOfCycles:
    """A context whose engine is Cycles, for the `poll` of Cycles' panels, which ask for it by name."""

    engine = "CYCLES"

    def __init__(self, context: bpy.types.Context) -> None:
        self._context = context

    def __getattr__(self, name: str) -> Any:
        return getattr(self._context, name)


def _our_name(cycles_name: str) -> str:
    return cycles_name.replace("CYCLES_", "NEURALGUIDE_", 1)


def _borrow(source: type[bpy.types.Panel]) -> type[bpy.types.Panel]:
    """A panel of ours that draws what a panel of Cycles draws."""

    def poll(_cls: type, context: bpy.types.Context) -> bool:
        return context.engine == _ENGINE and bool(source.poll(_ContextOfCycles(context)))

    namespace = {name: getattr(source, name) for name in dir(source) if name.startswith("bl_") and name != "bl_rna"}
    namespace |= {name: value for name, value in vars(source).items() if callable(value) or name == "bl_order"}
    namespace["bl_idname"] = _our_name(source.__name__)
    if "bl_parent_id" in namespace:
        namespace["bl_parent_id"] = _our_name(namespace["bl_parent_id"])
    namespace["poll"] = classmethod(poll)
    namespace["__doc__"] = f"{source.__name__}, for NeuralGuide."
    return type(namespace["bl_idname"], (bpy.types.Panel,), namespace)


_borrowed: list[type[bpy.types.Panel]] = []


#: All panels that we draw, in the order of the properties editor.
CLASSES = (
    *sampling_panels.PANELS,
    *guiding_panels.CLASSES,
    NEURALGUIDE_PT_light_paths,
    NEURALGUIDE_PT_light_paths_fast_gi,
    *simplify_panels.PANELS,
    NEURALGUIDE_PT_motion_blur,
    NEURALGUIDE_PT_motion_blur_curve,
    NEURALGUIDE_PT_film,
    NEURALGUIDE_PT_performance,
    NEURALGUIDE_PT_experiments,
    NEURALGUIDE_PT_filter,
    NEURALGUIDE_PT_passes,
    NEURALGUIDE_PT_passes_cryptomatte,
    NEURALGUIDE_PT_passes_aov,
    NEURALGUIDE_PT_light_groups,
    NEURALGUIDE_PT_dispersion,
)


def register() -> None:
    """Add our panels and those of Cycles, and the engine's name to Blender's."""
    for cls in CLASSES:
        bpy.utils.register_class(cls)
    for name in _CYCLES_PANELS:
        source = getattr(bpy.types, name, None)  # absent where the Cycles add-on is off
        if source is not None:
            panel = _borrow(source)
            bpy.utils.register_class(panel)
            _borrowed.append(panel)
    for panel in _compatible_panels():
        panel.COMPAT_ENGINES.add(_ENGINE)


def unregister() -> None:
    """Undo `register`."""
    for panel in bpy.types.Panel.__subclasses__():
        getattr(panel, "COMPAT_ENGINES", set()).discard(_ENGINE)
    while _borrowed:
        bpy.utils.unregister_class(_borrowed.pop())
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
