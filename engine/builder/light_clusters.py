# SPDX-License-Identifier: GPL-3.0-or-later
"""Clusters of lights, whose worth regions learn: a cut through the light tree, suns, patches of the background.

References: Vevoda, Kondapaneni and Krivanek 2018, "Bayesian Online Regression for Adaptive Direct Illumination
Sampling", section 4.
"""

from __future__ import annotations

import heapq

import numpy as np
import numpy.typing as npt

from engine.array_types import Float32Array, Int32Array
from engine.builder.environment import EnvironmentMap
from engine.state.lights import GROUP_SIZE, NODE_ENERGY, LightArrays

#: Nodes of the cut through the light tree, about: the last one that is divided may add a few.
CUT_SIZE = 128
#: Patches of the background: bands of latitude and sectors of longitude. A window is about as wide as one.
BANDS, SECTORS = 8, 16
#: Light trees up to which regions learn which lights they sample: what they keep grows with the square.
_MOST_LEARNING_TREES = 8


def choose_cut(nodes: Float32Array, child: Int32Array) -> tuple[Int32Array, Int32Array]:
    """Nodes of the light tree that have all emitters below them, none below two, and much the same energy.

    Parameters
    ----------
    nodes : float32 (G, NODE_WIDTH, GROUP_SIZE); child : int32 (G, GROUP_SIZE)

    Returns
    -------
    cut : int32 (C,), nodes
    cluster : int32 (GROUP_SIZE G,), of each node its place in `cut`, -1 for those above and below
    """
    cluster = np.full(child.size, -1, np.int32)
    if not len(nodes):
        return np.zeros(0, np.int32), cluster
    # The strongest is divided next.
    waiting = [(-float(nodes[0, NODE_ENERGY, 0]), 0)]
    whole: list[int] = []
    while waiting and len(waiting) + len(whole) < CUT_SIZE:
        _, node = heapq.heappop(waiting)
        below = int(child[divmod(node, GROUP_SIZE)])
        if below < 0:
            whole.append(node)
            continue
        for k in np.flatnonzero(child[below]).tolist():
            heapq.heappush(waiting, (-float(nodes[below, NODE_ENERGY, k]), GROUP_SIZE * below + k))
    cut = np.array(sorted(whole + [node for _, node in waiting]), np.int32)
    cluster[cut] = np.arange(len(cut))
    return cut, cluster


def possible_clusters(lights: LightArrays) -> npt.NDArray[np.bool_] | None:
    """Which clusters of lights can be sampled, bool (C,); where lights are linked by each light tree, bool (S, C).

    None: there is nothing to choose between, or there are too many trees to learn it for each.
    """
    is_possible: npt.NDArray[np.bool_] = lights.cluster_share > 0.0
    tree_count = len(lights.links.trees)
    if is_possible.sum() < 2 or tree_count > _MOST_LEARNING_TREES:
        return None
    if tree_count:
        return is_possible & (lights.links.cluster_tree == np.arange(tree_count)[:, None])
    return is_possible


def _first(part_count: int, count: int) -> np.ndarray:
    """First row (column) of each band (sector), and one behind the last: `first_of_part` of the kernels."""
    return -(-np.arange(part_count + 1) * count // part_count)


def divide_map(environment: EnvironmentMap) -> tuple[int, int, Float32Array, Float32Array]:
    """Patches of a background.

    Returns
    -------
    bands, sectors : int
        0 without a map.
    patches : float32 (P, B + 1)
        Cumulative probability of rows within each patch, 1 behind its last row.
    share : float32 (P,)
        Probability of each patch.
    """
    conditional = environment.conditional.astype(np.float64)
    height, width = len(conditional), conditional.shape[1] - 1
    bands, sectors = min(BANDS, height), min(SECTORS, width)
    if not height:
        return 0, 0, np.zeros((0, 1), np.float32), np.zeros(0, np.float32)
    rows, columns = _first(bands, height), _first(sectors, width)
    mass = np.diff(environment.marginal[:, 0].astype(np.float64))[:, None] * np.diff(conditional[:, columns], axis=1)
    patches = np.ones((bands * sectors, int(np.diff(rows).max()) + 1), np.float32)
    share = np.zeros(bands * sectors, np.float32)
    for band in range(bands):
        part = mass[rows[band] : rows[band + 1]]
        total = part.sum(axis=0)
        sums = np.cumsum(part, axis=0) / np.maximum(total, 1e-300)
        for sector in range(sectors):
            patch = band * sectors + sector
            share[patch] = total[sector]
            patches[patch, 0] = 0.0
            patches[patch, 1 : len(part) + 1] = sums[:, sector]
            patches[patch, len(part)] = 1.0
    return bands, sectors, patches, share
