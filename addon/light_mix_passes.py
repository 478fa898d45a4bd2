# SPDX-License-Identifier: GPL-3.0-or-later
"""Passes that a light mix is made of: noted when a render hands them to Blender, or read from a file, and mixed."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Callable, Iterable, Iterator, Mapping

import bpy
import numpy as np
import numpy.typing as npt

from . import light_mix

Float32Array = npt.NDArray[np.float32]

_FEATURES = ("Denoising Albedo", "Denoising Normal")

#: Whether renders leave their groups for a mix: where somebody looks.
keeps_passes = not bpy.app.background


@dataclasses.dataclass
class Noted:
    """Passes of a view layer that a mix is made of, row 0 at the bottom.

    picture : float32 (height, width, 4)
    groups : dict of float32 (height, width, 3), by name of the group
    environment : the pass, None where it was not rendered
    sampled : the picture before it was denoised, None where it was not
    albedo, normal : what helps to denoise the groups
    """

    picture: Float32Array | None = None
    groups: dict[str, Float32Array] = dataclasses.field(default_factory=dict)
    environment: Float32Array | None = None
    sampled: Float32Array | None = None
    albedo: Float32Array | None = None
    normal: Float32Array | None = None


class _NotingPasses(Mapping[str, Float32Array]):
    """Passes of a render, which are made when they are looked up: what is, is kept."""

    def __init__(self, passes: Mapping[str, Float32Array], names: Iterable[str]) -> None:
        self._passes, self._names = passes, {*names}
        self.noted: dict[str, Float32Array] = {}

    def __getitem__(self, name: str) -> Float32Array:
        image = self._passes[name]
        if name in self._names:
            self.noted[name] = image
        return image

    def __contains__(self, name: object) -> bool:
        return name in self._passes

    def __iter__(self) -> Iterator[str]:
        return iter(self._passes)

    def __len__(self) -> int:
        return len(self._passes)


def note(
    passes: Mapping[str, Float32Array], layer: bpy.types.ViewLayer, write: Callable[[Mapping[str, Float32Array]], None]
) -> Noted:
    """Have a render's passes written, and note those that a mix is made of: each is made once.

    Parameters
    ----------
    passes : mapping of float32 (height, width, channels)
    layer : ViewLayer
        What they are of.
    write : callable
        Looks passes up.
    """
    groups = {light_mix.PASS_PREFIX + group.name: group.name for group in getattr(layer, "lightgroups", ())}
    if not keeps_passes or not groups:
        write(passes)
        return Noted()
    noting = _NotingPasses(passes, ("Combined", "Noisy Image", "Environment", *_FEATURES, *groups))
    write(noting)
    noted = noting.noted
    sampled = noted.get("Noisy Image")
    if sampled is not None and _is_same(sampled, noted["Combined"]):
        sampled = None
    if sampled is not None:
        # The denoiser has used them, whether the layer asks for them or not.
        with contextlib.suppress(KeyError, MemoryError):
            for name in _FEATURES:
                noting[name]
    return Noted(
        noted.get("Combined"), {group: noted[name] for name, group in groups.items() if name in noted},
        noted.get("Environment"), sampled, *map(noted.get, _FEATURES),
    )  # fmt: skip


def _is_same(image: Float32Array, other: Float32Array) -> bool:
    return image is other or np.array_equal(image, other, equal_nan=True)


class Mixer:
    """Mixes passes of a view layer; those of a denoised picture are denoised once, at the first change.

    Parameters
    ----------
    passes : Noted
        With a picture.
    threads : int
        That may denoise; 0 = all.
    """

    def __init__(self, passes: Noted, threads: int) -> None:
        self.passes = passes
        self._threads = threads
        self._parts: tuple[Float32Array, dict[str, Float32Array]] | None = None

    @property
    def groups(self) -> list[str]:
        """Light groups that there are passes of."""
        return list(self.passes.groups)

    def picture(self, factors: Mapping[str, light_mix.Factor]) -> Float32Array:
        """The picture by these factors, float32 (height, width, 4), row 0 at the bottom.

        Raises
        ------
        ValueError
            As `engine.render.light_mix.mixed` does.
        DenoiserMissing, DenoiserFailed
            If the picture is denoised and its groups cannot be.
        """
        from engine.render.light_mix import changes, denoised_parts, mixed, mixed_denoised

        passes = self.passes
        assert passes.picture is not None
        if passes.sampled is None or not changes(factors):
            return mixed(passes.picture, passes.groups, factors)
        if self._parts is None:
            self._parts = denoised_parts(
                passes.sampled, passes.groups, passes.albedo, passes.normal, threads=self._threads
            )
        return mixed_denoised(passes.picture, *self._parts, factors)
