# SPDX-License-Identifier: GPL-3.0-or-later
"""Mixing the light groups of rendered frames: files of layers in, files of layers out.

Combined of a file that is made is mixed, and so is Noisy Image. Light groups and all else are as they were rendered.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

import bpy
import numpy as np
import numpy.typing as npt

from . import light_mix
from .animated_paths import animated_paths
from .denoise_sequence import frames_by_number
from .exr_layers import LayeredImage, LayersError, read_layers, write_layers

#: The folder beside the frames that takes what is made of them.
FOLDER = "mixed"

Float32Array = npt.NDArray[np.float32]

#: Factors by group.
Mix = Mapping[str, light_mix.Factor]


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


def mix_in(image: LayeredImage) -> Mix:
    """The mix that a file's metadata has from its render.

    Raises
    ------
    LayersError
        If there is none, or it makes no sense.
    """
    text = image.metadata(light_mix.FIELD)
    if not text:
        raise LayersError(f"{image.path} says no light mix: it was rendered without light groups, or by another engine")
    try:
        return light_mix.from_text(text)
    except ValueError as error:
        raise LayersError(f"{image.path}: {error}") from None


def check_mix(image: LayeredImage, mix: Mix) -> None:
    """Look whether a file can be mixed.

    Raises
    ------
    LayersError
        If it has no light groups, lacks one that the mix changes, or is mixed already.
    """
    from engine.render.light_mix import checked_factors, missing_groups

    layers = image.layers()
    if not layers:
        raise LayersError(f"{image.path} has no pass Combined: render frames as OpenEXR MultiLayer")
    if image.metadata(light_mix.APPLIED_FIELD):
        raise LayersError(f"{image.path} is mixed already: choose frames as they were rendered")
    known = [group for layer in layers for group in _groups(image, layer)]
    if not known:
        raise LayersError(
            f"{image.path} has no light groups: put lamps into groups in the view layer's properties, under Passes, "
            "and render again as OpenEXR MultiLayer"
        )
    try:
        checked_factors(mix)
    except ValueError as error:
        raise LayersError(f"{image.path}: {error}") from None
    if missing := missing_groups(mix, known):
        raise LayersError(
            f"{image.path} was rendered without light group {', '.join(missing)}, which is in the mix: there are "
            f"{', '.join(dict.fromkeys(known))}. Set its factor to 1, or render again"
        )


def mix_layers(image: LayeredImage, mix: Mix, threads: int = 0) -> LayeredImage:
    """A file with its view layers mixed, and with metadata that says so.

    Raises
    ------
    LayersError
        As `check_mix`, or if it takes a denoiser and there is none.
    """
    check_mix(image, mix)
    known: list[str] = []
    for layer in image.layers():
        groups = _groups(image, layer)
        known += groups
        image = _mix_layer(image, layer, {group: mix.get(group, light_mix.NEUTRAL) for group in groups}, threads)
    applied = {group: mix.get(group, light_mix.NEUTRAL) for group in known}
    return image.stamped(light_mix.APPLIED_FIELD, light_mix.to_text(applied))


def _mix_layer(image: LayeredImage, layer: str, mix: Mix, threads: int) -> LayeredImage:
    from engine.denoise.library import problem
    from engine.render.light_mix import changes, denoised_parts, mixed, mixed_denoised

    picture, sampled = (image.image(layer, name, "RGB") for name in ("Combined", "Noisy Image"))
    if picture is None or not changes(mix):
        return image
    if sampled is None or np.array_equal(sampled, picture, equal_nan=True):
        lights = {group: _light(image, layer, group) for group in changes(mix)}
        for name in ("Combined", "Noisy Image") if sampled is not None else ("Combined",):
            image = image.changed(layer, name, "RGB", mixed(picture, lights, mix))
        return image
    if text := problem():
        raise LayersError(f"{image.path} is denoised, and so its light groups have to be: {text}")
    lights = {group: _light(image, layer, group) for group in mix}
    features = image.image(layer, "Denoising Albedo", "RGB"), image.image(layer, "Denoising Normal", "XYZ")
    parts = denoised_parts(sampled, lights, *features, threads=threads)
    image = image.changed(layer, "Combined", "RGB", mixed_denoised(picture, *parts, mix))
    return image.changed(layer, "Noisy Image", "RGB", mixed(sampled, lights, mix))


def _light(image: LayeredImage, layer: str, group: str) -> Float32Array:
    """Light of a group as it is in Combined."""
    from engine.render.light_mix import without_background

    light = image.image(layer, light_mix.PASS_PREFIX + group, "RGB")
    assert light is not None
    environment = None
    if group == image.metadata(light_mix.BACKGROUND_FIELD.format(layer=layer)):
        environment = _environment(image, layer)
    return light if environment is None else without_background(light, environment)


def _environment(image: LayeredImage, layer: str) -> Float32Array | None:
    """The pass Environment, which Blender before 5.0 calls Env."""
    for name in ("Environment", "Env"):
        environment = image.image(layer, name, "RGB")
        if environment is not None:
            return environment
    return None


def _groups(image: LayeredImage, layer: str) -> list[str]:
    """Light groups that a file has passes of."""
    names = [name for name in image.passes(layer) if name.startswith(light_mix.PASS_PREFIX)]
    return [
        name.removeprefix(light_mix.PASS_PREFIX) for name in names if image.find(layer, name, "RGB") is not None
    ]
