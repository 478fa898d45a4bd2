# SPDX-License-Identifier: GPL-3.0-or-later
"""Where along a segment within homogeneous media to look for the light of an emitter.

Candidates are drawn in equal steps of the angle under which the emitter sees the segment, and in equal steps of what
collides; one of them is taken in proportion to what it would scatter if nothing hid the emitter. The estimate is that
of resampling, with the balance heuristic over both techniques.

References
----------
Kulla and Fajardo 2012, "Importance Sampling Techniques for Path Tracing in Participating Media", section 4.1.
Talbot, Cline and Egbert 2005, "Importance Resampling for Global Illumination", Eq. (6).
"""

import math

import numpy as np

from engine.kernels.bsdf.phase import PHASE_G, henyey_greenstein
from engine.kernels.constants import INV_FOUR_PI, ONE_MINUS_EPSILON
from engine.kernels.lights.segments import (
    emission_cone,
    emission_towards,
    from_node,
    lit_interval,
    subtended_angle,
)
from engine.kernels.local import local_floats
from engine.kernels.media import emitted_length
from engine.kernels.vector import add, dot, scale
from engine.runtime.jit import kernel
from engine.state.lanes import CLOSURE_SAMPLE_WEIGHT
from engine.state.lights import GROUP_SIZE, NODE_SPREAD
from engine.state.media import EXTINCTION, PROPOSAL_WEIGHT, SCATTERING, SEEN_LENGTH

#: Candidates by angle; as many by collisions. Emitters at infinity have the latter only. More of them make the noise no
#: less: what hides the emitter is not known to them.
CANDIDATES = 2
#: Mean cosines beyond which a phase function is smoothed, and the share that is the same everywhere: what resamples
#: sees the emitter's centre only.
_LARGEST_G = np.float32(0.8)
_EVEN_SHARE = np.float32(0.1)


@kernel
def equiangular_distance(across, along, length, sine, cosine):
    """Distance [m] from where a segment begins, behind an angle of this sine and cosine; see `subtended_angle`."""
    distance = (along * along + across * across) * sine / max(across * cosine + along * sine, 1e-30)
    return min(max(distance, 0.0), length)


@kernel
def equiangular_pdf(across, along, angle, distance):
    """Density [m^-1] of distances in equal steps of the angle; `angle` [rad] is that of the whole segment."""
    beside = distance - along
    return across / (angle * (across * across + beside * beside))


@kernel
def weigh_distances(channels, coefficients, throughput, lane, start, length):
    """Set up the densities of a stretch of media: what each channel scatters of it, and how often it proposes.

    Fills rows PROPOSAL_WEIGHT and SEEN_LENGTH of `coefficients`; the density of a distance from `start` is the first's
    sum over the channels, each times its transmittance.

    Returns
    -------
    float32
        The sum of all weights, 0: nothing is scattered.
    """
    total = 0.0
    for c in range(len(channels)):
        extinction = coefficients[EXTINCTION, c]
        weight = abs(throughput[lane, c]) * coefficients[SCATTERING, c] * math.exp(-extinction * start)
        coefficients[PROPOSAL_WEIGHT, c] = weight
        coefficients[SEEN_LENGTH, c] = emitted_length(extinction, length)
        total += weight * coefficients[SEEN_LENGTH, c]
    for c in range(len(channels)):
        coefficients[PROPOSAL_WEIGHT, c] *= 1.0 / total if total > 0.0 else 0.0
    return total


@kernel
def collision_distance(channels, coefficients, length, u):
    """Distance [m] in equal steps of what collides; its density is `collision_pdf`."""
    last = len(channels) - 1
    chosen = last
    for c in range(last):
        share = coefficients[PROPOSAL_WEIGHT, c] * coefficients[SEEN_LENGTH, c]
        if chosen == last and u < share:
            chosen = c
            u = u / share
        elif chosen == last:
            u = u - share
    extinction = coefficients[EXTINCTION, chosen]
    if chosen == last:
        share = coefficients[PROPOSAL_WEIGHT, last] * coefficients[SEEN_LENGTH, last]
        u = u / share if share > 0.0 else 0.0
    u = min(max(u, 0.0), ONE_MINUS_EPSILON)
    if not extinction > 0.0:
        return u * length
    return min(-math.log1p(-u * extinction * coefficients[SEEN_LENGTH, chosen]) / extinction, length)


@kernel
def collision_pdf(channels, coefficients, distance):
    """Density [m^-1] of `collision_distance`."""
    return _dimmed(channels, coefficients, PROPOSAL_WEIGHT, distance, _is_grey(channels, coefficients))


@kernel
def _is_grey(channels, coefficients):
    """Whether all channels have the same extinction: one exponential does for them."""
    is_grey = True
    for c in range(1, len(channels)):
        is_grey = is_grey and coefficients[EXTINCTION, c] == coefficients[EXTINCTION, 0]
    return is_grey


