# SPDX-License-Identifier: GPL-3.0-or-later
"""Glass, and what it may touch: rays start in place on both.

A glass that stands on a table lies in one place with it. A ray that leaves one of the two surfaces a rounding error off
would start beyond the other: it would go through the table, or be on the table without having been bent.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from engine.builder.world_boxes import REACH, WorldBoxes, has_triangles
from engine.kernels.surface import RELATIVE_ERROR
from engine.state import geometry as layout
from engine.state.geometry import GeometryArrays

#: Triangles that are looked at; what was not looked at counts as touching. About 0.1 s.
_MOST_LOOKS = 20_000_000
#: What else takes time, in the same measure: an instance's box, and a pair of instances.
_LOOKS_A_BOX, _LOOKS_A_PAIR = 10, 10_000


def _triangle_boxes(geometry: GeometryArrays, mesh: int) -> tuple[np.ndarray, np.ndarray]:
    """Low and high corners, float32 (3, T) each, of the boxes around a mesh's triangles."""
    row = geometry.mesh_table[mesh]
    start, count = int(row[layout.MESH_FIRST_TRIANGLE]), int(row[layout.MESH_TRIANGLE_COUNT])
    # Axis by axis: numpy works along rows of memory.
    first, second, third = (geometry.vertices[geometry.triangles[start : start + count, k], :3].T for k in range(3))
    return np.minimum(np.minimum(first, second), third), np.maximum(np.maximum(first, second), third)


def _to_stored(geometry: GeometryArrays) -> np.ndarray:
    """From the world to stored vertices, float64 (I, 3, 4); zeros where there is no way back."""
    is_baked = geometry.instance_table[:, layout.INSTANCE_FLAGS] & layout.INSTANCE_FLAG_BAKED != 0
    return np.where(is_baked[:, None, None], np.eye(3, 4), geometry.inverses.astype(np.float64).reshape(-1, 3, 4))


def touching_glass(
    geometry: GeometryArrays, boxes: WorldBoxes, is_glass: npt.NDArray[np.bool_]
) -> npt.NDArray[np.bool_]:
    """Glass that may touch something, and what it may touch: bool (I,).

    Two instances may touch if the box around one triangle of either meets the box around the glass: faces in one place
    do, and so does much that is only near. That costs their rays a tenth more time, where finding the very faces took
    up to half of the time of building a scene.

    Parameters
    ----------
    boxes : WorldBoxes
        Of all instances.
    is_glass : bool (I,)
        Which have a material that bends light.
    """
    found = np.zeros(len(is_glass), bool)
    reach = REACH * RELATIVE_ERROR * boxes.extent[:, None]
    low, high = boxes.low - reach, boxes.high + reach
    is_there = has_triangles(geometry) & np.isfinite(boxes.extent)
    to_stored = _to_stored(geometry)
    triangles: dict[int, tuple[np.ndarray, np.ndarray]] = {}
    looked = 0
    for glass in np.flatnonzero(is_glass & is_there).tolist():
        looked += _LOOKS_A_BOX * len(is_glass)
        is_near = is_there & ((low <= high[glass]) & (high >= low[glass])).all(axis=1)
        is_near[glass] = False
        if looked > _MOST_LOOKS:
            found |= is_near
            found[glass] |= is_near.any()
            continue
        for other in np.flatnonzero(is_near).tolist():
            if found[other] and found[glass]:
                continue
            mesh = int(geometry.instance_table[other, layout.INSTANCE_MESH])
            if mesh not in triangles:
                triangles[mesh] = _triangle_boxes(geometry, mesh)
            at_low, at_high = triangles[mesh]
            looked += _LOOKS_A_PAIR + at_low.shape[1]
            # The box of the glass as the other's space sees it, in a box.
            matrix = to_stored[other]
            middle = matrix[:, :3] @ (0.5 * (low[glass] + high[glass])) + matrix[:, 3]
            half = np.abs(matrix[:, :3]) @ (0.5 * (high[glass] - low[glass]))
            is_beside = np.zeros(at_low.shape[1], bool)
            for axis in range(3):
                is_beside |= at_low[axis] > np.float32(middle[axis] + half[axis])
                is_beside |= at_high[axis] < np.float32(middle[axis] - half[axis])
            if not is_beside.all():
                found[glass] = found[other] = True
    return found
