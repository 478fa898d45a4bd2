# SPDX-License-Identifier: GPL-3.0-or-later
"""Images of a scene as two pools of pixels, bytes and floats, with alpha as Cycles' loader leaves it."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from engine.array_types import Float32Array, Int64Array, Uint8Array
from engine.scene.content import same_content, snapshot
from engine.scene.description import Image, Notice
from engine.scene.image import associate, is_multiplied
from engine.scene.texel_file import TexelFile, check_room, mapped_memory
from engine.state.shaders import (
    IMAGE_IS_ASSOCIATED,
    IMAGE_IS_FLOAT,
    IMAGE_IS_SRGB,
    IMAGE_OFFSET,
    IMAGE_TILE_COUNT,
    IMAGE_TILE_FIRST,
    IMAGE_WIDTH,
    IMAGE_X,
    IMAGE_Y,
    SRGB_TABLE_SIZE,
    TILE_IMAGE,
    TILE_NUMBER,
)

_POOL_TYPES = (np.uint8, np.float32)


def srgb_table() -> Float32Array:
    """The sRGB decoding curve sampled evenly on [0, 1] (IEC 61966-2-1)."""
    x = np.linspace(0.0, 1.0, SRGB_TABLE_SIZE)
    return np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4).astype(np.float32)


@dataclass(frozen=True)
class ImagePool:
    """Table of images (`ShaderArrays.images`), the two pools of pixels, and what was found on the way.

    files : those that the pools lie in, () = they are in memory
    """

    table: Int64Array
    pixels_byte: Uint8Array
    pixels_float: Float32Array
    notices: list[Notice]
    files: tuple[TexelFile, ...] = ()

    def keep_within(self, most_bytes: int) -> None:
        """Where texels lie in files and more of them are in memory than this, let go of all: those needed come back."""
        if self.files and mapped_memory() > most_bytes:
            for file in self.files:
                file.let_go()


def build_image_pool(images: Sequence[Image]) -> ImagePool:
    """Table of images and the two pools; an image without pixels becomes one transparent black texel.

    Images that stand in a pool as they are get their pixels from there, so that they are in memory once. Images that
    lie one after the other as in a pool, and stay as they are, become that pool. Where pixels of any lie in a file, so
    do the pools.

    Raises
    ------
    ValueError
        Where there is no room for that file.
    """
    notices: list[Notice] = []
    table = _table(images)
    ends = [0, 0]
    for row, image in enumerate(images):
        pixels = _usable(image, notices)
        is_float = pixels.dtype != np.uint8
        table[row, IMAGE_X] = pixels.shape[1]
        table[row, IMAGE_Y] = pixels.shape[0]
        table[row, IMAGE_OFFSET] = ends[is_float]
        table[row, IMAGE_IS_FLOAT] = is_float
        table[row, IMAGE_IS_SRGB] = image.encoding == "SRGB"
        table[row, IMAGE_IS_ASSOCIATED] = is_multiplied(image)
        ends[is_float] += pixels.size
    folder = next((image.folder for image in images if image.folder), "")
    sizes = [max(end, 4) for end in ends]
    files: list[TexelFile] = []
    if folder:
        check_room(sizes[0] + 4 * sizes[1], folder)
        files = [TexelFile(size, dtype, folder) for size, dtype in zip(sizes, _POOL_TYPES, strict=True)]
        pools = [file.values for file in files]
    else:
        found = [_pool_at_hand([image for image in images if image.pixels.dtype == dtype]) for dtype in _POOL_TYPES]
        pools = [np.zeros(size, dtype) if pool is None or len(pool) != size else pool
                 for size, dtype, pool in zip(sizes, _POOL_TYPES, found, strict=True)]  # fmt: skip

    def place(row: int) -> None:
        # Not kept from above: what is in the pool must be free before the next is.
        image, pixels = images[row], _usable(images[row], [])
        is_float = pixels.dtype != np.uint8
        start = int(table[row, IMAGE_OFFSET])
        if np.shares_memory(pixels[:1, :1], pools[is_float][start : start + 1]):
            return
        view = pools[is_float][start : start + pixels.size].reshape(pixels.shape)
        if files:
            written = np.empty_like(pixels)
            is_same = _copy(image, pixels, written)
            files[is_float].write(start, written)
            files[is_float].let_go()
        else:
            is_same = _copy(image, pixels, view)
        if is_same and pixels is image.pixels:
            image.pixels, image.folder = view, ""

    # Files are written by one thread: they are there since memory is short.
    with ThreadPoolExecutor(1 if files else None, thread_name_prefix="images") as threads:
        list(threads.map(place, range(len(images))))
    return ImagePool(table, pools[0], pools[1], notices, tuple(files))


def _table(images: Sequence[Image]) -> Int64Array:
    """The table of images with what they say of tiles, whose lists lie behind it."""
    listed = [tile for image in images for tile in image.tiles]
    first = max(len(images), 1)
    table = np.zeros((first + len(listed), IMAGE_WIDTH), np.int64)
    if not images:
        table[0, IMAGE_X] = table[0, IMAGE_Y] = 1
    if listed:
        table[first:, [TILE_NUMBER, TILE_IMAGE]] = listed
    for row, image in enumerate(images):
        table[row, IMAGE_TILE_COUNT], table[row, IMAGE_TILE_FIRST] = len(image.tiles), first
        first += len(image.tiles)
    return table


def _pool_at_hand(images: Sequence[Image]) -> np.ndarray | None:
    """The memory that images of one type lie in, if they do so one after the other and none is to be changed."""
    if not images or not images[0].pixels.size:
        return None
    first = images[0].pixels
    # What is no part of something larger is its maker's, who may write into it.
    memory = first.base
    if not isinstance(memory, np.ndarray) or memory.dtype != first.dtype or not memory.flags.c_contiguous:
        return None
    at = begin = (first.ctypes.data - memory.ctypes.data) // memory.itemsize
    for image in images:
        pixels = image.pixels
        is_next = pixels.ctypes.data == memory.ctypes.data + at * memory.itemsize and pixels.flags.c_contiguous
        if not is_next or not pixels.flags.writeable or pixels.ndim != 3 or pixels.shape[2] != 4:
            return None
        at += pixels.size
    with ThreadPoolExecutor(thread_name_prefix="images") as threads:
        if not all(threads.map(_stays, images)):
            return None
    return memory.reshape(-1)[begin:at]


def _stays(image: Image) -> bool:
    """Whether pixels are in the pool as they are in the image."""
    pixels = image.pixels
    if image.alpha_mode == "NONE":
        return _is_opaque(pixels)
    if pixels.dtype != np.uint8 and not np.isfinite(pixels).all():
        return False
    return image.is_associated == is_multiplied(image) or _is_opaque(pixels)


class ImagePoolCache:
    """The pool of a session's images, kept while they stay the same; `version` grows when it is made anew."""

    def __init__(self) -> None:
        self._pool: ImagePool | None = None
        #: The images it was made of, with their pixels in the pool where they stand in it as they are.
        self._images: list[Image] = []
        self.version = 0

    def keep_within(self, most_bytes: int) -> None:
        """See `ImagePool.keep_within`."""
        if self._pool is not None:
            self._pool.keep_within(most_bytes)

    def get(self, images: Sequence[Image]) -> ImagePool:
        """The pool of these images, `build_image_pool`'s or the one at hand."""
        if self._pool is None or not same_content(self._images, list(images)):
            self._pool, self._images = None, []
            self.version += 1
            self._pool = build_image_pool(images)
            self._images = [snapshot(image) for image in images]
        for image, known in zip(images, self._images, strict=True):
            image.pixels, image.folder = known.pixels, known.folder
        return self._pool


