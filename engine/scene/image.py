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
