# SPDX-License-Identifier: GPL-3.0-or-later
"""Pixels of image textures, in the encoding the engine filters them in."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Hashable
from dataclasses import dataclass, field

import bpy
import numpy as np

from engine.array_types import Float32Array
from engine.scene.description import Image
from engine.scene.texel_file import TexelFile, check_room

from .alpha_of_files import is_data_space, is_read_from_file, loaded_anew, reading_of
from .colorspaces import to_scene_linear, to_srgb
from .context import CachedImage, ExportContext
from .image_frames import image_path, show_frame, shown_frame
from .image_headers import expected_bytes
from .image_memory import ImageMemory
from .image_tiles import tile_file, tile_index, tile_numbers, tile_path, tiles_as_shown
from .texture_limit import TextureLimit, read_limit

_PINK = "Blender's pink"
_PINK_TEXEL = (255, 0, 255, 255)
#: Up to so many bytes of images that Blender had not decoded stay decoded, for the next render.
MOST_LEFT = 1 << 27


@dataclass
class ImageExporter:
    """Collects images in the order they are met."""

    context: ExportContext
    images: list[Image] = field(default_factory=list)
    #: What was asked for, in order: what identifies an image, and its index.
    met: list[tuple[Hashable, int]] = field(default_factory=list)
    _indices: dict[Hashable, int] = field(default_factory=dict)
    #: Index of what stands for images that cannot be read.
    _missing: int | None = None
    #: Full names of the images so far.
    _names: set[str] = field(default_factory=set)
    #: Size of the pixels so far, in memory and in files [bytes].
    _in_memory: int = 0
    _in_files: int = 0
    _memory: ImageMemory = field(default_factory=ImageMemory)
    #: Size of images that Blender has decoded for this export and keeps [bytes].
    _left: int = 0
    _limit: TextureLimit = field(default_factory=TextureLimit)

    def __post_init__(self) -> None:
        """Look up once what holds for all images."""
        self._limit = read_limit(self.context)

    def export(self, image: bpy.types.Image, user: bpy.types.ImageUser | None, subject: str) -> int:
        """Index into `images` of what a texture node shows at this frame: one pink texel if it cannot be read."""
        self.context.check_cancel()
        if image.source == "TILED":
            return self._export_tiles(image, subject)
        frame = shown_frame(image, user, self.context.scene.frame_current)
        identity = (image.name_full, frame)
        if identity not in self._indices:
            self._add(identity, self._export(image, frame))
        index = self._indices[identity]
        self.met.append((identity, index))
        if self.is_missing(index):
            what = f"the file {bpy.path.abspath(image.filepath)}" if image.filepath else "the image"
            self.context.notice(f"{subject} / {image.name}", f"{what} is missing or cannot be read", _PINK)
        return index

    def _export_tiles(self, image: bpy.types.Image, subject: str) -> int:
        """Index into `images` of what tells where an image's tiles are: each is an image."""
        # Blender knows an image's colour space once it has read its file.
        image.size[:]
        identities = [(number, (image.name_full, "tile", number)) for number in tile_numbers(image)]
        with tiles_as_shown(image) as shown:
            if not shown:
                self.context.notice(f"{subject} / {image.name}", "its tiles have unsaved changes", "as they are saved")
            for number, identity in identities:
                path = tile_path(shown or image_path(image), number)
                if identity not in self._indices:
                    self._add(identity, self._read_tile(image, identity, path))
                self.met.append((identity, self._indices[identity]))
                if self.is_missing(self._indices[identity]):
                    problem = f"the file {path} of tile {number} is missing or cannot be read"
                    self.context.notice(f"{subject} / {image.name}", problem, _PINK)
        whole = ("tiles", image.name_full, tuple(identities))
        self._find_tiles(whole)
        self.met.append((whole, self._indices[whole]))
        return self._indices[whole]

    def _find_tiles(self, identity: tuple[str, str, tuple[tuple[int, Hashable], ...]]) -> None:
        """Add what tells where tiles are that have been added before."""
        if identity not in self._indices:
            tiles = [(number, self._indices[tile]) for number, tile in identity[2]]
            found = [self.images[index] for _number, index in tiles]
            like = next((one for one, (_, index) in zip(found, tiles, strict=True) if not self.is_missing(index)), None)
            index = tile_index(identity[1], tiles, like or found[0])
            index.key = ("tiles", *((number, one.key) for one, (number, _) in zip(found, tiles, strict=True)))
            self._add(identity, index)

    def _read_tile(self, image: bpy.types.Image, identity: tuple[Hashable, ...], path: str) -> Image | None:
        """A tile from its file, or as it was read before; None if it cannot be."""
        self._names.add(image.name_full)
        try:
            status = os.stat(path)
            stamp: tuple[Hashable, ...] = (status.st_mtime_ns, status.st_size)
        except OSError:
            stamp = tuple(len(item.packed_file.data) for item in image.packed_files)
        settings = (image.colorspace_settings.name, image.alpha_mode, self.context.working_space)
        return self._keep(identity, (*settings, path, *stamp), lambda: _read_tile_file(self.context, image, path))

    def take_over(self, identity: Hashable) -> int:
        """Index into `images` of one that is as it was at the last export, which may not have been able to read it."""
        if isinstance(identity, tuple) and identity[0] == "tiles":
            self._find_tiles(identity)
        elif identity not in self._indices:
            kept = self.context.cache.images.get(identity)
            if kept is not None:
                kept.last_used = self.context.cache.export_count
            self._add(identity, None if kept is None else kept.image)
        self.met.append((identity, self._indices[identity]))
        return self._indices[identity]

    def is_missing(self, index: int) -> bool:
        """Whether this is what stands for images that cannot be read."""
        return index == self._missing

    def _add(self, identity: Hashable, exported: Image | None) -> None:
        """Append an image; those that cannot be read have one texel, which textures repeat or clip like any."""
        if exported is None and self._missing is not None:
            self._indices[identity] = self._missing
            return
        self._indices[identity] = len(self.images)
        if exported is None:
            self._missing = len(self.images)
            exported = Image(("missing",), "missing", np.array([[_PINK_TEXEL]], np.uint8), "LINEAR")
        self.images.append(exported)

    def export_file(self, path: str) -> int:
        """Index into `images` of a file that no datablock of the scene shows, -1 if it cannot be read."""
        context = self.context
        try:
            status = os.stat(path)
        except OSError:
            status = None
        identity = ("file", path)
        state = None if status is None else (context.working_space, status.st_mtime_ns, status.st_size)
        kept = context.cache.images.get(identity)
        if kept is None or kept.state != state:
            exported = None if status is None else _read_file(context, path)
            if exported is None:
                context.notice(f"Studio light {os.path.basename(path)}", "its file cannot be read", _PINK)
                return -1
            exported.key = (*identity, context.cache.new_version())
            kept = context.cache.images[identity] = CachedImage(exported, state)
        kept.last_used = context.cache.export_count
        self.images.append(kept.image)
        return len(self.images) - 1

    def _export(self, image: bpy.types.Image, frame: int | None) -> Image | None:
        context = self.context
        self._names.add(image.name_full)
        # A painted image says so until it is saved; only its pixels tell whether it changed again.
        return self._keep(
            (image.name_full, frame),
            _state(context, image, frame),
            lambda: self._read(image) if frame is None else _read_frame(context, image, frame),
            is_surely_same=not image.is_dirty,
        )

    def _keep(
        self, identity: tuple[Hashable, ...], state: Hashable, read: Callable[[], Image | None], *,
        is_surely_same: bool = True,
    ) -> Image | None:
        """What the last export has kept of an image in this state, else what `read` gives, kept for the next."""
        context = self.context
        state = (state, self._limit)
        kept = context.cache.images.get(identity)
        if kept is not None and kept.state == state and is_surely_same:
            kept.last_used = context.cache.export_count
            self._in_memory += kept.image.pixels.nbytes
            return kept.image
        exported = read()
        if exported is None:
            return None
        exported = self._limit.apply(exported)
        if kept is not None and _is_equal(kept.image, exported):
            exported = kept.image
        else:
            exported.key = (*identity, context.cache.new_version())
        self._make_room(exported)
        self._memory.keep(exported)
        context.cache.images[identity] = CachedImage(exported, state, context.cache.export_count)
        return exported

    def _read(self, image: bpy.types.Image) -> Image | None:
        """Read pixels, and leave Blender without its copy if it had none before and images are many."""
        was_loaded = image.has_data or image.is_dirty
        try:
            return _read_loaded(self.context, image, self._memory)
        finally:
            if not was_loaded:
                size = _decoded_size(image)
                if self._left + size > MOST_LEFT:
                    image.buffers_free()
                else:
                    self._left += size

    def close(self) -> None:
        """There are no more images."""
        self._memory.close()

    def _make_room(self, image: Image) -> None:
        """Put pixels into a file where those in memory would be too many.

        Raises
        ------
        ValueError
            Where the disk has no room for all that the scene has so far.
        """
        size, most = image.pixels.nbytes, self.context.texture_memory
        if most is None or image.folder or self._in_memory + size <= most:
            self._in_memory += size
            return
        folder = bpy.app.tempdir or tempfile.gettempdir()
        if not self._in_files:
            # Said before hours are spent on reading what has no room in the end.
            check_room(self._in_memory + size + expected_bytes(self._names), folder)
            what = f"need more than the {most / 2**30:.1f} GiB that Texture Memory allows"
            self.context.notice("Textures", what, f"they lie in a temporary file in {folder}, and are read from there")
        self._in_files += size
        # What is in memory by now will be in the file too.
        check_room(self._in_memory + size, folder)
        file = TexelFile(image.pixels.size, image.pixels.dtype, folder)
        file.write(0, image.pixels)
        file.let_go()
        image.pixels, image.folder = file.values.reshape(image.pixels.shape), folder


