# SPDX-License-Identifier: GPL-3.0-or-later
"""Reading files of layers, and writing them with some pixels changed, by OpenImageIO as Blender brings it.

Everything else in a file stays as it is: other passes, names, metadata, compression and the size of numbers.
"""

from __future__ import annotations

import contextlib
import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt


class LayersError(ValueError):
    """A file cannot be read or written; the message names it and says why."""


@dataclass(frozen=True)
class LayeredImage:
    """A file's pixels.

    Attributes
    ----------
    path : Path
    parts : list of float32 (height, width, channels), row 0 at the top
    specs : list
        What OpenImageIO knows of each part.
    """

    path: Path
    parts: list[npt.NDArray[np.float32]]
    specs: list[Any]

    @property
    def size(self) -> tuple[int, int]:
        """Width and height [pixels]."""
        return self.parts[0].shape[1], self.parts[0].shape[0]

    def layers(self) -> list[str]:
        """Names of view layers that have a Combined pass, in the file's order; '' for a file of one."""
        names = [name.rpartition(".")[0] for spec in self.specs for name in spec.channelnames]
        combined = [name[: -len("Combined")].rstrip(".") for name in names if name.split(".")[-1] == "Combined"]
        return list(dict.fromkeys(combined))

    def find(self, layer: str, name: str, channels: str) -> tuple[int, list[int]] | None:
        """Part of a pass, and where its channels are, by their letters; None where it is not all there."""
        prefix = f"{layer}.{name}." if layer else f"{name}."
        for part, spec in enumerate(self.specs):
            names = list(spec.channelnames)
            wanted = [prefix + letter for letter in channels]
            if all(one in names for one in wanted):
                return part, [names.index(one) for one in wanted]
        return None

    def image(self, layer: str, name: str, channels: str) -> npt.NDArray[np.float32] | None:
        """A pass, float32 (height, width, channels), row 0 at the bottom; None where the file has not got it."""
        found = self.find(layer, name, channels)
        if found is None:
            return None
        part, columns = found
        return np.ascontiguousarray(self.parts[part][::-1, :, columns])

    def passes(self, layer: str) -> list[str]:
        """Names of passes of a view layer, in the file's order."""
        names = [name.rpartition(".")[0] for spec in self.specs for name in spec.channelnames]
        start = f"{layer}." if layer else ""
        return list(dict.fromkeys(name[len(start) :] for name in names if name.startswith(start)))

    def metadata(self, field: str) -> str:
        """A field of the file's metadata, '' where it has none of the name."""
        values = (spec.getattribute(field) for spec in self.specs)
        return next((str(value) for value in values if value is not None), "")

    def stamped(self, field: str, value: str) -> LayeredImage:
        """The same with a field of metadata set."""
        specs = [_library().ImageSpec(spec) for spec in self.specs]
        for spec in specs:
            spec.attribute(field, value)
        return replace(self, specs=specs)

    def changed(self, layer: str, name: str, channels: str, pixels: npt.NDArray[np.float32]) -> LayeredImage:
        """The same with other pixels in a pass that it has, (height, width, channels), row 0 at the bottom."""
        found = self.find(layer, name, channels)
        assert found is not None
        part, columns = found
        parts = list(self.parts)
        parts[part] = parts[part].copy()
        parts[part][..., columns] = pixels[::-1]
        return replace(self, parts=parts)


def _library() -> Any:
    # Nobody who denoises no sequence waits for the exporter.
    from .export.bundled_modules import find_bundled

    library = find_bundled("OpenImageIO")
    if library is None:
        raise LayersError("this Blender has no OpenImageIO for Python, which reads and writes files of layers")
    return library


def read_layers(path: Path) -> LayeredImage:
    """Read a file of layers.

    Raises
    ------
    LayersError
        If it is no such file, is not whole, or its parts differ in size.
    """
    library = _library()
    opened = library.ImageInput.open(str(path))
    if opened is None:
        raise LayersError(f"{path} cannot be read: {library.geterror() or 'no reason given'}")
    specs: list[Any] = []
    parts: list[npt.NDArray[np.float32]] = []
    try:
        while opened.seek_subimage(len(specs), 0):
            spec = library.ImageSpec(opened.spec())
            pixels = opened.read_image(len(specs), 0, 0, spec.nchannels, "float")
            if pixels is None:
                raise LayersError(f"{path} is damaged: {opened.geterror() or 'pixels are missing'}")
            specs.append(spec)
            parts.append(np.asarray(pixels, np.float32))
    finally:
        opened.close()
    if len({pixels.shape[:2] for pixels in parts}) > 1:
        raise LayersError(f"{path} has layers of different sizes")
    return LayeredImage(path, parts, specs)


def write_layers(path: Path, image: LayeredImage) -> None:
    """Write a file of layers; it has its name only once it is whole.

    Raises
    ------
    LayersError
        If it cannot be written.
    """
    library = _library()
    unfinished = path.with_name(f".{path.stem}.{os.getpid()}{path.suffix}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        _write(library, unfinished, image.specs, image.parts)
        os.replace(unfinished, path)
    except OSError as error:
        raise LayersError(f"{path} cannot be written: {error.strerror or error}") from None
    finally:
        with contextlib.suppress(OSError):
            unfinished.unlink(missing_ok=True)


def _write(library: Any, path: Path, specs: list[Any], parts: list[npt.NDArray[np.float32]]) -> None:
    """Write all parts; raises OSError, which says why."""
    output = library.ImageOutput.create(str(path))
    if output is None:
        raise OSError(library.geterror() or "no such format")
    try:
        is_written = output.open(str(path), tuple(specs))
        for index, (spec, pixels) in enumerate(zip(specs, parts, strict=True)):
            if is_written and index:
                is_written = output.open(str(path), spec, "AppendSubimage")
            is_written = is_written and output.write_image(pixels)
    finally:
        is_closed = output.close()
    if not (is_written and is_closed):
        raise OSError(output.geterror() or "is the disk full?")
