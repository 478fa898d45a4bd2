# SPDX-License-Identifier: GPL-3.0-or-later
"""`neuralguide` of scenes, materials, view layers and images: what a user may choose, by names scripts depend on."""

from __future__ import annotations

import zlib
from collections.abc import Iterable
from typing import Any

import bpy
from bpy.props import (
    BoolProperty,
    EnumProperty,
    FloatProperty,
    IntProperty,
    PointerProperty,
    StringProperty,
)

from engine.settings import MAX_SEED, RenderSettings, Setting

from .declared_settings import EXPERIMENT, SCENE_SETTINGS, scene_default, setting_owner
from .light_mix_properties import NeuralGuideImageSettings, NeuralGuideLightMixGroup, mix_properties
from .shared_settings import SHARED_SETTINGS, setting_value, thread_count

_KINDS = {bool: BoolProperty, int: IntProperty, float: FloatProperty, str: StringProperty}
_UNITS = {"s": {"unit": "TIME_ABSOLUTE"}, "pixels": {"subtype": "PIXEL"}}
#: How far sliders go, and how numbers are shown.
_LOOKS: dict[str, dict[str, Any]] = {
    "adaptive_threshold": {"precision": 4},
    "preview_adaptive_threshold": {"precision": 4},
    "denoised_threshold": {"precision": 4, "step": 0.1, "soft_max": 0.1},
    "time_limit": {"step": 100},
    "sequence_samples": {"soft_max": 4096},
    "light_sampling_threshold": {"precision": 4},
    "film_exposure": {"soft_max": 10.0},
    "field_path": {"subtype": "FILE_PATH"},
}
# From Blender 5.0 on, paths say whether "//" is the .blend's folder; before that all did.
if "is_path_supports_blend_relative" in bpy.types.Property.bl_rna.properties:
    _LOOKS["field_path"]["options"] = {"PATH_SUPPORTS_BLEND_RELATIVE"}


def _property(setting: Setting) -> Any:
    """A Blender property of a declared setting."""
    facts: dict[str, Any] = {
        "name": setting.label,
        "description": setting.sentence,
        "default": scene_default(setting),
        **_UNITS.get(setting.unit, {}),
        **_LOOKS.get(setting.name, {}),
    }
    if setting.choices:
        facts["items"] = [tuple(choice) for choice in setting.choices]
    lowest = setting.minimum if setting.scene_minimum is None else setting.scene_minimum
    if lowest is not None:
        facts["min"] = lowest
    if setting.maximum is not None:
        facts["max"] = setting.maximum
    kind = EnumProperty if setting.choices else _KINDS[type(setting.default)]
    return kind(**facts)


def _properties(settings: Iterable[Setting]) -> dict[str, Any]:
    return {setting.name: _property(setting) for setting in settings}


class NeuralGuideExperimentSettings(bpy.types.PropertyGroup):
    """Settings for experiments, `scene.neuralguide.experiment`, under their names in `RenderSettings`."""

    __annotations__ = _properties(setting for setting in SCENE_SETTINGS.values() if setting.is_experiment)


class NeuralGuideSceneSettings(bpy.types.PropertyGroup):
    """Settings of a render, under their names in `engine.settings.RenderSettings` where that has them too.

    Those that Cycles has too count only where they are set, or where the scene does not follow Cycles
    (`addon.shared_settings`).
    """

    __annotations__ = _properties(setting for setting in SCENE_SETTINGS.values() if not setting.is_experiment) | {
        EXPERIMENT: PointerProperty(type=NeuralGuideExperimentSettings),
        **mix_properties(),
    }


def _material_changed(settings: bpy.types.PropertyGroup, _context: bpy.types.Context) -> None:
    """Have Blender copy the material for the render anew, which it does not by itself for properties of add-ons."""
    settings.id_data.update_tag()


