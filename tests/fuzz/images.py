# SPDX-License-Identifier: GPL-3.0-or-later
"""Small random images."""

from __future__ import annotations

from random import Random
from typing import Any

from tests.fuzz.numbers import chance, color


def random_image(random: Random) -> Any:
    """An image of a few pixels, packed or of floats, in some colour space; None at times, as where nobody chose one."""
    import bpy

    if chance(random, 0.05):
        return None
    width, height = random.choice((1, 2, 4, 7)), random.choice((1, 2, 4, 5))
    is_float = chance(random, 0.4)
    image = bpy.data.images.new("Image", width, height, alpha=chance(random, 0.5), float_buffer=is_float)
    image.colorspace_settings.name = random.choice(("sRGB", "Non-Color", "Linear Rec.709"))
    image.pixels = [channel for _ in range(width * height) for channel in color(random)]
    image.alpha_mode = random.choice(("STRAIGHT", "CHANNEL_PACKED", "NONE"))
    image.pack()
    return image
