# SPDX-License-Identifier: GPL-3.0-or-later
"""Where along a segment within homogeneous media to look for the light of an emitter.

One candidate is drawn in equal steps of the angle under which the emitter sees the segment, another in equal steps of
what collides; one of the two is taken in proportion to what it would scatter if nothing hid the emitter. The estimate
is that of resampling, with the balance heuristic over both techniques. Emitters at infinity have the second candidate
only. More candidates make the noise no less, for what hides the emitter is not known to them.

References
----------
Kulla and Fajardo 2012, "Importance Sampling Techniques for Path Tracing in Participating Media", section 4.1.
Talbot, Cline and Egbert 2005, "Importance Resampling for Global Illumination", Eq. (6).
"""

import math

import numpy as np

from engine.kernels.bsdf.phase import PHASE_G, henyey_greenstein
from engine.kernels.constants import INV_FOUR_PI, ONE_MINUS_EPSILON
from engine.kernels.exponential import decay
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
        weight = abs(throughput[lane, c]) * coefficients[SCATTERING, c] * decay(extinction * start)
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
    extinction = coefficients[EXTINCTION, 0]
    total, others = coefficients[PROPOSAL_WEIGHT, 0], 0.0
    for c in range(1, len(channels)):
        if coefficients[EXTINCTION, c] == extinction:
            # One exponential does for all that are alike.
            total += coefficients[PROPOSAL_WEIGHT, c]
        else:
            others += coefficients[PROPOSAL_WEIGHT, c] * decay(coefficients[EXTINCTION, c] * distance)
    return total * decay(extinction * distance) + others


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
def _least_extinction(channels, coefficients):
    """Least extinction of the channels that are scattered [m^-1]."""
    least = coefficients[EXTINCTION, 0]
    for c in range(1, len(channels)):
        if coefficients[SCATTERING, c] > 0.0:
            least = min(least, coefficients[EXTINCTION, c])
    return least


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
        Coefficients of the media; see `weigh_distances` for the rows that are written.
    throughput : float32 (L, C)
    node : int
        Node of the emitter in the light tree, < 0: it is at infinity.
    fills_all : bool
        The media reach to the emitter.
    u_candidates, u_pick : float32 in [0, 1)

    Returns
    -------
    distance : float32 [m]
    weight : float32 [m], one over the density with which it was drawn, on the average; 0 = none
    """
    nodes, channels = lights.nodes, closures.channels
    none = 0.0 * length
    if node < 0:
        if not weigh_distances(channels, coefficients, throughput, lane, none, length) > 0.0:
            return none, none
        place = collision_distance(channels, coefficients, length, u_candidates)
        pdf = collision_pdf(channels, coefficients, place)
        return (place, 1.0 / pdf) if pdf > 0.0 else (none, none)
    start, end = lit_interval(nodes, node, origin, direction, length)
    if not end > start:
        return none, none
    reach = end - start
    if not weigh_distances(channels, coefficients, throughput, lane, start, reach) > 0.0:
        return none, none
    outer, inverse_span = emission_cone(nodes, node)
    offset = from_node(nodes, node, origin)
    along = -dot(offset, direction)
    spread = nodes[node // GROUP_SIZE, NODE_SPREAD, node % GROUP_SIZE]
    across = math.sqrt(max(dot(offset, offset) - along * along, 0.0) + spread)
    across = max(across, 1e-6 * (abs(along) + 1e-3))
    along -= start
    angle = subtended_angle(across, along, reach)
    # For what is lost between the point and the emitter one exponential does: nothing hangs on it but the choice.
    beyond = _least_extinction(channels, coefficients) if fills_all else none
    first = equiangular_distance(
        across, along, reach, math.sin(u_candidates * angle), math.cos(u_candidates * angle)
    )
    second = collision_distance(channels, coefficients, reach, u_candidates)
    places, targets, weights = local_floats(), local_floats(), local_floats()
    for k in range(2):
        place = first if k == 0 else second
        away = from_node(nodes, node, add(origin, scale(direction, start + place)))
        apart = math.sqrt(max(dot(away, away), 1e-20))
        # What collides is both what is proposed and, times a constant, what the segment scatters.
        pdf = collision_pdf(channels, coefficients, place)
        target = pdf * decay(beyond * apart) * emission_towards(nodes, node, away, apart, outer, inverse_span)
        target *= _phase_towards(closures, lane, -dot(direction, away) / apart)
        pdf += equiangular_pdf(across, along, angle, place)
        places[k] = place
        targets[k] = target
        weights[k] = target / pdf if pdf > 0.0 else 0.0
    total = weights[0] + weights[1]
    if not total > 0.0:
        return none, none
    chosen = 1 if weights[1] > 0.0 and u_pick * total >= weights[0] else 0
    return start + places[chosen], total / targets[chosen]