def _is_equal(a: Image, b: Image) -> bool:
    settings = ("name", "encoding", "is_associated", "alpha_mode")
    if any(getattr(a, name) != getattr(b, name) for name in settings) or a.pixels.dtype != b.pixels.dtype:
        return False
    return np.array_equal(a.pixels.view(np.uint8), b.pixels.view(np.uint8))


def _read_loaded(context: ExportContext, image: bpy.types.Image, memory: ImageMemory) -> Image | None:
    """Read pixels as Cycles has them, and bring them into an encoding the engine knows."""
    width, height = image.size
    if width < 1 or height < 1:
        return None
    reading = reading_of(image)
    if reading is None:
        return _read_pixels(context, image, memory)
    with loaded_anew(image) as other:
        other.alpha_mode = reading.alpha_mode
        if other.size[0] < 1:
            return None
        exported = _read_pixels(context, other, memory, image.alpha_mode, is_multiplied=reading.is_multiplied)
    if exported is not None:
        exported.name = image.name
    return exported


def _read_pixels(
    context: ExportContext, image: bpy.types.Image, memory: ImageMemory, alpha_mode: str = "", *,
    is_multiplied: bool = False,
) -> Image | None:
    """Read pixels as Blender stores them.

    Parameters
    ----------
    alpha_mode : str
        Alpha mode of the image, where Blender reads it by another.
    is_multiplied : bool
        Whether colours that Blender has left alone count as multiplied by alpha.
    """
    width, height = image.size
    channels = image.channels
    size = width * height * channels
    flat = None if image.is_float else memory.floats(size)
    if flat is None:
        flat = np.empty(size, np.float32)
    try:
        image.pixels.foreach_get(flat)
    except (RuntimeError, TypeError, SystemError):
        return None
    raw = _four_channels(flat.reshape(height, width, channels))
    space = image.colorspace_settings.name
    is_data = is_data_space(image)
    exported = Image(None, image.name, raw, alpha_mode=alpha_mode or image.alpha_mode)
    exported.is_associated = is_multiplied
    if image.is_float:
        # Blender converts floats on loading, and multiplies them with their alpha.
        exported.is_associated |= image.alpha_mode not in ("CHANNEL_PACKED", "NONE")
        exported.encoding = "RAW" if is_data else "LINEAR"
        if space == "sRGB" and context.working_space == "Rec.709" and is_read_from_file(image):
            # As Cycles, which filters such files as they are stored.
            exported.pixels, exported.encoding = to_srgb(raw, is_associated=exported.is_associated), "SRGB"
        return exported
    if is_data:
        exported.encoding = "RAW"
    elif space == "sRGB" and context.working_space == "Rec.709":
        exported.encoding = "SRGB"
    elif space in ("Linear Rec.709", "Linear") and context.working_space == "Rec.709":
        exported.encoding = "LINEAR"
    else:
        factor = _divisor(raw) if is_multiplied else None
        stored = raw if factor is None else raw / factor
        linear = to_scene_linear(stored, space, context.working_space)
        if linear is None:
            linear = _converted_by_blender(stored, space)
        if linear is not None:
            exported.pixels, exported.encoding = linear.copy() if linear is raw else linear, "LINEAR"
            if factor is not None:
                exported.pixels *= factor
            return exported
        context.notice(image.name, f"colour space {space!r} is not supported", "read as sRGB")
        exported.encoding = "SRGB"
    exported.pixels = memory.converted(raw)
    return exported


