# SPDX-License-Identifier: GPL-3.0-or-later
"""Building the light tree over local emitters: groups of eight nodes with bounds on where and how strongly they shine.

A group's emitters are divided in two until there are eight parts, the strongest and widest part first, each by the
surface area orientation heuristic over binned centroids. Parts of several emitters get a group of their own. Bounds are
merged bottom-up. Groups know the node above them, so the probability of an emitter is found by walking up from its
leaf.

References: Conty Estevez and Kulla 2018, "Importance Sampling of Many Lights with Adaptive Tree Splitting", section 4;
two-sided cones as in PBRT-4, section 12.6.3.
"""

from __future__ import annotations

import math

import numpy as np

from engine.array_types import Float32Array, Int32Array
from engine.runtime.jit import kernel
from engine.state.lights import (
    GROUP_SIZE,
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
    NODE_WIDTH,
)

# Columns of the per-emitter bounds that `build_tree` takes.
BOUNDS_LOWER = 0
BOUNDS_UPPER = 3
BOUNDS_ENERGY = 6
BOUNDS_AXIS = 7
BOUNDS_NORMALS = 10  # theta_o [rad]
BOUNDS_EMISSION = 11  # theta_e [rad]
BOUNDS_TWO_SIDED = 12
BOUNDS_SPREAD = 13
#: Squared radius of a sphere around the centre of the box; 0 = half the diagonal of the box.
BOUNDS_RADIUS_SQUARED = 14
BOUNDS_WIDTH = 16

_BIN_COUNT = 12


@kernel
def _box_measure(bins, axis, k):
    """Surface area of a bin's box; its diagonal where it is flat in two dimensions."""
    dx = bins[axis, k, 3] - bins[axis, k, 0]
    dy = bins[axis, k, 4] - bins[axis, k, 1]
    dz = bins[axis, k, 5] - bins[axis, k, 2]
    if dx < 0.0:
        return 0.0 * dx
    area = 2.0 * (dx * dy + dy * dz + dz * dx)
    if area > 0.0:
        return area
    return math.sqrt(dx * dx + dy * dy + dz * dz)


@kernel
def _cost(bins, axis, k):
    """Energy x area x orientation of a bin.

    The orientation measure runs from pi (all normals alike) to 4 pi (all directions); how far between is read off the
    length of the mean axis, which costs no trigonometry.
    """
    energy = bins[axis, k, 6]
    if energy <= 0.0:
        return 0.0 * energy
    x = bins[axis, k, 7]
    y = bins[axis, k, 8]
    z = bins[axis, k, 9]
    concentration = min(1.0, math.sqrt(x * x + y * y + z * z) / energy)
    return energy * _box_measure(bins, axis, k) * (4.0 - 3.0 * concentration)


@kernel
def _merge_bins(bins, axis, target, k):
    for c in range(3):
        bins[axis, target, c] = min(bins[axis, target, c], bins[axis, k, c])
        bins[axis, target, c + 3] = max(bins[axis, target, c + 3], bins[axis, k, c + 3])
    for c in range(6, 11):
        bins[axis, target, c] += bins[axis, k, c]


@kernel
def _clear_bins(bins, axis, first, last):
    for k in range(first, last):
        for c in range(3):
            bins[axis, k, c] = 3.0e38
            bins[axis, k, c + 3] = -3.0e38
        for c in range(6, 11):
            bins[axis, k, c] = 0.0


