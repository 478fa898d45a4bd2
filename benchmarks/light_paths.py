# SPDX-License-Identifier: GPL-3.0-or-later
"""The settings of a scene that decide what picture a render converges to, whoever renders it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

#: Names in `engine.settings.RenderSettings`, without what only changes noise, such as roulette and light thresholds.
_NAMES = (
    "max_bounces", "diffuse_bounces", "glossy_bounces", "transmission_bounces", "transparent_max_bounces",
    "use_caustics_reflective", "use_caustics_refractive", "filter_glossy", "clamp_direct", "clamp_indirect",
    "pixel_filter", "filter_width", "film_exposure", "film_transparent",
)  # fmt: skip


def light_paths(scene: Any, settings: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Light-path settings of an open scene, as far as they change what a render converges to.

    Parameters
    ----------
    scene : bpy.types.Scene
    settings : mapping, optional
        What a rival is told beside the scene's Cycles settings, by its name in `RenderSettings`; it wins.
    """
    from addon.shared_settings import cycles_value

    found = {name: cycles_value(scene, name) for name in _NAMES}
    return found | {name: value for name, value in (settings or {}).items() if name in found}


def differences(ours: Mapping[str, Any], theirs: Mapping[str, Any]) -> list[str]:
    """What differs, in words; nothing where one of them says nothing, as older records do."""
    if not ours or not theirs:
        return []
    return [
        f"{name} {ours.get(name)} instead of {theirs.get(name)}"
        for name in sorted({*ours, *theirs})
        if ours.get(name) != theirs.get(name)
    ]
