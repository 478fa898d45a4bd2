# SPDX-License-Identifier: GPL-3.0-or-later
"""`python -m benchmarks first-click`: Cycles' picture with nothing set but the engine?

Each scene is saved with a size, samples and a seed of its Cycles settings, and rendered twice by the command line, each
time in a process of its own: by Cycles, and with no other change than `-E NEURALGUIDE`.
"""

from __future__ import annotations

import math
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks import environment
from benchmarks.images import Float32Array, read_exr
from benchmarks.parity import ParityResult, compare, conclude
from benchmarks.scene_files import SceneSource, open_scene

ENGINES = ("CYCLES", "NEURALGUIDE")


def save_scene(scene: Any, path: Path, samples: int, seed: int) -> None:
    """Save the open scene with samples and seed where Cycles has them."""
    import bpy

    cycles, image = scene.cycles, scene.render.image_settings
    cycles.samples, cycles.seed, cycles.use_animated_seed = samples, seed, False
    cycles.use_adaptive_sampling = cycles.use_denoising = False
    if hasattr(image, "media_type"):
        image.media_type = "IMAGE"
    image.file_format, image.color_mode, image.color_depth = "OPEN_EXR", "RGBA", "32"
    bpy.ops.wm.save_as_mainfile(filepath=str(path.resolve()), copy=True)


def _render(blend: Path, engine: str, frame: int, threads: int) -> Float32Array:
    """Render a saved scene by the command line, which knows no more than the engine's name.

    Raises
    ------
    RuntimeError
        With the last line that it said.
    """
    image = blend.with_name(f"{blend.stem}_{engine}_{frame:04}.exr").resolve()
    output = str(image).removesuffix(f"{frame:04}.exr") + "####"
    options = ["-b", str(blend), "-E", engine, "-o", output, "-t", str(threads), "-f", str(frame)]
    done = subprocess.run([sys.executable, "-m", "addon", *options], capture_output=True, text=True, check=False)
    if done.returncode:
        lines = done.stderr.strip().splitlines() or [f"exit status {done.returncode}"]
        raise RuntimeError(lines[-1])
    return read_exr(image)[0]


def click_pictures(
    source: SceneSource,
    samples: int,
    seed_count: int,
    *,
    out: Path,
    engines: Sequence[str] = ENGINES,
    pixels: int = 0,
    threads: int = 0,
) -> dict[str, list[Float32Array]]:
    """Pictures of a scene by engine, one a seed.

    Raises
    ------
    RuntimeError
        If a render failed.
    """
    scene = open_scene(source, pixels)
    folder = out / source.name
    folder.mkdir(parents=True, exist_ok=True)
    images: dict[str, list[Float32Array]] = {engine: [] for engine in engines}
    for seed in range(1, seed_count + 1):
        blend = folder / f"seed{seed}.blend"
        save_scene(scene, blend, samples, seed)
        for engine in engines:
            images[engine].append(_render(blend, engine, scene.frame_current, threads or environment.thread_count()))
        blend.unlink()
    return images


def compare_first_clicks(
    source: SceneSource, samples: int, seed_count: int, *, out: Path, pixels: int = 0, threads: int = 0
) -> ParityResult:
    """Both engines' pictures of a scene, compared.

    Raises
    ------
    RuntimeError
        If a render failed.
    """
    images = click_pictures(source, samples, seed_count, out=out, pixels=pixels, threads=threads)
    theirs, ours = (images[engine] for engine in ENGINES)
    # What few samples are worth is another question: some are spent on finding out what pays.
    return compare(source.name, ours, theirs, samples, source.note(), source.allowance(), error_ratio_limit=math.inf)


def first_click(
    sources: Sequence[SceneSource], samples: int, seed_count: int, *, out: Path, pixels: int = 0, threads: int = 0
) -> int:
    """Compare every scene, print the table, write JSON; returns how many differ or failed.

    Raises
    ------
    ValueError
        For fewer than 2 seeds.
    """
    if seed_count < 2:
        raise ValueError("first-click needs at least 2 seeds, for standard errors")
    results, failed = [], []
    for source in sources:
        try:
            result = compare_first_clicks(source, samples, seed_count, out=out, pixels=pixels, threads=threads)
        except RuntimeError as error:
            failed.append(f"{source.name}: {error}")
            print(f"  {failed[-1]}", flush=True)
            continue
        results.append(result)
        print(
            f"  {result.scene}: mean {100 * result.mean_difference:+.2f} ± {100 * result.mean_error:.2f} %,"
            f" {result.verdict}",
            flush=True,
        )
    return conclude("Nothing set but the engine, against Cycles", results, failed, out)
