# SPDX-License-Identifier: GPL-3.0-or-later
"""Properties of objects that Attribute nodes read, found as Cycles finds them."""

from __future__ import annotations

import re
from typing import Any

import bpy

from engine.scene.attribute_names import PARTICLE

Value = tuple[float, float, float, float]

#: Where no one has a property.
NOTHING: Value = (0.0, 0.0, 0.0, 0.0)
#: What stands for numbers that a property lacks.
_BLACK: Value = (0.0, 0.0, 0.0, 1.0)
#: A path that may end at one number of a vector or colour, and that to the whole.
_ELEMENT = re.compile(r"(.+)(?:\[\d+\]|\.[rgbwxyz])")


def find_property(item: bpy.types.DepsgraphObjectInstance, request: str) -> tuple[Value, bool]:
    """Value of a property of an instance, zeros where no one has it; whether attributes of instances come before it.

    Parameters
    ----------
    request : str
        "object:name", or "instancer:name" to ask the particle system and the instancer first. Of "particle:name" no
        object knows anything.
    """
    kind, _, name = request.partition(":")
    if request.startswith(PARTICLE):
        return NOTHING, False
    owners: list[Any] = []
    is_instanced = kind == "instancer" and item.is_instance
    if is_instanced:
        if item.particle_system is not None:
            value = read_property(item.particle_system.settings, name)
            if value is not None:
                return value, False
        owners.append(item.parent)
    owners += [_owner(item, name), item.object.data]
    for owner in owners:
        value = None if owner is None else read_property(owner, name)
        if value is not None:
            return value, is_instanced
    return NOTHING, is_instanced


def _owner(item: bpy.types.DepsgraphObjectInstance, name: str) -> Any:
    """Whose property of the object it is: Blender gives instances the colour of what instances them.

    `item.object` has that only where Python had not met what is instanced before.
    """
    is_color = name == "color" and item.object.get(name) is None
    return item.parent if item.is_instance and is_color else item.object


def read_property(owner: Any, name: str) -> Value | None:
    """A custom property, or else an RNA path, of a datablock: a number, a switch, or up to four numbers."""
    value = owner.get(name)
    if value is None:
        element = _ELEMENT.fullmatch(name)
        try:
            # Paths lead to properties: one number of an array is none.
            if element and not hasattr(owner.path_resolve(element[1]), "bl_rna"):
                return None
            value = owner.path_resolve(name)
        except (ValueError, AttributeError):
            return None
    if isinstance(value, (int, float)):
        return (float(value), float(value), float(value), 1.0)
    if isinstance(value, str):
        return None
    try:
        numbers = list(value)
    except TypeError:
        return None
    if len(numbers) > 4 or not all(isinstance(number, (int, float)) for number in numbers):
        return None
    if any(isinstance(number, bool) for number in numbers):
        return None
    red, green, blue, alpha = [*map(float, numbers), *_BLACK[len(numbers) :]]
    return (red, green, blue, alpha)
