# SPDX-License-Identifier: GPL-3.0-or-later
"""Directions through light portals, by which the background is sampled beside its map.

A portal is picked in proportion to the solid angle under which the receiver sees it, and a direction within it: through
rectangles all directions are then alike, through ellipses all points. Portals that the receiver is behind do not
count.

What stages hold of portals is a call through an address (`linked_portals.py`), so that scenes without them compile
nothing for them. A sample is weighed by `portal_pdf` of its direction, as what scattering finds is.
"""

import math

import numpy as np

from engine.kernels.constants import PI
from engine.kernels.lights.area import SMALLEST_SOLID_ANGLE, rectangle_angles, rectangle_frame, sample_rectangle
from engine.kernels.lights.mapping import concentric_disk
from engine.kernels.vector import add, cross, dot, length, scale
from engine.runtime.jit import kernel
from engine.state.portals import (
    PORTAL_AXIS_U,
    PORTAL_AXIS_V,
    PORTAL_DIRECTION,
    PORTAL_IS_ROUND,
    PORTAL_LENGTH_U,
    PORTAL_LENGTH_V,
    PORTAL_P,
)


@kernel
def _column(portals, k, column):
    return portals[k, column], portals[k, column + 1], portals[k, column + 2]


@kernel
def _offset(portals, k, p):
    """From a receiver to a portal's centre."""
    x, y, z = _column(portals, k, PORTAL_P)
    return x - p[0], y - p[1], z - p[2]


@kernel
def _weight(portals, k, p):
    """Solid angle [sr] under which a portal is seen from p, of an ellipse about; 0 from behind."""
    offset = _offset(portals, k, p)
    height = -dot(offset, _column(portals, k, PORTAL_DIRECTION))
    if not height > 0.0:
        return 0.0 * height
    length_u, length_v = portals[k, PORTAL_LENGTH_U], portals[k, PORTAL_LENGTH_V]
    x0, x1, y0, y1, z = rectangle_frame(
        offset, _column(portals, k, PORTAL_AXIS_U), length_u, _column(portals, k, PORTAL_AXIS_V), length_v
    )
    _, _, _, _, solid_angle = rectangle_angles(x0, x1, y0, y1, z)
    if not solid_angle > SMALLEST_SOLID_ANGLE:
        squared = dot(offset, offset)
        solid_angle = length_u * length_v * height / (squared * math.sqrt(squared))
    return solid_angle * (0.25 * PI if portals[k, PORTAL_IS_ROUND] > 0.0 else np.float32(1.0))


@kernel
def _point(portals, k, p, u0, u1):
    """From a receiver to a point of a portal that is in front of it."""
    offset = _offset(portals, k, p)
    axis_u, axis_v = _column(portals, k, PORTAL_AXIS_U), _column(portals, k, PORTAL_AXIS_V)
    length_u, length_v = portals[k, PORTAL_LENGTH_U], portals[k, PORTAL_LENGTH_V]
    if portals[k, PORTAL_IS_ROUND] > 0.0:
        x, y = concentric_disk(u0, u1)
        return add(offset, add(scale(axis_u, 0.5 * length_u * x), scale(axis_v, 0.5 * length_v * y)))
    x0, x1, y0, y1, z = rectangle_frame(offset, axis_u, length_u, axis_v, length_v)
    n0, n2, g2, g3, solid_angle = rectangle_angles(x0, x1, y0, y1, z)
    if not solid_angle > SMALLEST_SOLID_ANGLE:
        return add(offset, add(scale(axis_u, (u0 - 0.5) * length_u), scale(axis_v, (u1 - 0.5) * length_v)))
    x, y = sample_rectangle(x0, x1, y0, y1, z, n0, n2, g2, g3, solid_angle, u0, u1)
    n = cross(axis_u, axis_v)
    third = scale(n, z if dot(n, offset) < 0.0 else -z)
    return add(add(scale(axis_u, x), scale(axis_v, y)), third)


@kernel
def _pdf_of(portals, k, weight, p, wi):
    """Density [sr^-1] of a direction through one portal, in front of p, seen under `weight`; 0 outside of it."""
    normal = _column(portals, k, PORTAL_DIRECTION)
    facing = -dot(wi, normal)
    if not facing > 0.0:
        return 0.0 * facing
    offset = _offset(portals, k, p)
    t = -dot(offset, normal) / facing
    x = t * dot(wi, _column(portals, k, PORTAL_AXIS_U)) - dot(offset, _column(portals, k, PORTAL_AXIS_U))
    y = t * dot(wi, _column(portals, k, PORTAL_AXIS_V)) - dot(offset, _column(portals, k, PORTAL_AXIS_V))
    length_u, length_v = portals[k, PORTAL_LENGTH_U], portals[k, PORTAL_LENGTH_V]
    u, v = x / length_u, y / length_v
    if portals[k, PORTAL_IS_ROUND] > 0.0:
        return t * t / (facing * 0.25 * PI * length_u * length_v) if u * u + v * v <= 0.25 else 0.0 * facing
    if abs(u) > 0.5 or abs(v) > 0.5:
        return 0.0 * facing
    # Small ones have been weighed by their middle, and are drawn by area.
    return 1.0 / weight if weight > SMALLEST_SOLID_ANGLE else t * t / (facing * length_u * length_v)


@kernel
def sample_portals(portals, p, u0, u1):
    """Draw a direction through the portals that a receiver is in front of.

    Returns
    -------
    x, y, z : float32, unit direction
    possible : float32, 0 where there is no such portal
    """
    total = 0.0 * u0
    for k in range(portals.shape[0]):
        total += _weight(portals, k, p)
    chosen, chosen_weight, before = -1, total, 0.0 * u0
    target = u0 * total
    share = u0
    for k in range(portals.shape[0]):
        weight = _weight(portals, k, p)
        # Rounding may leave nothing of the target for the last one: the last that counts is kept.
        if weight > 0.0 and (chosen < 0 or before <= target):
            chosen, chosen_weight = k, weight
            share = (target - before) / chosen_weight
        before += weight
    if chosen < 0:
        return total, total, total + 1.0, 0.0 * total
    x, y, z = _point(portals, chosen, p, min(1.0, max(0.0, share)), u1)
    far = length((x, y, z))
    if not far > 0.0:
        return 0.0 * total, 0.0 * total, 0.0 * total + 1.0, total
    return x / far, y / far, z / far, total


@kernel
def portal_pdf(portals, p, wi):
    """Density [sr^-1] of `sample_portals` for a direction, and whether it draws any there: 0 if not."""
    total, pdf = 0.0 * p[0], 0.0 * p[0]
    for k in range(portals.shape[0]):
        weight = _weight(portals, k, p)
        if weight > 0.0:
            total += weight
            pdf += weight * _pdf_of(portals, k, weight, p, wi)
    return (pdf / total, total) if total > 0.0 else (total, total)
