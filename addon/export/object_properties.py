# SPDX-License-Identifier: GPL-3.0-or-later
"""Properties of objects that Attribute nodes read, found as Cycles finds them."""

from __future__ import annotations

import re
from typing import Any

import bpy

#: Begins the requests of Attribute nodes of that type.
INSTANCER = "instancer"

Value = tuple[float, float, float, float]

#: A path that may end at a component of a vector or colour, and that to the whole.
_COMPONENT = re.compile(r"(.+)(?:\[\d+\]|\.[rgbwxyz])")


def find_property(item: bpy.types.DepsgraphObjectInstance, request: str) -> Value:
    """Value of a property of an instance; zeros where no one has it.

    Parameters
    ----------
    request : str
        "object:name", or "instancer:name" to ask the particle system and the instancer first.
    """
    kind, _, name = request.partition(":")
    owners: list[Any] = []
    if kind == INSTANCER and item.is_instance:
        if item.particle_system is not None:
            owners.append(item.particle_system.settings)
        owners.append(item.parent)
    owners += [_owner(item, name), item.object.data]
    for owner in owners:
        value = read_property(owner, name)
        if value is not None:
            return value
    return (0.0, 0.0, 0.0, 0.0)


def _owner(item: bpy.types.DepsgraphObjectInstance, name: str) -> Any:
    """Whose property of the object it is: Blender gives instances the colour of what instances them.

    `item.object` has that only where Python had not met what is instanced before.
    """
    is_color = name == "color" and item.object.get(name) is None
    return item.parent if item.is_instance and is_color else item.object


def _resolve(owner: Any, path: str) -> Any:
    """What an RNA path leads to, None where that is nothing or a component of an array, which Cycles does not find."""
    component = _COMPONENT.fullmatch(path)
    try:
        if component and not hasattr(owner.path_resolve(component[1]), "bl_rna"):
            return None
        return owner.path_resolve(path)
    except (ValueError, AttributeError):
        return None


def read_property(owner: Any, name: str) -> Value | None:
    """A custom property, or else an RNA path, of a datablock: one number or up to four."""
    value = owner.get(name)
    if value is None:
        value = _resolve(owner, name)
    if isinstance(value, str):
        return None
    if isinstance(value, (bool, int, float)):
        return (float(value), float(value), float(value), 1.0)
    try:
        numbers = [float(number) for number in value]
    except (TypeError, ValueError):
        return None
    if len(numbers) > 4:
        return None
    red, green, blue, alpha = [*numbers, *(0.0, 0.0, 0.0, 1.0)[len(numbers) :]]
    return (red, green, blue, alpha)
