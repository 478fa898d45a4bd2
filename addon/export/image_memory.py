# SPDX-License-Identifier: GPL-3.0-or-later
"""Memory that byte images are exported into, one after the other as in the engine's pool, which then copies none."""

from __future__ import annotations

import mmap
import os

import numpy as np

from engine.array_types import Float32Array
from engine.scene.description import Image

#: Bytes that are set aside. What images do not reach is never touched.
SIZE = 1 << 28
#: Values converted at a time: they are to stay in a core's cache.
_CHUNK = 1 << 15


class ImageMemory:
    """Floats as Blender hands them out are read behind the images so far, and become bytes where they lie.

    Fresh memory takes longer to touch than pixels take to read.
    """

    def __init__(self) -> None:
        self._map: mmap.mmap | None = None
        self._values = np.empty(0, np.uint8)
        self._end = 0
        #: Those that lie here; none once one has found no room.
        self._images: list[Image] = []
        self._is_full = False

    def floats(self, count: int) -> Float32Array | None:
        """Room for so many floats, good until the next call; None where there is none."""
        if self._map is None and not self._is_full:
            try:
                self._map = _anonymous(SIZE)
                self._values = np.frombuffer(self._map, np.uint8)
            except OSError:
                self._is_full = True
        if self._end + 4 * count > len(self._values):
            self._give_up()
        if 4 * count > len(self._values):
            return None
        return self._values[self._end : self._end + 4 * count].view(np.float32)

    def converted(self, pixels: Float32Array) -> np.ndarray:
        """Bytes of pixels that Blender hands out as multiples of 1/255; `pixels` may be what `floats` gave."""
        flat = pixels.reshape(-1)
        # There a byte lies before the float that it is of, and over floats that have been read by then.
        result = self._values[self._end : self._end + flat.size]
        if self._is_full or len(result) < flat.size:
            result = np.empty(flat.size, np.uint8)
        scaled = np.empty(min(_CHUNK, flat.size), np.float32)
        for first in range(0, flat.size, _CHUNK):
            part = flat[first : first + _CHUNK]
            of_part = scaled[: len(part)]
            np.multiply(part, np.float32(255.0), out=of_part)
            of_part += np.float32(0.5)
            result[first : first + _CHUNK] = of_part
        return result.reshape(pixels.shape)

    def keep(self, image: Image) -> None:
        """The image is one of the scene: if it lies here, what comes next lies behind it."""
        start = self._values[self._end : self._end + 1]
        if image.pixels.dtype == np.uint8 and np.shares_memory(image.pixels.reshape(-1)[:1], start):
            self._end += image.pixels.size
            self._images.append(image)

    def close(self) -> None:
        """No more images: what was read behind them is given back."""
        if self._map is None:
            return
        first = -(-self._end // mmap.PAGESIZE) * mmap.PAGESIZE
        if hasattr(mmap, "MADV_DONTNEED") and os.name == "posix" and first < SIZE:
            self._map.madvise(mmap.MADV_DONTNEED, first, SIZE - first)

    def _give_up(self) -> None:
        """Each image has memory of its own, which goes when it is in the pool: of many, not all are there twice."""
        for image in self._images:
            image.pixels = image.pixels.copy()
        self._images, self._end, self._is_full = [], 0, True


def _anonymous(size: int) -> mmap.mmap:
    """Memory, in large pages where the system has them."""
    if os.name != "posix":
        return mmap.mmap(-1, size)
    memory = mmap.mmap(-1, size, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
    if hasattr(mmap, "MADV_HUGEPAGE"):
        memory.madvise(mmap.MADV_HUGEPAGE)
    return memory
