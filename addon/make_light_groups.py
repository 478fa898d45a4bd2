# SPDX-License-Identifier: GPL-3.0-or-later
"""*Make Light Groups*: lamps, objects that emit and the world are put into groups, at one click."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import bpy

from .light_sources import emits, is_lamp, world_emits

#: Each group is a pass of the picture: this many are mixed by hand, and more fill the memory.
MOST_GROUPS = 32
_WORLD = "World"
_LAMP_KINDS = {"POINT": "Point Lamps", "SUN": "Suns", "SPOT": "Spots", "AREA": "Area Lamps"}
_INSTANCES, _GLOWING = "Instances", "Glowing Objects"


def _collection_name(scene: bpy.types.Scene, item: bpy.types.Object) -> str:
    """The first collection of the scene that an object is in."""
    collections = [collection.name for collection in scene.collection.children_recursive]
    names = {collection.name for collection in item.users_collection}
    return next((name for name in collections if name in names), scene.name)


def _kind_name(_scene: bpy.types.Scene, item: bpy.types.Object) -> str:
    if is_lamp(item):
        return _LAMP_KINDS[item.data.type]
    return _INSTANCES if item.instance_type == "COLLECTION" else _GLOWING


def _object_name(_scene: bpy.types.Scene, item: bpy.types.Object) -> str:
    return str(item.name)


_NAMERS: dict[str, Callable[[bpy.types.Scene, bpy.types.Object], str]] = {
    "COLLECTION": _collection_name, "LAMP_KIND": _kind_name, "OBJECT": _object_name,
}  # fmt: skip


def _sources(layer: bpy.types.ViewLayer) -> Iterator[bpy.types.Object]:
    """Objects that light the layer; a collection that is instanced counts as its instance."""
    for item in layer.objects:
        if not item.hide_render and emits(item):
            yield item


def make_groups(scene: bpy.types.Scene, layer: bpy.types.ViewLayer, by: str) -> tuple[list[str], list[str]]:
    """Put all light of a view layer into groups; groups that nothing is in go.

    Parameters
    ----------
    by : str
        'COLLECTION', 'LAMP_KIND' or 'OBJECT'. The world has a group of its own.

    Returns
    -------
    groups : list of str
        Those that the layer has now.
    problems : list of str
        What has no group of these.

    Raises
    ------
    ValueError
        If they are too many; the scene is as it was.
    """
    wanted: dict[str, list[Any]] = {}
    problems = []
    for item in _sources(layer):
        if item.library is not None:
            problems.append(f"{item.name} is linked from another file")
        else:
            wanted.setdefault(_NAMERS[by](scene, item), []).append(item)
    # A collection may be called World too.
    world = [scene.world] if world_emits(scene.world) else []
    if world and scene.world.library is not None:
        problems.append(f"world {scene.world.name} is linked from another file")
        world = []
    count = len(wanted) + len(world)
    if count > MOST_GROUPS:
        raise ValueError(
            f"these would be {count} light groups, and each takes a pass and its memory: {MOST_GROUPS} at most. "
            "Choose By Collection, or By Lamp Kind"
        )
    groups = {group.name: group for group in layer.lightgroups}
    kept: set[str] = set()
    for name, owners in [*wanted.items(), *([(_WORLD, world)] if world else [])]:
        # Blender changes names that files of layers cannot have, or that there are twice.
        safe = name.replace(".", "_")
        group = groups[safe] if safe in groups and safe not in kept else layer.lightgroups.add(name=name)
        kept.add(group.name)
        for owner in owners:
            owner.lightgroup = group.name
    used = kept | {item.lightgroup for item in layer.objects} | ({scene.world.lightgroup} if scene.world else set())
    for name, group in groups.items():
        if name not in used:
            layer.lightgroups.remove(group)
    return [group.name for group in layer.lightgroups], problems


class NEURALGUIDE_OT_make_light_groups(bpy.types.Operator):  # noqa: N801 (Blender's convention)
    """Put all lamps, all objects that emit, and the world into light groups of this view layer, which the next render
    has a pass of each for"""

    bl_idname = "neuralguide.make_light_groups"
    bl_label = "Make Light Groups"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012

    by: bpy.props.EnumProperty(  # type: ignore[valid-type]
        name="By",
        items=(
            ("COLLECTION", "By Collection", "A group for each collection that has lights"),
            ("LAMP_KIND", "By Lamp Kind", "A group for suns, spots, point lamps, area lamps, and one for what glows"),
            ("OBJECT", "By Object", "A group for each lamp and each object that emits"),
        ),
    )

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Make them."""
        try:
            groups, problems = make_groups(context.scene, context.view_layer, self.by)
        except ValueError as error:
            self.report({"ERROR"}, str(error)[0].upper() + str(error)[1:])
            return {"CANCELLED"}
        for problem in problems:
            self.report({"WARNING"}, f"In no group: {problem}")
        if not groups:
            self.report({"WARNING"}, "Nothing in this view layer emits light")
            return {"CANCELLED"}
        self.report({"INFO"}, f"{len(groups)} light groups: {', '.join(groups)}. Render to mix them")
        return {"FINISHED"}


def register() -> None:
    """Register the operator."""
    bpy.utils.register_class(NEURALGUIDE_OT_make_light_groups)


def unregister() -> None:
    """Unregister it."""
    bpy.utils.unregister_class(NEURALGUIDE_OT_make_light_groups)
