# SPDX-License-Identifier: GPL-3.0-or-later
"""What a viewport renders by: the scene's settings, with those of Cycles that are for its viewport."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from engine.methods import METHODS, SOURCES
from engine.render.light_mix import checked_factors
from engine.settings import LEAST_GUIDED_SAMPLES, RenderSettings

from .. import light_mix
from ..properties import render_settings
from ..shared_settings import follows_cycles, setting_value
from ..versions import PAUSED_BY_WINDOW, is_since

if TYPE_CHECKING:
    import bpy

    from engine.viewport.view import Factor

#: Where Cycles' number is 0, without end: a day or so. Lengths of iterations are worked out ahead.
_ENDLESS_SAMPLES = 1 << 16

#: Settings of a render, and what a viewport has instead.
_OWN_SETTINGS = {
    "use_adaptive_sampling": "use_preview_adaptive_sampling",
    "adaptive_threshold": "preview_adaptive_threshold",
    "adaptive_min_samples": "preview_adaptive_min_samples",
    "use_denoising": "use_preview_denoising",
    "denoising_input_passes": "preview_denoising_input_passes",
    "denoising_prefilter": "preview_denoising_prefilter",
    "denoising_quality": "preview_denoising_quality",
}


def preview_settings(scene: bpy.types.Scene) -> RenderSettings:
    """What the process is told for a viewport.

    Raises
    ------
    ValueError
        As `render_settings`.
    """
    settings = render_settings(scene)
    samples = setting_value(scene, "preview_samples") or _ENDLESS_SAMPLES
    own = {name: setting_value(scene, cycles_name) for name, cycles_name in _OWN_SETTINGS.items()}
    return replace(
        settings, **own, samples=min(samples, _ENDLESS_SAMPLES), time_limit=0.0, denoised_threshold=0.0, strata=0,
        guiding_method=_method(settings.guiding_method, samples), radiance_cache=_cache(settings.radiance_cache),
        caustics=_caustics(settings.caustics),
    )  # fmt: skip


def denoises_from(scene: bpy.types.Scene) -> int:
    """Samples a pixel before which a viewport is not denoised."""
    return int(setting_value(scene, "preview_denoising_start_sample"))


def _method(name: str, samples: int) -> str:
    """Guiding that starts anew with every edit: networks would be trained for nothing, and few candidates pay."""
    if name == "OFF" or samples < LEAST_GUIDED_SAMPLES:
        return "OFF"
    source = METHODS[name].source
    return source if source and not SOURCES[source].is_network else "VMM"


def _caustics(kind: str) -> str:
    """So does a trial of photons, which keeps the first picture waiting."""
    return "PATHS" if kind == "AUTO" else kind


def _cache(kind: str) -> str:
    """A cache starts anew with every edit too: a viewport has one where a user has chosen it."""
    return "OFF" if kind == "AUTO" else kind


def shown_mix(depsgraph: bpy.types.Depsgraph) -> dict[str, Factor]:
    """What the light of each group of a view layer is multiplied by: 1 where the mix is switched off.

    Raises
    ------
    ValueError
        Naming a group whose factor makes no sense.
    """
    scene = depsgraph.scene
    groups = [group.name for group in getattr(depsgraph.view_layer_eval, "lightgroups", ())]
    factors = light_mix.factors_of(scene) if scene.neuralguide.use_light_mix else {}
    mix = {group: factors.get(group, light_mix.NEUTRAL) for group in groups}
    checked_factors(mix)
    return mix


def is_paused(scene: bpy.types.Scene, region_data: bpy.types.RegionView3D) -> bool:
    """Whether the pause button is pressed: the window's own, or Cycles' for all windows in older Blenders."""
    if is_since(PAUSED_BY_WINDOW):
        return bool(region_data.pause_render)
    return follows_cycles(scene) and bool(scene.cycles.preview_pause)