@kernel
def _choose_split(bounds, centers, order, start, end, bins):
    """Axis and centroid coordinate of the cheapest of the binned splits of `order[start:end]`; axis -1 = none."""
    lower = (3.0e38, 3.0e38, 3.0e38)
    upper = (-3.0e38, -3.0e38, -3.0e38)
    for i in range(start, end):
        e = order[i]
        lower = (min(lower[0], centers[e, 0]), min(lower[1], centers[e, 1]), min(lower[2], centers[e, 2]))
        upper = (max(upper[0], centers[e, 0]), max(upper[1], centers[e, 1]), max(upper[2], centers[e, 2]))
    extent = (upper[0] - lower[0], upper[1] - lower[1], upper[2] - lower[2])
    largest = max(extent[0], extent[1], extent[2])
    if not largest > 0.0:
        return -1, lower[0]
    if end - start <= 3:
        for axis in range(3):
            if extent[axis] == largest:
                return axis, lower[axis] + 0.5 * extent[axis]

    for axis in range(3):
        _clear_bins(bins, axis, 0, _BIN_COUNT + 2)
    bin_scale = np.float32(_BIN_COUNT)
    for i in range(start, end):
        e = order[i]
        # Axes of two-sided emitters have no sign: point them into one half-space.
        sign = 1.0
        if bounds[e, BOUNDS_TWO_SIDED] > 0.0:
            guide = bounds[e, BOUNDS_AXIS] + 0.618 * bounds[e, BOUNDS_AXIS + 1] + 0.414 * bounds[e, BOUNDS_AXIS + 2]
            if guide < 0.0:
                sign = -1.0
        weight = sign * bounds[e, BOUNDS_ENERGY] * math.cos(0.5 * bounds[e, BOUNDS_NORMALS])
        for axis in range(3):
            if extent[axis] > 0.0:
                k = min(_BIN_COUNT - 1, int(bin_scale * ((centers[e, axis] - lower[axis]) / extent[axis])))
                for c in range(3):
                    bins[axis, k, c] = min(bins[axis, k, c], bounds[e, BOUNDS_LOWER + c])
                    bins[axis, k, c + 3] = max(bins[axis, k, c + 3], bounds[e, BOUNDS_UPPER + c])
                    bins[axis, k, c + 7] += weight * bounds[e, BOUNDS_AXIS + c]
                bins[axis, k, 6] += bounds[e, BOUNDS_ENERGY]
                bins[axis, k, 10] += 1.0

    best_axis = -1
    best_bin = 0
    best = 3.0e38
    for axis in range(3):
        if not extent[axis] > 0.0:
            continue
        regularization = largest / extent[axis]
        # Right sums grow in spare bin N and leave their cost with the split, left sums then meet them from below.
        for k in range(_BIN_COUNT - 1, 0, -1):
            _merge_bins(bins, axis, _BIN_COUNT, k)
            bins[axis, k, 11] = _cost(bins, axis, _BIN_COUNT)
        for split in range(1, _BIN_COUNT):
            _merge_bins(bins, axis, _BIN_COUNT + 1, split - 1)
            left_count = bins[axis, _BIN_COUNT + 1, 10]
            if left_count > 0.0 and left_count < np.float32(end - start):
                cost = regularization * (_cost(bins, axis, _BIN_COUNT + 1) + bins[axis, split, 11])
                if cost < best:
                    best = cost
                    best_axis = axis
                    best_bin = split
    if best_axis < 0:
        return -1, lower[0]
    for axis in range(3):
        if axis == best_axis:
            return axis, lower[axis] + extent[axis] * (np.float32(best_bin) / bin_scale)
    return -1, lower[0]


@kernel
def _partition(centers, order, start, end, axis, position):
    """Move emitters left of `position` to the front; returns where the others begin."""
    i = start
    j = end - 1
    while i <= j:
        if centers[order[i], axis] < position:
            i += 1
        else:
            order[i], order[j] = order[j], order[i]
            j -= 1
    return i


@kernel
def _weight_of(bounds, order, start, end):
    """Energy times the diagonal of the box of `order[start:end]`; 0 for a single emitter."""
    if end - start < 2:
        return 0.0 * bounds[order[start], BOUNDS_ENERGY]
    energy = 0.0
    squared = 0.0
    for c in range(3):
        lower = 3.0e38
        upper = -3.0e38
        for i in range(start, end):
            lower = min(lower, bounds[order[i], BOUNDS_LOWER + c])
            upper = max(upper, bounds[order[i], BOUNDS_UPPER + c])
        squared += (upper - lower) * (upper - lower)
    for i in range(start, end):
        energy += bounds[order[i], BOUNDS_ENERGY]
    return energy * math.sqrt(squared)


@kernel
def _next_part(part, weight, count):
    """The part to be divided next, -1 = none: the strongest and widest of those too large for a group, then of all."""
    chosen = -1
    for k in range(count):
        size = part[k, 1] - part[k, 0]
        if size < 2:
            continue
        if chosen >= 0:
            is_large = size > GROUP_SIZE
            best_is_large = part[chosen, 1] - part[chosen, 0] > GROUP_SIZE
            if is_large < best_is_large or (is_large == best_is_large and weight[k] <= weight[chosen]):
                continue
        chosen = k
    return chosen


