# SPDX-License-Identifier: GPL-3.0-or-later
"""The world: background shader, how it is sampled, who sees it."""

from __future__ import annotations

import bpy

from engine.scene.description import (
    VISIBLE_CAMERA,
    VISIBLE_DIFFUSE,
    VISIBLE_GLOSSY,
    VISIBLE_TRANSMISSION,
    VISIBLE_VOLUME,
    World,
)

from ..versions import read_setting, uses_nodes
from .context import ExportContext, cycles_property
from .nodes import GraphExporter

_VISIBILITY = (
    ("camera", VISIBLE_CAMERA),
    ("diffuse", VISIBLE_DIFFUSE),
    ("glossy", VISIBLE_GLOSSY),
    ("transmission", VISIBLE_TRANSMISSION),
    ("scatter", VISIBLE_VOLUME),
)


def world_of(context: ExportContext) -> bpy.types.World | None:
    """The world of the view layer, whether it shines there or not."""
    return getattr(context.view_layer, "world_override", None) or context.scene.world


def export_world(context: ExportContext, graphs: GraphExporter) -> World | None:
    """The world of the view layer; None where there is none or the layer leaves it out."""
    world = world_of(context)
    if world is None or not context.view_layer.use_sky:
        return None
    graph = graphs.export(world.node_tree, world.name) if uses_nodes(world) else None
    return World(
        key=("world", world.name_full),
        name=world.name,
        graph=graph,
        color=tuple(world.color),
        visibility=world_visibility(world),
        sampling=cycles_property(world, "sampling_method", "AUTOMATIC"),
        map_resolution=cycles_property(world, "sample_map_resolution", 1024),
        max_bounces=cycles_property(world, "max_bounces", 1024),
        cast_shadow=bool(read_setting(world, "cycles.use_shadows")),
        light_group=context.light_group(world),
    )


def world_visibility(world: bpy.types.World) -> int:
    """VISIBLE_* bits of the rays that see a world."""
    visibility = 0
    for name, bit in _VISIBILITY:
        if cycles_property(world, name, True, group="cycles_visibility"):
            visibility |= bit
    return visibility
