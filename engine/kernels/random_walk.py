# SPDX-License-Identifier: GPL-3.0-or-later
"""Random walks below surfaces: what a medium is made of, and how steps are drawn and weighed.

Steps are drawn in three ways, by any of the channels: by the phase function and free paths; by directions towards the
surface that was entered, and free paths that are stretched by as much; and by those away from it where the opposite
side is near. The balance heuristic weighs all of them. After nine steps scattering is taken as even, and as rarer.

References
----------
Chiang et al. 2016, "Practical and Controllable Subsurface Scattering for Production Path Tracing".
Krivanek and d'Eon 2014, "A Zero-variance-based Sampling Scheme for Monte Carlo Subsurface Scattering".
Meng et al. 2016, "Improving the Dwivedi Sampling Scheme", Eqs. (9) and (10).
d'Eon and Krivanek 2020, "Zero-Variance Theory for Efficient Subsurface Scattering" (SIGGRAPH course), Eq. (67).
Wrenninge et al. 2017, "Path Traced Subsurface Scattering using Anisotropic Phase Functions and Non-Exponential Free
Flights": the fits of `_fitted_albedo`.
d'Eon 2016, "A Hitchhiker's Guide to Multiple Scattering", Eq. (53.7).
Van de Hulst 1980, "Multiple Light Scattering".
"""

import math
from typing import NamedTuple

import numpy as np

from engine.kernels.angles import sine_and_cosine
from engine.kernels.constants import INV_FOUR_PI, TWO_PI
from engine.kernels.exponential import decay
from engine.kernels.rng import sample_4d, track_4
from engine.kernels.vector import add, dot, orthonormal_basis, scale
from engine.runtime.jit import kernel
from engine.state.walks import (
    WALK_ALBEDO,
    WALK_CHANNEL,
    WALK_EXTINCTION,
    WALK_HIT,
    WALK_REDUCED_EXTINCTION,
    WALK_REDUCED_SCATTERING,
    WALK_SCATTERING,
    WALK_THROUGHPUT,
)

#: Steps of a walk (Cycles).
MOST_STEPS = 256
#: The last step whose scattering is not even.
_LAST_UNEVEN = 9
#: Albedos below are raised to this, and the throughput falls instead: else walks could not be guided (Cycles).
_LEAST_ALBEDO = np.float32(0.2)
_MOST_ALBEDO = np.float32(0.999999)
_LEAST_LENGTH = np.float32(1e-16)
#: Mean cosines below which the inverse would divide by next to nothing.
_ISOTROPIC = np.float32(1e-3)
#: Steps whose numbers are stratified.
STRATIFIED_STEPS = 8
#: Their sets are so far apart, farther than vertices' (`engine.kernels.rng`).
_STEP_SETS = 1 << 21
_INV_TWO_PI = np.float32(2.0) * INV_FOUR_PI


@kernel
def _polynomial(g, a, b):
    """Of degree 7: coefficients 0 to 3, and 4 to 7."""
    high = b[0] + g * (b[1] + g * (b[2] + g * b[3]))
    return a[0] + g * (a[1] + g * (a[2] + g * (a[3] + g * high)))


@kernel
def _fitted_albedo(color, g):
    """Single-scattering albedo of a medium of which a half-space sends back `color`: Wrenninge et al. 2017.

    Parameters
    ----------
    g : float32, in [0, 1): mean cosine of the phase function
    """
    a = _polynomial(
        g, (1.8260523782, -1.28451056436, -1.79904629312, 9.19393289202),
        (-22.8215585862, 32.0234874259, -23.6264803333, 7.21067002658),
    )  # fmt: skip
    b = _polynomial(
        g, (0.0, 31.1491581433, -201.847017512, 841.576016723),
        (-2018.09288505, 2731.71560286, -1935.41424244, 559.009054474),
    )  # fmt: skip
    b = 4.98511194385 + 0.127355959438 * math.exp(b)
    c = _polynomial(
        g, (1.09686102424, -0.394704063468, 1.05258115941, -8.83963712726),
        (28.8643230661, -46.8802913581, 38.5402837518, -12.7181042538),
    )  # fmt: skip
    d = _polynomial(
        g, (0.496310210422, 0.360146581622, -2.15139309747, 17.8896899217),
        (-55.2984010333, 82.065982243, -58.5106008578, 15.8478295021),
    )  # fmt: skip
    e = _polynomial(
        g, (0.0, 76.7316253952, -594.356773233, 2448.8834203),
        (-5576.68528998, 7116.60171912, -4763.54467887, 1303.5318055),
    )  # fmt: skip
    e = 4.23190299701 + 0.00310603949088 * math.exp(e)
    f = _polynomial(
        g, (2.40602999408, -2.51814844609, 9.18494908356, -79.2191708682),
        (259.082868209, -403.613804597, 302.85712436, -87.4370473567),
    )  # fmt: skip
    blend = math.sqrt(math.sqrt(color))
    dark = (1.0 - blend) * a * math.atan(b * color) ** c
    return dark + blend * d * math.atan(e * color) ** f