@kernel
def _build_topology(bounds, centers, child, parent, leaf_of_emitter, order, span, part, weight, bins):
    """Divide emitters into groups, from the top; returns the number of groups. Lower groups have higher numbers."""
    span[1, 0] = 0
    span[1, 1] = bounds.shape[0]
    child[0, 0] = 1
    parent[0] = -1
    parent[1] = 0
    group_count = 2
    if bounds.shape[0] == 1:
        child[0, 0] = ~0
        leaf_of_emitter[0] = 0
        return 1
    group = 1
    while group < group_count:
        part[0, 0] = span[group, 0]
        part[0, 1] = span[group, 1]
        weight[0] = 0.0
        count = 1
        while count < GROUP_SIZE:
            k = _next_part(part, weight, count)
            if k < 0:
                break
            start = part[k, 0]
            end = part[k, 1]
            axis, position = _choose_split(bounds, centers, order, start, end, bins)
            middle = start
            if axis >= 0:
                middle = _partition(centers, order, start, end, axis, position)
            if middle == start or middle == end:
                # Emitters in one place: halve by number.
                middle = (start + end) // 2
            part[k, 1] = middle
            part[count, 0] = middle
            part[count, 1] = end
            weight[k] = _weight_of(bounds, order, start, middle)
            weight[count] = _weight_of(bounds, order, middle, end)
            count += 1
        for k in range(count):
            node = GROUP_SIZE * group + k
            if part[k, 1] - part[k, 0] == 1:
                emitter = order[part[k, 0]]
                child[group, k] = ~emitter
                leaf_of_emitter[emitter] = node
                continue
            child[group, k] = group_count
            parent[group_count] = node
            span[group_count, 0] = part[k, 0]
            span[group_count, 1] = part[k, 1]
            group_count += 1
        group += 1
    return group_count


@kernel(float64_literals=True)
def _merge_cones(cones, a, b):
    """Widen cone a to hold b (Conty Estevez and Kulla 2018, algorithm 1): axis, theta_o, theta_e, sides."""
    target = a
    two_sided = max(cones[a, 5], cones[b, 5])
    emission = max(cones[a, 4], cones[b, 4])
    if cones[b, 3] > cones[a, 3]:
        a, b = b, a
    cosine = cones[a, 0] * cones[b, 0] + cones[a, 1] * cones[b, 1] + cones[a, 2] * cones[b, 2]
    sign = 1.0
    if two_sided > 0.0 and cosine < 0.0:
        sign = -1.0
        cosine = -cosine
    cosine = min(1.0, max(-1.0, cosine))
    between = math.acos(cosine)
    wide = cones[a, 3]
    narrow = cones[b, 3]
    x = cones[a, 0]
    y = cones[a, 1]
    z = cones[a, 2]
    if wide + 1e-6 < min(math.pi, between + narrow):
        angle = 0.5 * (between + wide + narrow)
        if angle >= math.pi:
            wide = math.pi
        else:
            turn = angle - wide
            ox = sign * cones[b, 0] - cosine * x
            oy = sign * cones[b, 1] - cosine * y
            oz = sign * cones[b, 2] - cosine * z
            norm = math.sqrt(ox * ox + oy * oy + oz * oz)
            if norm > 1e-6:
                s = math.sin(turn) / norm
                c = math.cos(turn)
                x, y, z = x * c + ox * s, y * c + oy * s, z * c + oz * s
                wide = angle
            elif cosine > 0.0:
                wide = max(wide, between + narrow)
            else:
                wide = math.pi
    cones[target, 0] = x
    cones[target, 1] = y
    cones[target, 2] = z
    cones[target, 3] = wide
    cones[target, 4] = emission
    cones[target, 5] = two_sided


