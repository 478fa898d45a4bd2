# SPDX-License-Identifier: GPL-3.0-or-later
"""Lamps, emissive triangles and the background of a scene, as `LightArrays`."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from engine.array_types import Float32Array, Int32Array
from engine.builder.blockers import Blockers, find_blockers
from engine.builder.emission import ProgramInfo
from engine.builder.emissive_triangles import find_sources, find_triangles
from engine.builder.environment import EnvironmentMap, empty_map
from engine.builder.lamps import Lamps, convert_lamps
from engine.builder.light_clusters import divide_map
from engine.builder.light_forest import Emitters, Forest, build_forest, find_sight, lamp_rows
from engine.builder.media import SceneMedia
from engine.builder.portals import build_portals
from engine.kernels.lights.linked_portals import link_portals
from engine.scene.description import Notice, SceneDescription, World
from engine.state import lights as la
from engine.state.geometry import GeometryArrays
from engine.state.lights import LightArrays, LightLinks, no_selection
from engine.state.portals import no_portal_kernels

#: `World.max_bounces` from which on light sampling has no limit of its own.
_UNLIMITED_BOUNCES = 1024


def _header(
    world: World | None, info: ProgramInfo, lamps: Lamps, emitter_count: int, cut_size: int, cluster_count: int
) -> Int32Array:
    """What `LightArrays.header` has of emitters, of the background as it is met, and of the cut."""
    order = lamps.order
    local_count = int((~lamps.is_distant).sum())
    header = np.zeros(la.HEADER_WIDTH, np.int32)
    header[la.HEADER_EMITTERS] = emitter_count
    header[la.HEADER_HITTABLE] = int((order == 0).sum())
    header[la.HEADER_FIRST_DISTANT] = local_count
    header[la.HEADER_LAST_DISTANT] = local_count + int((order == 2).sum())
    header[la.HEADER_BACKGROUND_PROGRAM] = info.world_program
    header[la.HEADER_BACKGROUND_VISIBILITY] = world.visibility if world else 0
    header[la.HEADER_BACKGROUND_MAX_BOUNCES] = min(world.max_bounces, 1 << 20) if world else 0
    header[la.HEADER_BACKGROUND_SHADOW] = world.cast_shadow if world else 1
    header[la.HEADER_CUT] = cut_size
    header[la.HEADER_CLUSTERS] = cluster_count
    return header


def _sources(geometry: GeometryArrays, info: ProgramInfo, lamps: Lamps) -> Float32Array | None:
    """Spheres around all that paths may find light in; None: it may be anywhere, or in too many places."""
    program = info.world_program
    world_is_black = program < 0 or (
        bool(info.emission_is_constant[program]) and not np.any(info.emission_estimate[program])
    )
    # Lamps that rays may cross or reach.
    if not world_is_black or np.any((lamps.order == 0) | (lamps.order == 2)):
        return None
    return find_sources(geometry, info)


def _write_lamps(lamps: Lamps, emitters: Int32Array) -> None:
    """Write rows of `LightArrays.emitters`, but for where they are in the light tree."""
    emitters[:, la.EMITTER_KIND] = lamps.table[:, la.LAMP_KIND]
    emitters[:, la.EMITTER_LAMP] = np.arange(len(emitters))
    emitters[:, [la.EMITTER_INSTANCE, la.EMITTER_TRIANGLE]] = -1
    emitters[:, la.EMITTER_PROGRAM] = lamps.table[:, la.LAMP_PROGRAM]
    emitters[:, la.EMITTER_VISIBILITY] = lamps.table[:, la.LAMP_VISIBILITY]


def _link_shadows(forest: Forest, blockers: Blockers | None, lamps: Lamps) -> LightLinks:
    """Links with the masks of shadow rays."""
    masks = np.zeros((len(forest.emitters), 1), np.int32)
    if blockers is None:
        return forest.links._replace(blockers=masks)
    of_lamps = blockers.lamps[lamps.table[:, la.LAMP_LIGHT]]
    lamp, instance = lamp_rows(forest.emitters), forest.emitters[:, la.EMITTER_INSTANCE]
    masks[lamp >= 0, 0] = of_lamps[lamp[lamp >= 0]]
    masks[instance >= 0, 0] = blockers.surfaces[instance[instance >= 0]]
    hides = of_lamps != 0
    hidden = np.flatnonzero(hides & (lamps.order % 2 == 0)).astype(np.int32)
    return forest.links._replace(
        blockers=masks, casters=blockers.bits.astype(np.int32), hides=hides.astype(np.uint8), hidden=hidden
    )


def _varying(lamps: Lamps) -> Int32Array:
    """`LightArrays.varying`."""
    return np.flatnonzero((lamps.table[:, la.LAMP_PROGRAM] >= 0) & (lamps.order % 2 == 0)).astype(np.int32)


def _cluster_share(forest: Forest, patch_share: Float32Array) -> Float32Array:
    """`LightArrays.cluster_share`; 0 of a background that has patches in its place."""
    tree_count = forest.patch_count // len(patch_share) if len(patch_share) else 0
    of_distant = np.ones(len(forest.distant), np.float32)
    of_distant[forest.is_background] = 0.0
    if not len(forest.links.trees):
        of_distant = of_distant[~forest.is_background]
    of_nodes = np.ones(len(forest.cluster_node), np.float32)
    return np.concatenate([of_nodes, of_distant, np.tile(patch_share, tree_count)])


def _write_discs(
    environment: EnvironmentMap, world: World | None, program: int, emitters: Int32Array, first: int
) -> None:
    """Write the rows of `LightArrays.emitters` of the background's discs and of its map; `first`: row of `distant`."""
    visibility = world.visibility if world else 0
    for k, row in enumerate(emitters):
        disc = k if k < len(environment.discs) else -1
        row[:] = (la.LIGHT_BACKGROUND, disc, -1, -1, program, 0, ~(first + k), visibility)


