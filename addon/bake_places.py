# SPDX-License-Identifier: GPL-3.0-or-later
"""The places of a bake, as Blender has them: in passes of a result, of all texels at once."""

from __future__ import annotations

from typing import TYPE_CHECKING

import bpy
import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from engine.scene.bake import Bake

#: What Blender calls places that are on no face of the object, and the passes of its result that have the places.
_NO_TRIANGLE = -1
_PLACES, _DIFFERENTIALS, _SEEDS = "BakePrimitive", "BakeDifferential", "BakeSeed"


class BakePlaces:
    """Places in the passes of a result, which are copied from Blender a band of rows at a time.

    Blender hands out whole passes alone, so one of them is there twice for a moment.

    Parameters
    ----------
    layer : RenderLayer
    shape : (int, int)
        Rows and columns of the image.
    instance, view
        As of `Bake`.

    Raises
    ------
    ValueError
        If Blender has other passes there.
    """

    def __init__(self, layer: bpy.types.RenderLayer, shape: tuple[int, int], instance: int, view: str) -> None:
        found = {item.name: item for item in layer.passes}
        places, differentials = found.get(_PLACES), found.get(_DIFFERENTIALS)
        if places is None or differentials is None or (places.channels, differentials.channels) != (3, 4):
            has = ", ".join(f"{item.name} ({item.channels})" for item in layer.passes)
            raise ValueError(f"this Blender gives places to bake in another form: its result has {has}")
        self._places, self._differentials, self._seeds = places, differentials, found.get(_SEEDS)
        self._shape, self._instance, self._view = shape, instance, view

    def on_triangles(self) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.float32]]:
        """Triangles, below 0 of none, and weights of all texels, as of `Bake`: views of one array."""
        numbers = self._read(self._places)
        return numbers.view(np.int32)[..., 2], numbers[..., :2]

    def band(self, first: int, end: int) -> Bake:
        """Places of the rows from one to another, this one excluded."""
        from engine.scene.bake import Bake

        numbers = self._read(self._places)[first:end]
        triangles = np.maximum(np.ascontiguousarray(numbers[..., 2]).view(np.int32), _NO_TRIANGLE)
        weights = np.ascontiguousarray(numbers[..., :2])
        del numbers
        return Bake(
            instance=self._instance,
            triangles=triangles,
            weights=weights,
            differentials=self._rows_of(self._differentials, first, end),
            seeds=None if self._seeds is None else self._rows_of(self._seeds, first, end).view(np.int32)[..., 0],
            view=self._view,
            first_row=first,
        )

    def _rows_of(self, item: bpy.types.RenderPass, first: int, end: int) -> npt.NDArray[np.float32]:
        pixels = self._read(item)
        return pixels if (first, end) == (0, self._shape[0]) else pixels[first:end].copy()

    def _read(self, item: bpy.types.RenderPass) -> npt.NDArray[np.float32]:
        """A pass as it lies in memory, float32 (H, W, channels): numbers of triangles are integers, and no floats."""
        pixels = np.empty(len(item.rect) * item.channels, np.float32)
        item.rect.foreach_get(pixels)
        return pixels.reshape(*self._shape, item.channels)