@kernel
def _similar_albedo(color, g):
    """Single-scattering albedo of a medium of which a half-space sends back `color`, for any g: d'Eon 2016."""
    root = 4.20863 * color - math.sqrt(9.59217 + 41.6808 * color + 17.7126 * color * color) + 4.09712
    square = root * root
    below = 1.0 - g * square
    return (1.0 - square) / below if below != 0.0 else np.float32(0.0)


@kernel
def begin_walk(rows, c, color, length, g, is_fitted):
    """Write what one channel's medium is made of into `rows`, whose throughput is the path's, color included.

    Parameters
    ----------
    rows : float32 (WALK_ROWS, C)
    c : int
    color : float32
        What a half-space is to send back.
    length : float32 [m]
        Mean free path; of the fit that by similarity.
    g : float32
        Mean cosine of the phase function.
    is_fitted : bool
        Take the fit of Wrenninge et al., which knows no negative g.
    """
    extinction = 1.0 / max(length, _LEAST_LENGTH)
    if is_fitted and g >= 0.0:
        albedo = _fitted_albedo(color, g)
        extinction /= 1.0 - g
    else:
        albedo = _similar_albedo(color, g)
    albedo = min(max(albedo, 0.0), _MOST_ALBEDO)
    # Scattering brings the color in again.
    throughput = rows[WALK_THROUGHPUT, c] / color if color != 0.0 else np.float32(0.0)
    if albedo < _LEAST_ALBEDO:
        throughput *= albedo / _LEAST_ALBEDO
        albedo = _LEAST_ALBEDO
    scattering = extinction * albedo
    rows[WALK_EXTINCTION, c] = extinction
    rows[WALK_SCATTERING, c] = scattering
    rows[WALK_REDUCED_EXTINCTION, c] = extinction - scattering + scattering * (1.0 - g)
    rows[WALK_REDUCED_SCATTERING, c] = scattering * (1.0 - g)
    rows[WALK_ALBEDO, c] = albedo
    rows[WALK_THROUGHPUT, c] = throughput


class Entry(NamedTuple):
    """Where a walk has begun, and what it is guided by.

    Attributes
    ----------
    p, n : tuple of 3 float32
        Position and normal, outwards, of the point of entry.
    length, inverse_length : float32
        Diffusion length, in mean free paths, and 1 over it.
    log_ratio : float32
        Of (length + 1) / (length - 1).
    opposite : float32 [m]
        Distance of the opposite side along the normal; negative: none is near.
    """

    p: tuple[float, float, float]
    n: tuple[float, float, float]
    length: float
    inverse_length: float
    log_ratio: float
    opposite: float


@kernel
def diffusion_length(channels, rows):
    """Of the channel that scatters most, in mean free paths: 1 / the exponent by which light fades with depth."""
    albedo = np.float32(0.0)
    for c in range(len(channels)):
        albedo = max(albedo, rows[WALK_ALBEDO, c])
    exponent = 2.44294 - 0.0215813 * albedo + 0.578637 / albedo
    return 1.0 / math.sqrt(1.0 - albedo**exponent)


@kernel
def guided_fraction(g):
    """Probability with which one of the first steps is guided (Cycles' rule)."""
    return 1.0 - max(np.float32(0.5), abs(g) ** np.float32(0.125))


@kernel
def medium_of_step(g, guided, step):
    """Row of the extinction and mean cosine by which a step is drawn, and how likely it is guided.

    Parameters
    ----------
    g, guided : float32
        Those of the first steps.
    """
    if step > _LAST_UNEVEN:
        return WALK_REDUCED_EXTINCTION, np.float32(0.0), np.float32(0.75)
    return WALK_EXTINCTION, g, guided


@kernel
def walk_4(rng, sample, dimension, step):
    """Four numbers of a walk's step, as `track_4`; the first steps are all stratified."""
    if step < STRATIFIED_STEPS:
        return sample_4d(rng, sample, dimension + step * _STEP_SETS)
    return track_4(rng, sample, dimension, step)


