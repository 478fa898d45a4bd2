# SPDX-License-Identifier: GPL-3.0-or-later
"""`python -m benchmarks passes`: contact sheets of a scene's passes, ours beside Cycles' and the difference."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.gallery import FILE_PIXELS, GROUP_COLUMNS, stack, strip
from benchmarks.images import Float32Array, read_exr
from benchmarks.rivals import Budget, Rival, find_rival
from benchmarks.scene_files import SceneSource, open_scene

#: Switches of Blender's view layer and their passes.
_SWITCHES = {
    "use_pass_combined": "Combined", "use_pass_emit": "Emission", "use_pass_environment": "Environment",
    "use_pass_ambient_occlusion": "Ambient Occlusion", "use_pass_z": "Depth", "use_pass_mist": "Mist",
    "use_pass_normal": "Normal", "use_pass_position": "Position", "use_pass_uv": "UV", "use_pass_vector": "Vector",
    **{f"use_pass_{lobes}_{light}": f"{lobes.title()} {light.title()}"
       for lobes in ("diffuse", "glossy", "transmission") for light in ("direct", "indirect", "color")},
}  # fmt: skip
#: The same of Cycles' own settings of the view layer.
_CYCLES_SWITCHES = {
    "use_pass_volume_direct": ("Volume Direct",), "use_pass_volume_indirect": ("Volume Indirect",),
    "denoising_store_passes": ("Denoising Normal", "Denoising Albedo", "Denoising Depth"),
}  # fmt: skip
#: Beyond so many times the median, places are shown as if there.
_FAR = 4.0
#: What is nowhere above is rounding: Cycles' Vector where nothing moves.
_BLACK = 1e-4


def _shown(pixels: Float32Array) -> Float32Array:
    """A pass as a picture of three channels: directions and places by their size, distances from near to far."""
    pixels = np.nan_to_num(np.abs(pixels[..., :3]), posinf=0.0)
    # One number is grey; of two the second is blue too.
    pixels = pixels[..., np.minimum(np.arange(3), pixels.shape[2] - 1)]
    middle = float(np.median(pixels.max(axis=2)))
    return np.minimum(pixels, _FAR * middle) if middle > 1.0 else pixels


def _render(source: SceneSource, rival: Rival, samples: int, pixels: int, path: Path) -> dict[str, Float32Array]:
    """All passes of one renderer's picture by name, those that are black left out."""
    import bpy

    scene = open_scene(source, pixels)
    rival.configure(scene, Budget(samples), 1, 0)
    layer = scene.view_layers[0]
    for switch in _SWITCHES:
        setattr(layer, switch, True)
    for switch in _CYCLES_SWITCHES:
        setattr(layer.cycles, switch, True)
    settings = scene.render.image_settings
    if hasattr(settings, "media_type"):
        settings.media_type = "MULTI_LAYER_IMAGE"
    settings.file_format, settings.color_depth = "OPEN_EXR_MULTILAYER", "32"
    scene.render.filepath = str(path.resolve())
    bpy.ops.render.render(write_still=True)
    names = [*_SWITCHES.values(), *(name for names in _CYCLES_SWITCHES.values() for name in names)]
    found = {name: _shown(read_exr(path, f"{layer.name}.{name}")[0]) for name in names}
    return {name: image for name, image in found.items() if image.max() > _BLACK}


def pass_sheets(sources: Sequence[SceneSource], rival: Rival, samples: int, *, out: Path, pixels: int = 0) -> int:
    """Write one sheet a scene, `SCENE_passes.png`, a row of panels a pass; returns the number of failures."""
    out.mkdir(parents=True, exist_ok=True)
    failure_count = 0
    for source in sources:
        size = pixels or (0 if source.is_builtin else FILE_PIXELS)
        cache = Path("out") / "passes" / source.name
        cache.mkdir(parents=True, exist_ok=True)
        ours = _render(source, rival, samples, size, cache / "ours.exr")
        theirs = _render(source, find_rival("cycles"), samples, size, cache / "cycles.exr")
        for name in sorted(set(ours) ^ set(theirs)):
            print(f"  {source.name}: {name} is black in one of the two")
            failure_count += 1
        rows: list[Any] = [strip(name, image, theirs[name], 240) for name, image in ours.items() if name in theirs]
        if rows:
            stack(rows, GROUP_COLUMNS).save(out / f"{source.name}_passes.png", optimize=True)
            print(f"  wrote {out / source.name}_passes.png")
    return failure_count
