# SPDX-License-Identifier: GPL-3.0-or-later
"""Lights as kernels read them; built by `engine.builder.lights`.

An *emitter* is what the light tree picks: an emissive triangle, a lamp or the background. Emitters are numbered
triangles first (so a triangle emitter's number is its row in `triangles`), then lamps, then discs of the background,
then its map. Directions within a disc are drawn from the disc alone, all others from the map alone.

A *cluster* is what a region learns the worth of (`LightSelection`): a node of a cut through the light tree, an emitter
at infinity, or a patch of the background's map. Every emitter, and every direction of the background, is in one.
Clusters are numbered in this order: nodes of the cut, rows of `distant` but for the background's map, patches.
"""

from __future__ import annotations

import numpy as np

from engine.array_types import Float32Array, Int32Array, Int64Array, Uint8Array
from engine.runtime.bundle import Bundle

# Kinds of emitters
LIGHT_TRIANGLE = 0
LIGHT_BACKGROUND = 1
#: Kinds of lamps have their numbers in their files, from this one on (`engine.kernels.lights.lamps`).
FIRST_LAMP = 2

# ---------------------------------------------------------------------------------------------------------------------
# The light tree: groups of nodes. Node k of group g has the number GROUP_SIZE g + k; the root is node 0, alone in its
# group.

#: Nodes that are chosen among at once: as many as there are floats in a vector register.
GROUP_SIZE = 8

# Columns of LightArrays.nodes (float32): what lies below a node.

NODE_CENTER = 0
NODE_RADIUS = 3
NODE_HALF_SIZE = 4
#: Radiant intensity [W/sr] along the strongest direction, mean of channels.
NODE_ENERGY = 7
NODE_AXIS = 8
#: The cone around the axis that holds all normals: cosine and sine of its half angle theta_o.
NODE_COS_NORMALS = 11
NODE_SIN_NORMALS = 12
#: Cosine of theta_e, how far from its normal each emitter still emits.
NODE_COS_EMISSION = 13
#: 1 where emitters emit to both sides of their normals.
NODE_TWO_SIDED = 14
#: Added to the squared distance: mean squared distance of the energy from the centre, plus its emitters' own size.
NODE_SPREAD = 15
NODE_WIDTH = 16

# LightArrays.distant (float32): emitters at infinity.
DISTANT_DIRECTION = 0  # towards the light
DISTANT_COS = 3  # of the half angle it is seen under; -1 for the background
DISTANT_SIN = 4
DISTANT_ENERGY = 5  # irradiance [W m^-2] on a plane facing it, mean of channels
DISTANT_EMITTER = 6
DISTANT_WIDTH = 8

# LightArrays.emitters (int32)
EMITTER_KIND = 0
#: Row in `lamps`, of the background in `discs`; -1 for triangles and the background's map.
EMITTER_LAMP = 1
EMITTER_INSTANCE = 2
EMITTER_TRIANGLE = 3
#: Program to evaluate for the emission, -1: the radiance is constant and known.
EMITTER_PROGRAM = 4
EMITTER_FLAGS = 5
#: Its node, or ~row of `distant`.
EMITTER_NODE = 6
EMITTER_VISIBILITY = 7
EMITTER_WIDTH = 8

#: Sides of a triangle that are sampled as a light.
EMITTER_FRONT = 1
EMITTER_BACK = 2
#: The front is the opposite of cross(edge 1, edge 2): a mirroring transform.
EMITTER_MIRRORED = 4
#: It moves or changes its shape while the shutter is open: where it is tells the geometry.
EMITTER_MOVING = 8

# LightArrays.triangles (float32): world space, at the middle of the shutter.
TRIANGLE_V0 = 0
TRIANGLE_EDGE1 = 3  # v1 - v0
TRIANGLE_EDGE2 = 6  # v2 - v0
TRIANGLE_RADIANCE = 9  # constant emission, or 1 where a program tells
TRIANGLE_WIDTH = 12

# ---------------------------------------------------------------------------------------------------------------------
# LightArrays.lamps (float32)

LAMP_P = 0  # position; of those infinitely far away: unit direction towards the middle of it
#: Radiance [W m^-2 sr^-1]; radiant intensity [W/sr] of points without a radius, irradiance [W m^-2] of suns without
#: an angle and of area lights without spread.
LAMP_RADIANCE = 3
LAMP_ESTIMATE = 6  # mean emission of its program, 1 without
LAMP_TEMPERATURE = 9  # of black bodies [K], else 0
#: The first of those that the file of the lamp's kind names.
LAMP_KIND_COLUMNS = 10
LAMP_WIDTH = 32

