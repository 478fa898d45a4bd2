# SPDX-License-Identifier: GPL-3.0-or-later
"""What the .blend file keeps of a light mix: strength, colour and a switch for each light group of a scene or image."""

from __future__ import annotations

from typing import Any

import bpy
from bpy.props import BoolProperty, CollectionProperty, FloatProperty, FloatVectorProperty

from . import light_mix_files, light_mix_picture


def mix_changed(settings: bpy.types.PropertyGroup, _context: Any) -> None:
    """Have the picture mixed anew; windows in rendered shading hear of it by Blender."""
    owner = settings.id_data
    if isinstance(owner, bpy.types.Image):
        light_mix_files.show(owner)
    else:
        light_mix_picture.show(owner)


class NeuralGuideLightMixGroup(bpy.types.PropertyGroup):
    """The factor of the light group of this name."""

    is_on: BoolProperty(  # type: ignore[valid-type]
        name="On", description="Whether the mix has the light of this group", default=True, update=mix_changed
    )
    strength: FloatProperty(  # type: ignore[valid-type]
        name="Strength", description="Factor on the light of this group", default=1.0, min=0.0, soft_max=10.0,
        step=5, precision=3, update=mix_changed,
    )
    color: FloatVectorProperty(  # type: ignore[valid-type]
        name="Color", description="Colour that the light of this group is multiplied by", subtype="COLOR", size=3,
        default=(1.0, 1.0, 1.0), min=0.0, soft_max=1.0, update=mix_changed,
    )
    #: What *Write Back to Lamps* has multiplied lamps by since the picture was rendered.
    written: FloatVectorProperty(  # type: ignore[valid-type]
        size=3, default=(1.0, 1.0, 1.0), min=0.0, options={"HIDDEN"}
    )


def mix_properties() -> dict[str, Any]:
    """Properties of whatever has a mix."""
    return {
        "light_mix": CollectionProperty(type=NeuralGuideLightMixGroup),
        "use_light_mix": BoolProperty(
            name="Light Mix", description="Show the picture with its light groups mixed; off: as it was rendered",
            default=True, update=mix_changed,
        ),
    }  # fmt: skip


class NeuralGuideImageSettings(bpy.types.PropertyGroup):
    """What images of files of layers have: the mix of their light groups."""

    __annotations__ = mix_properties()
