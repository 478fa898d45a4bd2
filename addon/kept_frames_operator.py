# SPDX-License-Identifier: GPL-3.0-or-later
"""An operator that throws away what is kept of an unfinished frame, so that it begins anew."""

from __future__ import annotations

import bpy

from . import kept_frames


class NEURALGUIDE_OT_discard_unfinished(bpy.types.Operator):  # noqa: N801 (Blender's convention)
    """Remove what is kept of the current frame, so that it begins anew when it is rendered"""

    bl_idname = "neuralguide.discard_unfinished"
    bl_label = "Discard Unfinished Frame"

    @classmethod
    def poll(cls, _context: bpy.types.Context) -> bool:
        """Not while something is rendered."""
        return not bpy.app.is_job_running("RENDER")

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Remove the files."""
        gone, left = kept_frames.forget_frame(context.scene)
        if left:
            self.report({"ERROR"}, f"{left[0]} stays: another process uses it, or the folder cannot be written")
            return {"CANCELLED"}
        frame = context.scene.frame_current
        said = f"Frame {frame} begins anew: {gone[0]} is gone" if gone else f"Nothing is kept of frame {frame}"
        self.report({"INFO"}, said)
        return {"FINISHED"}


def register() -> None:
    """Register the operator."""
    bpy.utils.register_class(NEURALGUIDE_OT_discard_unfinished)


def unregister() -> None:
    """Unregister it."""
    bpy.utils.unregister_class(NEURALGUIDE_OT_discard_unfinished)
