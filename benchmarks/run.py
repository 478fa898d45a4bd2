# SPDX-License-Identifier: GPL-3.0-or-later
"""`python -m benchmarks run`: speed and error of every rival on every scene."""

from __future__ import annotations

import json
import math
import statistics
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from benchmarks import environment, metrics
from benchmarks.images import Float32Array
from benchmarks.reference import load_reference
from benchmarks.rendering import Failure, Render, image_stack, render_scene
from benchmarks.rivals import Budget, Rival, denoised_label
from benchmarks.scene_files import SceneSource
from benchmarks.tables import geometric_mean, table


@dataclass
class RivalResult:
    """Medians over seeds of one rival on one scene; nan where there is nothing to say.

    seed_error, seed_error_trimmed : error by the variance over seeds (no bias in it)
    reference_error, reference_error_trimmed, mape, flip : against the reference image (its noise in it)
    efficiency : 1 / (trimmed seed error x render seconds)
    """

    scene: str
    rival: str
    seed_count: int
    samples: float
    render_seconds: float
    export_seconds: float
    compile_seconds: float
    samples_per_second: float
    peak_memory_mib: float
    seed_error: float = math.nan
    seed_error_trimmed: float = math.nan
    reference_error: float = math.nan
    reference_error_trimmed: float = math.nan
    mape: float = math.nan
    flip: float = math.nan
    efficiency: float = math.nan
    first_image_seconds: float = math.nan


def _median(values: Sequence[float]) -> float:
    return float(statistics.median(values)) if values else math.nan


def evaluate(scene: str, renders: dict[str, list[Render]], reference: Float32Array | None) -> dict[str, RivalResult]:
    """Figures of every rival on one scene.

    Without a reference the mean of all renders serves as the denominator of the seed error, the same for all rivals.
    """
    everything = [image for rival in renders.values() for image in image_stack(rival)]
    if not everything:
        return {}
    denominator = reference if reference is not None else np.mean(np.stack(everything), axis=0)
    results = {}
    for name, rival_renders in renders.items():
        if not rival_renders:
            continue
        records = [render.record for render in rival_renders]
        images = image_stack(rival_renders)
        result = RivalResult(
            scene,
            name,
            len(records),
            _median([r.samples for r in records]),
            _median([r.render_seconds for r in records]),
            _median([r.export_seconds for r in records]),
            max(r.compile_seconds for r in records),
            _median([r.samples_per_second for r in records]),
            max(r.peak_memory_mib for r in records),
            first_image_seconds=_median([r.first_image_seconds for r in records]),
        )
        if len(images) >= 3:
            error = metrics.seed_variance(images, denominator)
            result.seed_error, result.seed_error_trimmed = error.whole, error.trimmed
            if error.trimmed > 0.0:
                result.efficiency = 1.0 / (error.trimmed * result.render_seconds)
        if reference is not None:
            errors = [metrics.relative_squared_error(image, reference) for image in images]
            result.reference_error = _median([error.whole for error in errors])
            result.reference_error_trimmed = _median([error.trimmed for error in errors])
            result.mape = _median([metrics.absolute_percentage_error(image, reference) for image in images])
            result.flip = _median([metrics.flip(image, reference) for image in images])
        results[name] = result
    return results


def result_table(results: Sequence[RivalResult], first_rival: str) -> str:
    """The table of a run: figures, and ratios to the first rival (above 1 is better than it)."""
    baseline = {r.scene: r for r in results if r.rival == first_rival}
    rows = []
    for r in results:
        base = baseline.get(r.scene, r)
        rows.append(
            [
                r.scene,
                r.rival,
                denoised_label(r.rival),
                r.samples,
                r.render_seconds,
                r.export_seconds,
                r.samples_per_second / 1e6,
                r.samples_per_second / base.samples_per_second,
                r.seed_error,
                r.seed_error_trimmed,
                base.seed_error_trimmed / r.seed_error_trimmed if r.seed_error_trimmed else math.nan,
                r.efficiency / base.efficiency,
                r.reference_error_trimmed,
                r.mape,
                r.flip,
                r.peak_memory_mib,
                r.first_image_seconds,
            ]
        )
    header = [
        "scene", "rival", "denoised", "spp", "render s", "export s", "Msamples/s", "x speed", "seed err", "trimmed",
        "x error", "x efficiency", "ref err", "MAPE", "FLIP", "MiB", "first s",
    ]  # fmt: skip
    return table(header, rows)