def _divisor(pixels: Float32Array) -> Float32Array:
    """What takes alpha out of colours, float32 (height, width, 4)."""
    factor = np.ones_like(pixels)
    alpha = pixels[..., 3:]
    factor[..., :3] = np.where(alpha > 0.0, alpha, np.float32(1.0))
    return factor


def _decoded_size(image: bpy.types.Image) -> int:
    """Size of Blender's copy of the pixels [bytes]."""
    if not image.has_data:
        return 0
    width, height = image.size
    return width * height * image.channels * (4 if image.is_float else 1)


def _converted_by_blender(pixels: Float32Array, space: str) -> Float32Array | None:
    """Colours stored in `space` as scene-linear, alpha untouched; None if Blender does not know the space.

    Blender converts images of floats, on loading: so an image is packed, and then said to be in that space.
    """
    height, width = pixels.shape[:2]
    carrier = bpy.data.images.new("NeuralGuide", width, height, alpha=True, float_buffer=True, is_data=True)
    try:
        opaque = pixels.copy()
        opaque[..., 3] = 1.0
        carrier.pixels.foreach_set(opaque.ravel())
        carrier.pack()
        carrier.colorspace_settings.name = space
        result = np.empty(pixels.size, np.float32)
        carrier.pixels.foreach_get(result)
    except (RuntimeError, TypeError):
        return None
    finally:
        bpy.data.images.remove(carrier, do_unlink=False)
    result = result.reshape(pixels.shape)
    result[..., 3] = pixels[..., 3]
    return result