# LightArrays.lamp_table (int32)
LAMP_KIND = 0
LAMP_FLAGS = 1
LAMP_VISIBILITY = 2
LAMP_MAX_BOUNCES = 3
LAMP_PROGRAM = 4
LAMP_EMITTER = 5
LAMP_LIGHT = 6  # index into SceneDescription.lights
LAMP_LIGHT_GROUP = 7  # of the view layer, -1 = none
LAMP_TABLE_WIDTH = 8

LAMP_FLAG_MIS = 1
LAMP_FLAG_SHADOW = 2
#: Can only be sampled, never hit.
LAMP_FLAG_DELTA = 4
#: A surface lies in one place with it, or it is far from the origin: see `engine.builder.same_place`.
LAMP_FLAG_IN_SURFACE = 8
#: This bit and those above it mean what the file of the lamp's kind says.
LAMP_FLAG_OF_KIND = 16

# LightArrays.header (int32)
HEADER_EMITTERS = 0
#: Lamps [0, HEADER_HITTABLE) have an extent in space: rays may cross them.
HEADER_HITTABLE = 1
#: Lamps [HEADER_FIRST_DISTANT, HEADER_LAST_DISTANT) are infinitely far away, and seen under an angle.
HEADER_FIRST_DISTANT = 2
HEADER_LAST_DISTANT = 3
HEADER_BACKGROUND_EMITTER = 4  # -1: the background's map is not sampled as a light
HEADER_BACKGROUND_PROGRAM = 5
HEADER_BACKGROUND_VISIBILITY = 6
HEADER_BACKGROUND_MAX_BOUNCES = 7
#: Rows of `sources`; -1: light may come from anywhere.
HEADER_SOURCES = 8
HEADER_BACKGROUND_SHADOW = 9
HEADER_CLUSTERS = 10
#: Clusters [0, HEADER_CUT) are nodes, those from HEADER_FIRST_PATCH on are patches.
HEADER_CUT = 11
HEADER_FIRST_PATCH = 12
#: Patches of the background: bands of latitude times sectors of longitude, band by band.
HEADER_BANDS = 13
HEADER_SECTORS = 14
#: Emitters that there would be without links.
HEADER_UNLINKED = 15
HEADER_FIRST_DISC = 16  # of `Emitters.table`: the first disc of the background
HEADER_WIDTH = 17

# LightArrays.discs (float32): suns of the background.
DISC_AXIS = 0  # unit vector to the centre
DISC_ONE_MINUS_COS = 3  # of half its angle
DISC_WIDTH = 4

#: Steps of `map_guide`; a power of two, so that finding one's own does not round.
MAP_GUIDE_SIZE = 64


class LightSelection(Bundle):
    """How likely regions of space choose each cluster of lights, as learned: N nodes of a binary tree, R regions.

    node_split, node_link, bounds, grid, grid_scale : as `engine.kernels.binary_tree` reads them
    table : int32 (R,), row of `cumulative` by the number of light trees; -1: the region chooses by the tree alone
    cumulative : float32 (S, clusters + 1), cumulative probability, 0 first and 1 last, a row for each light tree; S = 0
        where nothing has been learned
    """

    _dynamic = frozenset({"cumulative"})

    node_split: Float32Array
    node_link: Int32Array
    bounds: Float32Array
    grid: Int32Array
    grid_scale: Float32Array
    table: Int32Array
    cumulative: Float32Array


def no_selection() -> LightSelection:
    """Nothing learned: all regions choose by the light tree."""
    return LightSelection(
        np.zeros(1, np.float32), np.zeros((1, 2), np.int32), np.zeros((2, 3), np.float32), np.zeros(1, np.int32),
        np.zeros(3, np.float32), np.zeros(1, np.int32), np.zeros((0, 1), np.float32),
    )


# Columns of LightLinks.trees
#: Group of the root, -1 = the tree has no local emitters.
TREE_ROOT = 0
#: Rows of `distant`.
TREE_FIRST_DISTANT = 1
TREE_LAST_DISTANT = 2
#: Emitter that stands for the background, -1 = it is not sampled.
TREE_BACKGROUND = 3
#: The first cluster that is a patch.
TREE_FIRST_PATCH = 4
TREE_WIDTH = 8


