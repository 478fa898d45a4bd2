# SPDX-License-Identifier: GPL-3.0-or-later
"""Light linking and shadow linking: sets of objects, as Blender numbers them from collections of emitters.

Blender gives every object that some emitter's collection names a set: what is in the same collections in the same way
shares one. An emitter lights the sets that its collection includes, all of them if it includes none, but for those that
it excludes. Objects of nested collections go by the entry of the outermost.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import bpy
import numpy as np

from engine.scene.linking import ALL_SETS, MOST_SETS, Linking

from ..versions import read_setting
from .context import ExportContext
from .instances import Appearance


def _objects_below(collection: bpy.types.Collection) -> Iterator[bpy.types.Object]:
    for child in collection.children:
        yield from _objects_below(child)
    yield from collection.objects


def _entries(collection: bpy.types.Collection) -> Iterator[tuple[bpy.types.Object, bool]]:
    """Objects of a collection, and whether they are included; the last entry of an object counts."""
    for entry, child in zip(collection.collection_children, collection.children, strict=True):
        for found in _objects_below(child):
            yield found, entry.light_linking.link_state == "INCLUDE"
    for entry, found in zip(collection.collection_objects, collection.objects, strict=True):
        yield found, entry.light_linking.link_state == "INCLUDE"


@dataclass
class _Sets:
    """Sets that collections of one purpose make.

    Attributes
    ----------
    of_object : dict of int
        By address of the original object, for those in a set but 0.
    of_collection : dict of int
        Bits of the sets that an emitter with that collection reaches, by the collection's address.
    """

    of_object: dict[int, int] = field(default_factory=dict)
    of_collection: dict[int, int] = field(default_factory=dict)


def _make_sets(context: ExportContext, collections: list[bpy.types.Collection], purpose: str) -> _Sets:
    sets = _Sets()
    if len(collections) > MOST_SETS:
        context.notice(
            context.scene.name, f"more than {MOST_SETS} collections for {purpose} are not supported",
            "the others are as if they were not chosen",
        )  # fmt: skip
    entries: dict[int, dict[int, bool]] = {}
    for number, collection in enumerate(collections[:MOST_SETS]):
        for found, is_included in _entries(collection):
            entries.setdefault(found.original.as_pointer(), {})[number] = is_included
    numbers: dict[tuple[tuple[int, bool], ...], int] = {}
    for address, states in entries.items():
        number = numbers.setdefault(tuple(sorted(states.items())), len(numbers) + 1)
        if number < MOST_SETS:
            sets.of_object[address] = number
    if len(numbers) >= MOST_SETS:
        context.notice(
            context.scene.name, f"more than {MOST_SETS} sets of objects for {purpose} are not supported",
            "the others are as if they were in no collection",
        )
    for number, collection in enumerate(collections[:MOST_SETS]):
        included = excluded = 0
        for pairs, row in numbers.items():
            known = dict(pairs)
            if row < MOST_SETS and number in known:
                included |= (1 << row) * known[number]
                excluded |= (1 << row) * (not known[number])
        sets.of_collection[collection.as_pointer()] = (included or ALL_SETS) & ~excluded
    return sets


def _collection_of(kind: Appearance, name: str) -> bpy.types.Collection | None:
    """A collection of an emitter, None: it reaches everything."""
    linking = read_setting(kind.owner, "light_linking")
    chosen = None if linking is None else getattr(linking, name)
    return None if chosen is None else chosen.original


def _set_of(kind: Appearance, sets: _Sets) -> int:
    """The set of an object as one that emitters reach; an instance is in that of its instancer, if that has one."""
    parent = 0 if kind.instancer is None else sets.of_object.get(kind.instancer.original.as_pointer(), 0)
    return parent or sets.of_object.get(kind.owner.original.as_pointer(), 0)


def export_linking(
    context: ExportContext, kinds: list[Appearance], kind_of: np.ndarray, lamps: list[Appearance]
) -> Linking | None:
    """Who is lit, and who casts shadows, by whom; None: everything by everyone.

    Parameters
    ----------
    kinds : list of Appearance
    kind_of : int32 (N,), row of `kinds` of each instance
    lamps : list of Appearance, one a light
    """
    columns: list[np.ndarray] = []
    is_used = False
    for name, purpose in (("receiver_collection", "light linking"), ("blocker_collection", "shadow linking")):
        found = [_collection_of(kind, name) for kind in kinds]
        unique = {one.as_pointer(): one for one in found if one is not None}
        is_used = is_used or bool(unique)
        sets = _make_sets(context, list(unique.values()), purpose)
        bits = [ALL_SETS if one is None else sets.of_collection.get(one.as_pointer(), ALL_SETS) for one in found]
        rows = {id(kind): row for row, kind in enumerate(kinds)}
        columns += [
            np.array([_set_of(kind, sets) for kind in kinds], np.int32).reshape(-1)[kind_of],
            np.array(bits, np.uint64).reshape(-1)[kind_of],
            np.array([bits[rows[id(kind)]] for kind in lamps], np.uint64),
        ]
    if not is_used:
        return None
    receiver_set, surface_receivers, lamp_receivers, blocker_set, surface_blockers, lamp_blockers = columns
    return Linking(
        receiver_set, blocker_set, surface_receivers, surface_blockers, lamp_receivers, lamp_blockers
    )