def _four_channels(pixels: Float32Array) -> Float32Array:
    """Grey spread over colour, alpha one where there is none."""
    channels = pixels.shape[2]
    if channels == 4:
        return pixels
    result = np.ones((*pixels.shape[:2], 4), np.float32)
    if channels == 3:
        result[..., :3] = pixels
    else:
        result[..., :3] = pixels[..., :1]
        if channels == 2:
            result[..., 3] = pixels[..., 1]
    return result


def _state(context: ExportContext, image: bpy.types.Image, frame: int | None) -> tuple[Hashable, ...]:
    """Everything that tells one version of an image's content from another, short of its pixels."""
    settings = (image.source, image.colorspace_settings.name, image.alpha_mode, context.working_space)
    if image.source == "GENERATED":
        size = (image.generated_width, image.generated_height)
        return (*settings, size, image.generated_type, tuple(image.generated_color), image.use_generated_float)
    if image.packed_file is not None:
        return (*settings, image.packed_file.as_pointer(), image.packed_file.size)
    path = image_path(image, frame)
    try:
        status = os.stat(path)
    except OSError:
        return (*settings, path)
    return (*settings, path, status.st_mtime_ns, status.st_size)


def _read_frame(context: ExportContext, image: bpy.types.Image, frame: int) -> Image | None:
    """One frame of a sequence or movie, through a datablock of its own: `pixels` cannot be asked for a frame."""
    path = image_path(image, frame)
    if not os.path.isfile(path):
        return None
    exported = _read_file(context, path, image, movie_frame=frame if image.source == "MOVIE" else None)
    if exported is not None:
        exported.name = image.name
    return exported


def _read_tile_file(context: ExportContext, image: bpy.types.Image, path: str) -> Image | None:
    with tile_file(image, path) as file:
        exported = _read_file(context, file, image) if os.path.isfile(file) else None
    if exported is not None:
        exported.name = image.name
    return exported


def _read_file(
    context: ExportContext, path: str, like: bpy.types.Image | None = None, *, movie_frame: int | None = None
) -> Image | None:
    """The image of a file, read through a datablock of its own.

    Parameters
    ----------
    like : Image, optional
        Whose colour space and alpha it has; by default what Blender makes of the file.
    movie_frame : int, optional
        Which frame, of a file that is a movie.
    """
    try:
        single = bpy.data.images.load(path, check_existing=False)
    except RuntimeError:
        return None
    try:
        if like is not None:
            if like.colorspace_settings.name:
                single.colorspace_settings.name = like.colorspace_settings.name
            single.alpha_mode = like.alpha_mode
        if movie_frame is not None:
            show_frame(single, movie_frame)
        return _read_loaded(context, single, ImageMemory())
    finally:
        # Nobody uses it. Unlinking it all the same rebuilds view layers, and Blender 5.2 crashes at the next frame.
        bpy.data.images.remove(single, do_unlink=False)
