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
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks import metrics
from benchmarks.scene_files import expand, hide_lamps, open_scene
from benchmarks.tables import table
from engine.guiding.saved.file import SUFFIX, load_field, save_field
from engine.render.report import RenderResult
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
    parser.add_argument("--no-nee", action="store_true", help="without light sampling")
    parser.add_argument("--threads", type=int, default=0, help="0 = all cores")
    return parser


class Comparison(NamedTuple):
    """Renders of a scene that started anew, and from what a preview had learned, at equal samples.

    anew, started : variance over seeds (`benchmarks.metrics.seed_variance`)
    regions, mebibytes, load_seconds : of the field, of its file, of reading that
    verdicts : what previews said of guiding (`engine.guiding.saved.learned.VERDICTS`), with how many said so
    """

    scene: str
    samples: int
    anew: metrics.Error
    started: metrics.Error
    regions: int
    mebibytes: float
    load_seconds: float
    verdicts: str


def compare(
    text: str, method: str, *, preview: int, samples: Sequence[int], seeds: int, pixels: int, threads: int = 0,
    use_nee: bool = True,
) -> list[Comparison]:
    """Measure a scene, for each number of samples.

    Parameters
    ----------
    text : str
        A .blend file or builtin:NAME; light paths and filter are the scene's.
    method : str
    preview : int
        Samples a pixel that fields are learned from.
    use_nee : bool
        Whether lights are sampled: what is learned has to find them if not.
    """
    import bpy

    import addon
    from addon.export import ExportCache, export_scene
    from addon.properties import render_settings

    addon.register()
    source = expand([text])[0]
    scene = open_scene(source, pixels)
    hide_lamps(scene)
    settings = replace(
        render_settings(scene), guiding_method=method, time_limit=0.0, threads=threads, use_nee=use_nee,
        use_adaptive_sampling=False, use_denoising=False,
    )
    session = Session(settings)
    depsgraph = bpy.context.evaluated_depsgraph_get()
    session.load(export_scene(depsgraph, view_layer=depsgraph.view_layer_eval, cache=ExportCache()))

    def rendered(count: int, seed: int, **options: Any) -> RenderResult:
        session.settings = replace(settings, samples=count, seed=seed)
        return session.render(**options)

    def image(result: RenderResult) -> np.ndarray:
        return result.passes["Combined"][..., :3]

    fields, previews, load_seconds, sizes = [], [], [], []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"field{SUFFIX}"
        for seed in range(seeds):
            result = rendered(preview, seed, keep=True)
            if result.learned is None:
                raise ValueError(f"{source.name}: {method} has learned nothing that could be kept")
            previews.append(image(result))
            save_field(path, result.learned)
            began = time.perf_counter()
            fields.append(load_field(path))
            load_seconds.append(time.perf_counter() - began)
            sizes.append(path.stat().st_size / 2**20)
    verdicts = ", ".join(f"{count} {name}" for name, count in Counter(field.verdict for field in fields).items())
    found = []
    for count in samples:
        anew = [image(rendered(count, _APART + seed)) for seed in range(seeds)]
        started = [image(rendered(count, _APART + seed, start=fields[seed])) for seed in range(seeds)]
        mean = np.mean([*previews, *anew, *started], axis=0)
        first, second = (metrics.seed_variance(images, mean, 2) for images in (anew, started))
        regions = round(float(np.mean([field.region_count for field in fields])))
        size, seconds = float(np.mean(sizes)), float(np.median(load_seconds))
        found.append(Comparison(source.name, count, first, second, regions, size, seconds, verdicts))
    session.close()
    return found


def _row(item: Comparison) -> list[float | int | str | None]:
    return [
        item.scene, item.samples, item.anew.trimmed, item.started.trimmed, item.started.trimmed / item.anew.trimmed,
        item.started.whole / item.anew.whole, item.regions, item.mebibytes, item.load_seconds, item.verdicts,
    ]  # fmt: skip


def main(arguments: list[str] | None = None) -> int:
    """Measure, and print a table; returns the exit status."""
    chosen = _parser().parse_args(arguments)
    rows = [
        _row(item)
        for text in chosen.scenes
        for item in compare(
            text, chosen.method, preview=chosen.preview, samples=chosen.samples, seeds=chosen.seeds,
            pixels=chosen.pixels, threads=chosen.threads, use_nee=not chosen.no_nee,
        )
    ]  # fmt: skip
    header = [
        "scene", "samples", "anew", "from a field", "ratio", "ratio, whole", "regions", "file [MiB]", "loading [s]",
        "guiding",
    ]
    print(table(header, rows), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