def _list_distant(environment: EnvironmentMap, lamps: Lamps, local_count: int, first_emitter: int) -> Float32Array:
    """`LightArrays.distant`: lamps, discs of the background, and its map if there is one."""
    of_lamps = lamps.distant[local_count:]
    lamp_count, disc_count = len(of_lamps), len(environment.discs)
    distant = np.zeros((lamp_count + disc_count + (environment.mean > 0.0), la.DISTANT_WIDTH), np.float32)
    distant[:, la.DISTANT_EMITTER] = first_emitter + np.arange(len(distant))
    distant[:lamp_count, :3] = lamps.values[local_count:, la.LAMP_P : la.LAMP_P + 3]
    distant[:lamp_count, la.DISTANT_COS : la.DISTANT_ENERGY + 1] = of_lamps
    of_discs = distant[lamp_count : lamp_count + disc_count]
    cosine = 1.0 - environment.discs[:, la.DISC_ONE_MINUS_COS].astype(np.float64)
    squared_sine = np.maximum(1.0 - cosine * cosine, 0.0)
    of_discs[:, :3] = environment.discs[:, la.DISC_AXIS : la.DISC_AXIS + 3]
    of_discs[:, la.DISTANT_COS] = cosine
    of_discs[:, la.DISTANT_SIN] = np.sqrt(squared_sine)
    of_discs[:, la.DISTANT_ENERGY] = math.pi * squared_sine * environment.disc_radiance
    if environment.mean > 0.0:
        distant[-1, : la.DISTANT_ENERGY + 1] = (0.0, 0.0, 1.0, -1.0, 0.0, math.pi * environment.mean)
    return distant


def _portals(world: World | None, environment: EnvironmentMap) -> dict[str, Any]:
    """Fields of `LightArrays` about light portals: none of a background whose map is not sampled."""
    found = world.portals if world is not None and environment.mean > 0.0 else ()
    portals = build_portals(found, is_uniform=environment.compensated is None)
    return {"portals": portals, "portal_kernels": link_portals() if len(portals) else no_portal_kernels()}


def _compensated(environment: EnvironmentMap, world: World | None) -> EnvironmentMap:
    """The map without what scattering finds; empty where each has to find all light by itself."""
    found = environment.compensated
    if found is None or world is None or not world.cast_shadow or world.max_bounces < _UNLIMITED_BOUNCES:
        return empty_map()
    return found


