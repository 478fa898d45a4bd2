# SPDX-License-Identifier: GPL-3.0-or-later
"""Settings that Cycles has too: who says what they are.

A scene that follows Cycles (`scene.neuralguide.use_cycles_settings`) goes by its Cycles settings, but for those of ours
that a script has set: these count from then on. With the switch off ours count alone, and so they do where the Cycles
add-on is off.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import bpy

#: Name in `scene.neuralguide` and in `RenderSettings`: owner below the scene, and the name there.
SHARED_SETTINGS: dict[str, tuple[str, str]] = {
    "samples": ("cycles", "samples"),
    "preview_samples": ("cycles", "preview_samples"),
    "use_preview_adaptive_sampling": ("cycles", "use_preview_adaptive_sampling"),
    "preview_adaptive_threshold": ("cycles", "preview_adaptive_threshold"),
    "preview_adaptive_min_samples": ("cycles", "preview_adaptive_min_samples"),
    "use_preview_denoising": ("cycles", "use_preview_denoising"),
    "preview_denoising_input_passes": ("cycles", "preview_denoising_input_passes"),
    "preview_denoising_prefilter": ("cycles", "preview_denoising_prefilter"),
    "preview_denoising_quality": ("cycles", "preview_denoising_quality"),
    "preview_denoising_start_sample": ("cycles", "preview_denoising_start_sample"),
    "use_adaptive_sampling": ("cycles", "use_adaptive_sampling"),
    "adaptive_threshold": ("cycles", "adaptive_threshold"),
    "adaptive_min_samples": ("cycles", "adaptive_min_samples"),
    "time_limit": ("cycles", "time_limit"),
    "seed": ("cycles", "seed"),
    "use_animated_seed": ("cycles", "use_animated_seed"),
    "max_bounces": ("cycles", "max_bounces"),
    "diffuse_bounces": ("cycles", "diffuse_bounces"),
    "glossy_bounces": ("cycles", "glossy_bounces"),
    "transmission_bounces": ("cycles", "transmission_bounces"),
    "volume_bounces": ("cycles", "volume_bounces"),
    "transparent_max_bounces": ("cycles", "transparent_max_bounces"),
    "min_light_bounces": ("cycles", "min_light_bounces"),
    "min_transparent_bounces": ("cycles", "min_transparent_bounces"),
    "light_sampling_threshold": ("cycles", "light_sampling_threshold"),
    "use_caustics_reflective": ("cycles", "caustics_reflective"),
    "use_caustics_refractive": ("cycles", "caustics_refractive"),
    "filter_glossy": ("cycles", "blur_glossy"),
    "clamp_direct": ("cycles", "sample_clamp_direct"),
    "clamp_indirect": ("cycles", "sample_clamp_indirect"),
    "pixel_filter": ("cycles", "pixel_filter_type"),
    "filter_width": ("cycles", "filter_width"),
    "film_exposure": ("cycles", "film_exposure"),
    "film_transparent": ("render", "film_transparent"),
    "use_denoising": ("cycles", "use_denoising"),
    "denoising_input_passes": ("cycles", "denoising_input_passes"),
    "denoising_prefilter": ("cycles", "denoising_prefilter"),
    "denoising_quality": ("cycles", "denoising_quality"),
}


def has_cycles(scene: bpy.types.Scene) -> bool:
    """Whether the scene has Cycles' settings: not where its add-on is off, or Blender was built without."""
    return hasattr(scene, "cycles")


def follows_cycles(scene: bpy.types.Scene) -> bool:
    """Whether Cycles' settings count for what a script has not set of ours."""
    ours = getattr(scene, "neuralguide", None)  # None where the add-on only exports
    return has_cycles(scene) and (ours is None or ours.use_cycles_settings)


def setting_source(scene: bpy.types.Scene, name: str) -> tuple[Any, str]:
    """Who says what a shared setting is: the owner, and the property's name there.

    Parameters
    ----------
    scene : Scene
        Original or evaluated.
    name : str
        One of `SHARED_SETTINGS`.
    """
    ours = getattr(scene, "neuralguide", None)
    owner_name, their_name = SHARED_SETTINGS[name]
    if follows_cycles(scene) and (ours is None or not ours.is_property_set(name)):
        theirs = getattr(scene, owner_name)
        if hasattr(theirs, their_name):
            return theirs, their_name
    return ours, name


def setting_value(scene: bpy.types.Scene, name: str) -> Any:
    """A shared setting as it counts for the render."""
    owner, own_name = setting_source(scene, name)
    return getattr(owner, own_name)


def cycles_value(scene: bpy.types.Scene, name: str) -> Any:
    """A shared setting as Cycles would render with it, whatever counts for us."""
    owner_name, their_name = SHARED_SETTINGS[name]
    return getattr(getattr(scene, owner_name), their_name)


def layer_samples(scene: bpy.types.Scene, view_layer: bpy.types.ViewLayer, samples: int) -> int:
    """Samples of a view layer: its own number where it has one, by the rule of Cycles' Layer Samples.

    Parameters
    ----------
    samples : int
        Those of the scene.
    """
    rule = getattr(scene.cycles, "use_layer_samples", "USE") if follows_cycles(scene) else "USE"
    own = view_layer.samples
    if own <= 0 or rule == "IGNORE":
        return samples
    return min(own, samples) if rule == "BOUNDED" else own


def layer_is_denoised(scene: bpy.types.Scene, view_layer: bpy.types.ViewLayer, is_denoised: bool) -> bool:
    """Whether a view layer is denoised: where the scene is, unless Cycles' switch of the layer is off.

    Parameters
    ----------
    is_denoised : bool
        Whether the scene is denoised.
    """
    return is_denoised and (not follows_cycles(scene) or view_layer.cycles.use_denoising)


def thread_count(scene: bpy.types.Scene) -> int:
    """Threads to render with, 0 = all: our own number, else Blender's."""
    return scene.neuralguide.threads or _blender_threads(scene)


def _blender_threads(scene: bpy.types.Scene) -> int:
    return scene.render.threads if scene.render.threads_mode == "FIXED" else 0


def copy_cycles_settings(scene: bpy.types.Scene) -> None:
    """Set all of ours to what Cycles would render `scene` with; from then on they count.

    Raises
    ------
    ValueError
        If Blender's Cycles add-on is off, so that the scene has no Cycles settings.
    """
    if not has_cycles(scene):
        raise ValueError("Cycles' settings are not there: enable the Cycles add-on in the preferences")
    ours = scene.neuralguide
    for name, (owner_name, their_name) in SHARED_SETTINGS.items():
        if hasattr(getattr(scene, owner_name), their_name):  # not all in older Blenders
            setattr(ours, name, cycles_value(scene, name))
    ours.threads = _blender_threads(scene)
