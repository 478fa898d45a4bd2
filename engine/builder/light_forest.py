# SPDX-License-Identifier: GPL-3.0-or-later
"""Light trees: one over all emitters, or where lights are linked one for each choice of emitters that receivers see."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import combinations

import numpy as np

from engine.array_types import Float32Array, Int32Array
from engine.builder.light_clusters import choose_cut
from engine.builder.light_tree import build_tree
from engine.builder.media import SceneMedia
from engine.scene.description import Notice
from engine.scene.linking import MOST_SETS, Linking, contains
from engine.state import lights as la
from engine.state.lights import LightLinks


@dataclass
class Emitters:
    """All emitters of a scene, each once: triangles, lamps, discs of the background, its map.

    Attributes
    ----------
    table : int32 (E, EMITTER_WIDTH)
        But for where they are in a light tree.
    triangles : float32 (T, TRIANGLE_WIDTH)
    bounds : float32 (N, BOUNDS_WIDTH)
        Of triangles and local lamps, the first N.
    distant : float32 (D, DISTANT_WIDTH)
        Of the others.
    has_background : bool
        Whether the last one is the background's map.
    """

    table: Int32Array
    triangles: Float32Array
    bounds: Float32Array
    distant: Float32Array
    has_background: bool


@dataclass
class Forest:
    """Light trees as `LightArrays` has them, and what stands in them for the emitters.

    nodes, child, parent, distant, emitters, triangles, node_cluster, cluster_node, links : as there
    patch_count : int
        Patches of the background, of all trees.
    is_background : bool (D,)
        Which rows of `distant` are the background.
    """

    nodes: Float32Array
    child: Int32Array
    parent: Int32Array
    distant: Float32Array
    emitters: Int32Array
    triangles: Float32Array
    node_cluster: Int32Array
    cluster_node: Int32Array
    is_background: np.ndarray
    patch_count: int
    links: LightLinks


@dataclass
class Sight:
    """Who sees which emitters, with as many light trees as there are different choices of emitters.

    Attributes
    ----------
    tree : int32 (I,)
        Tree of each instance as a receiver.
    joined : int32 (S, S)
        As `LightLinks.joined`.
    sees : bool (S, E)
    surfaces : int64 (I,), lamps : int64 (L,)
        Bit t: whether what it emits is seen by receivers of tree t.
    """

    tree: Int32Array
    joined: Int32Array
    sees: np.ndarray
    surfaces: np.ndarray
    lamps: np.ndarray


def _bits(columns: np.ndarray) -> np.ndarray:
    """Columns of truth values (S, N) as bits, int64 (N,)."""
    return (columns.astype(np.int64) << np.arange(len(columns))[:, None]).sum(axis=0)


def lamp_rows(emitters: Int32Array) -> Int32Array:
    """Row of each emitter's lamp, int32 (E,); -1 of triangles, and of the background, whose discs are no lamps."""
    return np.where(emitters[:, la.EMITTER_KIND] == la.LIGHT_BACKGROUND, -1, emitters[:, la.EMITTER_LAMP])


@dataclass
class _Choices:
    """Choices of emitters, each with the light tree of its number.

    of_surfaces, of_lamps : uint64 (I,), (L,)
        Sets of receivers that each lights.
    """

    of_surfaces: np.ndarray
    of_lamps: np.ndarray
    surfaces: list[np.ndarray] = field(default_factory=list)
    lamps: list[np.ndarray] = field(default_factory=list)
    sets: list[tuple[int, ...]] = field(default_factory=list)
    _known: dict[bytes, int] = field(default_factory=dict)

    def tree(self, *sets: int) -> int:
        """The tree of what lights receivers of all of these sets; -1: there are as many as rays can tell apart."""
        surfaces = np.logical_and.reduce([contains(self.of_surfaces, number) for number in sets])
        lamps = np.logical_and.reduce([contains(self.of_lamps, number) for number in sets])
        # What is found but not sampled counts too: choices are of all that may emit.
        pattern = surfaces.tobytes() + lamps.tobytes()
        if pattern not in self._known:
            if len(self.sets) == MOST_SETS:
                return -1
            self._known[pattern] = len(self.sets)
            self.surfaces.append(surfaces)
            self.lamps.append(lamps)
            self.sets.append(sets)
        return self._known[pattern]


