# SPDX-License-Identifier: GPL-3.0-or-later
"""The panel Light Mix in the sidebar of image editors."""

from __future__ import annotations

import bpy

from . import light_mix, light_mix_picture
from .engine import NeuralGuideRenderEngine
from .last_render import draw_text

_NONE_RENDERED = "No light groups were rendered. Put lamps into groups, then render"


def _is_shown(context: bpy.types.Context) -> bool:
    """Whether an image editor shows a picture of ours, as it was rendered or mixed."""
    image = getattr(context.space_data, "image", None)
    if image is None:
        return False
    return image.type == "RENDER_RESULT" or image == light_mix_picture.image_of(context.scene, context.view_layer)


class NEURALGUIDE_OT_reset_light_mix(bpy.types.Operator):  # noqa: N801 (Blender's convention)
    """Set all strengths and colours of the light mix to 1, and forget groups that no view layer has any longer"""

    bl_idname = "neuralguide.reset_light_mix"
    bl_label = "Reset"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Reset, and show it."""
        light_mix.reset(context.scene)
        light_mix_picture.show(context.scene)
        return {"FINISHED"}


class NEURALGUIDE_PT_light_mix(bpy.types.Panel):  # noqa: N801
    """Strength and colour of each light group that was rendered."""

    bl_label = "Light Mix"
    bl_space_type = "IMAGE_EDITOR"
    bl_region_type = "UI"
    bl_category = "Light Mix"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Only with our engine, where its picture is."""
        return context.engine == NeuralGuideRenderEngine.bl_idname and _is_shown(context)

    def draw_header(self, context: bpy.types.Context) -> None:
        """Draw the switch."""
        self.layout.prop(context.scene.neuralguide, "use_light_mix", text="")

    def draw(self, context: bpy.types.Context) -> None:
        """Draw."""
        layout, scene = self.layout, context.scene
        rendered = light_mix_picture.rendered_groups(scene)
        mix = scene.neuralguide.light_mix
        if not rendered:
            draw_text(layout, context, _NONE_RENDERED, icon="INFO")
            layout.operator_menu_enum("neuralguide.make_light_groups", "by")
        column = layout.column(align=True)
        column.active = scene.neuralguide.use_light_mix
        for entry in mix:
            row = column.row(align=True)
            row.prop(entry, "is_on", text=entry.name)
            part = row.row(align=True)
            part.active = entry.is_on and entry.name in rendered
            part.prop(entry, "strength", text="")
            part.prop(entry, "color", text="")
        missing = [entry.name for entry in mix if rendered and entry.name not in rendered]
        if problem := light_mix_picture.problem(scene):
            draw_text(layout, context, problem, icon="ERROR")
        if missing:
            draw_text(layout, context, f"Not in the last render: {', '.join(missing)}", icon="INFO")
        if len(mix):
            row = layout.row(align=True)
            row.operator(NEURALGUIDE_OT_reset_light_mix.bl_idname, icon="LOOP_BACK")
            row.operator("neuralguide.write_light_mix", icon="LIGHT")


_classes = (NEURALGUIDE_OT_reset_light_mix, NEURALGUIDE_PT_light_mix)


def register() -> None:
    """Register the panel and its operator."""
    for cls in _classes:
        bpy.utils.register_class(cls)


def unregister() -> None:
    """Unregister them."""
    for cls in reversed(_classes):
        bpy.utils.unregister_class(cls)
