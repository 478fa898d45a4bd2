# SPDX-License-Identifier: GPL-3.0-or-later
"""Properties of objects that Attribute nodes read, found as Cycles finds them."""

from __future__ import annotations

from typing import Any

import bpy

from .context import ExportContext

Value = tuple[float, float, float, float]


def find_property(
    context: ExportContext, item: bpy.types.DepsgraphObjectInstance, request: str, subject: str
) -> Value:
    """Value of a property of an instance; zeros where no one has it.

    Parameters
    ----------
    request : str
        "object:name", or "instancer:name" to ask the particle system and the instancer first.
    """
    kind, _, name = request.partition(":")
    owners: list[Any] = []
    if kind == "instancer" and item.is_instance:
        if item.particle_system is not None:
            owners.append(item.particle_system.settings)
        owners.append(item.parent)
    owners += [_owner(item, name), item.object.data]
    for owner in owners:
        value = read_property(owner, name)
        if value is not None:
            return value
    if kind == "instancer" and item.is_instance:
        context.notice(subject, f"attribute {name!r} of geometry nodes' instances is not supported", "0")
    return (0.0, 0.0, 0.0, 0.0)


def _owner(item: bpy.types.DepsgraphObjectInstance, name: str) -> Any:
    """Whose property of the object it is: Blender gives instances the colour of what instances them.

    `item.object` has that only where Python had not met what is instanced before.
    """
    is_color = name.partition("[")[0] == "color" and item.object.get(name) is None
    return item.parent if item.is_instance and is_color else item.object


def read_property(owner: Any, name: str) -> Value | None:
    """A custom property, or else an RNA path, of a datablock: one number or up to four."""
    value = owner.get(name)
    if value is None:
        try:
            value = owner.path_resolve(name)
        except (ValueError, AttributeError):
            return None
    if isinstance(value, (bool, str)):
        return None
    if isinstance(value, (int, float)):
        return (float(value), float(value), float(value), 1.0)
    try:
        numbers = [float(number) for number in value]
    except (TypeError, ValueError):
        return None
    if len(numbers) > 4:
        return None
    red, green, blue, alpha = [*numbers, *(0.0, 0.0, 0.0, 1.0)[len(numbers) :]]
    return (red, green, blue, alpha)
