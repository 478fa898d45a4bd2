# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators: take over Cycles' settings, empty the kernel cache."""

from __future__ import annotations

import shutil

import bpy

from . import properties


class NEURALGUIDE_OT_copy_cycles_settings(bpy.types.Operator):  # noqa: N801 (Blender's convention)
    """Take over sampling, light paths, film and filter from the scene's Cycles settings"""

    bl_idname = "neuralguide.copy_cycles_settings"
    bl_label = "Take over Cycles' Settings"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Only where the Cycles add-on is on."""
        return context.scene is not None and hasattr(context.scene, "cycles")

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Copy, and say what Cycles has that NeuralGuide has not."""
        left = properties.copy_cycles_settings(context.scene)
        if left:
            self.report({"INFO"}, f"Taken over; NeuralGuide has no {', '.join(left)}")
        return {"FINISHED"}


class NEURALGUIDE_OT_clear_kernel_cache(bpy.types.Operator):  # noqa: N801
    """Delete compiled kernels; the next render compiles them again, which takes up to a minute"""

    bl_idname = "neuralguide.clear_kernel_cache"
    bl_label = "Clear Kernel Cache"

    def execute(self, _context: bpy.types.Context) -> set[str]:
        """Delete the folder that holds them."""
        from engine.kernel_cache import cache_root

        shutil.rmtree(cache_root(), ignore_errors=True)
        self.report({"INFO"}, f"Cleared {cache_root()}")
        return {"FINISHED"}


_classes = (NEURALGUIDE_OT_copy_cycles_settings, NEURALGUIDE_OT_clear_kernel_cache)


def register() -> None:
    """Register the operators."""
    for cls in _classes:
        bpy.utils.register_class(cls)


def unregister() -> None:
    """Unregister them."""
    for cls in reversed(_classes):
        bpy.utils.unregister_class(cls)
