# SPDX-License-Identifier: GPL-3.0-or-later
"""The panels Light Mix in the sidebars of image editors, and of windows in rendered shading."""

from __future__ import annotations

import bpy

from . import light_mix, light_mix_files, light_mix_picture
from .engine import NeuralGuideRenderEngine
from .exr_layers import LayersError
from .last_render import draw_text
from .shared_settings import thread_count

_NONE_RENDERED = "No light groups were rendered. Put lamps into groups, then render"


def _shows_render(context: bpy.types.Context) -> bool:
    """Whether an image editor shows a render of ours, as it was rendered or mixed."""
    image = getattr(context.space_data, "image", None)
    if image is None or context.engine != NeuralGuideRenderEngine.bl_idname:
        return False
    return image.type == "RENDER_RESULT" or image == light_mix_picture.image_of(context.scene, context.view_layer)


def _shown_file(context: bpy.types.Context) -> bpy.types.Image | None:
    """The image of the file of layers that an image editor shows, as it was rendered or mixed."""
    return light_mix_files.shown_file(getattr(context.space_data, "image", None))


class NEURALGUIDE_OT_reset_light_mix(bpy.types.Operator):  # noqa: N801 (Blender's convention)
    """Set all strengths and colours of the light mix to 1, and forget groups that no view layer has any longer"""

    bl_idname = "neuralguide.reset_light_mix"
    bl_label = "Reset"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Reset, and show it."""
        image = _shown_file(context)
        if image is not None:
            light_mix.reset(image, light_mix_files.opened_groups(image))
            light_mix_files.show(image)
        else:
            light_mix.reset(context.scene, light_mix.group_names(context.scene))
            light_mix_picture.show(context.scene)
            # For windows in rendered shading: Blender tells of what is set, and not of what is unset.
            context.scene.update_tag()
        return {"FINISHED"}


class NEURALGUIDE_OT_mix_file(bpy.types.Operator):  # noqa: N801
    """Read the light groups of this OpenEXR MultiLayer file, and show their mix: first by the factors that the file
    has in its metadata"""

    bl_idname = "neuralguide.mix_file"
    bl_label = "Mix Lights of This File"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Only where such a file is shown."""
        return _shown_file(context) is not None

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Read, and show it."""
        image = _shown_file(context)
        assert image is not None  # Blender has asked `poll`
        try:
            light_mix_files.open_file(image, thread_count(context.scene))
        except LayersError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return {"FINISHED"}


class NEURALGUIDE_OT_save_file_mix(bpy.types.Operator):  # noqa: N801
    """Keep the factors in the metadata of the file. Its picture and its passes stay as they were rendered"""

    bl_idname = "neuralguide.save_file_mix"
    bl_label = "Save Mix in File"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Only where such a file was opened."""
        image = _shown_file(context)
        return image is not None and bool(light_mix_files.opened_groups(image))

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Save."""
        image = _shown_file(context)
        assert image is not None  # Blender has asked `poll`
        try:
            path = light_mix_files.save(image)
        except LayersError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        self.report({"INFO"}, f"The mix is in the metadata of {path}")
        return {"FINISHED"}


class NEURALGUIDE_PT_light_mix(bpy.types.Panel):  # noqa: N801
    """Strength and colour of each light group of a picture."""

    bl_label = "Light Mix"
    bl_space_type = "IMAGE_EDITOR"
    bl_region_type = "UI"
    bl_category = "Light Mix"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Only where a picture of ours is, or a file of layers by whatever engine."""
        return _shows_render(context) or _shown_file(context) is not None

    def draw_header(self, context: bpy.types.Context) -> None:
        """Draw the switch."""
        owner = _shown_file(context) or context.scene
        self.layout.prop(owner.neuralguide, "use_light_mix", text="")

    def draw(self, context: bpy.types.Context) -> None:
        """Draw."""
        image = _shown_file(context)
        if image is not None:
            _draw_file(self.layout, context, image)
        else:
            _draw_render(self.layout, context)


