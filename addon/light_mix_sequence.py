# SPDX-License-Identifier: GPL-3.0-or-later
"""Mixing the light groups of rendered frames: files of layers in, files of layers out.

Combined of a file that is made is mixed, and so is Noisy Image. Light groups and all else are as they were rendered.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

import bpy

from . import light_mix
from .animated_paths import animated_paths
from .denoise_sequence import frames_by_number
from .exr_layers import LayeredImage, LayersError, read_layers, write_layers
from .light_mix_layers import Mix, check_mix, mix_layers

#: The folder beside the frames that takes what is made of them.
FOLDER = "mixed"


def find_files(path: Path) -> dict[int | None, Path]:
    """Files to mix, by frame: all of the sequence that a file is one of, or it alone where its name has no number.

    Raises
    ------
    LayersError
        If there is no such file.
    """
    frames = frames_by_number(path)
    return {number: frames[number] for number in sorted(frames)} if frames else {None: path}


def mixes_of(scene: bpy.types.Scene, frames: Sequence[int | None]) -> dict[int | None, Mix]:
    """The mixes of a scene by frame; those of its current frame for None.

    Where factors are animated the scene goes to each frame, and back.
    """

    mixes: dict[int | None, Mix] = dict.fromkeys(frames, light_mix.factors_of(scene))
    if not any(".light_mix[" in path for path in animated_paths(scene)):
        return mixes
    current, part = scene.frame_current, scene.frame_subframe
    try:
        for frame in frames:
            if frame is not None:
                scene.frame_set(frame)
                mixes[frame] = light_mix.factors_of(scene)
    finally:
        scene.frame_set(current, subframe=part)
    return mixes


class SequenceMixer:
    """Mixes files one after the other; iterating gives each once it is written.

    Parameters
    ----------
    files : mapping of Path
        By frame, as `find_files` gives them.
    folder : Path
        Where files of the same names are made.
    mix_of : callable (frame, image) -> dict
        Factors for a file.
    threads : int
        That denoise groups of a denoised picture; 0 = all.

    Attributes
    ----------
    warnings : list of str

    Raises
    ------
    LayersError
        If the folder is that of the files, or the first file cannot be mixed.
    """

    def __init__(
        self, files: Mapping[int | None, Path], folder: Path, mix_of: Callable[[int | None, LayeredImage], Mix],
        threads: int = 0,
    ) -> None:
        first, path = next(iter(files.items()))
        if folder.resolve() == path.parent.resolve():
            raise LayersError(f"{folder} is where the frames are: choose another folder, so that they stay")
        self._files, self._folder, self._mix_of, self._threads = files, folder, mix_of, threads
        self.warnings: list[str] = []
        image = read_layers(path)
        check_mix(image, mix_of(first, image))

    def __len__(self) -> int:
        return len(self._files)

    def __iter__(self) -> Iterator[Path]:
        from engine.render.light_mix import changes

        is_changed = False
        for frame, path in self._files.items():
            image, target = read_layers(path), self._folder / path.name
            mix = self._mix_of(frame, image)
            is_changed = is_changed or bool(changes(mix))
            write_layers(target, mix_layers(image, mix, self._threads))
            yield target
        if not is_changed:
            self.warnings.append("all factors are 1: the pictures are as they were rendered")