@kernel(float64_literals=True)
def _fill_nodes(bounds, child, nodes, boxes, cones, group_count):
    """Bounds of all nodes, lower groups (which have higher numbers) before those above."""
    for node in range(GROUP_SIZE * group_count - 1, -1, -1):
        group = node // GROUP_SIZE
        k = node % GROUP_SIZE
        below = child[group, k]
        if below == 0:
            continue
        radius_squared = np.float64(0.0)
        if below < 0:
            e = ~below
            for c in range(6):
                boxes[node, c] = bounds[e, BOUNDS_LOWER + c]
            for c in range(3):
                cones[node, c] = bounds[e, BOUNDS_AXIS + c]
            cones[node, 3] = bounds[e, BOUNDS_NORMALS]
            cones[node, 4] = bounds[e, BOUNDS_EMISSION]
            cones[node, 5] = bounds[e, BOUNDS_TWO_SIDED]
            energy = np.float64(bounds[e, BOUNDS_ENERGY])
            spread = np.float64(bounds[e, BOUNDS_SPREAD])
            radius_squared = np.float64(bounds[e, BOUNDS_RADIUS_SQUARED])
        else:
            first = GROUP_SIZE * below
            energy = np.float64(nodes[below, NODE_ENERGY, 0])
            for c in range(6):
                boxes[node, c] = boxes[first, c]
                cones[node, c] = cones[first, c]
            for i in range(1, GROUP_SIZE):
                if child[below, i] == 0:
                    break
                energy += nodes[below, NODE_ENERGY, i]
                for c in range(3):
                    boxes[node, c] = min(boxes[node, c], boxes[first + i, c])
                    boxes[node, c + 3] = max(boxes[node, c + 3], boxes[first + i, c + 3])
                _merge_cones(cones, node, first + i)
            spread = np.float64(0.0)
            for i in range(GROUP_SIZE):
                squared = 0.0
                for c in range(3):
                    offset = nodes[below, NODE_CENTER + c, i] - 0.5 * (boxes[node, c] + boxes[node, c + 3])
                    squared += offset * offset
                spread += nodes[below, NODE_ENERGY, i] * (squared + nodes[below, NODE_SPREAD, i])
            if energy > 0.0:
                spread /= energy
        diagonal = 0.0
        for c in range(3):
            half = 0.5 * (boxes[node, c + 3] - boxes[node, c])
            nodes[group, NODE_CENTER + c, k] = 0.5 * (boxes[node, c + 3] + boxes[node, c])
            nodes[group, NODE_HALF_SIZE + c, k] = half
            diagonal += half * half
            nodes[group, NODE_AXIS + c, k] = cones[node, c]
        nodes[group, NODE_RADIUS, k] = math.sqrt(radius_squared if radius_squared > 0.0 else diagonal)
        nodes[group, NODE_ENERGY, k] = energy
        nodes[group, NODE_COS_NORMALS, k] = math.cos(cones[node, 3])
        nodes[group, NODE_SIN_NORMALS, k] = math.sin(cones[node, 3])
        nodes[group, NODE_COS_EMISSION, k] = math.cos(min(math.pi, cones[node, 4]))
        nodes[group, NODE_TWO_SIDED, k] = cones[node, 5]
        nodes[group, NODE_SPREAD, k] = spread


def build_tree(bounds: Float32Array) -> tuple[Float32Array, Int32Array, Int32Array, Int32Array]:
    """Light tree over emitters given by their bounds.

    Parameters
    ----------
    bounds : float32 (N, BOUNDS_WIDTH)
        Box [m], peak intensity [W/sr], unit axis, angles [rad], sides, spread and radius squared [m^2] an emitter.

    Returns
    -------
    nodes : float32 (G, NODE_WIDTH, GROUP_SIZE); child : int32 (G, GROUP_SIZE); parent : int32 (G,)
        As in `LightArrays`. G is 0 for N = 0.
    leaf_of_emitter : int32 (N,)
        Its node.
    """
    count = len(bounds)
    leaf_of_emitter = np.zeros(count, np.int32)
    # A group divides at least two emitters, but for the first, which holds the root.
    most = count + 1 if count else 0
    child = np.zeros((most, GROUP_SIZE), np.int32)
    parent = np.zeros(most, np.int32)
    if count == 0:
        return np.zeros((0, NODE_WIDTH, GROUP_SIZE), np.float32), child, parent, leaf_of_emitter
    centers = np.ascontiguousarray(0.5 * (bounds[:, 0:3] + bounds[:, 3:6]))
    order = np.arange(count, dtype=np.int32)
    span = np.zeros((most, 2), np.int64)
    part = np.zeros((GROUP_SIZE, 2), np.int64)
    bins = np.zeros((3, _BIN_COUNT + 2, 12), np.float32)
    group_count = _build_topology(
        bounds, centers, child, parent, leaf_of_emitter, order, span, part, np.zeros(GROUP_SIZE, np.float32), bins
    )
    nodes = np.zeros((group_count, NODE_WIDTH, GROUP_SIZE), np.float32)
    boxes = np.zeros((group_count * GROUP_SIZE, 6), np.float32)
    cones = np.zeros((group_count * GROUP_SIZE, 6), np.float64)
    _fill_nodes(bounds, child, nodes, boxes, cones, group_count)
    return nodes, child[:group_count].copy(), parent[:group_count].copy(), leaf_of_emitter
