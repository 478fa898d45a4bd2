# SPDX-License-Identifier: GPL-3.0-or-later
"""`python -m benchmarks.sequence builtin:blur-lamp`: does one field for a sequence pay, at equal samples?

As Dong et al. 2024, "Efficient Neural Path Guiding with 4D Modeling", section 6.2 and Fig. 9, ask it, but with the
samples of training counted. Times between the scene's keys are rendered as frames without motion blur.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks import metrics
from benchmarks.papers import PROTOCOLS
from benchmarks.rivals import VARIANTS
from benchmarks.scene_files import expand, hide_lamps, open_scene
from benchmarks.tables import geometric_mean, table
from engine.render.sequence import train_sequence
from engine.render.session import Session
from engine.settings import RenderSettings

#: Settings by name, and whether one field is trained for all frames.
METHODS: dict[str, tuple[dict[str, Any], bool]] = {
    "OFF": ({"guiding_method": "OFF"}, False),
    "NPM, each frame": ({"guiding_method": "NPM"}, False),
    "NPM, sequence": ({"guiding_method": "NPM"}, True),
    **{f"{name}, sequence": (VARIANTS[name], True) for name in ("NPM-FREQUENCY", "NPM-PLANES")},
}


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.sequence", description="One field for a sequence, against one for each frame."
    )
    parser.add_argument("scene", help=".blend file or builtin:NAME, animated")
    parser.add_argument("--span", nargs=2, type=float, default=(9.0, 11.0), metavar=("FIRST", "LAST"), help="[frames]")
    parser.add_argument("--frames", type=int, default=7, help="in the span (default: %(default)s)")
    parser.add_argument("--every", type=int, default=2, help="trained on is every so manyth (default: %(default)s)")
    parser.add_argument("--samples", type=int, default=64, help="a pixel and frame in all (default: %(default)s)")
    parser.add_argument(
        "--training", type=int, default=16, help="of these, of a sequence's training (default: %(default)s)"
    )
    parser.add_argument("--methods", nargs="+", default=list(METHODS), choices=METHODS, help="default: all")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--pixels", type=int, default=3456)
    parser.add_argument("--threads", type=int, default=0, help="0 = all cores")
    return parser


def render_frame(settings: RenderSettings, description: Any, field: Any = None) -> np.ndarray:
    """Combined of one frame: float32 (height, width, 4), row 0 at the bottom; `field` is that of a sequence."""
    session = Session(settings)
    session.load(description)
    source = None if field is None else field.source(settings, description)
    image = session.render(source=source).passes["Combined"]
    session.close()
    return image


def main(arguments: list[str] | None = None) -> int:
    """Measure, and print a table; returns the exit status."""
    chosen = _parser().parse_args(arguments)
    import bpy

    from addon.export import ExportCache, export_frames

    scene = open_scene(expand([chosen.scene])[0], chosen.pixels)
    scene.render.use_motion_blur = False
    hide_lamps(scene)
    times = np.linspace(*chosen.span, chosen.frames).tolist()
    frames = export_frames(bpy.context.evaluated_depsgraph_get(), times, cache=ExportCache())
    trained_on = frames[:: chosen.every]
    plain = RenderSettings(**PROTOCOLS["4d"].settings, threads=chosen.threads)
    training = chosen.training * len(frames) // len(trained_on)

    images: dict[str, list[list[np.ndarray]]] = {}
    for name in chosen.methods:
        changes, is_sequence = METHODS[name]
        images[name] = []
        for seed in range(chosen.seeds):
            settings = replace(plain, samples=chosen.samples, seed=seed, **changes)
            field = None
            if is_sequence:
                field = train_sequence(settings, trained_on, tuple(chosen.span), samples=training)
                settings = replace(settings, samples=chosen.samples - training * len(trained_on) // len(frames))
                print(f"{name}, seed {seed}: {field}", file=sys.stderr, flush=True)
            images[name].append([render_frame(settings, frame, field) for frame in frames])

    errors: dict[str, list[float]] = {}
    for name, by_seed in images.items():
        errors[name] = []
        for index in range(len(frames)):
            mean = np.mean([seed[index] for seeds in images.values() for seed in seeds], axis=0)
            errors[name].append(metrics.seed_variance([seed[index] for seed in by_seed], mean, 2).trimmed)
    base = errors[chosen.methods[0]]
    rows: list[list[float | int | str | None]] = []
    for name, own in errors.items():
        gains = [a / b for a, b in zip(base, own, strict=True)]
        kept = 1.0 - chosen.training / chosen.samples if METHODS[name][1] else 1.0
        is_trained = [index % chosen.every == 0 for index in range(len(frames))]
        rows.append(
            [
                name, geometric_mean(own), geometric_mean(gains),
                # Error goes with the reciprocal of the samples.
                geometric_mean(gains) / kept,
                geometric_mean([gain for gain, is_on in zip(gains, is_trained, strict=True) if is_on]),
                geometric_mean([gain for gain, is_on in zip(gains, is_trained, strict=True) if not is_on]),
            ]
        )
    first = chosen.methods[0]
    header = [
        chosen.scene, "relMSE", f"{first} / it", "if training were free", "frames trained on", "frames between",
    ]
    print(table(header, rows), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