class NEURALGUIDE_OT_add_light_mix(bpy.types.Operator):  # noqa: N801
    """Have a strength and a colour for each light group, before any render"""

    bl_idname = "neuralguide.add_light_mix"
    bl_label = "Mix Light Groups"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Add what is missing."""
        light_mix.add_missing(context.scene, light_mix.group_names(context.scene))
        return {"FINISHED"}


class NEURALGUIDE_PT_view_light_mix(bpy.types.Panel):  # noqa: N801
    """Strength and colour of each light group of the view layer, in a window in rendered shading."""

    bl_label = "Light Mix"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "Light Mix"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Only where our engine shows light groups."""
        is_ours = context.engine == NeuralGuideRenderEngine.bl_idname
        return is_ours and context.space_data.shading.type == "RENDERED" and bool(_layer_groups(context))

    def draw_header(self, context: bpy.types.Context) -> None:
        """Draw the switch."""
        self.layout.prop(context.scene.neuralguide, "use_light_mix", text="")

    def draw(self, context: bpy.types.Context) -> None:
        """Draw."""
        scene, groups = context.scene, _layer_groups(context)
        _draw_factors(self.layout, context, scene, groups, "")
        if any(group not in scene.neuralguide.light_mix for group in groups):
            self.layout.operator(NEURALGUIDE_OT_add_light_mix.bl_idname, icon="LIGHT")
        else:
            row = self.layout.row(align=True)
            row.operator(NEURALGUIDE_OT_reset_light_mix.bl_idname, icon="LOOP_BACK")
            row.operator("neuralguide.write_light_mix", icon="LIGHT")


def _layer_groups(context: bpy.types.Context) -> list[str]:
    return [group.name for group in getattr(context.view_layer, "lightgroups", ())]


def _draw_render(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    scene = context.scene
    rendered = light_mix_picture.rendered_groups(scene)
    if not rendered:
        draw_text(layout, context, _NONE_RENDERED, icon="INFO")
        layout.operator_menu_enum("neuralguide.make_light_groups", "by")
    _draw_factors(layout, context, scene, rendered, light_mix_picture.problem(scene))
    missing = [entry.name for entry in scene.neuralguide.light_mix if rendered and entry.name not in rendered]
    if missing:
        draw_text(layout, context, f"Not in the last render: {', '.join(missing)}", icon="INFO")
    if len(scene.neuralguide.light_mix):
        row = layout.row(align=True)
        row.operator(NEURALGUIDE_OT_reset_light_mix.bl_idname, icon="LOOP_BACK")
        row.operator("neuralguide.write_light_mix", icon="LIGHT")


def _draw_file(layout: bpy.types.UILayout, context: bpy.types.Context, image: bpy.types.Image) -> None:
    rendered = light_mix_files.opened_groups(image)
    if not rendered:
        layout.operator(NEURALGUIDE_OT_mix_file.bl_idname, icon="LIGHT")
        return
    _draw_factors(layout, context, image, rendered, light_mix_files.problem(image))
    row = layout.row(align=True)
    row.operator(NEURALGUIDE_OT_reset_light_mix.bl_idname, icon="LOOP_BACK")
    row.operator(NEURALGUIDE_OT_save_file_mix.bl_idname, icon="FILE_TICK")


def _draw_factors(
    layout: bpy.types.UILayout, context: bpy.types.Context, owner: light_mix.Owner, rendered: list[str], problem: str
) -> None:
    column = layout.column(align=True)
    column.active = owner.neuralguide.use_light_mix
    for entry in owner.neuralguide.light_mix:
        row = column.row(align=True)
        row.prop(entry, "is_on", text=entry.name)
        part = row.row(align=True)
        part.active = entry.is_on and entry.name in rendered
        part.prop(entry, "strength", text="")
        part.prop(entry, "color", text="")
    if problem:
        draw_text(layout, context, problem, icon="ERROR")


_classes = (
    NEURALGUIDE_OT_reset_light_mix,
    NEURALGUIDE_OT_mix_file,
    NEURALGUIDE_OT_save_file_mix,
    NEURALGUIDE_OT_add_light_mix,
    NEURALGUIDE_PT_light_mix,
    NEURALGUIDE_PT_view_light_mix,
)


def register() -> None:
    """Register the panel and its operators."""
    for cls in _classes:
        bpy.utils.register_class(cls)


def unregister() -> None:
    """Unregister them."""
    for cls in reversed(_classes):
        bpy.utils.unregister_class(cls)
