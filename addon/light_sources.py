# SPDX-License-Identifier: GPL-3.0-or-later
"""What lights a view layer: lamps, materials that emit and the world, and the light groups that each is used in."""

from __future__ import annotations

import dataclasses
from collections import defaultdict
from collections.abc import Iterator

import bpy

from .emission_nodes import emitting_nodes
from .versions import uses_nodes


@dataclasses.dataclass
class Sources:
    """Data that emits, each with the names of the groups that it does so in; '' is none.

    lamps : dict of set of str, by Light
    materials : dict of set of str, by Material
    world : the scene's, None where it emits nothing
    """

    lamps: dict[bpy.types.Light, set[str]] = dataclasses.field(default_factory=lambda: defaultdict(set))
    materials: dict[bpy.types.Material, set[str]] = dataclasses.field(default_factory=lambda: defaultdict(set))
    world: bpy.types.World | None = None


def world_emits(world: bpy.types.World | None) -> bool:
    """Whether a world lights the scene."""
    if world is None:
        return False
    if not uses_nodes(world):
        return any(world.color)
    return bool(emitting_nodes(world.node_tree))


def material_emits(material: bpy.types.Material | None) -> bool:
    """Whether a material sends out light of its own."""
    return material is not None and uses_nodes(material) and bool(emitting_nodes(material.node_tree))


def is_lamp(item: bpy.types.Object) -> bool:
    """Whether an object is a lamp that emits: light portals do not."""
    return item.type == "LIGHT" and not getattr(getattr(item.data, "cycles", None), "is_portal", False)


def _materials(item: bpy.types.Object) -> Iterator[bpy.types.Material]:
    """Original materials of an object, which may be evaluated."""
    materials = [slot.material for slot in item.material_slots]
    materials += getattr(item.data, "materials", ())
    for material in materials:
        if material is not None:
            yield material.original


def emits(item: bpy.types.Object) -> bool:
    """Whether an object, or something in the collection that it instances, is a light source."""
    if item.instance_type == "COLLECTION" and item.instance_collection is not None:
        return any(emits(one) for one in item.instance_collection.all_objects if not one.hide_render)
    return is_lamp(item) or any(map(material_emits, _materials(item)))


def find_sources(scene: bpy.types.Scene, layer: bpy.types.ViewLayer, depsgraph: bpy.types.Depsgraph) -> Sources:
    """All that emits in a view layer, instances included; an instance without a group is in that of what instances it.

    Parameters
    ----------
    depsgraph : Depsgraph
        Evaluated: nodes of geometry may have given materials and made instances.
    """
    known = {group.name for group in layer.lightgroups}
    found = Sources(world=scene.world if world_emits(scene.world) else None)
    does_emit: dict[bpy.types.Material, bool] = {}

    def note(item: bpy.types.Object, group: str) -> None:
        name = group if group in known else ""
        if is_lamp(item):
            found.lamps[item.data.original].add(name)
        for material in _materials(item):
            if material not in does_emit:
                does_emit[material] = material_emits(material)
            if does_emit[material]:
                found.materials[material].add(name)

    for item in layer.objects:
        if not item.hide_render:
            note(item, item.lightgroup)
    # What comes out of this is gone with the next step.
    for instance in depsgraph.object_instances:
        item, parent = instance.object, instance.parent
        # Evaluated ones are as they were: nothing tells Blender to evaluate them anew for a group.
        group = item.original.lightgroup
        if instance.is_instance and not group and parent is not None:
            group = parent.original.lightgroup
        if not item.original.hide_render:
            note(item, group)
    return found
