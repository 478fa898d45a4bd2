# SPDX-License-Identifier: GPL-3.0-or-later
"""The light mix of a scene or of an image: a factor for each of its light groups, as the .blend file keeps it.

A group is a name that objects have, so it has one factor, in whatever view layers it is. The factors are the scene's
also because Blender keyframes no lists of view layers.

An image of a saved file has factors of its own (`light_mix_files`).

Users change it in the panel (`light_mix_panel`). A render adds a group that has no factor yet, and notes the mix in the
metadata of its files (`light_mix_picture`). The shown picture, files of a sequence (`light_mix_sequence`) and lamps
(`light_mix_lamps`) are made by it.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Iterable
from typing import Any

import bpy

from .shared_settings import setting_value

#: In front of a light group's name in its pass, in Blender as in Cycles.
PASS_PREFIX = "Combined_"
#: Fields of a file's metadata: the mix as it was when the file was rendered, and what Combined has been mixed by since.
FIELD, APPLIED_FIELD = "neuralguide.light_mix", "neuralguide.light_mix_applied"
#: By view layer: the group whose light has the background that a transparent film leaves out of Combined.
BACKGROUND_FIELD = "neuralguide.{layer}.background_in"

Factor = tuple[float, float, float]
NEUTRAL: Factor = (1.0, 1.0, 1.0)
OFF: Factor = (0.0, 0.0, 0.0)

#: What has a mix: a scene, that of its renders, or an image, that of its file of layers.
Owner = Any


def factor_of(entry: Any) -> Factor:
    """What the light of a group is multiplied by: strength times colour, or 0 where it is switched off."""
    if not entry.is_on:
        return OFF
    red, green, blue = (entry.strength * channel for channel in entry.color)
    return red, green, blue


def set_factor(entry: Any, factor: Factor) -> None:
    """Have a group multiplied by a factor: its largest channel is the strength, and the rest of it the colour."""
    entry.strength = strength = max(factor)
    if strength > 0.0:
        red, green, blue = factor
        entry.color = red / strength, green / strength, blue / strength
    else:
        entry.property_unset("strength")
        entry.is_on = False


def factors_of(owner: Owner) -> dict[str, Factor]:
    """The mix of a scene or of an image: a factor by group."""
    return {entry.name: factor_of(entry) for entry in owner.neuralguide.light_mix}


def group_names(scene: bpy.types.Scene) -> list[str]:
    """Light groups that any view layer has, each once."""
    names = [group.name for layer in scene.view_layers for group in getattr(layer, "lightgroups", ())]
    return list(dict.fromkeys(names))


def shown_factors(scene: bpy.types.Scene) -> dict[str, Factor]:
    """The same for the kept picture, whose lamps may have got other strengths by *Write Back to Lamps* since."""
    factors = {}
    for entry in scene.neuralguide.light_mix:
        red, green, blue = (one * written for one, written in zip(factor_of(entry), entry.written, strict=True))
        factors[entry.name] = (red, green, blue)
    return factors


def add_missing(owner: Owner, names: Iterable[str]) -> None:
    """Have a factor for each of these groups. None is taken away or moved: keyframes name them by their place."""
    mix = owner.neuralguide.light_mix
    for name in names:
        if name not in mix:
            mix.add().name = name


def reset_entry(entry: Any) -> None:
    """The factor of a group is 1 again."""
    for name in ("is_on", "strength", "color"):
        entry.property_unset(name)


def reset(owner: Owner, known: Collection[str]) -> None:
    """All factors are 1 again, and those of groups that are not `known` any longer go."""
    mix = owner.neuralguide.light_mix
    for index in reversed(range(len(mix))):
        if mix[index].name in known:
            reset_entry(mix[index])
        else:
            mix.remove(index)


def background_group(depsgraph: bpy.types.Depsgraph) -> str:
    """The light group of a view layer that has the background, though the picture has not; '' if none has.

    That is the world's, where the film is transparent and there is a pass Environment.
    """
    scene, layer = depsgraph.scene_eval, depsgraph.view_layer_eval
    group = getattr(scene.world, "lightgroup", "")
    is_left_out = setting_value(scene, "film_transparent") and layer.use_pass_environment
    return str(group) if is_left_out and group in getattr(layer, "lightgroups", ()) else ""


def to_text(factors: dict[str, Factor]) -> str:
    """Factors as a file's metadata has them."""
    return json.dumps({group: [round(value, 6) for value in factor] for group, factor in factors.items()})


def from_text(text: str) -> dict[str, Factor]:
    """Factors of a file's metadata.

    Raises
    ------
    ValueError
        If that is something else.
    """
    from engine.render.light_mix import checked_factors

    try:
        found = json.loads(text)
    except ValueError:
        found = None
    if not isinstance(found, dict):
        raise ValueError(f"its light mix is none: {text[:80]}")
    factors = {}
    for group, factor in checked_factors(found).items():
        red, green, blue = (float(value) for value in factor)
        factors[group] = (red, green, blue)
    return factors
