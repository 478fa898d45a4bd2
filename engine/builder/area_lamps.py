# SPDX-License-Identifier: GPL-3.0-or-later
"""Area lamps: radiance power / (pi area), times the spread's own normalisation.

A lamp that is not normalised takes 1 for the area.
"""

from __future__ import annotations

import math

import numpy as np

from engine.builder import light_tree as lt
from engine.builder.lamp_kind import LampColumns, LampDraft, LampKind, norm, unit
from engine.kernels.lights import area as area_lamp
from engine.scene.description import Light


def _unit_as_cycles(vectors: np.ndarray) -> np.ndarray:
    """Unit vectors, rounded as Cycles rounds them: what lies in a lamp's plane hides it or not by the last bit."""
    with np.errstate(over="ignore"):
        single = vectors.astype(np.float32)
        squares = single * single
        norm = np.sqrt(squares[..., 0] + squares[..., 1] + squares[..., 2])[..., None]
    is_usable = np.isfinite(norm) & (norm > 0.0)
    inverse = np.float32(1.0) / np.where(is_usable, norm, np.float32(1.0))
    return np.where(is_usable, single * inverse, unit(vectors)).astype(np.float64)


def _leaning(
    axis_u: np.ndarray, axis_v: np.ndarray, direction: np.ndarray, length_u: np.ndarray, length_v: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Which lean (`area_lamp.FLAG_LEANING`), bool (N,), and half of the box that rays meet these in, (N, 3) [m]."""
    across, *leaning = (
        np.abs((a * b).sum(axis=1)) for a, b in ((axis_u, axis_v), (axis_u, direction), (axis_v, direction))
    )
    rows = np.stack([axis_u, axis_v, direction], axis=1)
    leans = (across <= 1e-5) & (np.maximum(*leaning) > 1e-5) & (np.abs(np.linalg.det(rows)) > 1e-6)
    inverse = np.linalg.inv(np.where(leans[:, None, None], rows, np.eye(3)))
    reach = 0.5 * (np.abs(inverse[:, :, 0]) * length_u[:, None] + np.abs(inverse[:, :, 1]) * length_v[:, None])
    return leans, np.where(leans[:, None], reach, 0.0)


def _convert_areas(lamps: LampColumns, draft: LampDraft) -> None:
    axes, values, bounds = lamps.axes, draft.values, draft.bounds
    is_ellipse = np.isin(lamps.own["shape"], ("DISK", "ELLIPSE"))
    size_y = np.where(np.isin(lamps.own["shape"], ("SQUARE", "DISK")), lamps.own["size_x"], lamps.own["size_y"])
    along_u, along_v = axes[:, :, 0] * lamps.own["size_x"][:, None], axes[:, :, 1] * size_y[:, None]
    length_u, length_v = norm(along_u), norm(along_v)
    area = length_u * length_v * np.where(is_ellipse, 0.25 * math.pi, 1.0)
    draft.is_usable = area > 0.0
    # Whatever: the rows of those that are not usable are not taken.
    area = np.where(draft.is_usable, area, 1.0)
    draft.flags[is_ellipse] |= area_lamp.FLAG_ELLIPSE
    spread = np.minimum(math.pi, np.maximum(0.0, lamps.own["spread"]))
    half = 0.5 * spread
    # Parallel light: the radiance's integral over directions is what counts.
    is_parallel = spread <= 0.0
    draft.make_delta(is_parallel)
    scale = 1.0 / math.pi / np.where(lamps.is_normalized, area, 1.0)
    draft.scale = np.where(is_parallel, scale * math.pi, scale)
    radiance = lamps.mean * np.where(is_parallel, draft.scale / math.pi, scale)
    is_narrow = ~is_parallel & (spread < math.pi - 1e-6)
    narrow = np.where(is_narrow, half, 1.0)
    tangent = np.tan(narrow)
    # The difference cancels where they are small.
    excess = np.where(narrow > 0.05, tangent - narrow, narrow * narrow * narrow / 3.0)
    spread_scale = 1.0 / excess
    values[:, area_lamp.TAN_SPREAD] = np.where(is_narrow, tangent, 0.0)
    values[:, area_lamp.SPREAD_SCALE] = np.where(is_narrow, spread_scale, 0.0)
    peak = np.where(is_parallel, 1e4, np.where(is_narrow, tangent * spread_scale, 1.0))
    # Where x and y are sheared the lamp is made rectangular: its normal is its plane's, on the side of its own -z.
    axis_u = _unit_as_cycles(along_u)
    sheared = (unit(along_v) * axis_u).sum(axis=1)
    straight = unit(along_v - (along_v * axis_u).sum(axis=1)[:, None] * axis_u)
    leans, reach = _leaning(axis_u, unit(along_v), lamps.direction, length_u, length_v)
    axis_v = np.where((abs(sheared) > 1e-6)[:, None], straight, _unit_as_cycles(along_v))
    normal = np.cross(axis_u, axis_v)
    is_away = (normal * lamps.direction).sum(axis=1) < 0.0
    direction = np.where(is_away[:, None], -normal, normal)
    direction = np.where(leans[:, None], lamps.direction, direction)
    draft.flags[leans] |= area_lamp.FLAG_LEANING
    along_v = axis_v * length_v[:, None]
    values[:, area_lamp.AXIS_U : area_lamp.AXIS_U + 3] = axis_u
    values[:, area_lamp.AXIS_V : area_lamp.AXIS_V + 3] = axis_v
    values[:, area_lamp.DIRECTION : area_lamp.DIRECTION + 3] = direction
    values[:, area_lamp.LENGTH_U], values[:, area_lamp.LENGTH_V] = length_u, length_v
    position = lamps.matrix[:, :3, 3]
    extent = np.maximum(0.5 * (np.abs(along_u) + np.abs(along_v)), reach)
    bounds[:, lt.BOUNDS_LOWER : lt.BOUNDS_LOWER + 3] = position - extent
    bounds[:, lt.BOUNDS_UPPER : lt.BOUNDS_UPPER + 3] = position + extent
    bounds[:, lt.BOUNDS_ENERGY] = radiance * area * peak
    bounds[:, lt.BOUNDS_AXIS : lt.BOUNDS_AXIS + 3] = direction
    bounds[:, lt.BOUNDS_EMISSION] = half + 1e-3
    bounds[:, lt.BOUNDS_SPREAD] = area * peak / math.pi
    longest = np.maximum(length_u, length_v)
    bounds[:, lt.BOUNDS_RADIUS_SQUARED] = 0.25 * np.where(
        is_ellipse, longest * longest, length_u * length_u + length_v * length_v
    )


def _corners(light: Light) -> np.ndarray:
    """See `LampKind.corners`."""
    matrix = np.asarray(light.transform, np.float64)
    size_y = light.size_x if light.shape in ("SQUARE", "DISK") else light.size_y
    along = 0.5 * matrix[:3, 0] * light.size_x, 0.5 * matrix[:3, 1] * size_y
    return np.array([matrix[:3, 3] + a * along[0] + b * along[1] for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))])


AREAS = LampKind(
    area_lamp.LAMP, _convert_areas, measures=("size_x", "size_y", "spread"), choices=("shape",), corners=_corners
)