def summary_table(results: Sequence[RivalResult], first_rival: str) -> str:
    """Geometric means and worst cases over scenes, relative to the first rival."""
    baseline = {r.scene: r for r in results if r.rival == first_rival}
    rows = []
    for rival in dict.fromkeys(r.rival for r in results):
        pairs = [(r, baseline[r.scene]) for r in results if r.rival == rival and r.scene in baseline]
        speed = [r.samples_per_second / b.samples_per_second for r, b in pairs]
        efficiency = [r.efficiency / b.efficiency for r, b in pairs]
        finite = [e for e in efficiency if math.isfinite(e)]
        rows.append(
            [
                rival,
                len(pairs),
                geometric_mean(speed),
                _median(speed),
                min(speed, default=math.nan),
                geometric_mean(efficiency),
                _median(finite),
                min(finite, default=math.nan),
            ]
        )
    header = ["rival", "scenes", "x speed", "median", "worst", "x efficiency", "median", "worst"]
    return table(header, rows)


def find_reference(folder: Path | None, source: SceneSource) -> Float32Array | None:
    """The reference image of a scene, `folder/NAME.exr`, if there is one.

    Raises
    ------
    ValueError
        If the JSON beside it says that it was made of another version of the scene.
    """
    found = load_reference(folder, source.name)
    if found is None:
        return None
    problem = found.problem(source.content_hash(), {})
    if problem:
        raise ValueError(f"the reference of {source.name} in {folder} does not fit: {problem}")
    return found.image


def run(
    sources: Sequence[SceneSource],
    rivals: Sequence[Rival],
    budget: Budget,
    seed_count: int,
    *,
    out: Path,
    pixels: int = 0,
    references: Path | None = None,
    threads: int = 0,
    first_seed: int = 1,
    resume: bool = False,
    **how: bool,
) -> int:
    """Render, evaluate, print; returns the number of failures. `how`: `isolate`, `at_defaults` of `render_scene`."""
    results: list[RivalResult] = []
    failures: list[tuple[str, Failure]] = []
    for source in sources:
        reference = find_reference(references, source)
        size = (reference.shape[1], reference.shape[0]) if reference is not None else None
        renders, failed = render_scene(
            source, rivals, budget, seed_count, out=out, pixels=pixels, size=size, threads=threads,
            first_seed=first_seed, resume=resume, **how,
        )  # fmt: skip
        failures += [(source.name, failure) for failure in failed]
        results += evaluate(source.name, renders, reference).values()
    first = rivals[0].name
    facts = environment.describe()
    used = threads or facts["cores"]
    settings = {rival.name: rival.settings for rival in rivals if rival.settings}
    print(f"\n{budget}, {seed_count} seeds, {used} threads, commit {facts['commit']}, {facts['cpu']}\n")
    for name, chosen in settings.items():
        print(f"{name}: " + ", ".join(f"{key} {value}" for key, value in chosen.items()))
    print(result_table(results, first))
    print()
    print(summary_table(results, first))
    if not any(r.seed_count >= 3 for r in results):
        print("\nErrors by variance over seeds need --seeds 3 or more.")
    for name, failure in failures:
        print(f"failed: {name}, {failure.rival}: {failure.message}")
    out.mkdir(parents=True, exist_ok=True)
    summary = {
        "environment": facts, "budget": asdict(budget), "settings": settings,
        "results": [asdict(r) for r in results],
    }  # fmt: skip
    (out / "summary.json").write_text(json.dumps(summary, indent=1) + "\n", encoding="utf-8")
    return len(failures)
