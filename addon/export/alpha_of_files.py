# SPDX-License-Identifier: GPL-3.0-or-later
"""What alpha does to colours of image files: Cycles reads them by itself, by the file's own rule or by the setting."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple

import bpy

from ..versions import ALPHA_AS_SET, is_since
from .colorspaces import DATA_SPACES

#: Formats of files whose colours are multiplied by alpha; of TIFF each file says so.
_MULTIPLIED = ("OPEN_EXR", "OPEN_EXR_MULTILAYER", "HDR", "CINEON", "DPX")


class Reading(NamedTuple):
    """By which alpha mode Blender is to read a file; and whether its colours then count as multiplied by alpha."""

    alpha_mode: str
    is_multiplied: bool = False


def is_data_space(image: bpy.types.Image) -> bool:
    """Whether an image's values are no colours."""
    settings = image.colorspace_settings
    return settings.name in DATA_SPACES or bool(getattr(settings, "is_data", False))


def is_read_from_file(image: bpy.types.Image) -> bool:
    """Whether Cycles reads an image's file, and not Blender's pixels."""
    return image.source in ("FILE", "SEQUENCE") and image.packed_file is None and not image.is_dirty


def reading_of(image: bpy.types.Image) -> Reading | None:
    """How the file of an image is to be read, None if that is how Blender has read it."""
    mode = image.alpha_mode
    if image.channels != 4 or mode not in ("STRAIGHT", "PREMUL") or not is_read_from_file(image):
        return None
    if is_data_space(image):
        reading = Reading("CHANNEL_PACKED")
    elif is_since(ALPHA_AS_SET) or _is_overlooked(image):
        is_multiplied = mode == "PREMUL" or _is_overlooked(image)
        reading = Reading(mode)
        if is_multiplied and not image.is_float:
            reading = Reading("CHANNEL_PACKED", is_multiplied=True)
    else:
        reading = Reading(_mode_of_file(image))
    # Straight bytes are what is in the file.
    is_same = reading.alpha_mode == mode or not image.is_float and reading == Reading("CHANNEL_PACKED")
    return None if is_same else reading


def _is_overlooked(image: bpy.types.Image) -> bool:
    """Whether the file is of a kind whose alpha Cycles took for multiplied before it went by the setting."""
    return not is_since(ALPHA_AS_SET) and image.file_format == "WEBP"


def _mode_of_file(image: bpy.types.Image) -> str:
    """'PREMUL' if colours are multiplied by alpha in the image's file, else 'STRAIGHT'."""
    if image.file_format == "TIFF":
        with loaded_anew(image) as other:
            return other.alpha_mode
    return "PREMUL" if image.file_format in _MULTIPLIED else "STRAIGHT"


@contextmanager
def loaded_anew(image: bpy.types.Image) -> Iterator[bpy.types.Image]:
    """An image's file in a datablock of its own, in the same colour space, with the alpha mode that Blender gives."""
    other = bpy.data.images.load(bpy.path.abspath(image.filepath_raw, library=image.library), check_existing=False)
    try:
        other.colorspace_settings.name = image.colorspace_settings.name
        yield other
    finally:
        # Nobody uses it. Unlinking it all the same rebuilds view layers, and Blender 5.2 crashes at the next frame.
        bpy.data.images.remove(other, do_unlink=False)
