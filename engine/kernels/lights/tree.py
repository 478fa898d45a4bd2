# SPDX-License-Identifier: GPL-3.0-or-later
"""Picking an emitter: the light tree for those nearby, a short list for those at infinity.

Every choice is made in proportion to one estimate, the irradiance a receiver could get from what lies below a node
(`node_importance`) or from a distant emitter (`distant_importance`); sampling walks down, the probability of a given
emitter is found by walking up. `has_transmission` receivers count light from both sides.

References: Conty Estevez and Kulla 2018, "Importance Sampling of Many Lights with Adaptive Tree Splitting", Eq. (3).
"""

import math

import numpy as np

from engine.kernels.constants import ONE_MINUS_EPSILON
from engine.kernels.local import local_floats
from engine.runtime.jit import kernel
from engine.state.lights import (
    DISTANT_COS,
    DISTANT_DIRECTION,
    DISTANT_EMITTER,
    DISTANT_ENERGY,
    DISTANT_SIN,
    EMITTER_NODE,
    LINK_CHILD,
    LINK_COUNT,
    LINK_PARENT,
    NODE_AXIS,
    NODE_CENTER,
    NODE_COS_EMISSION,
    NODE_COS_NORMALS,
    NODE_ENERGY,
    NODE_HALF_SIZE,
    NODE_RADIUS,
    NODE_SIN_NORMALS,
    NODE_SPREAD,
    NODE_TWO_SIDED,
)

#: An int64, not a literal: each type of node index would compile `node_importance` again.
_ROOT = np.int64(0)


@kernel(forceinline=True)
def node_importance(nodes, k, p, n, has_transmission):
    """Irradiance at p, up to a constant, that node k may cause; 0 only where it causes none.

    Cosines are those of the most favourable point of the node's bounding sphere; the distance is the mean over its
    energy. All angles are kept as products of lengths with the distance D: sin theta_u = radius / D,
    cos theta = along / D and so on, so that one division serves all and square roots do not wait for each other.
    """
    dx = nodes[k, NODE_CENTER] - p[0]
    dy = nodes[k, NODE_CENTER + 1] - p[1]
    dz = nodes[k, NODE_CENTER + 2] - p[2]
    squared = dx * dx + dy * dy + dz * dz
    height = n[0] * dx + n[1] * dy + n[2] * dz
    reach = (
        abs(n[0]) * nodes[k, NODE_HALF_SIZE]
        + abs(n[1]) * nodes[k, NODE_HALF_SIZE + 1]
        + abs(n[2]) * nodes[k, NODE_HALF_SIZE + 2]
    )
    is_above = has_transmission or height + reach > 0.0
    height = abs(height) if has_transmission else height
    along = -(nodes[k, NODE_AXIS] * dx + nodes[k, NODE_AXIS + 1] * dy + nodes[k, NODE_AXIS + 2] * dz)
    along = abs(along) if nodes[k, NODE_TWO_SIDED] > 0.0 else along
    radius = nodes[k, NODE_RADIUS]
    tangent = math.sqrt(max(0.0, squared - radius * radius))
    across = math.sqrt(max(0.0, squared - along * along))
    beside = math.sqrt(max(0.0, squared - height * height))
    inverse = 1.0 / max(squared, 1e-30)

    # theta' = theta - theta_o - theta_u, between the receiver and the nearest normal of an emitter.
    nearest = (along * tangent + across * radius) * inverse
    nearest_sine = (across * tangent - along * radius) * inverse
    emitted = nearest * nodes[k, NODE_COS_NORMALS] + nearest_sine * nodes[k, NODE_SIN_NORMALS]
    is_lit = emitted > nodes[k, NODE_COS_EMISSION]
    is_inside = squared <= radius * radius
    faces = is_inside or along >= tangent or nearest >= nodes[k, NODE_COS_NORMALS]
    received = (height * tangent + beside * radius) * inverse
    overhead = is_inside or height >= tangent
    importance = nodes[k, NODE_ENERGY] / (squared + nodes[k, NODE_SPREAD] + 1e-20)
    importance *= 1.0 if faces else emitted
    importance *= 1.0 if overhead else max(0.0, received)
    return importance if is_above and (faces or is_lit) else 0.0


