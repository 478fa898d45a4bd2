# SPDX-License-Identifier: GPL-3.0-or-later
"""`python -m benchmarks.light_tracing`: references by photons, for `benchmarks run --references`."""

from __future__ import annotations

import argparse
import datetime
import json
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np

from benchmarks import environment
from benchmarks.images import write_exr
from benchmarks.light_paths import light_paths
from benchmarks.light_tracing.picture import LightTracer
from benchmarks.reference import ReferenceFacts, own_error
from benchmarks.scene_files import SceneSource, expand, open_scene
from benchmarks.tables import table

#: Name of who made the picture, among rivals'.
NAME = "light-tracing"


def make_reference(
    source: SceneSource, photons: int, seeds: int, *, out: Path, pixels: int = 0, threads: int = 0, first_seed: int = 1
) -> ReferenceFacts:
    """Write `NAME.exr`, NaN where the picture is not known, and `NAME.json`.

    Parameters
    ----------
    photons : int
        Of each seed.

    Returns
    -------
    ReferenceFacts
        `samples` are photons a pixel.

    Raises
    ------
    ValueError
        Naming what in the scene photons are not traced for.
    """
    scene = open_scene(source, pixels)
    tracer = LightTracer(scene, threads or environment.thread_count())
    start = time.perf_counter()
    taken = list(range(first_seed, first_seed + seeds))
    images = [tracer.picture(photons, seed) for seed in taken]
    seconds = time.perf_counter() - start
    height, width = tracer.known.shape
    error = own_error([image[tracer.known][None] for image in images])
    facts = ReferenceFacts(
        source.name, source.content_hash(), light_paths(scene), width, height, NAME, round(photons / (width * height)),
        taken, error.whole, error.trimmed, seconds, environment.describe(),
        datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"), float(tracer.known.mean()),
    )  # fmt: skip
    write_exr(out / f"{source.name}.exr", np.mean(np.stack(images), axis=0, dtype=np.float64).astype(np.float32))
    (out / f"{source.name}.json").write_text(json.dumps(asdict(facts), indent=1) + "\n", encoding="utf-8")
    return facts


def main(arguments: Sequence[str] | None = None) -> int:
    """Make references and print what they are worth; returns the exit status."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.light_tracing", description=__doc__)
    parser.add_argument("scenes", nargs="+", help=".blend files, folders of them, or builtin:NAME (patterns allowed)")
    parser.add_argument("--photons", type=float, default=2e7, help="of each seed (default: %(default)g)")
    parser.add_argument("--seeds", type=int, default=4, help="independent pictures (default: %(default)s)")
    parser.add_argument("--first-seed", type=int, default=1, help="for a second reference, independent of the first")
    parser.add_argument("--pixels", type=int, default=0, help="scale scenes to about so many pixels")
    parser.add_argument("--threads", type=int, default=0, help="0 = all cores")
    parser.add_argument("--out", type=Path, default=Path("out/references"), help="folder (default: %(default)s)")
    chosen = parser.parse_args(arguments)
    rows: list[list[float | int | str | None]] = []
    failures: list[str] = []
    try:
        sources = expand(chosen.scenes)
    except ValueError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    for source in sources:
        try:
            facts = make_reference(
                source, int(chosen.photons), chosen.seeds, out=chosen.out, pixels=chosen.pixels,
                threads=chosen.threads, first_seed=chosen.first_seed,
            )  # fmt: skip
        except ValueError as error:
            failures.append(f"{source.name}: {error}")
            continue
        size = f"{facts.width}x{facts.height}"
        rows.append([source.name, size, facts.samples, chosen.seeds, facts.known, facts.error, facts.error_trimmed,
                     facts.render_seconds])  # fmt: skip
    header = ["scene", "size", "photons a pixel", "seeds", "known", "own error", "trimmed", "seconds"]
    print(f"\nReferences in {chosen.out}; errors are of the mean, where the picture is known\n")
    print(table(header, rows))
    for failure in failures:
        print(f"failed: {failure}")
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
