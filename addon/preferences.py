# SPDX-License-Identifier: GPL-3.0-or-later
"""Preferences of the add-on: compiled kernels, and whether panels show settings for experiments."""

from __future__ import annotations

import bpy


class NeuralGuidePreferences(bpy.types.AddonPreferences):
    """Shown in Blender's preferences."""

    #: The add-on's module: `bl_ext.<repository>.neuralguide` as an extension, else the folder Blender found it in.
    bl_idname = "addon"

    show_experiments: bpy.props.BoolProperty(  # type: ignore[valid-type]
        name="Show settings for experiments",
        description="Add a panel to the render properties, with settings that hardly anybody needs to change",
        default=False,
    )

    def draw(self, _context: bpy.types.Context) -> None:
        """Show the switch, the folder and a button."""
        from engine.runtime.kernel_cache import cache_root

        column = self.layout.column()
        column.prop(self, "show_experiments")
        column.label(text="Kernels that the add-on does not bring are compiled at the first render, and kept in:")
        column.label(text=str(cache_root()))
        column.operator("neuralguide.clear_kernel_cache")
        column.operator("neuralguide.copy_bug_report", icon="URL")


def shows_experiments(context: bpy.types.Context) -> bool:
    """Whether panels show settings for experiments; not where the add-on was registered without being enabled."""
    addon = context.preferences.addons.get(NeuralGuidePreferences.bl_idname)
    return addon is not None and addon.preferences is not None and addon.preferences.show_experiments


def register() -> None:
    """Register the preferences."""
    bpy.utils.register_class(NeuralGuidePreferences)


def unregister() -> None:
    """Unregister them."""
    bpy.utils.unregister_class(NeuralGuidePreferences)