@kernel
def distant_importance(distant, k, n, has_transmission):
    """Irradiance a distant emitter may cause on a surface with normal n."""
    cosine = (
        n[0] * distant[k, DISTANT_DIRECTION]
        + n[1] * distant[k, DISTANT_DIRECTION + 1]
        + n[2] * distant[k, DISTANT_DIRECTION + 2]
    )
    if has_transmission:
        cosine = abs(cosine)
    cos_u = distant[k, DISTANT_COS]
    if cosine < cos_u:
        cosine = cosine * cos_u + math.sqrt(max(0.0, 1.0 - cosine * cosine)) * distant[k, DISTANT_SIN]
        return distant[k, DISTANT_ENERGY] * max(0.0, cosine)
    return distant[k, DISTANT_ENERGY]


@kernel
def _group_importances(nodes, distant, p, n, has_transmission):
    """Importance of the whole tree and of everything (local, total); (1, 1) if there is nothing distant."""
    distant_count = distant.shape[0]
    local = 0.0 * p[0]
    if nodes.shape[0] > 0:
        if distant_count == 0:
            return local + 1.0, local + 1.0
        local = node_importance(nodes, _ROOT, p, n, has_transmission)
    total = local
    for k in range(distant_count):
        total += distant_importance(distant, k, n, has_transmission)
    return local, total


@kernel(forceinline=True)
def pick_emitter(nodes, links, distant, p, n, has_transmission, u):
    """Choose an emitter for a receiver at p with unit normal n.

    Returns
    -------
    emitter : int, -1 where none can contribute
    pmf : float, its probability
    """
    local, total = _group_importances(nodes, distant, p, n, has_transmission)
    if not total > 0.0:
        return -1, 0.0 * local
    u = u * total
    if u >= local:
        # Rounding may leave nothing of u for the last one: keep the last that could be chosen.
        chosen = -1
        chosen_importance = 0.0 * local
        u -= local
        for k in range(distant.shape[0]):
            importance = distant_importance(distant, k, n, has_transmission)
            if importance > 0.0:
                chosen = int(distant[k, DISTANT_EMITTER])
                chosen_importance = importance
                if u < importance:
                    break
                u -= importance
        if chosen >= 0:
            return chosen, chosen_importance / total
        u = local
    u = min(u / local, ONE_MINUS_EPSILON)
    pmf = local / total
    importances = local_floats()
    node = _ROOT
    child = np.int64(links[node, LINK_CHILD])
    while child >= 0:
        # All importances first: none of them waits for another.
        count = links[node, LINK_COUNT]
        below = 0.0 * local
        for k in range(count):
            importance = node_importance(nodes, child + k, p, n, has_transmission)
            importances[k] = importance
            below += importance
        if not below > 0.0:
            return -1, below
        # The last that counts and begins at or before the target, so that rounding always leaves one.
        target = u * below
        begin = 0.0 * local
        chosen_importance = begin
        reached = begin
        for k in range(count):
            importance = importances[k]
            is_taken = importance > 0.0 and reached <= target
            node = child + k if is_taken else node
            begin = reached if is_taken else begin
            chosen_importance = importance if is_taken else chosen_importance
            reached += importance
        u = min((target - begin) / chosen_importance, ONE_MINUS_EPSILON)
        pmf *= chosen_importance / below
        child = np.int64(links[node, LINK_CHILD])
    return ~child, pmf


@kernel
def emitter_pmf(nodes, links, distant, emitters, emitter, p, n, has_transmission):
    """Probability that `pick_emitter` chooses `emitter` for this receiver."""
    local, total = _group_importances(nodes, distant, p, n, has_transmission)
    if not total > 0.0:
        return 0.0 * local
    node = np.int64(emitters[emitter, EMITTER_NODE])
    if node < 0:
        return distant_importance(distant, ~node, n, has_transmission) / total
    pmf = local / total
    while node > 0:
        parent = np.int64(links[node, LINK_PARENT])
        first = np.int64(links[parent, LINK_CHILD])
        mine = 0.0 * local
        below = mine
        for k in range(first, first + links[parent, LINK_COUNT]):
            importance = node_importance(nodes, k, p, n, has_transmission)
            below += importance
            if k == node:
                mine = importance
        if not mine > 0.0:
            return 0.0 * local
        pmf *= mine / below
        node = parent
    return pmf
