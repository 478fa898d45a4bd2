# SPDX-License-Identifier: GPL-3.0-or-later
"""*Write Back to Lamps*: lamps, worlds and materials get what the light mix multiplies their light by.

A group is written as a whole or not at all, so that its factor can be 1 afterwards and the next render shows what the
mix has shown.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import bpy

from . import light_mix, light_mix_picture
from .animated_paths import animated_paths
from .emission_nodes import emission_sockets, emitting_nodes, multiply_emission
from .light_sources import Sources, find_sources
from .versions import uses_nodes

#: Things that a message names.
_MOST_NAMED = 6

_Edit = Callable[[], None]


class _Writer:
    """What has to be changed for one group, and why that cannot be.

    Attributes
    ----------
    edits : list of callable
    problems : list of str
    """

    def __init__(self, group: str, strength: float, color: tuple[float, float, float]) -> None:
        self.edits: list[_Edit] = []
        self.problems: list[str] = []
        self._group, self._strength, self._color = group, strength, color

    def _may_change(self, data: Any, what: str, users: set[str], paths: set[str]) -> bool:
        """Whether a datablock is this group's alone and may be changed; notes why it is not."""
        others = sorted(users - {self._group})
        animated = sorted(paths & animated_paths(data))
        if others:
            named = ", ".join(f"group {other}" if other else "objects without a group" for other in others)
            self.problems.append(f"{what} is used by {named} too")
        elif data.library is not None:
            self.problems.append(f"{what} is linked from another file")
        elif animated:
            self.problems.append(f"{what} is animated ({', '.join(animated)})")
        else:
            return True
        return False

    def lamp(self, lamp: bpy.types.Light, users: set[str]) -> None:
        """Plan to change a lamp."""
        if self._may_change(lamp, f"lamp {lamp.name}", users, {"energy", "color"}):
            self.edits.append(lambda: self._change_lamp(lamp))

    def _change_lamp(self, lamp: bpy.types.Light) -> None:
        lamp.energy *= self._strength
        lamp.color = [one * factor for one, factor in zip(lamp.color, self._color, strict=True)]

    def nodes(self, owner: bpy.types.Material | bpy.types.World, what: str, users: set[str]) -> None:
        """Plan to change what nodes of a material or a world emit."""
        if owner.library is not None or users != {self._group}:
            self._may_change(owner, what, users, set())
            return
        tree = owner.node_tree
        for node, outer in emitting_nodes(tree):
            if node != outer:
                self.problems.append(f"{what} emits in the node group {outer.name}")
                continue
            paths = {socket.path_from_id("default_value") for socket in emission_sockets(node)}
            if self._may_change(tree, f"{what}, node {node.name},", users, paths):
                self.edits.append(lambda node=node: multiply_emission(tree, node, self._strength, self._color))  # type: ignore[misc]

    def plain_world(self, world: bpy.types.World) -> None:
        """Plan to change a world without nodes."""
        if self._may_change(world, f"world {world.name}", {self._group}, {"color"}):
            self.edits.append(lambda: self._change_plain_world(world))

    def _change_plain_world(self, world: bpy.types.World) -> None:
        world.color = [one * self._strength * factor for one, factor in zip(world.color, self._color, strict=True)]


def _plan(group: str, strength: float, color: tuple[float, float, float], sources: Sources) -> _Writer:
    writer = _Writer(group, strength, color)
    for lamp, users in sources.lamps.items():
        if group in users:
            writer.lamp(lamp, users)
    for material, users in sources.materials.items():
        if group in users:
            writer.nodes(material, f"material {material.name}", users)
    world = sources.world
    if world is not None and world.lightgroup == group:
        if uses_nodes(world):
            writer.nodes(world, f"world {world.name}", {group})
        else:
            writer.plain_world(world)
    if not writer.edits and not writer.problems:
        writer.problems.append("nothing emits in it")
    return writer


def write_back(
    scene: bpy.types.Scene, layer: bpy.types.ViewLayer, depsgraph: bpy.types.Depsgraph
) -> tuple[list[str], list[str]]:
    """Multiply what emits in each group by the group's factor, which is 1 from then on.

    Returns
    -------
    written : list of str
        Names of groups.
    problems : list of str
        A sentence for each group that was left as it is.
    """
    sources = find_sources(scene, layer, depsgraph)
    written, problems = [], []
    for entry in scene.neuralguide.light_mix:
        factor = light_mix.factor_of(entry)
        if factor == light_mix.NEUTRAL:
            continue
        if entry.name not in layer.lightgroups:
            problems.append(f"{entry.name}: the view layer has no such light group")
            continue
        writer = _plan(entry.name, entry.strength if entry.is_on else 0.0, tuple(entry.color), sources)
        animated = sorted(path for path in animated_paths(scene) if path.startswith(entry.path_from_id() + "."))
        if animated:
            writer.problems.append("its factor is animated")
        if writer.problems:
            more = len(writer.problems) - _MOST_NAMED
            named = "; ".join(writer.problems[:_MOST_NAMED]) + (f"; {more} more" if more > 0 else "")
            problems.append(f"{entry.name}: {named}")
            continue
        for edit in writer.edits:
            edit()
        entry.written = [one * more for one, more in zip(entry.written, factor, strict=True)]
        light_mix.reset_entry(entry)
        written.append(entry.name)
    return written, problems


class NEURALGUIDE_OT_write_light_mix(bpy.types.Operator):  # noqa: N801 (Blender's convention)
    """Multiply energy and colour of the lamps of each group by its factor, and so the world's strength and materials
    that only this group uses. Factors of groups that were written are 1 then"""

    bl_idname = "neuralguide.write_light_mix"
    bl_label = "Write Back to Lamps"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Write, and say what could not be."""
        scene = context.scene
        written, problems = write_back(scene, context.view_layer, context.evaluated_depsgraph_get())
        for problem in problems:
            self.report({"WARNING"}, f"Not written: {problem}")
        if not written:
            if not problems:
                self.report({"INFO"}, "All factors are 1: there is nothing to write")
            return {"CANCELLED"}
        light_mix_picture.show(scene)
        self.report({"INFO"}, f"Written: {', '.join(written)}")
        return {"FINISHED"}


def register() -> None:
    """Register the operator."""
    bpy.utils.register_class(NEURALGUIDE_OT_write_light_mix)


def unregister() -> None:
    """Unregister it."""
    bpy.utils.unregister_class(NEURALGUIDE_OT_write_light_mix)
