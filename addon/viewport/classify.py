# SPDX-License-Identifier: GPL-3.0-or-later
"""What a dependency graph's updates mean for the export: how much of the scene is to be read again. Holds no bpy.

Blender says which datablocks it has touched, and in a coarse way why. Most of what it says means nothing for the
picture: a name, a selection, a tab, colour management. Where it could mean something the scene is exported, as much of
it as can have changed, and the picture starts anew only if the description has come out different.
"""

from __future__ import annotations

import enum
from collections.abc import Iterable
from typing import NamedTuple


class Touched(NamedTuple):
    """An update of a datablock.

    kind : str, its RNA type ('Object', 'Material', ...); `object_kind` that of an object ('MESH', 'LIGHT', 'CAMERA')
    geometry, transform, shading : bool, as Blender flags them
    """

    kind: str
    object_kind: str = ""
    geometry: bool = False
    transform: bool = False
    shading: bool = False


class Change(enum.Flag):
    """What is to be read again."""

    NOTHING = 0
    CAMERA = enum.auto()
    MATERIALS = enum.auto()
    WORLD = enum.auto()
    LIGHTS = enum.auto()
    TRANSFORMS = enum.auto()
    SETTINGS = enum.auto()
    TOPOLOGY = enum.auto()


#: Datablocks that no picture depends on.
_IDLE = frozenset(
    {
        "Brush", "FreestyleLineStyle", "Library", "Palette", "PaintCurve", "Screen", "Sound", "Speaker", "Text",
        "WindowManager", "WorkSpace",
    }
)  # fmt: skip
#: Trees of materials, worlds and lights, and groups in them; and who has them, besides lights.
_TREES = frozenset({"NodeTree", "ShaderNodeTree"})
_OWNERS = frozenset({"Material", "World"})
#: What these show.
_TEXTURES = frozenset({"Image", "Texture", "ImageTexture", "MovieClip", "TextureNodeTree"})


def classify(updates: Iterable[Touched], *, reads_objects: bool = False) -> Change:
    """All that a batch of updates means.

    Parameters
    ----------
    updates : iterable of Touched
    reads_objects : bool
        Whether materials read properties of objects, of whose changes Blender tells no more than of a selection.
    """
    batch = list(updates)
    has_owner = any(update.kind in _OWNERS or update.kind.endswith("Light") for update in batch)
    change = Change.NOTHING
    for update in batch:
        # Blender tells of the owners of a changed tree too: whose tree it is follows from them.
        if not (has_owner and update.kind in _TREES):
            change |= _of_one(update, reads_objects)
    return change


def _of_one(update: Touched, reads_objects: bool) -> Change:
    flagged = update.geometry or update.transform or update.shading
    kind = update.kind
    if kind in _IDLE:
        return Change.NOTHING
    if kind == "Scene":
        return Change.SETTINGS
    if kind == "Camera":
        return Change.CAMERA
    if kind == "World":
        return Change.WORLD
    if kind == "Material":
        return Change.MATERIALS
    if kind in _TREES or kind in _TEXTURES:
        return Change.MATERIALS | Change.WORLD | Change.LIGHTS
    if kind.endswith("Light"):
        return Change.LIGHTS
    if kind == "Object":
        return _of_object(update, flagged, reads_objects)
    if kind == "Collection":
        return Change.TOPOLOGY
    # Meshes, curves, volumes, node groups of modifiers, actions, and whatever is yet to come.
    return Change.TOPOLOGY


def _of_object(update: Touched, flagged: bool, reads_objects: bool) -> Change:
    if not flagged:
        return Change.TOPOLOGY if reads_objects else Change.NOTHING
    if update.object_kind == "CAMERA":
        return Change.CAMERA
    if update.geometry:
        return Change.LIGHTS if update.object_kind == "LIGHT" else Change.TOPOLOGY
    change = Change.NOTHING
    if update.transform:
        change |= Change.LIGHTS if update.object_kind == "LIGHT" else Change.TRANSFORMS
    if update.shading:
        change |= Change.LIGHTS if update.object_kind == "LIGHT" else Change.MATERIALS
    return change
