# SPDX-License-Identifier: GPL-3.0-or-later
"""Passes of light taken apart, from Blender's switches to the files it writes. Needs bpy."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.images import read_exr
from tests.helpers.light_sums import LOBES

#: Switches of the view layer, and the passes that they stand for.
SWITCHES = [
    "use_pass_emit", "use_pass_environment", "use_pass_ambient_occlusion",
    *(f"use_pass_{lobes.lower()}_{light}" for lobes in LOBES for light in ("direct", "indirect", "color")),
]  # fmt: skip
NAMES = [
    "Combined", "Emission", "Environment", "Ambient Occlusion",
    *(f"{lobes} {light}" for lobes in LOBES for light in ("Direct", "Indirect", "Color")),
    "Volume Direct", "Volume Indirect",
]  # fmt: skip


def ask_for_passes(scene: Any) -> None:
    """All passes that the picture is the sum of, into a file of layers."""
    for switch in SWITCHES:
        setattr(scene.view_layers[0], switch, True)
    for light in ("direct", "indirect"):
        setattr(scene.view_layers[0].cycles, f"use_pass_volume_{light}", True)
    settings = scene.render.image_settings
    if hasattr(settings, "media_type"):
        settings.media_type = "MULTI_LAYER_IMAGE"
    settings.file_format, settings.color_depth = "OPEN_EXR_MULTILAYER", "32"
    # The sum is that of the samples.
    scene.cycles.use_denoising = False
    # Blender 5.0 writes no layers of other pixels.
    scene.render.pixel_aspect_x = scene.render.pixel_aspect_y = 1.0


def render_passes(scene: Any, path: Path, names: list[str]) -> dict[str, np.ndarray]:
    """Render the scene to a file of layers and read passes of it, row 0 at the top."""
    import bpy

    scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    return {name: read_exr(path, name)[0] for name in names}
