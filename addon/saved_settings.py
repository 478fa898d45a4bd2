# SPDX-License-Identifier: GPL-3.0-or-later
"""Files keep their pictures: those saved before scenes could follow Cycles' settings go on with their own.

Such a file has settings of ours, but says nothing of `use_cycles_settings`. A file saved now says it wherever it has
settings of ours, so that the two can be told apart.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import bpy

#: Defaults of that time which are others now.
_FORMER_DEFAULTS = {"samples": 128, "clamp_indirect": 0.0}


def _is_undecided(scene: bpy.types.Scene) -> bool:
    """Whether a scene has settings of ours without saying whether it follows Cycles."""
    ours = scene.neuralguide
    if ours.is_property_set("use_cycles_settings"):
        return False
    return any(ours.is_property_set(name) for name in ours.bl_rna.properties.keys() if name not in ("rna_type", "name"))


def _keep_pictures(scenes: Iterable[bpy.types.Scene]) -> None:
    """Have scenes from before go on with settings of their own."""
    for scene in scenes:
        if _is_undecided(scene):
            ours = scene.neuralguide
            ours.use_cycles_settings = False
            for name, value in _FORMER_DEFAULTS.items():
                if not ours.is_property_set(name):
                    setattr(ours, name, value)


@bpy.app.handlers.persistent
def _after_loading(*_args: Any) -> None:
    _keep_pictures(bpy.data.scenes)


@bpy.app.handlers.persistent
def _after_importing(context: Any, *_args: Any) -> None:
    """Scenes that are appended or linked."""
    _keep_pictures(item.id for item in context.import_items if isinstance(item.id, bpy.types.Scene))


@bpy.app.handlers.persistent
def _mark(*_args: Any) -> None:
    """Say of every scene with settings of ours whether it follows Cycles."""
    for scene in bpy.data.scenes:
        if _is_undecided(scene):
            scene.neuralguide.use_cycles_settings = True


def _handlers() -> list[tuple[list[Any], Any]]:
    handlers = [(bpy.app.handlers.load_post, _after_loading), (bpy.app.handlers.save_pre, _mark)]
    if hasattr(bpy.app.handlers, "blend_import_post"):  # from Blender 4.3
        handlers.append((bpy.app.handlers.blend_import_post, _after_importing))
    return handlers


def register() -> None:
    """Look at the open file, and at every one that is opened or saved from now on."""
    for handlers, handler in _handlers():
        handlers.append(handler)
    if hasattr(bpy.data, "scenes"):  # while Blender starts there is no file yet
        _after_loading()


def unregister() -> None:
    """Stop looking; scenes in memory are told from those of old files when the add-on is enabled again."""
    for handlers, handler in _handlers():
        if handler in handlers:
            handlers.remove(handler)
    if hasattr(bpy.data, "scenes"):
        _mark()
