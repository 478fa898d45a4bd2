# SPDX-License-Identifier: GPL-3.0-or-later
"""Light portals of a world, as `LightArrays.portals`.

Where a portal is only decides which directions are sampled more often: a sheared one becomes a rectangle as large.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from engine.array_types import Float32Array
from engine.scene.description import Portal
from engine.state import portals as columns

#: Of directions through portals, where the background is of one colour: any other is as good as scattering's.
_SHARE_OF_UNIFORM = 0.9
#: And where its map knows bright places.
_SHARE = 0.5


def build_portals(portals: Sequence[Portal], *, is_uniform: bool) -> Float32Array:
    """Rows of portals; those without an area, or with a transform that is not finite, are left out.

    Parameters
    ----------
    is_uniform : bool
        Whether the background is of one colour.
    """
    rows = np.zeros((len(portals), columns.PORTAL_WIDTH), np.float32)
    is_usable = np.zeros(len(portals), np.bool_)
    for k, portal in enumerate(portals):
        matrix = np.asarray(portal.transform, np.float64)
        is_square = portal.shape in ("SQUARE", "DISK")
        along_u = matrix[:3, 0] * portal.size_x
        along_v = matrix[:3, 1] * (portal.size_x if is_square else portal.size_y)
        normal = np.cross(along_u, along_v)
        area, length = float(np.linalg.norm(normal)), float(np.linalg.norm(along_u))
        if not (np.isfinite(matrix).all() and np.isfinite(area) and area > 1e-12):
            continue
        normal, axis_u = normal / area, along_u / length
        if normal @ -matrix[:3, 2] < 0.0:
            normal = -normal
        row, is_usable[k] = rows[k], True
        row[columns.PORTAL_P : columns.PORTAL_P + 3] = matrix[:3, 3]
        row[columns.PORTAL_AXIS_U : columns.PORTAL_AXIS_U + 3] = axis_u
        row[columns.PORTAL_AXIS_V : columns.PORTAL_AXIS_V + 3] = np.cross(normal, axis_u)
        row[columns.PORTAL_DIRECTION : columns.PORTAL_DIRECTION + 3] = normal
        row[columns.PORTAL_LENGTH_U], row[columns.PORTAL_LENGTH_V] = length, area / length
        row[columns.PORTAL_IS_ROUND] = portal.shape in ("DISK", "ELLIPSE")
    rows[:, columns.PORTAL_SHARE] = _SHARE_OF_UNIFORM if is_uniform else _SHARE
    return np.ascontiguousarray(rows[is_usable])
