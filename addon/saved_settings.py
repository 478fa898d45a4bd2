# SPDX-License-Identifier: GPL-3.0-or-later
"""Files keep what they had: settings that have moved since, and whose settings counted.

Settings for experiments lay among the others once; they are moved to `scene.neuralguide.experiment`, with their
animation. What is there no more stays in the file and does nothing.

Scenes saved before they could follow Cycles' settings go on with their own. Such a scene has settings of ours, but says
nothing of `use_cycles_settings`. A file saved now says it wherever it has settings of ours, so that the two can be told
apart.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import bpy

from .declared_settings import EXPERIMENT, SCENE_SETTINGS, setting_owner

#: Defaults of scenes from before they could follow Cycles, which are others now.
_FORMER_DEFAULTS = {"samples": 128, "clamp_indirect": 0.0, "use_denoising": False, "use_adaptive_sampling": False}


def _stored(scene: bpy.types.Scene) -> Any:
    """What a scene's file holds of `scene.neuralguide`, whatever is registered; None where that is nothing."""
    # From Blender 5.0 properties of add-ons are apart from those of users.
    holder = scene.bl_system_properties_get() if hasattr(scene, "bl_system_properties_get") else scene
    return None if holder is None else holder.get("neuralguide")


def _set_stored(group: bpy.types.PropertyGroup, name: str, value: Any) -> None:
    """Set a property to a value as files hold it: choices by their number, switches as 0 or 1."""
    kind = group.bl_rna.properties[name]
    if kind.type == "ENUM":
        names = [item.identifier for item in kind.enum_items if item.value == value]
        if names:  # else a number that no version has written
            setattr(group, name, names[0])
    else:
        setattr(group, name, bool(value) if kind.type == "BOOLEAN" else value)


def _move_experiments(scenes: Iterable[bpy.types.Scene]) -> None:
    """Move settings for experiments to where they are now."""
    names = [setting.name for setting in SCENE_SETTINGS.values() if setting.is_experiment]
    for scene in scenes:
        stored = _stored(scene)
        for name in names:
            if stored is not None and name in stored:
                _set_stored(setting_owner(scene, name), name, stored.pop(name))


def _curves() -> Iterator[bpy.types.FCurve]:
    """Animation that may be of a scene: curves of actions, and drivers of scenes."""
    for action in bpy.data.actions:
        if hasattr(action, "layers"):  # from Blender 4.4
            for layer in action.layers:
                for strip in layer.strips:
                    for bag in strip.channelbags:
                        yield from bag.fcurves
        else:
            yield from action.fcurves
    for scene in bpy.data.scenes:
        if scene.animation_data is not None:
            yield from scene.animation_data.drivers


def _move_animation() -> None:
    """Have animation of settings for experiments find them where they are now."""
    moved = {
        f"neuralguide.{setting.name}": f"neuralguide.{EXPERIMENT}.{setting.name}"
        for setting in SCENE_SETTINGS.values()
        if setting.is_experiment
    }
    for curve in _curves():
        if curve.data_path in moved:
            curve.data_path = moved[curve.data_path]


def _is_undecided(scene: bpy.types.Scene) -> bool:
    """Whether a scene has settings of ours without saying whether it follows Cycles."""
    stored = _stored(scene)
    if stored is None or "use_cycles_settings" in stored:
        return False
    # By what is stored, since a setting that is there no more tells as much.
    return len(stored.get(EXPERIMENT, ())) > 0 or any(name not in (EXPERIMENT, "name") for name in stored.keys())


def _keep_pictures(scenes: Iterable[bpy.types.Scene]) -> None:
    """Have scenes from before go on with settings of their own."""
    for scene in scenes:
        if _is_undecided(scene):
            ours = scene.neuralguide
            ours.use_cycles_settings = False
            for name, value in _FORMER_DEFAULTS.items():
                if not ours.is_property_set(name):
                    setattr(ours, name, value)


def _bring_up_to_date(scenes: list[bpy.types.Scene]) -> None:
    _move_experiments(scenes)
    _move_animation()
    _keep_pictures(scenes)


@bpy.app.handlers.persistent
def _after_loading(*_args: Any) -> None:
    _bring_up_to_date(list(bpy.data.scenes))


@bpy.app.handlers.persistent
def _after_importing(context: Any, *_args: Any) -> None:
    """Scenes that are appended or linked."""
    _bring_up_to_date([item.id for item in context.import_items if isinstance(item.id, bpy.types.Scene)])


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
