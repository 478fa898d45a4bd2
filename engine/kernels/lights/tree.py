# SPDX-License-Identifier: GPL-3.0-or-later
"""Picking an emitter: the light tree for those nearby, a short list for those at infinity.

Every choice is made in proportion to one estimate, the irradiance a receiver could get from what lies below a node
(`group_importances`) or from a distant emitter (`distant_importance`); sampling walks down, the probability of a given
emitter is found by walking up. Both take the importances of a whole group at once.
`has_transmission` receivers count light from both sides.

Regions that have learned which lights they see choose a cluster by what they know (`LightSelection`), and an emitter
below it by the tree. `row` is what `selection_row` says of the receiver: both directions must use the same.

References: Conty Estevez and Kulla 2018, "Importance Sampling of Many Lights with Adaptive Tree Splitting", Eq. (3);
Vevoda, Kondapaneni and Krivanek 2018, "Bayesian Online Regression for Adaptive Direct Illumination Sampling".
"""

import math

import numpy as np

from engine.kernels.binary_tree import locate_leaf
from engine.kernels.constants import FLOAT_MAX, ONE_MINUS_EPSILON
from engine.kernels.eight import absolute, at, choose, last_of, load_eight, root, store_eight, sums_before
from engine.kernels.lights.linking import background_emitter, is_linked, tree_of_emitter, tree_range
from engine.runtime.jit import kernel
from engine.state.lanes import (
    DRAW_EMITTER,
    DRAW_IMPORTANCE,
    DRAW_N,
    DRAW_P,
    DRAW_PMF,
    DRAW_TRANSMITS,
    DRAW_U_PICK,
    DRAW_WIDTH,
)
from engine.state.lights import (
    DISTANT_COS,
    DISTANT_DIRECTION,
    DISTANT_EMITTER,
    DISTANT_ENERGY,
    DISTANT_SIN,
    EMITTER_NODE,
    GROUP_SIZE,
    HEADER_CUT,
    HEADER_FIRST_PATCH,
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

# Nodes of a group: int64, not literals, since each type of index would compile `group_importances` again.
_ROOT = np.int64(0)
_LAST = np.int64(GROUP_SIZE - 1)


@kernel
def _importances(node, p, n, has_transmission):
    """`group_importances` of one node at eight receivers, or of eight nodes at one.

    Cosines are those of the most favourable point of a node's bounding sphere; the distance is the mean over its
    energy. All angles are kept as products of lengths with the distance D: sin theta_u = radius / D,
    cos theta = along / D and so on, so that one division serves all and square roots do not wait for each other.

    Parameters
    ----------
    node : tuple, columns of `LightArrays.nodes` in the order in which `_node` gives them
    """
    center, half_size, axis, radius, cos_normals, sin_normals, cos_emission, two_sided, energy, spread = node
    dx = center[0] - p[0]
    dy = center[1] - p[1]
    dz = center[2] - p[2]
    squared = dx * dx + dy * dy + dz * dz
    height = n[0] * dx + n[1] * dy + n[2] * dz
    reach = absolute(n[0]) * half_size[0] + absolute(n[1]) * half_size[1] + absolute(n[2]) * half_size[2]
    is_above = height + reach > choose(has_transmission, -FLOAT_MAX, 0.0)
    height = choose(has_transmission, absolute(height), height)
    along = axis[0] * dx + axis[1] * dy + axis[2] * dz
    along = choose(two_sided > 0.0, absolute(along), 0.0 - along)
    tangent = root(squared - radius * radius)
    across = root(squared - along * along)
    beside = root(squared - height * height)
    inverse = 1.0 / choose(squared > 1e-30, squared, 1e-30)

    # theta' = theta - theta_o - theta_u, between the receiver and the nearest normal of an emitter.
    nearest = (along * tangent + across * radius) * inverse
    nearest_sine = (across * tangent - along * radius) * inverse
    emitted = nearest * cos_normals + nearest_sine * sin_normals
    is_lit = emitted > cos_emission
    is_inside = squared <= radius * radius
    faces = is_inside | (along >= tangent) | (nearest >= cos_normals)
    received = (height * tangent + beside * radius) * inverse
    overhead = is_inside | (height >= tangent)
    importance = energy / (squared + spread + 1e-20)
    importance = importance * choose(faces, 1.0, emitted)
    importance = importance * choose(overhead, 1.0, choose(received > 0.0, received, 0.0))
    return choose(is_above & (faces | is_lit), importance, 0.0)


@kernel
def group_importances(nodes, group, p, n, has_transmission):
    """Irradiance at p, up to a constant, that each node of a group may cause; 0 only where it causes none."""
    node = (
        _three(nodes, group, NODE_CENTER),
        _three(nodes, group, NODE_HALF_SIZE),
        _three(nodes, group, NODE_AXIS),
        load_eight(nodes, group, NODE_RADIUS),
        load_eight(nodes, group, NODE_COS_NORMALS),
        load_eight(nodes, group, NODE_SIN_NORMALS),
        load_eight(nodes, group, NODE_COS_EMISSION),
        load_eight(nodes, group, NODE_TWO_SIDED),
        load_eight(nodes, group, NODE_ENERGY),
        load_eight(nodes, group, NODE_SPREAD),
    )
    return _importances(node, p, n, has_transmission)


@kernel
def _three(rows, group, column):
    """Three columns in a row, eight floats each."""
    return load_eight(rows, group, column), load_eight(rows, group, column + 1), load_eight(rows, group, column + 2)


@kernel
def _node(nodes, group, k):
    """Node `k` of a group, for `_importances`."""
    return (
        (nodes[group, NODE_CENTER, k], nodes[group, NODE_CENTER + 1, k], nodes[group, NODE_CENTER + 2, k]),
        (nodes[group, NODE_HALF_SIZE, k], nodes[group, NODE_HALF_SIZE + 1, k], nodes[group, NODE_HALF_SIZE + 2, k]),
        (nodes[group, NODE_AXIS, k], nodes[group, NODE_AXIS + 1, k], nodes[group, NODE_AXIS + 2, k]),
        nodes[group, NODE_RADIUS, k],
        nodes[group, NODE_COS_NORMALS, k],
        nodes[group, NODE_SIN_NORMALS, k],
        nodes[group, NODE_COS_EMISSION, k],
        nodes[group, NODE_TWO_SIDED, k],
        nodes[group, NODE_ENERGY, k],
        nodes[group, NODE_SPREAD, k],
    )


@kernel
def _share_of(lights, node, p, n, has_transmission):
    """Probability with which a node is chosen among those of its group."""
    importances = group_importances(lights.nodes, node // GROUP_SIZE, p, n, has_transmission)
    mine = at(importances, node % GROUP_SIZE)
    if not mine > 0.0:
        return 0.0 * mine
    return mine / (at(sums_before(importances), _LAST) + at(importances, _LAST))


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
def _local_and_total(lights, tree, p, n, has_transmission):
    """Importance of a whole tree and of everything in it (local, total); (1, 1) if there is nothing distant."""
    group, first, last = tree_range(lights, tree)
    local = 0.0 * p[0]
    if group >= 0:
        if first == last:
            return local + 1.0, local + 1.0
        local = at(group_importances(lights.nodes, group, p, n, has_transmission), _ROOT)
    total = local
    for k in range(first, last):
        total += distant_importance(lights.distant, k, n, has_transmission)
    return local, total


@kernel
def selection_row(lights, tree, p):
    """Row of `LightSelection.cumulative` of the region that holds p and of a light tree; -1: it chooses by the tree."""
    selection = lights.selection
    if selection.cumulative.shape[0] == 0:
        return np.int64(-1)
    leaf = locate_leaf(selection, p)
    if leaf < 0:
        return np.int64(-1)
    row = np.int64(selection.table[leaf])
    if is_linked(lights) and row >= 0:
        row = row * lights.links.trees.shape[0] + tree
    return row


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
def _pick_group(lights, tree, p, n, has_transmission, u):
    """Choose between the nodes of a light tree and what is distant.

    Returns the emitter (-1: none, or one below the root), the probability of it or of the tree, and what is left of u.
    """
    distant = lights.distant
    local, total = _local_and_total(lights, tree, p, n, has_transmission)
    if not total > 0.0:
        return -1, 0.0 * local, u
    u = u * total
    if u >= local:
        # Rounding may leave nothing of u for the last one: keep the last that could be chosen.
        chosen = -1
        chosen_importance = 0.0 * local
        u -= local
        _, first, last = tree_range(lights, tree)
        for k in range(first, last):
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
def pick_emitter(lights, row, tree, p, n, has_transmission, u):
    """Choose an emitter of a light tree for a receiver at p with unit normal n.

    Returns
    -------
    emitter : int, -1 where none can contribute
    pmf : float, its probability; of the background that of the patch
    patch : int, cluster of the background in which to draw a direction, -1: anywhere
    """
    nodes, children = lights.nodes, lights.child
    if row >= 0:
        cluster, pmf, u = _pick_cluster(lights, row, u)
        if cluster >= lights.header[HEADER_CUT]:
            if cluster >= lights.header[HEADER_FIRST_PATCH]:
                return background_emitter(lights, tree), pmf, cluster
            return np.int64(lights.distant[cluster - lights.header[HEADER_CUT], DISTANT_EMITTER]), pmf, np.int64(-1)
        node = np.int64(lights.cluster_node[cluster])
    else:
        emitter, pmf, u = _pick_group(lights, tree, p, n, has_transmission, u)
        if emitter >= 0 or not pmf > 0.0:
            return np.int64(emitter), pmf, np.int64(-1)
        node = tree_range(lights, tree)[0] * GROUP_SIZE
    group = np.int64(children[node // GROUP_SIZE, node % GROUP_SIZE])
    while group >= 0:
        importances = group_importances(nodes, group, p, n, has_transmission)
        before = sums_before(importances)
        total = at(before, _LAST) + at(importances, _LAST)
        if not total > 0.0:
            return np.int64(-1), total, np.int64(-1)
        # The last that counts and begins at or before the target, so that rounding always leaves one.
        target = u * total
        chosen = last_of((importances > 0.0) & (before <= target))
        if chosen < 0:
            # Only of a total that is infinite.
            return np.int64(-1), 0.0 * u, np.int64(-1)
        importance = at(importances, chosen)
        u = min((target - at(before, chosen)) / importance, ONE_MINUS_EPSILON)
        pmf *= importance / total
        group = np.int64(children[group, chosen])
    return ~group, pmf, np.int64(-1)


@kernel
def group_of_few(lights):
    """The group whose nodes are all emitters that there are, at most eight and none at infinity; -1: there are more,
    or regions have learned what to choose.
    """
    if lights.selection.cumulative.shape[0] > 0 or lights.distant.shape[0] > 0 or lights.nodes.shape[0] == 0:
        return np.int64(-1)
    if is_linked(lights):
        return np.int64(-1)
    group = np.int64(lights.child[_ROOT, _ROOT])
    if group < 0:
        return np.int64(-1)
    for k in range(GROUP_SIZE):
        if lights.child[group, k] >= 0 and lights.nodes[group, NODE_ENERGY, k] > 0.0:
            return np.int64(-1)
    return group


@kernel
def pick_among_few(lights, group, draws):
    """`pick_emitter` for the receivers at all eight places of a `LightDraws`, of which the root's is the only group.

    What follows, for the emitters that there are, is what `pick_emitter` does for one receiver and all emitters.
    """
    real, numbers, nodes = draws.real, draws.integer, lights.nodes
    p, n = _three(real, _ROOT, DRAW_P), _three(real, _ROOT, DRAW_N)
    has_transmission = load_eight(real, _ROOT, DRAW_TRANSMITS) > 0.0
    total = 0.0 * p[0]
    for k in range(GROUP_SIZE):
        if nodes[group, NODE_ENERGY, k] > 0.0:
            importance = _importances(_node(nodes, group, k), p, n, has_transmission)
            store_eight(real, _ROOT, DRAW_IMPORTANCE + k, importance)
            total = total + importance
    target = load_eight(real, _ROOT, DRAW_U_PICK) * total
    before = 0.0 * total
    chosen = before - 1.0
    chosen_importance = before
    for k in range(GROUP_SIZE):
        if nodes[group, NODE_ENERGY, k] > 0.0:
            importance = load_eight(real, _ROOT, DRAW_IMPORTANCE + k)
            is_reached = (importance > 0.0) & (before <= target)
            chosen = choose(is_reached, np.float32(k), chosen)
            chosen_importance = choose(is_reached, importance, chosen_importance)
            before = before + importance
    store_eight(real, _ROOT, DRAW_PMF, chosen_importance / choose(total > 0.0, total, 1.0))
    for place in range(DRAW_WIDTH):
        k = int(at(chosen, np.int64(place)))
        numbers[DRAW_EMITTER, place] = ~np.int64(lights.child[group, k]) if k >= 0 else -1


@kernel
def emitter_pmf(lights, row, emitter, p, n, has_transmission):
    """Probability that `pick_emitter` chooses `emitter` for this receiver; not for the background of a region that
    chooses among its patches (`row` >= 0)."""
    distant = lights.distant
    node = np.int64(lights.emitters[emitter, EMITTER_NODE])
    pmf = 0.0 * p[0] + 1.0
    if row >= 0:
        if node < 0:
            return cluster_pmf(lights, row, lights.header[HEADER_CUT] + ~node)
    else:
        local, total = _local_and_total(lights, tree_of_emitter(lights, emitter), p, n, has_transmission)
        if not total > 0.0:
            return 0.0 * local
        if node < 0:
            return distant_importance(distant, ~node, n, has_transmission) / total
        pmf = local / total
    while pmf > 0.0:
        above = np.int64(lights.parent[node // GROUP_SIZE])
        if above < 0 or (row >= 0 and lights.node_cluster[node] >= 0):
            break
        pmf *= _share_of(lights, node, p, n, has_transmission)
        node = above
    if row >= 0 and pmf > 0.0:
        pmf *= cluster_pmf(lights, row, lights.node_cluster[node])
    return pmf


@kernel
def tree_choice(lights, emitter, cluster, p, n, has_transmission):
    """Probability with which the light tree alone would choose the cluster that an emitter is in: float.

    Parameters
    ----------
    cluster : int, as `cluster_of` says
    """
    local, total = _local_and_total(lights, tree_of_emitter(lights, emitter), p, n, has_transmission)
    if not total > 0.0:
        return 0.0 * local
    if cluster >= lights.header[HEADER_CUT]:
        distant = ~np.int64(lights.emitters[emitter, EMITTER_NODE])
        importance = distant_importance(lights.distant, distant, n, has_transmission)
        return importance / total * lights.cluster_share[cluster]
    node = np.int64(lights.cluster_node[cluster])
    pmf = local / total
    while pmf > 0.0:
        above = np.int64(lights.parent[node // GROUP_SIZE])
        if above < 0:
            break
        pmf *= _share_of(lights, node, p, n, has_transmission)
        node = above
    return pmf


@kernel
def cluster_of(lights, emitter, patch, pmf, p, n, has_transmission):
    """The cluster that an emitter is in, and the probability with which it was chosen on the way to the emitter.

    Parameters
    ----------
    patch : int, cluster of the direction, if the emitter is the background
    pmf : float, with which `pick_emitter` has chosen the emitter by the light tree

    Returns
    -------
    cluster : int
    pmf : float
    """
    node = np.int64(lights.emitters[emitter, EMITTER_NODE])
    if node < 0:
        cluster = np.int64(patch) if patch >= 0 else np.int64(lights.header[HEADER_CUT] + ~node)
        return cluster, pmf * lights.cluster_share[cluster]
    while lights.node_cluster[node] < 0:
        share = _share_of(lights, node, p, n, has_transmission)
        pmf = pmf / share if share > 0.0 else 0.0 * pmf
        node = np.int64(lights.parent[node // GROUP_SIZE])
    return np.int64(lights.node_cluster[node]), pmf
