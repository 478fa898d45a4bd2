# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether faces of a baked object lie over each other on its image.

Blender gives each texel to the face that comes last, for every engine. What the others would have baked is lost, and
nobody says so. By the texels that a face has and the area of its UVs it is seen how much that is.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import bpy
import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from engine.scene.description import Notice

#: Texels that tell which UV map places come from, and how far off the map most of them may lie [texels]: from Blender
#: 5.3 on a face has those too that it only touches.
_ASKED, _MOST_OFF = 1 << 12, 1.5
#: Texels among which those are sought, of which a few may have a face.
_LOOKED_AT = 1 << 20
#: What is not said: shares below this, fewer texels, and less than what edges that cross texels make by chance.
_LEAST_SHARE, _LEAST_TEXELS, _SIGMAS = 0.01, 16, 4.0
#: Texels whose faces are counted together.
_BLOCK = 1 << 20

_Float32 = npt.NDArray[np.float32]


class BakedUvs:
    """UV maps of an object that is baked.

    Parameters
    ----------
    baked : Object
        Evaluated; it is read now.
    """

    def __init__(self, baked: bpy.types.Object) -> None:
        self._name = baked.name
        mesh = baked.to_mesh()
        try:
            self._read(mesh)
        finally:
            baked.to_mesh_clear()

    def _read(self, mesh: Any) -> None:
        mesh.calc_loop_triangles()
        count = len(mesh.loop_triangles)
        corners = np.empty(3 * count, np.int32)
        mesh.loop_triangles.foreach_get("loops", corners)
        self._slots = np.empty(count, np.int32)
        mesh.loop_triangles.foreach_get("material_index", self._slots)
        self._maps: list[_Float32] = []
        for layer in mesh.uv_layers:
            values = np.empty(2 * len(layer.data), np.float32)
            layer.data.foreach_get("uv", values)
            self._maps.append(values.reshape(-1, 2)[corners].reshape(count, 3, 2))

    def overlap_notice(self, triangles: npt.NDArray[np.int32], weights: _Float32) -> Notice | None:
        """What to say where faces lie over each other on an image; None: nothing, or places are not by UVs.

        Parameters
        ----------
        triangles, weights
            As of `Bake`, of the whole image; below 0: no triangle.
        """
        from engine.scene.description import Notice

        found = self._map_of(triangles, weights)
        if found is None:
            return None
        uvs, tile = found
        size = np.array(triangles.shape[::-1], np.float64)
        count = np.zeros(len(uvs), np.int64)
        flat = triangles.reshape(-1)
        for start in range(0, len(flat), _BLOCK):
            block = flat[start : start + _BLOCK]
            count += np.bincount(block[block >= 0], minlength=len(uvs))
        edges = np.diff(uvs[:, [0, 1, 2, 0]].astype(np.float64), axis=1) * size
        area = 0.5 * np.abs(edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0])
        # Faces that reach beyond the tile have texels elsewhere, and those of other materials in other images.
        is_here = ((uvs >= tile) & (uvs <= tile + 1)).all(axis=(1, 2)) & np.isin(self._slots, self._slots[count > 0])
        whole, lost = area[is_here].sum(), area[is_here].sum() - count[is_here].sum()
        by_chance = _SIGMAS * np.sqrt(np.linalg.norm(edges[is_here], axis=2).sum())
        if lost <= max(_LEAST_SHARE * whole, _LEAST_TEXELS, by_chance):
            return None
        return Notice(
            f"Object {self._name}", f"UVs of its faces overlap: {lost / whole:.0%} of their texels are lost",
            "a texel of several faces shows the last of them, as in Cycles",
        )  # fmt: skip

    def _map_of(self, triangles: npt.NDArray[np.int32], weights: _Float32) -> tuple[_Float32, _Float32] | None:
        """The UV map that places come from, (faces, corners, 2), and its tile of this image; None of none."""
        height, width = triangles.shape
        step = max(triangles.size // _LOOKED_AT, 1)
        covered = step * np.flatnonzero(triangles.reshape(-1)[::step] >= 0)
        asked = covered[:: max(len(covered) // _ASKED, 1)]
        faces = triangles.reshape(-1)[asked]
        if not len(asked) or faces.max() >= len(self._slots):
            return None
        centers = (np.stack([asked % width, asked // width], axis=1) + 0.5) / (width, height)
        first = weights.reshape(-1, 2)[asked]
        whole = np.concatenate([first, 1.0 - first.sum(axis=1, keepdims=True)], axis=1)
        for uvs in self._maps:
            away = np.einsum("tc,tck->tk", whole, uvs[faces]) - centers
            tile = np.round(np.median(away, axis=0))
            off = np.abs(away - tile) * (width, height)
            if np.quantile(off, 0.9) < _MOST_OFF:
                return uvs, tile.astype(np.float32)
        return None
