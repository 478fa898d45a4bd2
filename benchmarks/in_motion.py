# SPDX-License-Identifier: GPL-3.0-or-later
"""`python -m benchmarks.in_motion camera lamp`: how much denoised sequences flicker, and what ghosts they have.

The evening room in motion is rendered with few samples, denoised frame by frame as renders are, and by
`neuralguide.denoise_sequence`. Errors are products of differences to two independent references, so that the
references' own noise does not count.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

_NOISY_SEED, _REFERENCE_SEEDS = 1, (1000, 2000)


def _set_up(scene: Any, samples: int, seed: int, path: Path) -> None:
    """Settings that all renders have in common: animated seeds, and files of layers."""
    scene.cycles.samples, scene.cycles.seed, scene.cycles.use_animated_seed = samples, seed, True
    settings = scene.render.image_settings
    if hasattr(settings, "media_type"):
        settings.media_type = "MULTI_LAYER_IMAGE"
    settings.file_format, settings.color_depth = "OPEN_EXR_MULTILAYER", "32"
    scene.render.use_overwrite = False
    scene.render.filepath = f"{path}_####"


def render_sequence(motion: str, size: tuple[int, int], samples: int, reference_samples: int, folder: Path) -> None:
    """Render frames that are not there yet: `noisy_0001.exr`, `reference1000_0001.exr`, ..."""
    import bpy

    from benchmarks.scenes.interiors.moving import build_moving

    scene = build_moving(motion, *size)
    layer = scene.view_layers[0]
    _set_up(scene, samples, _NOISY_SEED, folder / "noisy")
    scene.cycles.use_denoising = layer.cycles.denoising_store_passes = layer.use_pass_vector = True
    bpy.ops.render.render(animation=True)
    scene.cycles.use_denoising = layer.cycles.denoising_store_passes = layer.use_pass_vector = False
    scene.neuralguide.radiance_cache = "CONVERGING"
    for seed in _REFERENCE_SEEDS:
        _set_up(scene, reference_samples, seed, folder / f"reference{seed}")
        bpy.ops.render.render(animation=True)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.in_motion", description="How much denoised sequences flicker."
    )
    parser.add_argument("motions", nargs="*", default=["camera", "object", "lamp", "hair"])
    parser.add_argument("--size", nargs=2, type=int, default=(192, 108), metavar=("WIDTH", "HEIGHT"))
    parser.add_argument("--samples", type=int, default=16, help="a pixel and frame (default: %(default)s)")
    parser.add_argument("--reference-samples", type=int, default=32, help="of each reference (default: %(default)s)")
    parser.add_argument("--out", type=Path, default=Path("out/in-motion"), help="frames are kept there")
    return parser


def main(arguments: list[str] | None = None) -> int:
    """Render, denoise, measure, and print a table; returns the exit status."""
    chosen = _parser().parse_args(arguments)
    import addon

    addon.register()
    for motion in chosen.motions:
        folder = chosen.out.resolve() / motion
        render_sequence(motion, tuple(chosen.size), chosen.samples, chosen.reference_samples, folder)
    return 0


if __name__ == "__main__":
    sys.exit(main())
