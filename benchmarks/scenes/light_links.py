# SPDX-License-Identifier: GPL-3.0-or-later
"""Collections of what emitters light, and of what casts shadows in their light."""

from __future__ import annotations

from typing import Any

import bpy


def collection(name: str, *objects: Any, excluded: tuple[Any, ...] = (), children: tuple[Any, ...] = ()) -> Any:
    """A collection that belongs to no scene: its objects are included but for those that are excluded."""
    made = bpy.data.collections.new(name)
    for thing in (*objects, *excluded):
        made.objects.link(thing)
    for entry, thing in zip(made.collection_objects, made.objects, strict=True):
        entry.light_linking.link_state = "EXCLUDE" if thing in excluded else "INCLUDE"
    for child in children:
        made.children.link(child)
    return made


def link_light(thing: Any, chosen: Any) -> None:
    """Have an emitter light a collection."""
    thing.light_linking.receiver_collection = chosen


def link_shadows(thing: Any, chosen: Any) -> None:
    """Have a collection cast the shadows in an emitter's light."""
    thing.light_linking.blocker_collection = chosen
