# SPDX-License-Identifier: GPL-3.0-or-later
"""Images of textures as hosts hand them over."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from engine.array_types import Float32Array


@dataclass
class Image:
    """Pixels of an image texture. Whether two are equal, their keys tell.

    Attributes
    ----------
    pixels : uint8 or float32, shape (height, width, 4), row 0 at the bottom
        Straight or associated alpha as `is_associated` says.
    encoding : str
        How stored values become scene-linear: `'LINEAR'` (they are), `'SRGB'` (after filtering, as Cycles does with
        byte images) or `'RAW'` (non-colour data).
    folder : str
        Folder of the file in which the pixels lie, and all of the scene's will; '' = they are in memory.
    tiles : pairs of int
        Of an image in tiles (UDIM): the number of each, 1001 + 10 * row + column, and its index among the images. What
        lies beside them is magenta. () = it is no such image.
    """

    key: Hashable
    name: str
    #: Not compared: arrays have no truth value.
    pixels: npt.NDArray[np.uint8] | Float32Array = field(compare=False)
    encoding: str = "SRGB"
    is_associated: bool = False
    alpha_mode: str = "STRAIGHT"
    folder: str = ""
    tiles: tuple[tuple[int, int], ...] = ()


#: Alpha modes whose colour is multiplied by alpha before filtering (the others leave it alone).
_ASSOCIATING = ("STRAIGHT", "PREMUL")
#: Rows of an image that are changed at a time.
_ROWS = 256


def is_multiplied(image: Image) -> bool:
    """Whether colours count multiplied by alpha where the image is looked up."""
    return image.encoding != "RAW" and image.alpha_mode in _ASSOCIATING


def associate(pixels: np.ndarray) -> None:
    """Multiply colours by alpha, in place, as Cycles' loader does.

    Parameters
    ----------
    pixels : uint8 or float32 (height, width, 4)
    """
    alpha = pixels[..., 3:4]
    if pixels.dtype == np.uint8:
        for first in range(0, len(pixels), _ROWS):
            rows = slice(first, first + _ROWS)
            pixels[rows, :, :3] = (pixels[rows, :, :3].astype(np.uint16) * alpha[rows]) // 255
    else:
        pixels[..., :3] *= alpha