class NeuralGuideMaterialSettings(bpy.types.PropertyGroup):
    """What Blender's materials do not say; `addon.dispersion` tells what the engine makes of it."""

    dispersion: EnumProperty(  # type: ignore[valid-type]
        name="Dispersion",
        description="How refraction depends on the wavelength. The nodes' IOR is that of yellow light, 587.6 nm",
        items=(
            ("NONE", "None", "All wavelengths are refracted alike"),
            ("ABBE", "Abbe Number", "As makers of glass state it"),
            ("CAUCHY", "Cauchy", "By coefficients of A + B / wavelength²"),
        ),
        default="NONE",
        update=_material_changed,
    )
    abbe_number: FloatProperty(  # type: ignore[valid-type]
        name="Abbe Number",
        description="Low is strong: flint glass 30, diamond 55, water 56, crown glass 64",
        min=1.0,
        soft_min=10.0,
        soft_max=100.0,
        default=59.0,
        update=_material_changed,
    )
    cauchy_a: FloatProperty(  # type: ignore[valid-type]
        name="A",
        description="Index for very long wavelengths. With B it gives the strength; the IOR remains the nodes'",
        min=1.0,
        soft_max=3.0,
        precision=4,
        default=1.5046,
        update=_material_changed,
    )
    cauchy_b: FloatProperty(  # type: ignore[valid-type]
        name="B",
        description="Square micrometres",
        min=0.0,
        soft_max=0.05,
        precision=5,
        default=0.0042,
        update=_material_changed,
    )


class NeuralGuideViewLayerSettings(bpy.types.PropertyGroup):
    """Passes of a view layer that Blender itself has no switch for."""

    use_pass_albedo: BoolProperty(  # type: ignore[valid-type]
        name="Albedo", description="Share of light the first surface reflects or transmits, by channel"
    )
    use_pass_sample_count: BoolProperty(  # type: ignore[valid-type]
        name="Sample Count", description="Paths that were traced for each pixel"
    )
    use_pass_variance: BoolProperty(  # type: ignore[valid-type]
        name="Variance", description="Variance of the pixel's mean, by channel: how noisy it still is"
    )
    use_pass_candidate_count: BoolProperty(  # type: ignore[valid-type]
        name="Candidate Count", description="Directions that guiding weighed at the first surface (0 = not guided)"
    )
    use_pass_guiding_benefit: BoolProperty(  # type: ignore[valid-type]
        name="Guiding Benefit",
        description="How much noisier light at the first surface would be without guiding, estimated (1 = not guided)",
    )


def render_settings(scene: bpy.types.Scene) -> RenderSettings:
    """What the engine is told for the scene's current frame.

    Raises
    ------
    ValueError
        Naming the setting that makes no sense and what to choose instead.
    """
    values: dict[str, Any] = {
        name: setting_value(scene, name) if name in SHARED_SETTINGS else getattr(setting_owner(scene, name), name)
        for name in RenderSettings.__dataclass_fields__
    }
    if setting_value(scene, "use_animated_seed"):
        values["seed"] = zlib.crc32(f"{scene.frame_current} {values['seed']}".encode()) & MAX_SEED
    values["threads"] = thread_count(scene)
    return RenderSettings(**values)


_classes = (
    NeuralGuideExperimentSettings,
    NeuralGuideLightMixGroup,
    NeuralGuideImageSettings,
    NeuralGuideSceneSettings,
    NeuralGuideMaterialSettings,
    NeuralGuideViewLayerSettings,
)


def register() -> None:
    """Add the settings to scenes, materials, view layers and images."""
    for cls in _classes:
        bpy.utils.register_class(cls)
    bpy.types.Scene.neuralguide = PointerProperty(type=NeuralGuideSceneSettings)
    bpy.types.Material.neuralguide = PointerProperty(type=NeuralGuideMaterialSettings)
    bpy.types.ViewLayer.neuralguide = PointerProperty(type=NeuralGuideViewLayerSettings)
    bpy.types.Image.neuralguide = PointerProperty(type=NeuralGuideImageSettings)


def unregister() -> None:
    """Take them away; what a file holds stays in it."""
    del bpy.types.Image.neuralguide
    del bpy.types.ViewLayer.neuralguide
    del bpy.types.Material.neuralguide
    del bpy.types.Scene.neuralguide
    for cls in reversed(_classes):
        bpy.utils.unregister_class(cls)
