# SPDX-License-Identifier: GPL-3.0-or-later
"""The operator that denoises a sequence of frames, and where users find it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy
from bpy_extras.io_utils import ImportHelper

from .denoise_sequence import FOLDER, REACH, SequenceDenoiser, find_frames
from .frame_by_frame import FrameByFrame
from .shared_settings import thread_count


class NEURALGUIDE_OT_denoise_sequence(FrameByFrame, bpy.types.Operator, ImportHelper):  # noqa: N801 (Blender's convention)
    """Denoise a sequence of rendered OpenEXR MultiLayer files over time, so that it flickers less.
    It needs the passes Vector and Denoising Data. Choose any frame; all frames of the sequence are taken"""

    bl_idname = "neuralguide.denoise_sequence"
    bl_label = "Denoise Sequence"
    filename_ext = ".exr"
    filter_glob: bpy.props.StringProperty(default="*.exr", options={"HIDDEN"})  # type: ignore[valid-type]
    folder: bpy.props.StringProperty(  # type: ignore[valid-type]
        name="Folder", default=FOLDER,
        description="Where the denoised frames go, beside the frames unless it is a full path",
    )
    frames: bpy.props.CollectionProperty(  # type: ignore[valid-type]
        type=bpy.types.OperatorFileListElement, options={"HIDDEN", "SKIP_SAVE"},
        description="Names of the files to denoise, in order, beside the one that is chosen; none: all of its sequence",
    )
    reach: bpy.props.IntProperty(  # type: ignore[valid-type]
        name="Frames", default=REACH, min=0, max=32, soft_max=16,
        description="How many frames before, and as many after, help a frame",
    )

    doing = "denoising a sequence"
    out_of_memory = "out of memory: choose fewer Frames"

    def start(self, context: bpy.types.Context) -> SequenceDenoiser:
        """Denoise the chosen frames, or all of the sequence."""
        path = Path(bpy.path.abspath(self.filepath)).absolute()
        paths = [path.parent / frame.name for frame in self.frames] or find_frames(path)
        threads = thread_count(context.scene)
        return SequenceDenoiser(paths, path.parent / bpy.path.abspath(self.folder), self.reach, threads)


def _draw(menu: Any, _context: bpy.types.Context) -> None:
    menu.layout.operator(NEURALGUIDE_OT_denoise_sequence.bl_idname, text="Denoise Sequence of Frames...")


def register() -> None:
    """Register the operator, and add it to the menu Render."""
    bpy.utils.register_class(NEURALGUIDE_OT_denoise_sequence)
    bpy.types.TOPBAR_MT_render.append(_draw)


def unregister() -> None:
    """Undo `register`."""
    bpy.types.TOPBAR_MT_render.remove(_draw)
    bpy.utils.unregister_class(NEURALGUIDE_OT_denoise_sequence)
