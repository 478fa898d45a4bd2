# SPDX-License-Identifier: GPL-3.0-or-later
"""Files keep what they had: settings that have moved since, and whose settings counted.

Settings for experiments lay among the others once; they are moved to `scene.neuralguide.experiment`, with their
animation. What is there no more stays in the file and does nothing.

Scenes saved before they could follow Cycles' settings go on with their own, and those saved while every picture was
unbiased stay so. Such a scene has settings of ours, but says nothing of `use_cycles_settings`, or of `radiance_cache`.
A file saved now says both wherever it has settings of ours, so that old ones can be told.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import bpy

from .app_handlers import add_handlers, remove_handlers
from .declared_settings import EXPERIMENT, SCENE_SETTINGS, setting_owner

#: Settings whose default is another now, and what it was. Files say them wherever they have settings of ours.
_SAID = {"use_cycles_settings": False, "radiance_cache": "OFF", "caustics": "PATHS"}
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


def _unsaid(scene: bpy.types.Scene) -> list[str]:
    """What a scene that has settings of ours does not say of those whose default is another now."""
    stored = _stored(scene)
    if stored is None:
        return []
    # By what is stored, since a setting that is there no more tells as much.
    has_settings = any(name not in (EXPERIMENT, "name") for name in stored.keys())
    has_experiments = len(stored.get(EXPERIMENT, ())) > 0
    return [name for name in _SAID if name not in stored] if has_settings or has_experiments else []


def _keep_pictures(scenes: Iterable[bpy.types.Scene]) -> None:
    """Have scenes from before go on with what they had."""
    for scene in scenes:
        ours, unsaid = scene.neuralguide, _unsaid(scene)
        for name in unsaid:
            setattr(ours, name, _SAID[name])
        if "use_cycles_settings" in unsaid:
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
    """Have every scene with settings of ours say those whose default is another now."""
    for scene in bpy.data.scenes:
        for name in _unsaid(scene):
            setattr(scene.neuralguide, name, getattr(scene.neuralguide, name))


def _handlers() -> list[tuple[list[Any], Any]]:
    handlers = [(bpy.app.handlers.load_post, _after_loading), (bpy.app.handlers.save_pre, _mark)]
    if hasattr(bpy.app.handlers, "blend_import_post"):  # from Blender 4.3
        handlers.append((bpy.app.handlers.blend_import_post, _after_importing))
    return handlers


def register() -> None:
    """Look at the open file, and at every one that is opened or saved from now on."""
    add_handlers(_handlers())
    if hasattr(bpy.data, "scenes"):  # while Blender starts there is no file yet
        _after_loading()


def unregister() -> None:
    """Stop looking; scenes in memory are told from those of old files when the add-on is enabled again."""
    remove_handlers(_handlers())
    if hasattr(bpy.data, "scenes"):
        _mark()