def _join(choices: _Choices, sets: list[int], notices: list[Notice]) -> Int32Array:
    """`LightLinks.joined`, with trees for each two of the sets that media are in."""
    trees = [choices.tree(number) for number in sets]
    pairs: dict[tuple[int, int], int] = {}
    for (one, first), (other, last) in combinations(zip(sets, trees, strict=True), 2):
        if first != last and (first, last) not in pairs:
            both = choices.tree(one, other)
            if both < 0 and not notices:
                notices.append(
                    Notice(
                        "scene", f"more than {MOST_SETS} different choices of lights, with those of media that overlap,"
                        " are not supported", "what lights the medium that was entered first lights both",
                    )
                )  # fmt: skip
            pairs[first, last] = pairs[last, first] = both
    count = len(choices.sets)
    joined = np.repeat(np.arange(count, dtype=np.int32)[:, None], count, axis=1)
    for (first, last), both in pairs.items():
        joined[first, last] = both if both >= 0 else first
    return joined


def find_sight(
    linking: Linking | None, emitters: Int32Array, lamp_light: Int32Array, media: SceneMedia | None,
    notices: list[Notice], *, is_wanted: bool,
) -> Sight | None:
    """Who sees what; None: all receivers see all emitters, and it `is_wanted` for nothing else.

    Parameters
    ----------
    emitters : int32 (E, EMITTER_WIDTH)
        As of `Emitters.table`.
    lamp_light : int32 (L,)
        Number in `SceneDescription.lights` of each row of lamps.
    media : SceneMedia or None
    notices : list of Notice, appended to
    """
    if linking is None:
        return None
    of_surfaces, of_lamps = linking.surface_receivers, linking.lamp_receivers[lamp_light]
    bits = np.full(len(emitters), np.uint64(2**64 - 1))
    lamp, instance = lamp_rows(emitters), emitters[:, la.EMITTER_INSTANCE]
    bits[lamp >= 0] = of_lamps[lamp[lamp >= 0]]
    bits[instance >= 0] = of_surfaces[instance[instance >= 0]]
    choices = _Choices(of_surfaces, of_lamps)
    sets = np.unique(np.append(linking.receiver_set, 0)).tolist()
    tree_of_set = np.zeros(max(sets) + 1, np.int32)
    for number in sets:
        tree_of_set[number] = choices.tree(number)
    of_media: list[int] = []
    if media is not None:
        # The world's medium is in no collection.
        inside = linking.receiver_set[media.has_inside]
        of_media = np.unique(np.append(inside, 0) if media.arrays.world[0] >= 0 else inside).tolist()
    joined = _join(choices, of_media, notices)
    surfaces, lamps = np.array(choices.surfaces), np.array(choices.lamps)
    if surfaces.all() and lamps.all() and not is_wanted:
        return None
    sees = np.array([np.logical_and.reduce([contains(bits, number) for number in chosen]) for chosen in choices.sets])
    return Sight(
        tree_of_set[linking.receiver_set], joined, sees.reshape(len(choices.sets), -1), _bits(surfaces), _bits(lamps)
    )


def _seeing_all(emitter_count: int) -> np.ndarray:
    return np.ones((1, emitter_count), np.bool_)


def no_links() -> LightLinks:
    """Every emitter lights everything."""
    nothing, narrow, wide = np.zeros(0, np.int32), np.zeros((0, 0), np.int32), np.zeros(0, np.int64)
    return LightLinks(
        narrow, narrow, wide, wide, np.zeros((0, la.TREE_WIDTH), np.int32), nothing, nothing, nothing, narrow, nothing,
        np.zeros(0, np.uint8), nothing,
    )  # fmt: skip


