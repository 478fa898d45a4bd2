# SPDX-License-Identifier: GPL-3.0-or-later
"""Panels: our settings, and Blender's own and Cycles' panels that mean the same here."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import bpy

from engine.denoise.library import problem as denoiser_problem
from engine.settings import EXPERIMENT_SECTIONS

from . import last_render, learned_fields, preferences, warm_up
from .declared_settings import SCENE_SETTINGS, setting_owner, settings_of
from .dispersion import can_disperse
from .engine import NeuralGuideRenderEngine
from .passes import requested_mattes
from .shared_settings import SHARED_SETTINGS, follows_cycles, has_cycles, setting_source, setting_value

_ENGINE = NeuralGuideRenderEngine.bl_idname

#: Panels of Blender that name things we do not do.
_EXCLUDED_PANELS = {
    "RENDER_PT_freestyle",
    "RENDER_PT_simplify",
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
    "CYCLES_OBJECT_PT_shading",  # Blender 3 and 4: later it is OBJECT_PT_shading
    "CYCLES_OBJECT_PT_lightgroup",
)


class _RenderPanel:
    """What every panel of render properties has in common."""

    bl_space_type = "PROPERTIES"
    bl_region_type = "WINDOW"
    bl_context = "render"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Only with our engine."""
        return context.engine == _ENGINE

    def _column(self) -> bpy.types.UILayout:
        layout = self.layout  # type: ignore[attr-defined]
        layout.use_property_split = True
        layout.use_property_decorate = False
        return layout.column()


def _draw_shared(layout: bpy.types.UILayout, scene: bpy.types.Scene, name: str, **look: Any) -> None:
    """A setting that Cycles has too: the property that counts, and a way back to Cycles' where ours was set."""
    owner, own_name = setting_source(scene, name)
    row = layout.row(align=True)
    row.prop(owner, own_name, **({"text": SCENE_SETTINGS[name].label} | look))
    if owner == scene.neuralguide and follows_cycles(scene):
        row.operator("neuralguide.follow_cycles_setting", text="", icon="X").setting = name


def _draw_section(layout: bpy.types.UILayout, scene: bpy.types.Scene, section: str) -> None:
    """A row for each setting of a section."""
    for setting in settings_of(section):
        if setting.name in SHARED_SETTINGS:
            _draw_shared(layout, scene, setting.name)
        else:
            layout.prop(setting_owner(scene, setting.name), setting.name)


class NEURALGUIDE_PT_sampling(_RenderPanel, bpy.types.Panel):  # noqa: N801 (Blender's convention)
    """Whose settings count, samples, time and method."""

    bl_label = "Sampling"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw."""
        warm_up.start()
        scene = context.scene
        settings = scene.neuralguide
        column = self._column()
        if has_cycles(scene):
            column.prop(settings, "use_cycles_settings")
            if not settings.use_cycles_settings:
                column.operator("neuralguide.copy_cycles_settings")
        _draw_shared(column, scene, "use_adaptive_sampling")
        threshold = column.column()
        threshold.active = setting_value(scene, "use_adaptive_sampling")
        for name in ("adaptive_threshold", "adaptive_min_samples"):
            _draw_shared(threshold, scene, name)
        for name in ("samples", "preview_samples", "time_limit"):
            _draw_shared(column, scene, name)
        column.prop(settings, "spectral")


class NEURALGUIDE_PT_denoising(_RenderPanel, bpy.types.Panel):  # noqa: N801
    """What takes the noise out of the finished picture."""

    bl_label = "Denoise"
    bl_parent_id = "NEURALGUIDE_PT_sampling"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012

    def draw_header(self, context: bpy.types.Context) -> None:
        """Draw the switch."""
        row = self.layout.row()
        row.active = not denoiser_problem()
        _draw_shared(row, context.scene, "use_denoising", text="")

    def draw(self, context: bpy.types.Context) -> None:
        """Draw."""
        scene, problem = context.scene, denoiser_problem()
        column = self._column()
        if follows_cycles(scene):
            column.prop(scene.cycles, "use_preview_denoising", text="Viewport")
        if problem:
            # A label is one line.
            for part in problem.split(": "):
                column.label(text=part)
        column.active = not problem and setting_value(scene, "use_denoising")
        names = ["denoising_input_passes", "denoising_quality"]
        if setting_value(scene, "denoising_input_passes") != "RGB":
            names.insert(1, "denoising_prefilter")
        for name in names:
            _draw_shared(column, scene, name)


class NEURALGUIDE_PT_guiding(_RenderPanel, bpy.types.Panel):  # noqa: N801
    """What is learned, what it is used for, and what the last render made of it."""

    bl_label = "Guiding"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw."""
        _draw_section(self._column(), context.scene, "Guiding")
        sentence = last_render.guiding_sentence(context.scene)
        if sentence:
            last_render.draw_text(self.layout, context, f"Last render: {sentence}")


