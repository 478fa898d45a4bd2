# SPDX-License-Identifier: GPL-3.0-or-later
"""`python -m benchmarks.flicker builtin:evening-room`: how much do pictures flicker while the camera turns?

Each frame is rendered anew, by a seed of its own, and compared with a reference. An error that stays is hardly seen in
a moving picture; one that changes from frame to frame flickers.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.images import Float32Array, auto_exposure, tone_map
from benchmarks.metrics import FloatArray, reduce_error, relative_squared_error_map, seed_variance
from benchmarks.rivals import VARIANTS
from benchmarks.scene_files import expand, open_scene
from benchmarks.sequence import render_frame
from benchmarks.tables import table
from engine.scene.description import SceneDescription
from engine.settings import RenderSettings

#: The reference's samples are of other seeds than the frames'.
_REFERENCE_SEED = 10_000


@dataclass(frozen=True)
class Flicker:
    """Relative squared errors of frames without the worst 0.1% of the values.

    total : float, mean over frames; changing : float, the temporal variance of the difference to the reference
    """

    total: float
    changing: float


def flicker(frames: Sequence[FloatArray], references: Sequence[FloatArray]) -> Flicker:
    """How far frames are off, and how much of it changes from one to the next.

    Parameters
    ----------
    frames, references : float (height, width, 3) each, at least 2
        The references' own noise is in both figures.
    """
    truth = np.stack(references).astype(np.float64)
    difference, mean = np.stack(frames).astype(np.float64) - truth, truth.mean(axis=0)
    errors = [relative_squared_error_map(mean + one, mean) for one in difference]
    changing = seed_variance(list(difference), mean, least_seeds=2)
    return Flicker(reduce_error(np.mean(errors, axis=0)).trimmed, changing.trimmed)


def turned(description: SceneDescription, angle: float) -> SceneDescription:
    """The scene with its camera turned about the vertical through it, by so much [rad]; the camera stands still."""
    cosine, sine = math.cos(angle), math.sin(angle)
    rotation = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    transform = description.camera.transform.copy()
    transform[:3, :3] = rotation @ transform[:3, :3]
    return replace(description, camera=replace(description.camera, transform=transform))


def _render(settings: RenderSettings, description: SceneDescription) -> Float32Array:
    """Colour of one frame: float32 (height, width, 3), row 0 at the top."""
    return np.ascontiguousarray(render_frame(settings, description)[::-1, :, :3])


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.flicker", description="How much pictures flicker while the camera turns."
    )
    parser.add_argument("scene", help=".blend file or builtin:NAME")
    parser.add_argument("--frames", type=int, default=24)
    parser.add_argument("--degrees", type=float, default=10.0, help="that the camera turns (default: %(default)s)")
    parser.add_argument("--samples", type=int, default=32, help="a pixel and frame (default: %(default)s)")
    parser.add_argument("--reference-samples", type=int, default=1024, help="(default: %(default)s)")
    parser.add_argument("--rivals", nargs="+", default=["OFF", "OFF-CONVERGING", "OFF-FAST"], metavar="METHOD")
    parser.add_argument("--pixels", type=int, default=4096)
    parser.add_argument("--threads", type=int, default=0, help="0 = all cores")
    parser.add_argument("--out", type=Path, help="folder for the frames as PNG")
    return parser


def main(arguments: list[str] | None = None) -> int:
    """Measure, and print a table; returns the exit status."""
    chosen = _parser().parse_args(arguments)
    import bpy
    from PIL import Image

    import addon
    from addon.export import export_scene
    from addon.properties import render_settings

    addon.register()
    scene = open_scene(expand([chosen.scene])[0], chosen.pixels)
    still = export_scene(bpy.context.evaluated_depsgraph_get())
    plain = replace(
        render_settings(scene), threads=chosen.threads, time_limit=0.0, guiding_method="OFF",
        use_adaptive_sampling=False, use_denoising=False,
    )
    angles = np.radians(chosen.degrees) * np.linspace(-0.5, 0.5, chosen.frames)
    frames = [turned(still, float(angle)) for angle in angles]
    settings = replace(plain, samples=chosen.reference_samples)
    references = [
        _render(replace(settings, seed=_REFERENCE_SEED + index), frame) for index, frame in enumerate(frames)
    ]
    rows: list[list[float | int | str | None]] = []
    first: Flicker | None = None
    for rival in chosen.rivals:
        changes = VARIANTS.get(rival, {"guiding_method": rival})
        settings = replace(plain, samples=chosen.samples, **changes)
        images = [_render(replace(settings, seed=index), frame) for index, frame in enumerate(frames)]
        found = flicker(images, references)
        first = first or found
        rows.append(
            [rival, found.total, found.changing, found.changing / found.total, first.total / found.total,
             first.changing / found.changing]
        )  # fmt: skip
        for index, image in enumerate(images if chosen.out else []):
            path = chosen.out / f"{rival}_{index + 1:04}.png"
            path.parent.mkdir(parents=True, exist_ok=True)
            Image.fromarray(tone_map(image, auto_exposure(references[0]))).save(path)
    name = chosen.rivals[0]
    print(table([chosen.scene, "error", "flicker", "share", f"error: {name} / it", f"flicker: {name} / it"], rows))
    return 0


if __name__ == "__main__":
    sys.exit(main())