class LightLinks(Bundle):
    """Which emitters light which instances. There are S light trees, each over the emitters that some receivers see.

    An emitter is in `LightArrays.emitters` once for each tree that it is in. Without links (`receivers` has no column)
    there is one tree, and what follows is empty. The number of columns is part of the type, so that scenes without
    links have kernels that know nothing of them.

    receivers : int32 (I, 1), tree by which an instance receives light; (0, 0) without links
    joined : int32 (S, S), tree by which light is received where media overlap, by the trees of two of them: its
        emitters are those that both see
    surfaces : int64 (I,), bit t: what the instance emits lights the receivers of tree t
    lamps : int64 (L,), the same of lamps
    trees : int32 (S, TREE_WIDTH)
    rows : int32 (S * E,), row of `LightArrays.emitters` of the E emitters of a scene without links, by tree; -1 = none
    tree : int32 (E',), tree of each row of `LightArrays.emitters`
    cluster_tree : int32 (clusters,), tree that each cluster belongs to
    blockers : int32 (E', 1), mask of shadow rays towards each row of `LightArrays.emitters`, 0 = everything casts
        shadows in its light; (0, 0) without links
    casters : int32 (I,), masks of shadow rays that an instance casts shadows for; empty where no emitter has blockers
    hides : uint8 (L,), whether only some objects cast shadows in the light of a lamp
    hidden : int32 (K,), rows of those lamps that have an extent
    """

    receivers: Int32Array
    joined: Int32Array
    surfaces: Int64Array
    lamps: Int64Array
    trees: Int32Array
    rows: Int32Array
    tree: Int32Array
    cluster_tree: Int32Array
    blockers: Int32Array
    casters: Int32Array
    hides: Uint8Array
    hidden: Int32Array


class LightArrays(Bundle):
    """All emitters, the tree over them and their shapes.

    header : int32 (HEADER_WIDTH,)
    nodes : float32 (G, NODE_WIDTH, GROUP_SIZE), by group, zeros where there is no node; G = 0 without local emitters
    child : int32 (G, GROUP_SIZE), group below a node; ~emitter for a leaf, 0 where there is no node
    parent : int32 (G,), node above a group; -1 above the root
    distant : float32 (D, DISTANT_WIDTH)
    emitters : int32 (E, EMITTER_WIDTH)
    triangles : float32 (T, TRIANGLE_WIDTH)
    sources : float32 (S, 4), spheres that hold all that scattered rays can find by chance: centre, squared radius [m]
    lamps : float32 (L, LAMP_WIDTH); lamp_table : int32 (L, LAMP_TABLE_WIDTH)
    varying : int32 (V,), rows of the lamps with an extent whose emission a program tells
    lookup_offset : int64 (I, 2), where the triangles of instance i start in `lookup` (-1: it has no emitters), and
        the first triangle of its mesh
    lookup : int32 (K,), emitter of a triangle, -1 = none
    discs : float32 (K, DISC_WIDTH), of the background
    portals : float32 (P, PORTAL_WIDTH), through which its map is sampled too (`engine.state.portals`)
    portal_kernels : int64 (PORTAL_KERNELS,), addresses of what samples through them; 0 where there are none
    map_marginal : float32 (H + 1, 2), cumulative probability of rows and cosine of their lower latitude bound
    map_conditional : float32 (H, W + 1), cumulative probability within a row; H = 0 without a map
    map_guide : int32 (H + 1, MAP_GUIDE_SIZE + 1), where to look: the last column of a row, and in the last line the
        last row, whose cumulative probability is not above k / MAP_GUIDE_SIZE
    compensated_marginal, compensated_conditional, compensated_guide : the same of what is brighter than the mean, for
        receivers that find the rest by scattering (`engine.kernels.lights.finds_all`); H = 0: the same map
    map_patches : float32 (P, B + 1), cumulative probability of the rows within a patch; B rows in the highest band
    node_cluster : int32 (GROUP_SIZE G,), cluster of the nodes in the cut, -1 elsewhere
    cluster_node : int32 (HEADER_CUT,), nodes of the cut
    cluster_share : float32 (clusters,), probability of a patch within the map; 1 of all other clusters
    selection : LightSelection, what has been learned about them
    links : LightLinks
    """

    #: The map's size differs from world to world.
    _dynamic = frozenset({"map_conditional", "compensated_conditional", "map_patches"})

    header: Int32Array
    nodes: Float32Array
    child: Int32Array
    parent: Int32Array
    distant: Float32Array
    emitters: Int32Array
    triangles: Float32Array
    sources: Float32Array
    lamps: Float32Array
    lamp_table: Int32Array
    varying: Int32Array
    lookup_offset: Int64Array
    lookup: Int32Array
    discs: Float32Array
    portals: Float32Array
    portal_kernels: Int64Array
    map_marginal: Float32Array
    map_conditional: Float32Array
    map_guide: Int32Array
    compensated_marginal: Float32Array
    compensated_conditional: Float32Array
    compensated_guide: Int32Array
    map_patches: Float32Array
    node_cluster: Int32Array
    cluster_node: Int32Array
    cluster_share: Float32Array
    selection: LightSelection
    links: LightLinks
