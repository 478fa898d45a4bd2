# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators: copy Cycles' settings, follow them again, empty the kernel cache."""

from __future__ import annotations

import shutil

import bpy

from . import shared_settings


class NEURALGUIDE_OT_copy_cycles_settings(bpy.types.Operator):  # noqa: N801 (Blender's convention)
    """Set our own settings to what Cycles' are now: sampling, light paths, film and filter"""

    bl_idname = "neuralguide.copy_cycles_settings"
    bl_label = "Copy Cycles' Settings"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Only where the Cycles add-on is on."""
        return context.scene is not None and shared_settings.has_cycles(context.scene)

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Copy."""
        shared_settings.copy_cycles_settings(context.scene)
        return {"FINISHED"}


class NEURALGUIDE_OT_follow_cycles_setting(bpy.types.Operator):  # noqa: N801
    """A script has set NeuralGuide's own value. Forget it, so that Cycles' counts again"""

    bl_idname = "neuralguide.follow_cycles_setting"
    bl_label = "Use Cycles' Setting"
    bl_options = {"REGISTER", "UNDO", "INTERNAL"}  # noqa: RUF012

    setting: bpy.props.StringProperty(name="Setting")  # type: ignore[valid-type]

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Forget our own value."""
        context.scene.neuralguide.property_unset(self.setting)
        return {"FINISHED"}


class NEURALGUIDE_OT_clear_kernel_cache(bpy.types.Operator):  # noqa: N801
    """Delete compiled kernels; the next render compiles them again, which takes up to a minute"""

    bl_idname = "neuralguide.clear_kernel_cache"
    bl_label = "Clear Kernel Cache"

    def execute(self, _context: bpy.types.Context) -> set[str]:
        """Delete the folder that holds them."""
        from engine.runtime.kernel_cache import cache_root

        shutil.rmtree(cache_root(), ignore_errors=True)
        self.report({"INFO"}, f"Cleared {cache_root()}")
        return {"FINISHED"}


_classes = (
    NEURALGUIDE_OT_copy_cycles_settings,
    NEURALGUIDE_OT_follow_cycles_setting,
    NEURALGUIDE_OT_clear_kernel_cache,
)


def register() -> None:
    """Register the operators."""
    for cls in _classes:
        bpy.utils.register_class(cls)


def unregister() -> None:
    """Unregister them."""
    for cls in reversed(_classes):
        bpy.utils.unregister_class(cls)
