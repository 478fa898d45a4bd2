# SPDX-License-Identifier: GPL-3.0-or-later
"""Two pictures against a third, and beside each other."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from benchmarks.images import read_exr
from benchmarks.metrics import relative_squared_error

_BAR_HEIGHT = 26


def error_against(reference: Path, pictures: Sequence[Path]) -> list[float] | None:
    """Relative squared errors of EXR pictures (`benchmarks.metrics`); None where the reference is of another size."""
    expected, _ = read_exr(reference)
    images = [read_exr(path)[0] for path in pictures]
    if any(image.shape[:2] != expected.shape[:2] for image in images):
        return None
    return [relative_squared_error(image, expected).whole for image in images]


def save_pair(pictures: Sequence[Path], captions: Sequence[str], path: Path) -> None:
    """Put pictures side by side, each over its caption."""
    from PIL import Image, ImageDraw, ImageFont

    images = [Image.open(picture).convert("RGB") for picture in pictures]
    width, height = images[0].size
    sheet = Image.new("RGB", (width * len(images) + 4 * (len(images) - 1), height + _BAR_HEIGHT), (24, 24, 24))
    draw = ImageDraw.Draw(sheet)
    for place, (image, caption) in enumerate(zip(images, captions, strict=True)):
        left = place * (width + 4)
        sheet.paste(image, (left, 0))
        draw.text((left + 8, height + 5), caption, fill=(230, 230, 230), font=ImageFont.load_default(14))
    sheet.save(path, optimize=True)