def build_forest(emitters: Emitters, sight: Sight | None, patch_count: int) -> Forest:
    """Light trees over what receivers see.

    Parameters
    ----------
    sight : Sight or None
        None: one tree has all.
    patch_count : int
        Patches of the background's map.
    """
    sees = _seeing_all(len(emitters.table)) if sight is None else sight.sees
    tree_count, count, local_count = len(sees), len(emitters.table), len(emitters.bounds)
    # Triangles first, whatever tree they are in.
    tree, number = np.nonzero(sees)
    order = np.argsort(number >= len(emitters.triangles), kind="stable")
    tree, number = tree[order].astype(np.int32), number[order]
    rows = np.full((tree_count, count), -1, np.int32)
    rows[tree, number] = np.arange(len(number))
    table = emitters.table[number]
    trees = np.full((tree_count, la.TREE_WIDTH), -1, np.int32)
    parts: list[tuple[np.ndarray, ...]] = []
    cuts: list[Int32Array] = []
    clusters: list[Int32Array] = []
    cluster_tree: list[Int32Array] = []
    first_group = cut_count = 0
    for t in range(tree_count):
        mine = np.flatnonzero(sees[t, :local_count])
        nodes, child, parent, leaf = build_tree(np.ascontiguousarray(emitters.bounds[mine], np.float32))
        table[rows[t, mine], la.EMITTER_NODE] = leaf + la.GROUP_SIZE * first_group
        cut, node_cluster = choose_cut(nodes, child)
        clusters.append(np.where(node_cluster >= 0, node_cluster + cut_count, -1).astype(np.int32))
        cuts.append(cut + la.GROUP_SIZE * first_group)
        cluster_tree.append(np.full(len(cut), t, np.int32))
        is_leaf, is_inner = child < 0, child > 0
        if len(mine):
            child[is_leaf] = ~rows[t, mine][~child[is_leaf]]
        child[is_inner] += first_group
        parent[parent >= 0] += la.GROUP_SIZE * first_group
        trees[t, la.TREE_ROOT] = first_group if len(nodes) else -1
        parts.append((nodes, child, parent))
        first_group += len(nodes)
        cut_count += len(cut)

    distant: list[Float32Array] = []
    first = 0
    for t in range(tree_count):
        mine = np.flatnonzero(sees[t, local_count:])
        of_tree = emitters.distant[mine].copy()
        of_tree[:, la.DISTANT_EMITTER] = rows[t, local_count + mine]
        table[rows[t, local_count + mine], la.EMITTER_NODE] = ~(first + np.arange(len(mine)))
        trees[t, la.TREE_FIRST_DISTANT], trees[t, la.TREE_LAST_DISTANT] = first, first + len(mine)
        cluster_tree.append(np.full(len(mine), t, np.int32))
        distant.append(of_tree)
        first += len(mine)
    all_distant = np.concatenate(distant)
    is_background = np.zeros(len(all_distant), np.bool_)
    if emitters.has_background:
        is_background = all_distant[:, la.DISTANT_EMITTER].astype(np.int32) >= 0
        is_background &= np.isin(all_distant[:, la.DISTANT_EMITTER].astype(np.int32), rows[:, -1])
        trees[:, la.TREE_BACKGROUND] = rows[:, -1]
    # A background has patches for its clusters; with one tree, its own row is none.
    first_patch = cut_count + (len(all_distant) if sight is not None else int((~is_background).sum()))
    trees[:, la.TREE_FIRST_PATCH] = first_patch + patch_count * np.arange(tree_count)
    cluster_tree.append(np.repeat(np.arange(tree_count, dtype=np.int32), patch_count))
    links = no_links()
    if sight is not None:
        links = LightLinks(
            np.ascontiguousarray(sight.tree[:, None]), sight.joined, sight.surfaces, sight.lamps, trees, rows.ravel(),
            tree, np.concatenate(cluster_tree), np.zeros((0, 0), np.int32), np.zeros(0, np.int32),
            np.zeros(len(sight.lamps), np.uint8), np.zeros(0, np.int32),
        )  # fmt: skip
    nodes, child, parent = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    return Forest(
        nodes, child, parent, all_distant, table, emitters.triangles[number[number < len(emitters.triangles)]],
        np.concatenate(clusters), np.concatenate(cuts), is_background, patch_count * tree_count, links,
    )  # fmt: skip
