# SPDX-License-Identifier: GPL-3.0-or-later
"""Coordinates in the segments of a polygon about the origin, whose corners may be round and whose sides a fraction.

A polygon of N sides has floor(N) segments of the same angle and, where N is no whole number, a narrower last one that
ends at the x axis. Two coordinates in a segment: how far out a point lies (1 on the polygon, whose sides are tangents
to the unit circle), and where along the side. A round corner begins at the *bevel*: an angle from the divider between
two segments. Names: `half` is half a segment's angle, `within` the angle from its first divider.
"""

import math
from typing import NamedTuple

import numpy as np

from engine.kernels.constants import PI, TWO_PI
from engine.kernels.limits import at_least, clamp_unit
from engine.runtime.jit import kernel


class _Side(NamedTuple):
    """Half of a segment's side: straight near its middle, round from `bevel` to the divider.

    half, bevel : float32 [radians]
    roundness : float32, 1: all of it is an arc
    size : float32, of the side against that of a regular segment at the same distance
    """

    half: float
    bevel: float
    roundness: float
    size: float


@kernel
def _bevel(half, roundness):
    """Where the round corner begins of a side with half an angle."""
    return half - math.atan((1.0 - roundness) * math.tan(half)) if roundness != 0.0 else np.float32(0.0)


@kernel
def _length_at(distance, side, slope):
    """Length of half a side at some distance out; `slope` is that of the straight part over the distance."""
    soft = (1.0 - side.roundness) * side.bevel
    return distance * slope + soft * (0.5 * distance + 0.5) + side.roundness * side.bevel


@kernel
def _straight(radius, offset, side, normalize):
    """Distance, and way along the side, of a point that lies at an angle from the middle of a segment."""
    distance = radius * math.cos(offset)
    along = side.size * distance * math.tan(abs(offset))
    if normalize:
        along /= side.size * _length_at(distance, side, math.tan(side.half - side.bevel))
    return side.size * distance, along


@kernel
def _rounded(radius, distance, from_divider, side, normalize):
    """Way along the side of a point in a round corner, at an angle from the divider."""
    rest = side.half - side.bevel
    into = side.bevel - from_divider
    soft = (1.0 - side.roundness) * side.bevel
    across, ahead = radius * math.sin(rest), radius * math.cos(rest)
    if into < soft:
        along = across + ahead * into + 0.5 * (1.0 - ahead) * (into * into) / soft
    else:
        along = across + soft * (0.5 * ahead - 0.5) + into
    if normalize:
        nearer = _length_at(distance, side, math.tan(rest))
        share = into / side.bevel
        farther = across + soft * (0.5 * ahead + 0.5) + side.roundness * side.bevel
        return along / (nearer + share * (farther - nearer))
    return side.size * along


@kernel
def _on_circle(x, y, radius, angle):
    """Distance from the origin to a circle about a point, in some direction."""
    along = math.sin(angle) * y + math.cos(angle) * x
    return along + math.sqrt(along * along + radius * radius - x * x - y * y)


@kernel
def _width(side, regular, roundness):
    """Half a side's length on the polygon itself."""
    soft = (1.0 - roundness) * side.bevel
    return math.tan(side.half - side.bevel) + side.size * (
        soft * (0.5 / side.size + 0.5) + roundness * side.bevel
    )


@kernel
def _regular(radius, within, side, normalize):
    """Distance and way along the side in a polygon of equal segments, or far from the last one."""
    half, bevel, roundness = side.half, side.bevel, side.roundness
    if bevel <= within < 2.0 * half - bevel:
        return _straight(radius, half - within, side, normalize)
    from_divider = within - (2.0 * half if within > half else np.float32(0.0))
    distance = radius / _on_circle((1.0 - roundness) / math.cos(half), np.float32(0.0), roundness, from_divider)
    return distance, _rounded(radius, distance, abs(from_divider), side, normalize)


@kernel
def _beside_last(sides, roundness, last):
    """The circle that rounds the corners beside the last segment, and where the side before it meets that.

    Returns
    -------
    x, y, radius, bevel : float32
    """
    half = PI / sides
    inner = last - math.atan((1.0 - roundness) * math.tan(last))
    radius = roundness * math.tan(last) / math.tan(0.5 * (half + last))
    out = 1.0 / math.cos(last - inner)
    x = math.cos(inner) * out - radius * math.cos(last)
    y = radius * math.sin(last) - math.sin(inner) * out
    return x, y, radius, math.atan((y + radius * math.sin(half)) / (x + radius * math.cos(half)))


