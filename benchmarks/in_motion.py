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

from benchmarks.images import Float32Array
from benchmarks.tables import table
from benchmarks.temporal_error import References, sequence_errors
from engine.denoise.filter import denoise

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


def _read(folder: Path, name: str, layer: str = "Combined", channels: str = "RGB") -> list[Float32Array]:
    """A pass of all frames, row 0 at the bottom."""
    from addon.exr_layers import read_layers

    found = [read_layers(path).image("ViewLayer", layer, channels) for path in sorted(folder.glob(f"{name}_*.exr"))]
    return [image for image in found if image is not None]


def compare(folder: Path, reach: int) -> list[list[float | int | str | None]]:
    """Denoise a rendered sequence over time; rows of figures, as they are and over those of frame by frame."""
    import bpy

    bpy.ops.neuralguide.denoise_sequence(filepath=str(folder / "noisy_0001.exr"), reach=reach)
    first, second = (_read(folder, f"reference{seed}") for seed in _REFERENCE_SEEDS)
    features = zip(
        _read(folder, "noisy", "Denoising Albedo"), _read(folder, "noisy", "Denoising Normal", "XYZ"), strict=True
    )
    clean = [
        denoise(0.5 * (one + other), albedo, normal)
        for one, other, (albedo, normal) in zip(first, second, features, strict=True)
    ]
    references = References(
        first, second, [image for image in clean if image is not None], _read(folder, "noisy", "Vector", "XYZW")
    )
    sequences = {
        "not denoised": _read(folder, "noisy", "Noisy Image"), "frame by frame": _read(folder, "noisy"),
        "over time": _read(folder / "denoised", "noisy"),
    }  # fmt: skip
    errors = {name: sequence_errors(pictures, references) for name, pictures in sequences.items()}
    base = errors["frame by frame"]
    rows: list[list[float | int | str | None]] = []
    for name, own in errors.items():
        row: list[float | int | str | None] = [f"{folder.name}, {name}"]
        for figure in ("total", "whole", "temporal", "disoccluded"):
            value, other = getattr(own, figure), getattr(base, figure)
            row += [1000.0 * value, value / other]
        rows.append([*row, 100.0 * own.disoccluded_share])
    return rows


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.in_motion", description="How much denoised sequences flicker."
    )
    parser.add_argument("motions", nargs="*", default=["camera", "object", "lamp", "hair"])
    parser.add_argument("--size", nargs=2, type=int, default=(192, 108), metavar=("WIDTH", "HEIGHT"))
    parser.add_argument("--samples", type=int, default=16, help="a pixel and frame (default: %(default)s)")
    parser.add_argument("--reference-samples", type=int, default=32, help="of each reference (default: %(default)s)")
    parser.add_argument("--reach", type=int, default=4, help="frames before and after (default: %(default)s)")
    parser.add_argument("--out", type=Path, default=Path("out/in-motion"), help="frames are kept there")
    return parser


def main(arguments: list[str] | None = None) -> int:
    """Render, denoise, measure, and print a table; returns the exit status."""
    chosen = _parser().parse_args(arguments)
    import addon

    addon.register()
    rows: list[list[float | int | str | None]] = []
    for motion in chosen.motions:
        folder = chosen.out.resolve() / motion
        render_sequence(motion, tuple(chosen.size), chosen.samples, chosen.reference_samples, folder)
        rows += compare(folder, chosen.reach)
    header = ["relative squared error x 1000"]
    for figure in ("in all", "with the worst 0.1%", "over 8 frames", "come in sight"):
        header += [figure, "over frame by frame"]
    print(table([*header, "% of pixels"], rows))
    return 0


if __name__ == "__main__":
    sys.exit(main())
