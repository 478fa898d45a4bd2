# SPDX-License-Identifier: GPL-3.0-or-later
"""Panels of guiding: what is learned, how it is tried, where it is saved, and what it brought to the last render."""

from __future__ import annotations

import bpy

from . import last_render, learned_fields, preferences
from .declared_settings import SCENE_SETTINGS, settings_of
from .panel_parts import RenderPanel, draw_section

_METHOD = SCENE_SETTINGS["guiding_method"]
#: What every user may choose; the other methods are for experiments.
_PLAIN_METHODS = ("AUTO", "OFF")


def shown_methods(chosen: str) -> list[str]:
    """Methods that the menu offers where experiments are not shown: a file's own is among them."""
    return [choice.name for choice in _METHOD.choices if choice.name in (*_PLAIN_METHODS, chosen)]


class NEURALGUIDE_MT_guiding_method(bpy.types.Menu):  # noqa: N801 (Blender's convention)
    """Whether light is learned"""

    bl_label = _METHOD.label

    def draw(self, context: bpy.types.Context) -> None:
        """Draw."""
        settings = context.scene.neuralguide
        for name in shown_methods(settings.guiding_method):
            self.layout.prop_enum(settings, _METHOD.name, name)


def _draw_method(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """The menu of methods: all of them where the preferences show what is for experiments.

    The property always knows all of them, for scripts and files.
    """
    settings = context.scene.neuralguide
    if preferences.shows_experiments(context):
        layout.prop(settings, _METHOD.name)
        return
    split = layout.split(factor=0.4)
    name = split.row()
    name.alignment = "RIGHT"
    name.label(text=_METHOD.label)
    labels = {choice.name: choice.label for choice in _METHOD.choices}
    split.menu(NEURALGUIDE_MT_guiding_method.__name__, text=labels[settings.guiding_method])


class NEURALGUIDE_PT_guiding(RenderPanel, bpy.types.Panel):  # noqa: N801
    """What is learned, what it is used for, and what the last render made of it."""

    bl_label = "Guiding"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw."""
        column = self.column()
        for setting in settings_of("Guiding"):
            if setting is _METHOD:
                _draw_method(column, context)
            else:
                column.prop(context.scene.neuralguide, setting.name)
        sentence = last_render.guiding_sentence(context.scene)
        if sentence:
            last_render.draw_text(self.layout, context, f"Last render: {sentence}")


class NEURALGUIDE_PT_training(RenderPanel, bpy.types.Panel):  # noqa: N801
    """How guiding is tried, trained and repeated."""

    bl_label = "Trial and Training"
    bl_parent_id = "NEURALGUIDE_PT_guiding"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012

    def draw(self, context: bpy.types.Context) -> None:
        """Draw."""
        column = self.column()
        column.active = context.scene.neuralguide.guiding_method != "OFF"
        draw_section(column, context.scene, "Trial and Training")


class NEURALGUIDE_PT_learned_field(RenderPanel, bpy.types.Panel):  # noqa: N801
    """Says where what a render has learned is saved, and what it starts from."""

    bl_label = "Learned Field"
    bl_parent_id = "NEURALGUIDE_PT_guiding"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012

    def draw(self, context: bpy.types.Context) -> None:
        """Draw."""
        column = self.column()
        column.active = context.scene.neuralguide.guiding_method != "OFF"
        draw_section(column, context.scene, "Learned Field")
        learned = learned_fields.kept_field(context.scene, context.view_layer)
        column.label(text=f"In memory: {learned or 'nothing yet'}")
        row = column.row(align=True)
        row.operator("neuralguide.save_learned_field", text="Save")
        row.operator("neuralguide.load_learned_field", text="Load")


#: The menu, then panels, parents first.
CLASSES: tuple[type[bpy.types.Panel | bpy.types.Menu], ...] = (
    NEURALGUIDE_MT_guiding_method,
    NEURALGUIDE_PT_guiding,
    NEURALGUIDE_PT_training,
    NEURALGUIDE_PT_learned_field,
)