@kernel
def pick_channel(channels, rows, u):
    """Draw the channel that draws the step, by what each has left and scatters; what is left of `u` is uniform again.

    Fills row WALK_CHANNEL.
    """
    total = np.float32(0.0)
    for c in range(len(channels)):
        weight = abs(rows[WALK_THROUGHPUT, c] * rows[WALK_ALBEDO, c])
        rows[WALK_CHANNEL, c] = weight
        total += weight
    inverse = 1.0 / total if total > 0.0 else np.float32(0.0)
    even = np.float32(0.0) if total > 0.0 else 1.0 / np.float32(len(channels))
    for c in range(len(channels)):
        rows[WALK_CHANNEL, c] = rows[WALK_CHANNEL, c] * inverse + even
    picked = 0
    for c in range(len(channels)):
        share = rows[WALK_CHANNEL, c]
        if share > 0.0:
            picked = c
            if u < share:
                u = u / share
                break
            u -= share
    return picked, min(max(u, 0.0), np.float32(0.9999999))


@kernel
def scatter_by_phase(direction, g, u1, u2):
    """Direction by Henyey and Greenstein's phase function, about where the walk was going."""
    cosine = 1.0 - 2.0 * u1
    if abs(g) > _ISOTROPIC:
        part = (1.0 - g * g) / (1.0 + g - 2.0 * g * u1)
        cosine = min(max((1.0 + g * g - part * part) / (2.0 * g), -1.0), 1.0)
    return direction_about(direction, cosine, u2)


@kernel
def direction_about(axis, cosine, u):
    """Unit direction that has this cosine with a unit axis."""
    sine = math.sqrt(max(0.0, 1.0 - cosine * cosine))
    x, y = orthonormal_basis(axis)
    # The second half of the turn is the first one's mirror image.
    is_second = u > 0.5
    up, along = sine_and_cosine(TWO_PI * (1.0 - u if is_second else u))
    across = add(scale(x, along), scale(y, -up if is_second else up))
    return add(scale(across, sine), scale(axis, cosine))


@kernel
def towards_surface(entry, u):
    """Cosine with the normal of a guided direction: Meng et al., Eq. (10)."""
    return entry.length - (entry.length + 1.0) * decay(u * entry.log_ratio)


@kernel
def towards_densities(entry, cosine):
    """Densities of `towards_surface` and of its mirror image, by solid angle [sr^-1]."""
    less, more = entry.length - cosine, entry.length + cosine
    both = _INV_TWO_PI / (less * more * entry.log_ratio)
    return both * more, both * less


@kernel
def backward_share(entry, p):
    """Part of the guided steps that go away from the surface that was entered, by how near the opposite one is."""
    if entry.opposite < 0.0:
        return np.float32(0.0)
    depth = dot((entry.p[0] - p[0], entry.p[1] - p[1], entry.p[2] - p[2]), entry.n)
    depth = min(max(depth, 0.0), entry.opposite)
    return 1.0 / (1.0 + math.exp((entry.opposite - 2.0 * depth) * entry.inverse_length))


class Ways(NamedTuple):
    """How likely a step's direction was, and its free paths how much stretched, in the ways that it could be drawn.

    Attributes
    ----------
    guided : float32, share of guided steps
    backward : float32, share of these that go away from the surface
    forward_ratio, backward_ratio : float32, density of guided directions over the phase function
    forward_stretch, backward_stretch : float32
    """

    guided: float
    backward: float
    forward_ratio: float
    backward_ratio: float
    forward_stretch: float
    backward_stretch: float


@kernel
def weigh_step(channels, rows, medium, distance, is_exit, ways):
    """Multiply the walk's throughput by a step's value over its density; returns the largest channel.

    Parameters
    ----------
    medium : int
        Row of the extinction; scattering follows.
    distance : float32 [m]
    is_exit : bool
        The step has left the medium before it would have scattered.
    ways : Ways
    """
    # Where the step ends inside, a path that is stretched ends as much more often.
    forward = ways.guided * (1.0 - ways.backward) * ways.forward_ratio
    back = ways.guided * ways.backward * ways.backward_ratio
    if not is_exit:
        forward *= ways.forward_stretch
        back *= ways.backward_stretch
    density = np.float32(0.0)
    for c in range(len(channels)):
        extinction = rows[medium, c]
        depth = extinction * distance
        plain = decay(depth)
        rows[WALK_HIT, c] = plain
        step = (1.0 - ways.guided) * plain
        if forward > 0.0:
            step += forward * decay(ways.forward_stretch * depth)
        if back > 0.0:
            step += back * decay(ways.backward_stretch * depth)
        if not is_exit:
            step *= extinction
        density += rows[WALK_CHANNEL, c] * step
    inverse = 1.0 / density if density > 0.0 else np.float32(0.0)
    largest = np.float32(0.0)
    for c in range(len(channels)):
        value = rows[WALK_HIT, c] * inverse
        if not is_exit:
            value *= rows[medium + 1, c]
        left = rows[WALK_THROUGHPUT, c] * value
        rows[WALK_THROUGHPUT, c] = left
        largest = max(largest, abs(left))
    return largest
