# SPDX-License-Identifier: GPL-3.0-or-later
"""What panels of render properties have in common: when they are shown, and how a setting is drawn."""

from __future__ import annotations

from typing import Any

import bpy

from .declared_settings import SCENE_SETTINGS, setting_owner, settings_of
from .engine import NeuralGuideRenderEngine
from .shared_settings import SHARED_SETTINGS, follows_cycles, setting_source


class RenderPanel:
    """What every panel of render properties has in common."""

    bl_space_type = "PROPERTIES"
    bl_region_type = "WINDOW"
    bl_context = "render"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Only with our engine."""
        return context.engine == NeuralGuideRenderEngine.bl_idname

    def column(self) -> bpy.types.UILayout:
        """The panel's layout, labels to the left of what they name."""
        layout = self.layout  # type: ignore[attr-defined]
        layout.use_property_split = True
        layout.use_property_decorate = False
        return layout.column()


def draw_shared(layout: bpy.types.UILayout, scene: bpy.types.Scene, name: str, **look: Any) -> None:
    """A row for a setting that Cycles has too."""
    add_shared(layout.row(align=True), scene, name, **look)


def add_shared(row: bpy.types.UILayout, scene: bpy.types.Scene, name: str, **look: Any) -> None:
    """Add to a row the property of a shared setting that counts, and a way back to Cycles' where ours was set."""
    owner, own_name = setting_source(scene, name)
    row.prop(owner, own_name, **({"text": SCENE_SETTINGS[name].label} | look))
    # NeuralGuide's setting counts even when unset, where this Blender's Cycles has no such setting.
    if owner == scene.neuralguide and owner.is_property_set(name) and follows_cycles(scene):
        row.operator("neuralguide.follow_cycles_setting", text="", icon="X").setting = name


def draw_section(layout: bpy.types.UILayout, scene: bpy.types.Scene, section: str) -> None:
    """A row for each setting of a section."""
    for setting in settings_of(section):
        if setting.name in SHARED_SETTINGS:
            draw_shared(layout, scene, setting.name)
        else:
            layout.prop(setting_owner(scene, setting.name), setting.name)


def draw_presets(layout: bpy.types.UILayout, scene: bpy.types.Scene, name: str) -> None:
    """Cycles' button for its presets: they set Cycles' settings, so only where these count."""
    presets = getattr(bpy.types, name, None)
    if presets is not None and follows_cycles(scene):
        presets.draw_panel_header(layout)