def _usable(image: Image, notices: list[Notice]) -> np.ndarray:
    pixels = image.pixels
    if pixels.ndim != 3 or pixels.shape[2] != 4 or pixels.size == 0:
        notices.append(Notice(f"image {image.name}", f"has pixels of shape {pixels.shape}", "transparent black"))
        return np.zeros((1, 1, 4), np.uint8)
    if pixels.dtype not in (np.uint8, np.float32):
        return pixels.astype(np.float32)
    return pixels


def _is_opaque(pixels: np.ndarray) -> bool:
    """Whether alpha is one everywhere."""
    if pixels.dtype == np.uint8:
        # Seven times as fast as comparing each.
        return bool(pixels[..., 3].min() == 255)
    return bool((pixels[..., 3] == 1.0).all())


def _copy(image: Image, pixels: np.ndarray, view: np.ndarray) -> bool:
    """Copy pixels, bringing alpha to what the image's alpha mode asks for; True if they stayed the same."""
    view[...] = pixels
    if image.alpha_mode == "NONE":
        is_same = _is_opaque(view)
        view[..., 3] = 255 if view.dtype == np.uint8 else 1.0
        return is_same
    is_finite = True
    if view.dtype != np.uint8:
        # A texel that is not finite would spread through every filter.
        finite = np.isfinite(view).all(axis=2)
        is_finite = bool(finite.all())
        view[~finite] = 0.0
    if image.is_associated == is_multiplied(image) or _is_opaque(view):
        return is_finite
    if not image.is_associated:
        associate(view)
    return False
