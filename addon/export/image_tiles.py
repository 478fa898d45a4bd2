# SPDX-License-Identifier: GPL-3.0-or-later
"""The tiles of an image (UDIM): each is a file of its own, for a square of the UV plane."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import numpy as np

from engine.scene.description import Image

from .image_frames import image_path

if TYPE_CHECKING:
    import bpy

#: What Cycles shows beside the tiles.
_MAGENTA_TEXEL = (255, 0, 255, 255)
_FIRST = 1001
_IN_A_ROW = 10


def tile_numbers(image: bpy.types.Image) -> list[int]:
    """Numbers of an image's tiles, from 1001 on: ten in a row."""
    return sorted(int(tile.number) for tile in image.tiles)


def tile_path(path: str, number: int) -> str:
    """The file of a tile, where `path` has `<UDIM>` for its number, or `<UVTILE>` for its column and row.

    A path without either is that of the first tile, as Blender has it.
    """
    row, column = divmod(number - _FIRST, _IN_A_ROW)
    name = os.path.basename(path)
    named = name.replace("<UDIM>", str(number)).replace("<UVTILE>", f"u{column + 1}_v{row + 1}")
    return os.path.join(os.path.dirname(path), named)


@contextmanager
def tile_file(image: bpy.types.Image, path: str) -> Iterator[str]:
    """A file with a tile's content: `path`, or a temporary one with what the image has packed for it."""
    name = os.path.basename(path)
    packed = next((item for item in image.packed_files if os.path.basename(item.filepath) == name), None)
    if packed is None:
        yield path
        return
    with tempfile.TemporaryDirectory() as folder:
        unpacked = os.path.join(folder, name)
        with open(unpacked, "wb") as file:
            file.write(packed.packed_file.data)
        yield unpacked


@contextmanager
def tiles_as_shown(image: bpy.types.Image) -> Iterator[str]:
    """Path of the files with what tiles show, as for `tile_path`; '' if Blender cannot write them.

    What was painted, and tiles that have never been saved, Blender writes into a temporary folder. The image itself
    stays as it is.
    """
    path = image_path(image)
    if path and not image.is_dirty:
        yield path
        return
    with tempfile.TemporaryDirectory() as folder:
        path = os.path.join(folder, "painted NeuralGuide.<UDIM>.png")
        yield path if _save_copy(image.original, path) else ""


def _save_copy(image: bpy.types.Image, path: str) -> bool:
    """Write the tiles of an image as they are; False if Blender cannot."""
    kept = image.file_format
    if image.is_float:
        image.file_format = "OPEN_EXR"
    try:
        image.save(filepath=path, save_copy=True)
    except RuntimeError:
        return False
    finally:
        if image.is_float:
            image.file_format = kept
    return True


def tile_index(name: str, tiles: list[tuple[int, int]], first: Image) -> Image:
    """What a texture looks up to find a tile: where each is among the images.

    Parameters
    ----------
    tiles : number and index of each
    first : a tile that has been read: how colours and alpha are stored
    """
    return Image(
        None, name, np.array([[_MAGENTA_TEXEL]], np.uint8), first.encoding, first.is_associated,
        first.alpha_mode, tiles=tuple(tiles),
    )  # fmt: skip