class NEURALGUIDE_PT_training(_RenderPanel, bpy.types.Panel):  # noqa: N801
    """How guiding is tried, trained and repeated."""

    bl_label = "Trial and Training"
    bl_parent_id = "NEURALGUIDE_PT_guiding"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012

    def draw(self, context: bpy.types.Context) -> None:
        """Draw."""
        column = self._column()
        column.active = context.scene.neuralguide.guiding_method != "OFF"
        _draw_section(column, context.scene, "Trial and Training")


class NEURALGUIDE_PT_learned_field(_RenderPanel, bpy.types.Panel):  # noqa: N801
    """What becomes of what a render has learned."""

    bl_label = "Learned Field"
    bl_parent_id = "NEURALGUIDE_PT_guiding"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012

    def draw(self, context: bpy.types.Context) -> None:
        """Draw."""
        column = self._column()
        column.active = context.scene.neuralguide.guiding_method != "OFF"
        _draw_section(column, context.scene, "Learned Field")
        learned = learned_fields.kept_field(context.scene, context.view_layer)
        column.label(text=f"In memory: {learned or 'nothing yet'}")
        row = column.row(align=True)
        row.operator("neuralguide.save_learned_field", text="Save")
        row.operator("neuralguide.load_learned_field", text="Load")


class NEURALGUIDE_PT_sampling_lights(_RenderPanel, bpy.types.Panel):  # noqa: N801
    """How lights are sampled."""

    bl_label = "Lights"
    bl_parent_id = "NEURALGUIDE_PT_sampling"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012

    def draw(self, context: bpy.types.Context) -> None:
        """Draw."""
        _draw_section(self._column(), context.scene, "Lights")


class NEURALGUIDE_PT_sampling_advanced(_RenderPanel, bpy.types.Panel):  # noqa: N801
    """What is better left alone."""

    bl_label = "Advanced"
    bl_parent_id = "NEURALGUIDE_PT_sampling"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012

    def draw(self, context: bpy.types.Context) -> None:
        """Draw."""
        scene = context.scene
        column = self._column()
        row = column.row(align=True)
        _draw_shared(row, scene, "seed")
        _draw_shared(row, scene, "use_animated_seed", text="", icon="TIME")
        for name in ("min_light_bounces", "min_transparent_bounces"):
            _draw_shared(column, scene, name)
        if follows_cycles(scene) and any(layer.samples > 0 for layer in scene.view_layers):
            column.prop(scene.cycles, "use_layer_samples")


class NEURALGUIDE_PT_light_paths(_RenderPanel, bpy.types.Panel):  # noqa: N801
    """How far light is followed."""

    bl_label = "Light Paths"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012

    def draw(self, context: bpy.types.Context) -> None:
        """Draw."""
        column = self._column()
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
                _draw_shared(part, context.scene, name)


class NEURALGUIDE_PT_motion_blur(_RenderPanel, bpy.types.Panel):  # noqa: N801
    """When the shutter is open: Blender's own settings, as Cycles reads them."""

    bl_label = "Motion Blur"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012

    def draw_header(self, context: bpy.types.Context) -> None:
        """Draw the switch."""
        self.layout.prop(context.scene.render, "use_motion_blur", text="")

    def draw(self, context: bpy.types.Context) -> None:
        """Draw."""
        render = context.scene.render
        column = self._column()
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


class NEURALGUIDE_PT_motion_blur_curve(_RenderPanel, bpy.types.Panel):  # noqa: N801
    """How the shutter opens and closes."""

    bl_label = "Shutter Curve"
    bl_parent_id = "NEURALGUIDE_PT_motion_blur"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012

    def draw(self, context: bpy.types.Context) -> None:
        """Draw."""
        render = context.scene.render
        column = self._column()
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


class NEURALGUIDE_PT_film(_RenderPanel, bpy.types.Panel):  # noqa: N801
    """Exposure, filter, background."""

    bl_label = "Film"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012

    def draw(self, context: bpy.types.Context) -> None:
        """Draw."""
        scene = context.scene
        column = self._column()
        for name in ("film_exposure", "film_transparent", "pixel_filter"):
            _draw_shared(column, scene, name)
        if setting_value(scene, "pixel_filter") != "BOX":
            _draw_shared(column, scene, "filter_width")


