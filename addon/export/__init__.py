# SPDX-License-Identifier: GPL-3.0-or-later
"""Turns Blender's evaluated scene into an `engine.scene.description.SceneDescription`."""

from .context import ExportCache, ExportCancelled, ExportContext, StudioLight, Window
from .frames import export_frames
from .scene import export_scene

__all__ = ["ExportCache", "ExportCancelled", "ExportContext", "StudioLight", "Window", "export_frames", "export_scene"]
