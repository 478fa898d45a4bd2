# SPDX-License-Identifier: GPL-3.0-or-later
"""Preferences of the add-on: where compiled kernels are and how to be rid of them."""

from __future__ import annotations

import bpy

#: The add-on's module: `bl_ext.<repository>.neuralguide` as an extension, else the folder Blender found it in.
ADDON_MODULE = (__package__ or "addon").removesuffix(".addon")


class NeuralGuidePreferences(bpy.types.AddonPreferences):
    """Shown in Blender's preferences."""

    bl_idname = ADDON_MODULE

    def draw(self, _context: bpy.types.Context) -> None:
        """Show the folder and a button."""
        from engine.kernel_cache import cache_root

        column = self.layout.column()
        column.label(text="Kernels are compiled at the first render, once for each version of the add-on, and kept in:")
        column.label(text=str(cache_root()))
        column.operator("neuralguide.clear_kernel_cache")


def register() -> None:
    """Register the preferences."""
    bpy.utils.register_class(NeuralGuidePreferences)


def unregister() -> None:
    """Unregister them."""
    bpy.utils.unregister_class(NeuralGuidePreferences)
