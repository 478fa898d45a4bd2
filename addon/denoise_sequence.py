# SPDX-License-Identifier: GPL-3.0-or-later
"""Denoising a sequence of rendered frames so that it does not flicker: files of layers in, files of layers out."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np

from .exr_layers import LayeredImage, LayersError, read_layers, write_layers

#: Frames before and after that help a frame.
REACH = 4
#: The folder beside the frames that takes what is made of them.
FOLDER = "denoised"
#: Passes that are needed, their channels, and how Blender calls the switch.
_NEEDED = {
    "Combined": ("RGB", "Combined"),
    "Vector": ("XYZW", "Vector"),
    "Denoising Albedo": ("RGB", "Denoising Data"),
    "Denoising Normal": ("XYZ", "Denoising Data"),
}
_NUMBERED = re.compile(r"(.*?)([0-9]+)([^0-9]*)")
#: Missing frames that a message names.
_MOST_NAMED = 5


def frames_by_number(path: Path) -> dict[int, Path]:
    """Files of the sequence that a file is one of, by frame; none where its name has no number.

    Raises
    ------
    LayersError
        If there is no such file.
    """
    if not path.is_file():
        raise LayersError(f"there is no file {path}")
    match = _NUMBERED.fullmatch(path.name)
    if match is None:
        return {}
    before, _, after = match.groups()
    frames: dict[int, Path] = {}
    for other in path.parent.iterdir():
        found = _NUMBERED.fullmatch(other.name)
        if found is not None and (found[1], found[3]) == (before, after):
            frames[int(found[2])] = other
    return frames


def find_frames(path: Path) -> list[Path]:
    """All frames of the sequence that a file is one of, in order.

    Raises
    ------
    LayersError
        If it is no such file, is the only one, or if frames are missing between others.
    """
    frames = frames_by_number(path)
    if not frames:
        raise LayersError(f"{path.name} has no frame number in its name: choose one frame of a sequence")
    numbers = sorted(frames)
    if len(numbers) < 2:
        raise LayersError(f"{path} is the only frame: a sequence has two or more")
    missing = sorted(set(range(numbers[0], numbers[-1])) - set(numbers))
    if missing:
        named = ", ".join(map(str, missing[:_MOST_NAMED])) + (", ..." if len(missing) > _MOST_NAMED else "")
        raise LayersError(f"frames are missing between {numbers[0]} and {numbers[-1]}: {named}. Render them first")
    return [frames[number] for number in numbers]


def _layers_to_denoise(image: LayeredImage) -> list[str]:
    """View layers that have all that is needed; raises LayersError where none has."""
    missing: list[str] = []
    found = []
    layers = image.layers()
    if not layers:
        raise LayersError(f"{image.path} has no pass Combined: render frames as OpenEXR MultiLayer")
    for layer in layers:
        lacks = [switch for name, (letters, switch) in _NEEDED.items() if image.find(layer, name, letters) is None]
        if not lacks:
            found.append(layer)
        missing += lacks
    if not found:
        raise LayersError(
            f"{image.path} lacks passes: switch on {' and '.join(dict.fromkeys(missing))} in the view layer's "
            "properties, under Passes, and render again"
        )
    return found


class SequenceDenoiser:
    """Denoises the frames of a sequence one after the other; iterating gives each file once it is written.

    Parameters
    ----------
    paths : sequence of Path
        As `find_frames` gives them.
    folder : Path
        Where files of the same names are made.
    reach : int
        Frames before and after that help a frame.
    threads : int
        0 = all.

    Attributes
    ----------
    warnings : list of str
        What a user should know of the sequence once it is done.

    Raises
    ------
    LayersError
        If the first frame cannot be denoised.
    """

    def __init__(self, paths: Sequence[Path], folder: Path, reach: int = REACH, threads: int = 0) -> None:
        from engine.denoise.library import problem

        if text := problem():
            raise LayersError(text)
        if folder.resolve() == paths[0].parent.resolve():
            raise LayersError(f"{folder} is where the frames are: choose another folder, so that they stay")
        first = read_layers(paths[0])
        self._paths, self._folder, self._reach, self._threads = paths, folder, reach, threads
        self._layers, self._size = _layers_to_denoise(first), first.size
        self._moves = False
        self.warnings: list[str] = []
        others = [name for name in first.layers() if name not in self._layers]
        if others:
            self.warnings.append(f"without Vector and Denoising Data stays as it was: {', '.join(others)}")

    def _open(self, path: Path) -> LayeredImage:
        image = read_layers(path)
        if image.size != self._size:
            sizes = [f"{width} x {height}" for width, height in (image.size, self._size)]
            raise LayersError(f"{path} has {sizes[0]} pixels, and the first frame {sizes[1]}")
        return image

    def _frames(self, index: int):  # type: ignore[no-untyped-def]
        """`engine.denoise.temporal.Frame` of each view layer."""
        from engine.denoise.filter import denoise
        from engine.denoise.temporal import make_frame

        path = self._paths[index]
        image = self._open(path)
        frames = []
        for layer in self._layers:
            passes: list[np.ndarray] = []
            for name, (letters, _) in _NEEDED.items():
                pixels = image.image(layer, name, letters)
                if pixels is None:
                    raise LayersError(f"{path} has no pass {name} in {layer}, which the first frame has")
                passes.append(pixels)
            picture, vectors, albedo, normal = passes
            sampled = image.image(layer, "Noisy Image", "RGB")
            if sampled is None:
                sampled, filtered = picture, denoise(picture, albedo, normal, threads=self._threads)
                assert filtered is not None  # nothing cancels it
                picture = filtered
            self._moves = self._moves or bool(np.any(vectors))
            frames.append(make_frame(picture, sampled, albedo, normal, vectors, threads=self._threads))
        return frames

    def __len__(self) -> int:
        return len(self._paths)

    def __iter__(self) -> Iterator[Path]:
        from engine.denoise.temporal import steady

        frames = lru_cache(2 * self._reach + 1)(self._frames)
        for index, path in enumerate(self._paths):
            pictures = [
                steady(
                    lambda at, place=place: frames(at)[place],  # type: ignore[misc]
                    index, len(self), self._reach, threads=self._threads,
                )
                for place in range(len(self._layers))
            ]
            image, target = self._open(path), self._folder / path.name
            for layer, picture in zip(self._layers, pictures, strict=True):
                image = image.changed(layer, "Combined", "RGB", picture)
            write_layers(target, image)
            yield target
        if not self._moves:
            self.warnings.append("all motion vectors are 0: if anything moves, was motion blur on? It leaves none")
