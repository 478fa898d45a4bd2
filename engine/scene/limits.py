# SPDX-License-Identifier: GPL-3.0-or-later
"""What is too large to render on this machine."""

from __future__ import annotations

import os

from engine.scene.description import Frame

#: Of the film's sums, the picture made of them and the host's copy, without passes.
_BYTES_PER_PIXEL = 80
#: Where the system does not tell how much memory it has.
_USUAL_MEMORY = 1 << 35


def physical_memory() -> int:
    """Memory of this machine [bytes]."""
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):  # Windows has none of it
        return _USUAL_MEMORY


def check_frame(frame: Frame) -> None:
    """Refuse an image that cannot be.

    Raises
    ------
    ValueError
        Saying what to do.
    """
    x0, y0, x1, y1 = frame.region
    if frame.width < 1 or frame.height < 1:
        raise ValueError(f"the image is {frame.width} x {frame.height}: set a resolution of at least 1 x 1")
    if not (0 <= x0 < x1 <= frame.width and 0 <= y0 < y1 <= frame.height):
        raise ValueError(f"the render border {frame.region} is empty or outside {frame.width} x {frame.height} pixels")
    needed, there = (x1 - x0) * (y1 - y0) * _BYTES_PER_PIXEL, physical_memory()
    if needed > there:
        raise ValueError(
            f"{x1 - x0} x {y1 - y0} pixels need {needed / 2**30:.0f} GiB of memory and this machine has "
            f"{there / 2**30:.0f}: lower the resolution or set a render border"
        )
