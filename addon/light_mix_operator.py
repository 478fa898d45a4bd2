# SPDX-License-Identifier: GPL-3.0-or-later
"""The operator that mixes rendered frames, and where users find it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import bpy
from bpy_extras.io_utils import ImportHelper

from .exr_layers import LayeredImage
from .frame_by_frame import FrameByFrame
from .light_mix_layers import Mix, mix_in
from .light_mix_sequence import FOLDER, SequenceMixer, find_files, mixes_of
from .shared_settings import thread_count


def make_mixer(
    scene: bpy.types.Scene, path: Path, folder: Path, threads: int, source: str = "SCENE"
) -> SequenceMixer:
    """What mixes the sequence that a file is one of.

    Parameters
    ----------
    threads : int
        0 = all.
    source : str
        'SCENE': by the scene's factors at each frame; 'FILES': by those that each file says.

    Raises
    ------
    LayersError
        If there is no such file, or it cannot be mixed.
    """
    files = find_files(path)
    mix_of: Callable[[int | None, LayeredImage], Mix]
    if source == "FILES":

        def mix_of(_frame: int | None, image: LayeredImage) -> Mix:
            return mix_in(image)
    else:
        mixes = mixes_of(scene, list(files))

        def mix_of(frame: int | None, _image: LayeredImage) -> Mix:
            return mixes[frame]

    return SequenceMixer(files, folder, mix_of, threads)


class NEURALGUIDE_OT_mix_sequence(FrameByFrame, bpy.types.Operator, ImportHelper):  # noqa: N801 (Blender's convention)
    """Mix the light groups of rendered OpenEXR MultiLayer files by the factors of the light mix, as they are animated.
    Choose any frame; all frames of the sequence are taken"""

    bl_idname = "neuralguide.mix_sequence"
    bl_label = "Mix Sequence"
    filename_ext = ".exr"
    filter_glob: bpy.props.StringProperty(default="*.exr", options={"HIDDEN"})  # type: ignore[valid-type]
    folder: bpy.props.StringProperty(  # type: ignore[valid-type]
        name="Folder", default=FOLDER,
        description="Where the mixed frames go, beside the frames unless it is a full path",
    )
    source: bpy.props.EnumProperty(  # type: ignore[valid-type]
        name="Factors",
        items=(
            ("SCENE", "Of the Scene", "The light mix of this scene at each frame"),
            ("FILES", "Of the Files", "The light mix that there was when each frame was rendered"),
        ),
    )

    doing = "mixing a sequence"

    def start(self, context: bpy.types.Context) -> SequenceMixer:
        """Mix all frames of the sequence."""
        path = Path(bpy.path.abspath(self.filepath)).absolute()
        folder = path.parent / bpy.path.abspath(self.folder)
        return make_mixer(context.scene, path, folder, thread_count(context.scene), self.source)


def _draw(menu: Any, _context: bpy.types.Context) -> None:
    menu.layout.operator(NEURALGUIDE_OT_mix_sequence.bl_idname, text="Mix Lights of a Sequence of Frames...")


def register() -> None:
    """Register the operator, and add it to the menu Render."""
    bpy.utils.register_class(NEURALGUIDE_OT_mix_sequence)
    bpy.types.TOPBAR_MT_render.append(_draw)


def unregister() -> None:
    """Undo `register`."""
    bpy.types.TOPBAR_MT_render.remove(_draw)
    bpy.utils.unregister_class(NEURALGUIDE_OT_mix_sequence)
