# SPDX-License-Identifier: GPL-3.0-or-later
"""Picking an emitter: the light tree for those nearby, a short list for those at infinity.

Every choice is made in proportion to one estimate, the irradiance a receiver could get from what lies below a node
(`node_importance`) or from a distant emitter (`distant_importance`); sampling walks down, the probability of a given
emitter is found by walking up. `has_transmission` receivers count light from both sides.

Regions that have learned which lights they see choose a cluster by what they know (`LightSelection`), and an emitter
below it by the tree. `row` is what `selection_row` says of the receiver: both directions must use the same.

References: Conty Estevez and Kulla 2018, "Importance Sampling of Many Lights with Adaptive Tree Splitting", Eq. (3);
Vevoda, Kondapaneni and Krivanek 2018, "Bayesian Online Regression for Adaptive Direct Illumination Sampling".
"""

import math

import numpy as np

from engine.kernels.binary_tree import locate_leaf
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
    HEADER_BACKGROUND_EMITTER,
    HEADER_CUT,
    HEADER_FIRST_PATCH,
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


@kernel
def selection_row(lights, p):
    """Row of `LightSelection.cumulative` of the region that holds p, -1: it chooses by the light tree."""
    selection = lights.selection
    if selection.cumulative.shape[0] == 0:
        return np.int64(-1)
    leaf = locate_leaf(selection, p)
    if leaf < 0:
        return np.int64(-1)
    return np.int64(selection.table[leaf])


@kernel
def cluster_pmf(lights, row, cluster):
    """Probability with which a region chooses a cluster."""
    cumulative = lights.selection.cumulative
    return cumulative[row, cluster + 1] - cumulative[row, cluster]


@kernel
def _pick_cluster(lights, row, u):
    """Cluster that a region chooses, its probability, and a number that is uniform again."""
    cumulative = lights.selection.cumulative
    low = np.int64(0)
    high = np.int64(cumulative.shape[1] - 1)
    while high - low > 1:
        middle = (low + high) >> 1
        if cumulative[row, middle] <= u:
            low = middle
        else:
            high = middle
    begin = cumulative[row, low]
    pmf = cumulative[row, low + 1] - begin
    if not pmf > 0.0:
        return low, 0.0 * u, u
    return low, pmf, min((u - begin) / pmf, ONE_MINUS_EPSILON)


@kernel
def _pick_group(lights, p, n, has_transmission, u):
    """Choose between the light tree and what is distant.

    Returns the emitter (-1: none, or one below the root), the probability of it or of the tree, and what is left of u.
    """
    distant = lights.distant
    local, total = _group_importances(lights.nodes, distant, p, n, has_transmission)
    if not total > 0.0:
        return -1, 0.0 * local, u
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
            return chosen, chosen_importance / total, u
        u = local
    return -1, local / total, min(u / local, ONE_MINUS_EPSILON)


@kernel(forceinline=True)
def pick_emitter(lights, row, p, n, has_transmission, u):
    """Choose an emitter for a receiver at p with unit normal n.

    Returns
    -------
    emitter : int, -1 where none can contribute
    pmf : float, its probability; of the background that of the patch
    patch : int, cluster of the background in which to draw a direction, -1: anywhere
    """
    nodes, links = lights.nodes, lights.links
    node = _ROOT
    if row >= 0:
        cluster, pmf, u = _pick_cluster(lights, row, u)
        if cluster >= lights.header[HEADER_CUT]:
            if cluster >= lights.header[HEADER_FIRST_PATCH]:
                return np.int64(lights.header[HEADER_BACKGROUND_EMITTER]), pmf, cluster
            return np.int64(lights.distant[cluster - lights.header[HEADER_CUT], DISTANT_EMITTER]), pmf, np.int64(-1)
        node = np.int64(lights.cluster_node[cluster])
    else:
        emitter, pmf, u = _pick_group(lights, p, n, has_transmission, u)
        if emitter >= 0 or not pmf > 0.0:
            return np.int64(emitter), pmf, np.int64(-1)
    importances = local_floats()
    child = np.int64(links[node, LINK_CHILD])
    while child >= 0:
        # All importances first: none of them waits for another.
        count = links[node, LINK_COUNT]
        below = 0.0 * pmf
        for k in range(count):
            importance = node_importance(nodes, child + k, p, n, has_transmission)
            importances[k] = importance
            below += importance
        if not below > 0.0:
            return np.int64(-1), below, np.int64(-1)
        # The last that counts and begins at or before the target, so that rounding always leaves one.
        target = u * below
        begin = 0.0 * pmf
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
    return ~child, pmf, np.int64(-1)


@kernel
def emitter_pmf(lights, row, emitter, p, n, has_transmission):
    """Probability that `pick_emitter` chooses `emitter` for this receiver; not for the background of a region that
    chooses among its patches (`row` >= 0)."""
    nodes, links, distant = lights.nodes, lights.links, lights.distant
    node = np.int64(lights.emitters[emitter, EMITTER_NODE])
    pmf = 0.0 * p[0] + 1.0
    if row >= 0:
        if node < 0:
            return cluster_pmf(lights, row, lights.header[HEADER_CUT] + ~node)
    else:
        local, total = _group_importances(nodes, distant, p, n, has_transmission)
        if not total > 0.0:
            return 0.0 * local
        if node < 0:
            return distant_importance(distant, ~node, n, has_transmission) / total
        pmf = local / total
    while node > 0:
        if row >= 0 and lights.node_cluster[node] >= 0:
            break
        parent = np.int64(links[node, LINK_PARENT])
        first = np.int64(links[parent, LINK_CHILD])
        mine = 0.0 * pmf
        below = mine
        for k in range(first, first + links[parent, LINK_COUNT]):
            importance = node_importance(nodes, k, p, n, has_transmission)
            below += importance
            if k == node:
                mine = importance
        if not mine > 0.0:
            return 0.0 * pmf
        pmf *= mine / below
        node = parent
    if row >= 0:
        pmf *= cluster_pmf(lights, row, lights.node_cluster[node])
    return pmf


@kernel
def tree_choice(lights, emitter, patch, p, n, has_transmission):
    """The cluster that an emitter is in, and with which probability the light tree alone would choose it.

    Parameters
    ----------
    patch : int, cluster of the direction, if the emitter is the background

    Returns
    -------
    cluster : int
    pmf : float
    """
    links = lights.links
    local, total = _group_importances(lights.nodes, lights.distant, p, n, has_transmission)
    if not total > 0.0:
        return np.int64(-1), 0.0 * local
    node = np.int64(lights.emitters[emitter, EMITTER_NODE])
    if node < 0:
        cluster = np.int64(patch) if patch >= 0 else np.int64(lights.header[HEADER_CUT] + ~node)
        importance = distant_importance(lights.distant, ~node, n, has_transmission)
        return cluster, importance / total * lights.cluster_share[cluster]
    while lights.node_cluster[node] < 0:
        node = np.int64(links[node, LINK_PARENT])
    cluster = np.int64(lights.node_cluster[node])
    pmf = local / total
    while node > 0:
        parent = np.int64(links[node, LINK_PARENT])
        first = np.int64(links[parent, LINK_CHILD])
        mine = 0.0 * local
        below = mine
        for k in range(first, first + links[parent, LINK_COUNT]):
            importance = node_importance(lights.nodes, k, p, n, has_transmission)
            below += importance
            if k == node:
                mine = importance
        if not mine > 0.0:
            return cluster, 0.0 * local
        pmf *= mine / below
        node = parent
    return cluster, pmf
