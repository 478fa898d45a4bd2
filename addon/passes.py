# SPDX-License-Identifier: GPL-3.0-or-later
"""Render passes: which ones a view layer asks for, what Blender calls them, how pixels get into Blender's result."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import NamedTuple

import bpy
import numpy as np
import numpy.typing as npt

from engine.scene.pass_names import aov_pass, matte_passes

from .denoise_over_time import needs_passes
from .denoising_motion import has_motion
from .shared_settings import layer_is_denoised, setting_value
from .versions import RENAMED_PASSES, SPECULAR_FEATURES, is_since


class RenderPass(NamedTuple):
    """A pass the engine can write.

    `name` is the engine's, `blender_name` the one Blender's compositor and file output know, `channels` one letter a
    channel, `kind` Blender's socket type.
    """

    name: str
    blender_name: str
    channels: str
    kind: str


_RENAMED = is_since(RENAMED_PASSES)

COMBINED = RenderPass("Combined", "Combined", "RGBA", "COLOR")
NOISY = RenderPass("Noisy Image", "Noisy Image", "RGBA", "COLOR")
#: What Cycles' Denoising Data asks for.
DENOISING = (
    RenderPass("Denoising Normal", "Denoising Normal", "XYZ", "VECTOR"),
    RenderPass("Denoising Albedo", "Denoising Albedo", "RGB", "COLOR"),
    RenderPass("Denoising Depth", "Denoising Depth", "Z", "VALUE"),
)
#: What else it asks for from Blender 5.3 on.
DENOISING_MIRRORS = (
    RenderPass("Denoising Specular Albedo", "Denoising Specular Albedo", "RGB", "COLOR"),
    RenderPass("Denoising Roughness", "Denoising Roughness", "X", "VALUE"),
)
#: What Cycles' Motion among Denoising Data asks for, from Blender 5.3 on.
DENOISING_MOTION = (
    RenderPass("Denoising Backward Motion", "Denoising Backward Motion", "XYZ", "VECTOR"),
    RenderPass("Denoising Specular Motion", "Denoising Specular Motion", "XYZ", "VECTOR"),
)

#: (property of the view layer, is it ours or Blender's, pass)
OPTIONAL = (
    ("use_pass_z", False, RenderPass("Depth", "Depth", "Z", "VALUE")),
    ("use_pass_normal", False, RenderPass("Normal", "Normal", "XYZ", "VECTOR")),
    ("use_pass_position", False, RenderPass("Position", "Position", "XYZ", "VECTOR")),
    ("use_pass_emit", False, RenderPass("Emission", "Emission" if _RENAMED else "Emit", "RGB", "COLOR")),
    ("use_pass_environment", False, RenderPass("Environment", "Environment" if _RENAMED else "Env", "RGB", "COLOR")),
    ("use_pass_object_index", False, RenderPass("IndexOB", "Object Index" if _RENAMED else "IndexOB", "X", "VALUE")),
    (
        "use_pass_material_index",
        False,
        RenderPass("IndexMA", "Material Index" if _RENAMED else "IndexMA", "X", "VALUE"),
    ),
    ("use_pass_mist", False, RenderPass("Mist", "Mist", "Z", "VALUE")),
    ("use_pass_vector", False, RenderPass("Vector", "Vector", "XYZW", "VECTOR")),
    ("use_pass_uv", False, RenderPass("UV", "UV", "UVA", "VECTOR")),
    ("use_pass_albedo", True, RenderPass("Albedo", "Albedo", "RGB", "COLOR")),
    ("use_pass_sample_count", True, RenderPass("Sample Count", "Sample Count", "X", "VALUE")),
    ("use_pass_variance", True, RenderPass("Variance", "Variance", "RGB", "COLOR")),
    ("use_pass_candidate_count", True, RenderPass("Candidate Count", "Candidate Count", "X", "VALUE")),
    ("use_pass_guiding_benefit", True, RenderPass("Guiding Benefit", "Guiding Benefit", "X", "VALUE")),
)

#: (property of the view layer, kind of Cryptomatte)
MATTES = (
    ("use_pass_cryptomatte_object", "CryptoObject"),
    ("use_pass_cryptomatte_material", "CryptoMaterial"),
    ("use_pass_cryptomatte_asset", "CryptoAsset"),
)
#: As Cycles.
MOST_MATTE_LEVELS = 16

#: Passes of light taken apart, by Blender's switch: the engine's name, and Blender's before it renamed them.
_LIGHT_NAMES = {
    f"use_pass_{lobes.lower()}_{light.lower()}": (f"{lobes} {light}", f"{old}{light[:3]}")
    for lobes, old in (("Diffuse", "Diff"), ("Glossy", "Gloss"), ("Transmission", "Trans"))
    for light in ("Direct", "Indirect", "Color")
}
LIGHT = {
    switch: RenderPass(name, name if _RENAMED else old.replace("Color", "Col"), "RGB", "COLOR")
    for switch, (name, old) in _LIGHT_NAMES.items()
} | {
    "use_pass_ambient_occlusion": RenderPass(
        "Ambient Occlusion", "Ambient Occlusion" if _RENAMED else "AO", "RGB", "COLOR"
    )
}
#: The same among Cycles' own settings of a view layer.
CYCLES_LIGHT = {
    "use_pass_volume_direct": RenderPass(
        "Volume Direct", "Volume Direct" if _RENAMED else "VolumeDir", "RGB", "COLOR"
    ),
    "use_pass_volume_indirect": RenderPass(
        "Volume Indirect", "Volume Indirect" if _RENAMED else "VolumeInd", "RGB", "COLOR"
    ),
    "use_pass_shadow_catcher": RenderPass("Shadow Catcher", "Shadow Catcher", "RGB", "COLOR"),
}


def requested_passes(scene: bpy.types.Scene, view_layer: bpy.types.ViewLayer) -> Iterator[RenderPass]:
    """The passes that a view layer of `scene` asks for, Combined first."""
    yield COMBINED
    if layer_is_denoised(scene, view_layer, setting_value(scene, "use_denoising")):
        yield NOISY
    over_time = needs_passes(scene, view_layer)
    is_stored = getattr(getattr(view_layer, "cycles", None), "denoising_store_passes", False)
    if over_time or is_stored:
        yield from DENOISING
    if is_stored and is_since(SPECULAR_FEATURES):
        yield from DENOISING_MIRRORS
    if has_motion(scene, view_layer):
        yield from DENOISING_MOTION
    ours = view_layer.neuralguide
    for switch, is_ours, render_pass in OPTIONAL:
        if getattr(ours if is_ours else view_layer, switch, False) or (over_time and switch == "use_pass_vector"):
            yield render_pass
    cycles = getattr(view_layer, "cycles", None)
    for owner, table in ((view_layer, LIGHT), (cycles, CYCLES_LIGHT)):
        for switch, render_pass in table.items():
            if getattr(owner, switch, False):
                yield render_pass
    for group in getattr(view_layer, "lightgroups", ()):
        name = f"Combined_{group.name}"
        yield RenderPass(name, name, "RGB", "COLOR")
    for kind in requested_mattes(view_layer):
        for name in matte_passes(kind, min(view_layer.pass_cryptomatte_depth, MOST_MATTE_LEVELS)):
            # In lower case, so that codecs of EXR keep ids as they are.
            yield RenderPass(name, name, "rgba", "COLOR")
    for aov in view_layer.aovs:
        if aov.is_valid:
            channels, kind = ("RGBA", "COLOR") if aov.type == "COLOR" else ("X", "VALUE")
            yield RenderPass(aov_pass(aov.name), aov.name, channels, kind)


def requested_mattes(view_layer: bpy.types.ViewLayer) -> list[str]:
    """Kinds of Cryptomatte that `view_layer` asks for."""
    return [kind for switch, kind in MATTES if getattr(view_layer, switch)]


def write_pass(target: bpy.types.RenderPass, pixels: npt.NDArray[np.float32]) -> None:
    """Copy an image into a pass of Blender's render result.

    Parameters
    ----------
    target : bpy.types.RenderPass
    pixels : float32 (height, width) or (height, width, channels), row 0 at the bottom
        Channels beyond the pass's own are dropped.

    Raises
    ------
    ValueError
        If there are fewer channels or another number of pixels than the pass has.
    """
    if pixels.ndim == 2:
        pixels = pixels[..., np.newaxis]
    height, width, channel_count = pixels.shape
    if height * width != len(target.rect) or channel_count < target.channels:
        raise ValueError(
            f"pass {target.name}: got {width} x {height} pixels of {channel_count} channels for a result of "
            f"{len(target.rect)} pixels of {target.channels} channels"
        )
    flat = np.ascontiguousarray(pixels[..., : target.channels], dtype=np.float32)
    try:
        target.rect.foreach_set(flat.reshape(-1))
    except TypeError:
        # Older Blenders (3.4 for one) see a sequence of pixels, each a sequence of channels.
        target.rect.foreach_set(flat.reshape(-1, target.channels))


def write_layer(
    layer: bpy.types.RenderLayer,
    view: str,
    wanted: Mapping[str, RenderPass],
    images: Mapping[str, npt.NDArray[np.float32]],
) -> None:
    """Copy every image that both the engine delivered and the layer asked for into the result."""
    for name, render_pass in wanted.items():
        target = layer.passes.find_by_name(render_pass.blender_name, view)
        if target is not None and name in images:
            write_pass(target, images[name])


#: Blender's switches for passes that the engine does not have, and their names in the user interface.
UNSUPPORTED = {
    "use_pass_shadow": "Shadow",
    "use_pass_subsurface_direct": "Subsurface Direct",
    "use_pass_subsurface_indirect": "Subsurface Indirect",
    "use_pass_subsurface_color": "Subsurface Color",
    "use_pass_grease_pencil": "Grease Pencil",
}
#: The same among Cycles' own settings of a view layer.
UNSUPPORTED_CYCLES = {
    "use_pass_volume_scatter": "Volume Scatter",
    "use_pass_volume_transmit": "Volume Transmit",
    "use_pass_volume_majorant": "Volume Majorant",
    "pass_render_time": "Render Time",
}


def unsupported_passes(view_layer: bpy.types.ViewLayer) -> list[str]:
    """Names of passes that `view_layer` asks for and will not get."""
    found = [name for switch, name in UNSUPPORTED.items() if getattr(view_layer, switch, False)]
    cycles = getattr(view_layer, "cycles", None)
    found += [name for switch, name in UNSUPPORTED_CYCLES.items() if getattr(cycles, switch, False)]
    return found
