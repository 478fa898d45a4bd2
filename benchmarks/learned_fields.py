# SPDX-License-Identifier: GPL-3.0-or-later
"""`python -m benchmarks.learned_fields SCENE ...`: what does it bring to start from what an earlier render has learned?

Each seed renders a preview, keeps what it has learned, and then renders the same view twice from other random numbers:
starting anew, and from the preview's field. Errors are those of equal samples; the preview's are not counted.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks import metrics
from benchmarks.scene_files import expand, hide_lamps, open_scene
from benchmarks.tables import table
from engine.guiding.saved.file import SUFFIX, load_field, save_field
from engine.render.session import Session

#: Seeds of renders that are compared lie as far from those of previews.
_APART = 1000


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.learned_fields", description="Starting from a learned field, against starting anew."
    )
    parser.add_argument("scenes", nargs="+", help=".blend files or builtin:NAME")
    parser.add_argument("--method", default="VMM", help="guiding method (default: %(default)s)")
    parser.add_argument("--preview", type=int, default=64, help="samples a pixel to learn from (default: %(default)s)")
    parser.add_argument("--samples", type=int, nargs="+", default=[16, 32], help="to compare at (default: 16 32)")
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--pixels", type=int, default=36_864)
    parser.add_argument("--threads", type=int, default=0, help="0 = all cores")
    return parser


def _measure(text: str, chosen: argparse.Namespace) -> list[list[float | int | str | None]]:
    """Rows of the table, one for each number of samples."""
    import bpy

    import addon
    from addon.export import ExportCache, export_scene
    from addon.properties import render_settings

    addon.register()
    scene = open_scene(expand([text])[0], chosen.pixels)
    hide_lamps(scene)
    # Light paths and filter are the scene's.
    settings = replace(render_settings(scene), guiding_method=chosen.method, time_limit=0.0, threads=chosen.threads)
    session = Session(settings)
    depsgraph = bpy.context.evaluated_depsgraph_get()
    session.load(export_scene(depsgraph, view_layer=depsgraph.view_layer_eval, cache=ExportCache()))

    def image_of(samples: int, seed: int, **options: object) -> tuple[np.ndarray, object]:
        session.settings = replace(settings, samples=samples, seed=seed)
        result = session.render(**options)  # type: ignore[arg-type]
        return result.passes["Combined"][..., :3], result

    fields, previews, load_seconds, megabytes = [], [], [], []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"field{SUFFIX}"
        for seed in range(chosen.seeds):
            image, result = image_of(chosen.preview, seed, keep=True)
            previews.append(image)
            save_field(path, result.learned)  # type: ignore[attr-defined]
            began = time.perf_counter()
            fields.append(load_field(path))
            load_seconds.append(time.perf_counter() - began)
            megabytes.append(path.stat().st_size / 2**20)
    rows: list[list[float | int | str | None]] = []
    for samples in chosen.samples:
        anew = [image_of(samples, _APART + seed)[0] for seed in range(chosen.seeds)]
        started = [image_of(samples, _APART + seed, start=fields[seed])[0] for seed in range(chosen.seeds)]
        mean = np.mean([*previews, *anew, *started], axis=0)
        first, second = (metrics.seed_variance(images, mean, 2) for images in (anew, started))
        rows.append([
            expand([text])[0].name, samples, first.trimmed, second.trimmed, second.trimmed / first.trimmed,
            second.whole / first.whole, fields[0].region_count, float(np.mean(megabytes)),
            float(np.median(load_seconds)),
        ])  # fmt: skip
    session.close()
    return rows


def main(arguments: list[str] | None = None) -> int:
    """Measure, and print a table; returns the exit status."""
    chosen = _parser().parse_args(arguments)
    rows = [row for text in chosen.scenes for row in _measure(text, chosen)]
    header = [
        "scene", "samples", "anew", "from a field", "ratio", "ratio, whole", "regions", "file [MiB]", "loading [s]",
    ]
    print(table(header, rows), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