@kernel
def _dimmed(channels, coefficients, row, distance, is_grey):
    """Sum over the channels of a row of weights, each times its transmittance."""
    total = 0.0
    if is_grey:
        for c in range(len(channels)):
            total += coefficients[row, c]
        return total * math.exp(-coefficients[EXTINCTION, 0] * distance)
    for c in range(len(channels)):
        total += coefficients[row, c] * math.exp(-coefficients[EXTINCTION, c] * distance)
    return total


@kernel
def _phase_towards(closures, lane, cosine):
    """What a lane's phase functions scatter by an angle of this cosine, smoothed; see `_LARGEST_G`."""
    value = _EVEN_SHARE * INV_FOUR_PI
    for i in range(closures.count[lane]):
        g = min(max(closures.param[lane, i, PHASE_G], -_LARGEST_G), _LARGEST_G)
        weight = closures.param[lane, i, CLOSURE_SAMPLE_WEIGHT]
        value += (1.0 - _EVEN_SHARE) * weight * henyey_greenstein(cosine, g)
    return value


@kernel
def choose_distance(
    lights, closures, coefficients, throughput, lane, node, origin, direction, length, fills_all, u_candidates, u_pick,
):
    """Draw where light of an emitter is scattered towards the start of a segment.

    Parameters
    ----------
    lights : LightArrays
    closures : Closures
        The lane's phase functions.
    coefficients : float32 (COEFFICIENT_ROWS, channels)
        Of the media; see `weigh_distances` for the rows that are written.
    throughput : float32 (L, C)
    node : int
        Of the emitter in the light tree, < 0: it is at infinity.
    fills_all : bool
        The media reach to the emitter.
    u_candidates, u_pick : float32 in [0, 1)

    Returns
    -------
    distance : float32 [m]
    weight : float32 [m], one over the density with which it was drawn, on the average; 0 = none
    """
    nodes, channels = lights.nodes, closures.channels
    start = 0.0 * length
    end = length
    across = 1.0 + start
    along = start
    by_angle = 0
    outer, inverse_span = start, start
    if node >= 0:
        outer, inverse_span = emission_cone(nodes, node)
        start, end = lit_interval(nodes, node, origin, direction, length)
        if not end > start:
            return start, 0.0 * start
        offset = from_node(nodes, node, origin)
        along = -dot(offset, direction)
        spread = nodes[node // GROUP_SIZE, NODE_SPREAD, node % GROUP_SIZE]
        across = math.sqrt(max(dot(offset, offset) - along * along, 0.0) + spread)
        across = max(across, 1e-6 * (abs(along) + 1e-3))
        along -= start
        by_angle = CANDIDATES
    reach = end - start
    if not weigh_distances(channels, coefficients, throughput, lane, start, reach) > 0.0:
        return start, 0.0 * start
    count = by_angle + CANDIDATES
    places, targets, weights = local_floats(), local_floats(), local_floats()
    step = 1.0 / np.float32(CANDIDATES)
    is_grey = _is_grey(channels, coefficients)
    angle = subtended_angle(across, along, reach)
    # The angle of a candidate, turned on from one to the next.
    sine, cosine = math.sin(u_candidates * step * angle), math.cos(u_candidates * step * angle)
    turn_sine, turn_cosine = math.sin(step * angle), math.cos(step * angle)
    total = 0.0
    for k in range(count):
        if k < by_angle:
            place = equiangular_distance(across, along, reach, sine, cosine)
            sine, cosine = sine * turn_cosine + cosine * turn_sine, cosine * turn_cosine - sine * turn_sine
        else:
            u = (np.float32(k - by_angle) + u_candidates) * step
            place = collision_distance(channels, coefficients, reach, min(u, ONE_MINUS_EPSILON))
        # What collides is both what is proposed and, times a constant, what the segment scatters.
        pdf = _dimmed(channels, coefficients, PROPOSAL_WEIGHT, place, is_grey)
        target = pdf
        if by_angle > 0:
            pdf += equiangular_pdf(across, along, angle, place)
            p = add(origin, scale(direction, start + place))
            away = from_node(nodes, node, p)
            apart = math.sqrt(max(dot(away, away), 1e-20))
            if fills_all:
                target = _dimmed(channels, coefficients, PROPOSAL_WEIGHT, place + apart, is_grey)
            target *= emission_towards(nodes, node, away, apart, outer, inverse_span)
            target *= _phase_towards(closures, lane, -dot(direction, away) / apart)
        pdf *= np.float32(CANDIDATES)
        places[k] = place
        targets[k] = target
        weight = target / pdf if pdf > 0.0 else 0.0
        weights[k] = weight
        total += weight
    if not total > 0.0:
        return start, 0.0 * start
    rest = u_pick * total
    chosen = -1
    for k in range(count):
        if weights[k] > 0.0 and (chosen < 0 or rest >= 0.0):
            chosen = k
        rest -= weights[k]
    return start + places[chosen], total / targets[chosen]