class NEURALGUIDE_PT_performance(_RenderPanel, bpy.types.Panel):  # noqa: N801
    """Threads and what is kept between frames, by Blender's settings as Cycles reads them; memory for textures."""

    bl_label = "Performance"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012

    def draw(self, context: bpy.types.Context) -> None:
        """Draw."""
        scene = context.scene
        render, ours = scene.render, scene.neuralguide
        column = self._column()
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
        column.prop(ours, "texture_memory")


class NEURALGUIDE_PT_experiments(_RenderPanel, bpy.types.Panel):  # noqa: N801
    """Settings for experiments, by section."""

    bl_label = "Experiments"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Only where the preferences ask for it."""
        return super().poll(context) and preferences.shows_experiments(context)

    def draw(self, context: bpy.types.Context) -> None:
        """Draw."""
        column = self._column()
        for section in EXPERIMENT_SECTIONS:
            part = column.column()
            part.label(text=section)
            _draw_section(part, context.scene, section)


class NEURALGUIDE_PT_filter(_RenderPanel, bpy.types.Panel):  # noqa: N801
    """What the view layer shows, of what this engine has."""

    bl_label = "Filter"
    bl_context = "view_layer"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012 (Blender's convention)

    def draw(self, context: bpy.types.Context) -> None:
        """Draw."""
        layer = context.view_layer
        column = self._column()
        include = column.column(heading="Include")
        include.prop(layer, "use_sky", text="Environment")
        include.prop(layer, "use_solid", text="Surfaces")
        use = column.column(heading="Use")
        use.active = context.scene.render.use_motion_blur
        use.prop(layer, "use_motion_blur", text="Motion Blur")


class NEURALGUIDE_PT_passes(_RenderPanel, bpy.types.Panel):  # noqa: N801
    """Passes of the view layer."""

    bl_label = "Passes"
    bl_context = "view_layer"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw."""
        layer = context.view_layer
        column = self._column()
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
        column.prop(layer, "pass_alpha_threshold")
        for lobes in ("diffuse", "glossy", "transmission"):
            light = column.column(heading=lobes.capitalize(), align=True)
            for kind in ("direct", "indirect", "color"):
                light.prop(layer, f"use_pass_{lobes}_{kind}", text=kind.capitalize())
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


class NEURALGUIDE_PT_passes_cryptomatte(_RenderPanel, bpy.types.Panel):  # noqa: N801
    """Which Cryptomattes there are, and how many levels they have."""

    bl_label = "Cryptomatte"
    bl_context = "view_layer"
    bl_parent_id = "NEURALGUIDE_PT_passes"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw."""
        layer = context.view_layer
        column = self._column()
        column.prop(layer, "use_pass_cryptomatte_object", text="Object")
        column.prop(layer, "use_pass_cryptomatte_material", text="Material")
        column.prop(layer, "use_pass_cryptomatte_asset", text="Asset")
        levels = column.column()
        levels.active = bool(requested_mattes(layer))
        levels.prop(layer, "pass_cryptomatte_depth", text="Levels")


class NEURALGUIDE_PT_passes_aov(_RenderPanel, bpy.types.Panel):  # noqa: N801
    """Passes that AOV Output nodes fill."""

    bl_label = "Shader AOV"
    bl_context = "view_layer"
    bl_parent_id = "NEURALGUIDE_PT_passes"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw."""
        layer = context.view_layer
        column = self._column()
        row = column.row()
        row.template_list("VIEWLAYER_UL_aov", "aovs", layer, "aovs", layer, "active_aov_index", rows=3)
        buttons = row.column(align=True)
        buttons.operator("scene.view_layer_add_aov", icon="ADD", text="")
        buttons.operator("scene.view_layer_remove_aov", icon="REMOVE", text="")
        if layer.active_aov is not None and not layer.active_aov.is_valid:
            column.label(text="Another pass has this name", icon="ERROR")


class NEURALGUIDE_PT_light_groups(_RenderPanel, bpy.types.Panel):  # noqa: N801
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


class NEURALGUIDE_PT_dispersion(_RenderPanel, bpy.types.Panel):  # noqa: N801
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
        column = self._column()
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
        if panel.__name__ in _ADDED_PANELS or (is_for_all and panel.__name__ not in _EXCLUDED_PANELS):
            yield panel


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


_classes = (
    NEURALGUIDE_PT_sampling,
    NEURALGUIDE_PT_denoising,
    NEURALGUIDE_PT_sampling_lights,
    NEURALGUIDE_PT_sampling_advanced,
    NEURALGUIDE_PT_guiding,
    NEURALGUIDE_PT_training,
    NEURALGUIDE_PT_learned_field,
    NEURALGUIDE_PT_light_paths,
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
    for cls in _classes:
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
    for cls in reversed(_classes):
        bpy.utils.unregister_class(cls)