def build_lights(
    description: SceneDescription,
    geometry: GeometryArrays,
    program_info: ProgramInfo,
    environment: EnvironmentMap | None = None,
    notices: list[Notice] | None = None,
    media: SceneMedia | None = None,
) -> LightArrays:
    """Everything that emits, ready to be sampled.

    Parameters
    ----------
    description : SceneDescription
        Lights and world are read.
    geometry : GeometryArrays
    program_info : ProgramInfo
    environment : EnvironmentMap or None
        The world's radiance on a grid of directions. None: the background is not sampled as a light, scattered rays
        find it; right for worlds of one colour and for `World.sampling` 'NONE'.
    notices : list of Notice, appended to
    media : SceneMedia or None
        Instances with a medium inside receive light together where they overlap.
    """
    notices = [] if notices is None else notices
    triangles = find_triangles(geometry, program_info)
    lamps = convert_lamps(description.lights, program_info, notices)
    world = description.world
    if environment is None or world is None:
        environment = empty_map()

    triangle_count = len(triangles.rows)
    is_distant = lamps.is_distant
    local_count, distant_count = int((~is_distant).sum()), int(is_distant.sum())
    lamp_count = local_count + distant_count
    has_background = environment.mean > 0.0
    discs = environment.discs
    first_disc = triangle_count + lamp_count
    emitters = np.zeros((first_disc + len(discs) + has_background, la.EMITTER_WIDTH), np.int32)
    emitters[:triangle_count] = triangles.emitters
    lamps.table[:, la.LAMP_EMITTER] = triangle_count + np.arange(lamp_count)
    of_lamps = emitters[triangle_count:first_disc]
    _write_lamps(lamps, of_lamps)

    _write_discs(environment, world, program_info.world_program, emitters[first_disc:], distant_count)
    distant = _list_distant(environment, lamps, local_count, triangle_count + local_count)
    # Those that are infinitely far away come last.
    bounds = np.concatenate([triangles.bounds, lamps.bounds[:local_count]])
    blockers = find_blockers(description.linking, has_catchers=description.instances.has_catchers)
    # Kernels are compiled for scenes that link lights and shadows, or neither.
    sight = find_sight(
        description.linking, emitters, lamps.table[:, la.LAMP_LIGHT], media, notices, is_wanted=blockers is not None
    )
    bands, sectors, patches, patch_share = divide_map(environment)
    forest = build_forest(
        Emitters(emitters, triangles.rows, bounds, distant, bool(has_background)), sight, len(patch_share)
    )
    links = forest.links if sight is None else _link_shadows(forest, blockers, lamps)

    compensated = _compensated(environment, world)
    cut_size, cluster_share = len(forest.cluster_node), _cluster_share(forest, patch_share)
    header = _header(world, program_info, lamps, len(forest.emitters), cut_size, len(cluster_share))
    header[la.HEADER_FIRST_PATCH] = len(cluster_share) - forest.patch_count
    header[la.HEADER_UNLINKED] = len(emitters)
    header[la.HEADER_BACKGROUND_EMITTER] = len(emitters) - 1 if has_background else -1
    header[la.HEADER_FIRST_DISC] = first_disc
    header[la.HEADER_BANDS], header[la.HEADER_SECTORS] = bands, sectors
    sources = _sources(geometry, program_info, lamps)
    header[la.HEADER_SOURCES] = -1 if sources is None else len(sources)
    return LightArrays(
        header=header, nodes=forest.nodes, child=forest.child, parent=forest.parent, distant=forest.distant,
        emitters=forest.emitters, triangles=forest.triangles,
        sources=np.zeros((0, 4), np.float32) if sources is None else sources, lamps=lamps.values,
        lamp_table=lamps.table, varying=_varying(lamps), lookup_offset=triangles.lookup_offset, lookup=triangles.lookup,
        discs=discs, **_portals(world, environment), map_marginal=environment.marginal,
        map_conditional=environment.conditional,
        map_guide=environment.guide,
        compensated_marginal=compensated.marginal, compensated_conditional=compensated.conditional,
        compensated_guide=compensated.guide, map_patches=patches, node_cluster=forest.node_cluster,
        cluster_node=forest.cluster_node, cluster_share=cluster_share, selection=no_selection(), links=links,
    )  # fmt: skip
