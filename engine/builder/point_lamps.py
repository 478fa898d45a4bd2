# SPDX-License-Identifier: GPL-3.0-or-later
"""Points and spots of radius r: radiance power / (4 pi^2 r^2).

They are spheres, or with soft falloff discs that face the receiver. A lamp that is not normalised takes 1 for 4 pi r^2.
"""

from __future__ import annotations

import math

import numpy as np

from engine.builder import light_tree as lt
from engine.builder.lamp_kind import LampColumns, LampDraft, LampKind, norm
from engine.kernels.lights import sphere


def _convert_points(lamps: LampColumns, draft: LampDraft) -> None:
    values, bounds = draft.values, draft.bounds
    radius = np.maximum(0.0, lamps.own["radius"])
    squared = radius * radius
    is_round = radius > 0.0
    draft.flags[is_round & ~lamps.own["use_soft_falloff"]] |= sphere.FLAG_SPHERE
    draft.make_delta(~is_round)
    area = np.where(lamps.is_normalized & is_round, 4.0 * math.pi * squared, 1.0)
    of_delta = np.where(lamps.is_normalized, 1.0 / (4.0 * math.pi), 1.0 / math.pi)
    draft.scale = np.where(is_round, 1.0 / (math.pi * area), of_delta)
    intensity = lamps.mean * draft.scale
    values[:, sphere.RADIUS] = radius
    values[:, sphere.INVERSE : sphere.INVERSE + 9] = lamps.inverse_axes.reshape(-1, 9)
    position = lamps.matrix[:, :3, 3]
    bounds[:, lt.BOUNDS_LOWER : lt.BOUNDS_LOWER + 3] = position - radius[:, None]
    bounds[:, lt.BOUNDS_UPPER : lt.BOUNDS_UPPER + 3] = position + radius[:, None]
    bounds[:, lt.BOUNDS_ENERGY] = np.where(is_round, intensity * math.pi * squared, intensity)
    bounds[:, lt.BOUNDS_AXIS + 2] = 1.0
    bounds[:, lt.BOUNDS_NORMALS] = math.pi
    bounds[:, lt.BOUNDS_EMISSION] = 0.5 * math.pi
    bounds[:, lt.BOUNDS_SPREAD] = 0.5 * squared
    bounds[:, lt.BOUNDS_RADIUS_SQUARED] = squared


def _angle_of_sheared(axes: np.ndarray, tangent: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Which spots' axes are not perpendicular, bool (N,), and angles [rad] that their cones stay within, (N,).

    A direction on a cone's rim is -z + tangent (x cos t + y sin t) in the images x, y and z of the lamp's own axes, z
    of length 1 here: the largest part across z over the least part along it is a bound.
    """
    length = norm(axes[:, :, 2].copy())
    scaled = axes / length[:, None, None]
    z = scaled[:, :, 2]
    along = np.einsum("ni,nik->nk", z, scaled[:, :, :2])
    across = scaled[:, :, :2] - z[:, :, None] * along[:, None, :]
    (a, b), (_, c) = np.einsum("nij,nik->jkn", across, across)
    largest = np.sqrt(0.5 * (a + c) + np.sqrt(0.25 * (a - c) ** 2 + b * b))
    shift = norm(along)
    is_sheared = (shift > 1e-6 * largest) | (np.abs(b) > 1e-6 * np.sqrt(a * c))
    return is_sheared, np.arctan2(tangent * largest, 1.0 - tangent * shift)


def _convert_spots(lamps: LampColumns, draft: LampDraft) -> None:
    """Points within a cone, which the transform may squeeze."""
    _convert_points(lamps, draft)
    draft.is_usable = np.abs(np.linalg.det(lamps.axes)) >= 1e-30
    axes = np.where(draft.is_usable[:, None, None], lamps.axes, np.eye(3))
    values, bounds = draft.values, draft.bounds
    half = 0.5 * lamps.own["spot_angle"]
    cosine = np.cos(half)
    lengths = np.sqrt((axes * axes).sum(axis=1))
    values[:, sphere.DIRECTION : sphere.DIRECTION + 3] = lamps.direction
    values[:, sphere.COSINE] = cosine
    smooth = (1.0 - cosine) * lamps.own["spot_blend"]
    values[:, sphere.BLEND_SCALE] = np.minimum(1e30, 1.0 / np.maximum(smooth, 1e-30))
    longer, shorter = np.maximum(lengths[:, 0], lengths[:, 1]), np.minimum(lengths[:, 0], lengths[:, 1])
    tangent = np.tan(np.minimum(half, 0.5 * math.pi - 1e-4))
    widest = tangent * longer / lengths[:, 2]
    angle, one_minus_cos = np.arctan(widest), 1.0 - 1.0 / np.sqrt(1.0 + widest * widest)
    is_sheared, sheared = _angle_of_sheared(axes, tangent)
    angle, one_minus_cos = np.where(is_sheared, [sheared, 1.0 - np.cos(sheared)], [angle, one_minus_cos])
    values[:, sphere.ONE_MINUS_COS] = one_minus_cos
    # Full strength within the inner cone, fading to the outer one.
    inner = np.arccos(np.minimum(1.0, cosine + smooth))
    narrowest = np.tan(np.minimum(inner, 0.5 * math.pi - 1e-4)) * shorter / lengths[:, 2]
    bounds[:, lt.BOUNDS_AXIS : lt.BOUNDS_AXIS + 3] = lamps.direction
    bounds[:, lt.BOUNDS_NORMALS] = np.arctan(narrowest)
    bounds[:, lt.BOUNDS_EMISSION] = angle - np.arctan(narrowest) + 2e-3


POINTS = LampKind(
    sphere.POINT_LAMP, _convert_points, measures=("radius",), choices=("use_soft_falloff",), example={"radius": 0.4}
)
SPOTS = LampKind(
    sphere.SPOT_LAMP, _convert_spots, measures=("radius", "spot_angle", "spot_blend"), choices=("use_soft_falloff",),
    example={"radius": 0.3, "spot_angle": 1.2},
)
