# SPDX-License-Identifier: GPL-3.0-or-later
"""Cycles' shadow caustics: which lamps, casters and receivers a scene names for them."""

from __future__ import annotations

import bpy

from .context import ExportContext, cycles_property
from .world import world_of

_LIGHT, _CASTER, _RECEIVER = _ROLES = ("is_caustics_light", "is_caustics_caster", "is_caustics_receiver")


def note_caustics(context: ExportContext, shown: bpy.types.Object) -> None:
    """Take note of what an object is to do with caustics."""
    # Changes of these switches do not update a dependency graph.
    owner: bpy.types.ID = shown.original
    roles: tuple[str, ...] = (_CASTER, _RECEIVER)
    if shown.type == "LIGHT":
        owner, roles = owner.data, (_LIGHT,)
    context.caustics_roles.update(role for role in roles if cycles_property(owner, role, False))


def asks_for_caustics(context: ExportContext) -> bool:
    """Whether some light is to come over some caster to some receiver."""
    world = world_of(context)
    if world is not None and cycles_property(world.original, _LIGHT, False):
        context.caustics_roles.add(_LIGHT)
    return context.caustics_roles.issuperset(_ROLES)
