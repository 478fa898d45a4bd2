# SPDX-License-Identifier: GPL-3.0-or-later
"""Glass, and what it may touch: rays start in place on both.

A glass that stands on a table lies in one place with it. A ray that leaves one of the two surfaces a rounding error off
would start beyond the other: it would go through the table, or be on the table without having been bent.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from engine.builder.planes import MOST_PLANES, lies_in, planes_of
from engine.builder.world_boxes import REACH, WorldBoxes, are_round, has_triangles, is_baked
from engine.kernels.surface import RELATIVE_ERROR
from engine.state import geometry as layout
from engine.state.geometry import GeometryArrays

#: Triangles that are looked at; what nobody comes to counts as touching. A tenth of a second, or a few.
_MOST_LOOKS = 20_000_000
#: What else takes time, in the same measure: an instance's box, a pair of instances, and a triangle near another.
_LOOKS_A_BOX, _LOOKS_A_PAIR, _LOOKS_A_TRIANGLE = 10, 10_000, 20
#: Triangles of which planes are looked for. More are taken to be curved.
_MOST_TRIANGLES = 4096


class _Near:
    """Finds the triangles of instances that are near something."""

    def __init__(self, geometry: GeometryArrays, matrices: np.ndarray) -> None:
        self._geometry = geometry
        back = geometry.inverses.astype(np.float64).reshape(-1, 3, 4)
        self._to_world = matrices
        self._to_stored = np.where(is_baked(geometry)[:, None, None], np.eye(3, 4), back)
        #: Low and high corners of the boxes around triangles, float32 (3, T), by mesh.
        self._boxes: dict[int, tuple[np.ndarray, np.ndarray]] = {}

    def _rows(self, mesh: int) -> np.ndarray:
        start, count = self._geometry.mesh_table[mesh][[layout.MESH_FIRST_TRIANGLE, layout.MESH_TRIANGLE_COUNT]]
        return self._geometry.triangles[start : start + count]

    def _boxes_of(self, mesh: int) -> tuple[np.ndarray, np.ndarray]:
        if mesh not in self._boxes:
            # Axis by axis: numpy works along rows of memory.
            corners = [self._geometry.vertices[self._rows(mesh)[:, corner], :3].T for corner in range(3)]
            self._boxes[mesh] = np.minimum.reduce(corners), np.maximum.reduce(corners)
        return self._boxes[mesh]

    def within(self, instance: int, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """Triangles of an instance the boxes around which meet a box of the world: corners, float64 (T, 3, 3), world.

        The boxes are those of the space in which vertices are stored.
        """
        mesh = int(self._geometry.instance_table[instance, layout.INSTANCE_MESH])
        matrix = self._to_stored[instance]
        middle = matrix[:, :3] @ (0.5 * (low + high)) + matrix[:, 3]
        half = np.abs(matrix[:, :3]) @ (0.5 * (high - low))
        at_low, at_high = self._boxes_of(mesh)
        is_near = np.ones(at_low.shape[1], bool)
        for axis in range(3):
            is_near &= at_low[axis] <= np.float32(middle[axis] + half[axis])
            is_near &= at_high[axis] >= np.float32(middle[axis] - half[axis])
        stored = self._geometry.vertices[self._rows(mesh)[is_near], :3].astype(np.float64)
        matrix = self._to_world[instance]
        corners: np.ndarray = stored @ matrix[:, :3].T + matrix[:, 3]
        return corners

    def count(self, instance: int) -> int:
        """Triangles of an instance."""
        mesh = self._geometry.instance_table[instance, layout.INSTANCE_MESH]
        return int(self._geometry.mesh_table[mesh, layout.MESH_TRIANGLE_COUNT])


def _may_touch(first: np.ndarray, second: np.ndarray, tolerance: float) -> bool:
    """Whether some of two sets of triangles, float64 (T, 3, 3), may lie in one place.

    They may if one lies in a plane of the other set. Two that are curved are taken to touch.
    """
    for flat, other in ((first, second), (second, first)):
        if len(flat) > _MOST_TRIANGLES:
            continue
        planes = planes_of(flat.reshape(-1, 3), np.arange(3 * len(flat)).reshape(-1, 3))
        if len(planes) <= MOST_PLANES:
            return lies_in(planes, other.reshape(-1, 3), np.arange(3 * len(other)).reshape(-1, 3), tolerance)
    return True


def touching_glass(
    geometry: GeometryArrays, matrices: np.ndarray, boxes: WorldBoxes, is_glass: npt.NDArray[np.bool_]
) -> npt.NDArray[np.bool_]:
    """Glass that may touch something, and what it may touch: bool (I,).

    Where triangles lie in one plane, within the box that both instances are in, they may touch. Some that do not are
    found as well. That costs their rays time, where finding the very faces took up to nine tenths of the time of
    building a scene.

    Parameters
    ----------
    matrices : float64 (I, 3, 4)
        The instances' `world_matrices`.
    boxes : WorldBoxes
        Boxes of all instances.
    is_glass : bool (I,)
        Which have a material that bends light.
    """
    found = np.zeros(len(is_glass), bool)
    if not is_glass.any():
        return found
    reach = REACH * RELATIVE_ERROR * boxes.extent
    low, high = boxes.low - reach[:, None], boxes.high + reach[:, None]
    is_there = has_triangles(geometry) & ~are_round(geometry) & np.isfinite(boxes.extent)
    near = _Near(geometry, matrices)
    looked = 0
    for glass in np.flatnonzero(is_glass & is_there).tolist():
        looked += _LOOKS_A_BOX * len(is_glass)
        is_near = is_there & ((low <= high[glass]) & (high >= low[glass])).all(axis=1)
        is_near[glass] = False
        for other in np.flatnonzero(is_near).tolist():
            if found[other] and found[glass]:
                continue
            is_touching = looked > _MOST_LOOKS
            if not is_touching:
                looked += _LOOKS_A_PAIR + near.count(other)
                both = np.maximum(low[glass], low[other]), np.minimum(high[glass], high[other])
                theirs = near.within(other, *both)
                if len(theirs):
                    looked += near.count(glass) + _LOOKS_A_TRIANGLE * len(theirs)
                    ours = near.within(glass, *both)
                    tolerance = float(max(reach[glass], reach[other]))
                    is_touching = len(ours) > 0 and _may_touch(ours, theirs, tolerance)
            if is_touching:
                found[glass] = found[other] = True
    return found
