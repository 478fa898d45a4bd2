# SPDX-License-Identifier: GPL-3.0-or-later
"""What the .blend file keeps of a light mix: strength, colour and a switch for each light group of a scene."""

from __future__ import annotations

from typing import Any

import bpy
from bpy.props import BoolProperty, FloatProperty, FloatVectorProperty

from . import light_mix_picture


def mix_changed(settings: bpy.types.PropertyGroup, _context: Any) -> None:
    """Have the picture mixed anew."""
    light_mix_picture.show(settings.id_data)


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

