# SPDX-License-Identifier: GPL-3.0-or-later
"""Burley's profile of light that comes out at a distance from where it went in, and rays that look for such places.

References
----------
Christensen and Burley 2015, "Approximate Reflectance Profiles for Efficient Subsurface Scattering", Eq. (3).
King et al. 2013, "BSSRDF Importance Sampling": probe rays along one of three axes, weighed against the others.
"""

import math
from typing import NamedTuple

import numpy as np

from engine.kernels.constants import TWO_PI
from engine.kernels.vector import add, dot, orthonormal_basis, scale
from engine.runtime.jit import kernel

#: The profile ends at so many radii; this part of it lies within (Cycles).
_END = np.float32(16.0)
_WITHIN = np.float32(0.9963790093708328)
_MOST_TURNS = 10
_TOLERANCE = np.float32(1e-6)


@kernel
def burley_density(radius, r):
    """Profile [1/m] by distance, float32, normalised over it; 0 where the channel has no radius."""
    # Written so that a channel without a radius has none.
    if not (r > 0.0 and r < _END * radius):
        return np.float32(0.0)
    third = math.exp(-r / (3.0 * radius))
    return (third * third * third + third) / (4.0 * radius * _WITHIN)


@kernel
def _sample_burley(u):
    """Distance in radii whose part of the profile is `u`, by Newton's method."""
    wanted = u * _WITHIN
    r = math.exp(wanted * wanted * 2.4) - 1.0 if wanted <= 0.9 else np.float32(15.0)
    for _ in range(_MOST_TURNS):
        third = math.exp(-r * (1.0 / 3.0))
        whole = third * third * third
        wrong = 1.0 - 0.25 * whole - 0.75 * third - wanted
        slope = 0.25 * (whole + third)
        if abs(wrong) < _TOLERANCE or slope == 0.0:
            break
        r = max(r - wrong / slope, 0.0)
    return r


@kernel
def sample_cubic(u):
    """Distance in radii whose part of the profile (1 - r)^3 over the disk is `u`, by Newton's method, float32."""
    r = np.float32(0.25)
    for _ in range(_MOST_TURNS):
        left = 1.0 - r
        wrong = r * r * (10.0 + r * (-20.0 + r * (15.0 - 4.0 * r))) - u
        slope = 20.0 * r * left * left * left
        if abs(wrong) < _TOLERANCE or slope == 0.0:
            break
        r = min(max(r - wrong / slope, 0.0), 1.0)
    return r


class Probe(NamedTuple):
    """A line on which places are looked for where light comes out.

    Attributes
    ----------
    origin : tuple of 3 float32 [m]
    axis : tuple of 3 float32
        Unit, against which the line runs.
    length : float32 [m]
    distance : float32 [m]
        Of the line from the place of entry.
    across, along : tuple of 3 float32
        The other axes.
    shares : tuple of 3 float32
        How likely each of them was, `axis` first.
    """

    origin: tuple[float, float, float]
    axis: tuple[float, float, float]
    length: float
    distance: float
    across: tuple[float, float, float]
    along: tuple[float, float, float]
    shares: tuple[float, float, float]


@kernel
def choose_probe(p, ng, radius, u_distance, u_axis):
    """Probe of a channel of mean free path `radius`, about a point of normal `ng`; half of them go along the normal."""
    tangent, bitangent = orthonormal_basis(ng)
    return aim_probe(p, ng, tangent, bitangent, _sample_burley(u_distance) * radius, _END * radius, u_axis)


@kernel
def aim_probe(p, ng, tangent, bitangent, distance, end, u_axis):
    """Probe at a distance from a point, as long as a ball of radius `end` [m] about it; half go along the normal."""
    axis, across, along = ng, tangent, bitangent
    shares = (0.5, 0.25, 0.25)
    u = 2.0 * u_axis
    if u_axis >= 0.75:
        axis, across, along = bitangent, tangent, ng
        shares = (0.25, 0.25, 0.5)
        u = 4.0 * (u_axis - 0.75)
    elif u_axis >= 0.5:
        axis, across, along = tangent, ng, bitangent
        shares = (0.25, 0.5, 0.25)
        u = 4.0 * (u_axis - 0.5)
    height = math.sqrt(max(end * end - distance * distance, 0.0))
    beside = add(scale(across, distance * math.cos(TWO_PI * u)), scale(along, distance * math.sin(TWO_PI * u)))
    origin = add(p, add(scale(axis, height), beside))
    return Probe(origin, axis, 2.0 * height, distance, across, along, shares)


@kernel
def axis_weight(probe, ng):
    """Weight of a place of normal `ng` that the probe has met, against what probes along the other axes would have met.

    The power heuristic, over the cosine that the projection onto the probe's disk has.
    """
    own = probe.shares[0] * abs(dot(probe.axis, ng))
    across = probe.shares[1] * abs(dot(probe.across, ng))
    along = probe.shares[2] * abs(dot(probe.along, ng))
    total = own * own + across * across + along * along
    return own / total if total > 0.0 else np.float32(0.0)
