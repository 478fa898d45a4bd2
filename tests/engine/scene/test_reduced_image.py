# SPDX-License-Identifier: GPL-3.0-or-later
"""Images at a part of their size."""

from __future__ import annotations

import numpy as np
import pytest

from engine.scene.image import Image
from engine.scene.reduced_image import reduced, reduction


@pytest.mark.parametrize(
    ("size", "limit", "resolution", "factor"),
    [
        ((256, 192), 0, 1.0, 1), ((256, 192), 256, 1.0, 1), ((257, 192), 256, 1.0, 2), ((100, 4096), 1024, 1.0, 4),
        ((256, 256), 0, 0.5, 2), ((256, 256), 0, 0.49, 4), ((256, 256), 64, 0.5, 4), ((256, 256), 0, 0.0, 1),
    ],
)  # fmt: skip
def test_sides_are_halved_until_they_fit(
    size: tuple[int, int], limit: int, resolution: float, factor: int
) -> None:
    assert reduction(*size, limit, resolution) == factor


@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
@pytest.mark.parametrize("shape", [(130, 9), (8, 8), (1, 300), (3, 2)])
def test_texels_are_means_of_blocks(dtype: type, shape: tuple[int, int]) -> None:
    pixels = np.random.default_rng(0).uniform(0, 255, (*shape, 4)).astype(dtype)
    image = Image("k", "image", pixels, alpha_mode="CHANNEL_PACKED")
    small = reduced(image, 4)
    height, width = max(shape[0] // 4, 1), max(shape[1] // 4, 1)
    assert small.pixels.shape == (height, width, 4) and small.pixels.dtype == dtype and not small.is_associated
    for y, x in {(0, 0), (height - 1, width - 1), (height // 2, 0)}:
        expected = pixels[4 * y : 4 * y + 4, 4 * x : 4 * x + 4].astype(np.float64).mean(axis=(0, 1))
        np.testing.assert_allclose(small.pixels[y, x], expected, atol=0.51 if dtype == np.uint8 else 1e-3)


@pytest.mark.parametrize("alpha_mode", ["STRAIGHT", "CHANNEL_PACKED"])
def test_what_is_transparent_does_not_bleed(alpha_mode: str) -> None:
    pixels = np.zeros((2, 2, 4), np.float32)
    pixels[0, 0] = (1.0, 0.5, 0.25, 1.0)
    pixels[1, 1] = (9.0, 9.0, 9.0, 0.0)
    small = reduced(Image("k", "image", pixels, "LINEAR", alpha_mode=alpha_mode), 2)
    is_straight = alpha_mode == "STRAIGHT"
    assert small.is_associated == is_straight
    colour = (0.25, 0.125, 0.0625) if is_straight else (2.5, 2.375, 2.3125)
    np.testing.assert_allclose(small.pixels[0, 0], (*colour, 0.25))
    assert (pixels[1, 1] == (9.0, 9.0, 9.0, 0.0)).all()


def test_an_image_that_fits_stays() -> None:
    image = Image("k", "image", np.zeros((2, 2, 4), np.uint8))
    assert reduced(image, 1) is image