@kernel
def _irregular(radius, signed, angle, within, sides, roundness, normalize):
    """`tile_radially` of a rounded polygon with a last segment of its own: distance, way, half width, half angle."""
    half = PI / sides
    last = PI - np.float32(np.floor(sides)) * half
    end = TWO_PI - 2.0 * last
    regular = _Side(half, _bevel(half, roundness), roundness, np.float32(1.0))
    narrow = _Side(last, _bevel(last, roundness), roundness, math.cos(half) / math.cos(last))
    x, y, circle, outer_bevel = _beside_last(sides, roundness, last)
    outer = _Side(half, outer_bevel, 1.0 - math.tan(half - outer_bevel) / math.tan(half), np.float32(1.0))
    width = _width(regular, regular, roundness)
    if outer_bevel <= angle < end - outer_bevel:
        bevel = regular.bevel
        is_beside = angle >= end - half or angle < half
        if is_beside and (bevel <= within < 2.0 * half - bevel or angle >= end - bevel or angle < bevel):
            distance, along = _straight(radius, half - within, outer, normalize)
            return distance, along, width, half
        distance, along = _regular(radius, within, regular, normalize)
        return distance, along, width, half
    if end + narrow.bevel <= angle < TWO_PI - narrow.bevel:
        distance, along = _straight(radius, last - within, narrow, normalize)
        return distance, along, _width(narrow, regular, roundness), last
    # Both corners beside the last segment are one mirrored.
    if end - outer_bevel <= angle < TWO_PI - last:
        signed = -(signed + 2.0 * last)
    distance = radius / _on_circle(x, y, circle, signed)
    if signed < 0.0:
        along = _rounded(radius, distance, -signed, narrow, normalize)
        return narrow.size * distance, along, _width(narrow, regular, roundness), last
    along = _rounded(radius, narrow.size * distance, signed, outer, normalize)
    return narrow.size * distance, along, width, half


@kernel
def tile_radially(x, y, sides, roundness, normalize):
    """Blender's Radial Tiling at a point of the plane.

    Parameters
    ----------
    sides : float32, at least 2
    roundness : float32, clamped to [0, 1]
    normalize : bool
        Whether the way along the side goes from 0 to 1 in each segment; if not, the polygon is at a distance of 0.

    Returns
    -------
    along, distance, number, width, rotation : float32
        The segment's two coordinates, which one it is, half the length of its side, and where its middle lies
        [radians].
    """
    sides, roundness = at_least(sides, 2.0), clamp_unit(roundness)
    radius = math.sqrt(x * x + y * y)
    signed = math.atan2(y, x)
    below = np.float32(1.0) if y < 0.0 else np.float32(0.0)
    angle = signed + below * TWO_PI
    half = PI / sides
    segment = np.float32(np.floor(angle / (2.0 * half)))
    within = angle - segment * (2.0 * half)
    middle = half
    whole = np.float32(np.floor(sides))
    if sides != whole and roundness != 0.0:
        distance, along, width, middle = _irregular(radius, signed, angle, within, sides, roundness, normalize)
    else:
        side = _Side(half, _bevel(half, roundness), roundness, np.float32(1.0))
        last = PI - whole * half
        if sides != whole and not angle < TWO_PI - 2.0 * last:
            middle = last
            side = _Side(last, np.float32(0.0), roundness, math.cos(half) / math.cos(last))
        if sides == 2.0 and roundness == 0.0:
            # Both sides are without end: neither has a length.
            distance, along = _straight(radius, half - within, side, False)
            width = np.float32(0.0)
        elif middle != half:
            distance, along = _straight(radius, middle - within, side, normalize)
            width = math.tan(middle)
        else:
            distance, along = _regular(radius, within, side, normalize)
            width = _width(side, side, roundness)
    if within < middle:
        along = -along
    if x == 0.0 and y == 0.0:
        along = np.float32(0.0)
    if normalize:
        along = 0.5 * along + 0.5
    else:
        distance -= 1.0
    number = np.float32(np.floor(sides * (signed / TWO_PI + below)))
    return along, distance, number, width, segment * (2.0 * half) + middle
