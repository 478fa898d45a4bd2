# SPDX-License-Identifier: GPL-3.0-or-later
"""`python -m benchmarks stability`: every method on every way to fail, and what came of it.

A render goes through the session itself: small pictures would be mostly Blender's overhead. Finished renders stay under
the folder of results and are not repeated while scene, settings and the engine's sources are the same.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import math
import statistics
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import environment
from benchmarks.bias import find_bias, variance_ratio, worst_pixels
from benchmarks.images import Float32Array
from benchmarks.scene_files import BUILTIN, SceneSource
from benchmarks.stability_cases import Case, describe_case, find_cases, resized
from benchmarks.stability_figures import Figures, Picture
from benchmarks.tables import table
from benchmarks.total_error import total_error
from engine.methods import METHODS
from engine.scene.description import SceneDescription
from engine.settings import RenderSettings

UNGUIDED = "OFF"
#: Methods without a radiance cache and with one.
NAMES = [*METHODS, *(f"{method}-{cache}" for method in METHODS for cache in ("AUTO", "CONVERGING", "FAST"))]
#: Seeds of the reference, apart from those compared, and its samples over theirs.
REFERENCE_SEED, REFERENCE_COUNT, REFERENCE_FACTOR = 1001, 4, 4
#: Steps of training between iterations; the engine's own number is for pictures with more to learn from.
TRAINING_STEPS = 8
#: Guiding wherever it can be done, paying or not: what a bias would hide from.
FORCED: Mapping[str, Any] = {"guiding_trial": False, "learn_guiding_probability": False}
#: The network is asked nowhere unless candidates are asked for.
FORCED_RESAMPLING: Mapping[str, Any] = {"candidate_allocation": "FIXED", "candidate_count": 2}


def method_settings(
    name: str, base: RenderSettings, *, forced: bool, steps: int = TRAINING_STEPS
) -> RenderSettings:
    """Settings of a method's render (of `NAMES`): in step with its training, so that a seed gives one picture."""
    method, _, cache = name.partition("-")
    changes: dict[str, Any] = {"guiding_method": method, "deterministic": True, "training_steps": steps}
    if cache:
        changes["radiance_cache"] = cache
    if forced and method != UNGUIDED:
        changes |= FORCED
        if METHODS[method].predictor:
            changes |= FORCED_RESAMPLING
    return replace(base, **changes)


def render_case(
    description: SceneDescription, settings: RenderSettings, earlier_sizes: Sequence[tuple[int, int]] = ()
) -> Picture:
    """Render a case once; `earlier_sizes` are rendered before in the same session."""
    from engine.render.session import Session

    session = Session(settings)
    try:
        for size in earlier_sizes:
            session.load(resized(description, size))
            session.render()
        session.load(description)
        started = time.process_time()
        result = session.render()
        seconds = time.process_time() - started
    finally:
        session.close()
    report = result.report
    # Kernels are loaded by one thread.
    seconds = max(seconds - report.prepare_seconds, 0.0)
    seconds += report.guiding.training_seconds + report.guiding.source_seconds
    return Picture(
        np.ascontiguousarray(result.passes["Combined"][::-1, :, :3]), seconds, report.path_count,
        report.reject_count, [f"{n.subject}: {n.problem}; {n.fallback}" for n in report.notices],
        list(report.guiding.lines), report.guiding.stopped_at,
    )  # fmt: skip


class Store:
    """Finished renders in a folder: NAME.npz each, with the question that it answers."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def load(self, name: str, question: str) -> Picture | None:
        """A finished render, if it answers this question."""
        try:
            with np.load(self.folder / f"{name}.npz", allow_pickle=False) as data:
                facts = json.loads(str(data["facts"]))
                if facts.pop("question") != question:
                    return None
                return Picture(data["image"], **facts)
        except (OSError, ValueError, KeyError, TypeError):
            return None

    def save(self, name: str, question: str, picture: Picture) -> None:
        """Keep a render; one that is interrupted leaves nothing behind."""
        path = self.folder / f"{name}.npz"
        path.parent.mkdir(parents=True, exist_ok=True)
        facts = {key: value for key, value in vars(picture).items() if key != "image"} | {"question": question}
        unfinished = path.with_suffix(".part")
        with unfinished.open("wb") as file:
            np.savez_compressed(file, image=picture.image, facts=json.dumps(facts))
        unfinished.replace(path)


def _question(case: Case, settings: RenderSettings) -> str:
    asked = json.dumps(
        [asdict(case), asdict(settings), SceneSource(BUILTIN + case.scene).content_hash(),
         environment.sources_hash()],
        sort_keys=True, default=str,
    )  # fmt: skip
    return hashlib.sha256(asked.encode()).hexdigest()[:24]


def evaluate(
    case: str, pictures: Mapping[str, Sequence[Picture]], references: Sequence[Float32Array]
) -> list[Figures]:
    """Figures of every method on a case; unguided rendering must be among them."""
    reference = np.mean(np.stack(references).astype(np.float64), axis=0)
    plain = [picture.image for picture in pictures[UNGUIDED]]
    plain_worst = worst_pixels(plain, reference)
    halves = tuple(np.mean(np.stack(references[first::2]).astype(np.float64), axis=0) for first in (0, 1))
    plain_total = total_error(plain, halves).total
    plain_seconds = statistics.median(picture.seconds for picture in pictures[UNGUIDED])
    results = []
    for method, rendered in pictures.items():
        images = [picture.image for picture in rendered]
        finite = [np.nan_to_num(image, nan=0.0, posinf=0.0, neginf=0.0) for image in images]
        variance, variance_error, whole = variance_ratio(finite, plain[: len(finite)], reference)
        worst = worst_pixels(finite, reference)
        results.append(
            Figures(
                case, method, len(rendered), find_bias(images, references), variance, variance_error, whole,
                total_error(finite, halves).total / max(plain_total, 1e-20),
                worst / plain_worst if plain_worst > 0.0 else math.nan,
                statistics.median(picture.seconds for picture in rendered) / max(plain_seconds, 1e-9),
                sum(picture.reject_count for picture in rendered),
                sum(int((~np.isfinite(image)).sum()) for image in images),
                sum(picture.stopped_at > 0 for picture in rendered) / len(rendered),
                list(dict.fromkeys(n for picture in rendered for n in picture.notices if n.startswith("Guiding"))),
            )
        )  # fmt: skip
    return results


def measure_case(
    case: Case, methods: Sequence[str], store: Store, *, seeds: int = 0, samples: int = 0, threads: int = 0,
    forced: bool = False, steps: int = TRAINING_STEPS,
) -> tuple[list[Figures], Float32Array]:
    """Render a case by all methods, as far as that is not done yet; figures, and the reference."""
    if samples:
        case = replace(case, samples=samples)
    description, base = describe_case(case, threads)

    def picture(name: str, settings: RenderSettings) -> Picture:
        question = _question(case, settings)
        found = store.load(name, question)
        if found is None:
            found = render_case(description, settings, case.earlier_sizes)
            store.save(name, question, found)
            print(f"  {name}: {found.seconds:.2f} s", flush=True)
        return found

    references = [
        picture(
            f"reference/{case.name}/seed{seed}",
            replace(base, guiding_method=UNGUIDED, deterministic=True, seed=seed,
                    samples=REFERENCE_FACTOR * case.samples),
        ).image
        for seed in range(REFERENCE_SEED, REFERENCE_SEED + REFERENCE_COUNT)
    ]  # fmt: skip
    pictures: dict[str, list[Picture]] = {}
    for method in dict.fromkeys([UNGUIDED, *methods]):
        settings = method_settings(method, base, forced=forced, steps=steps)
        folder = "forced" if forced and method != UNGUIDED else "chosen"
        pictures[method] = [
            picture(f"{folder}/{case.name}/{method}_seed{seed}", replace(settings, seed=seed))
            for seed in range(1, (seeds or case.seeds) + 1)
        ]
    return evaluate(case.name, pictures, references), np.mean(np.stack(references), axis=0)


def result_table(results: Sequence[Figures]) -> str:
    """All figures, a line for each method and case."""
    rows: list[list[float | int | str | None]] = [
        [
            r.case, r.method, r.seed_count, f"{100 * r.bias.difference:+.2f} ± {100 * r.bias.error:.2f}", r.bias.z,
            r.bias.worst_z, f"{100 * r.bias.detectable:.2f}", f"{r.variance:.2f} ± {r.variance_error:.2f}",
            r.variance_whole, r.total, r.worst_pixel, r.time, r.stopped, r.reject_count, ", ".join(r.problems) or "-",
        ]
        for r in results
    ]  # fmt: skip
    header = [
        "case", "method", "seeds", "mean %", "z", "part z", "finds %", "variance", "whole", "total", "worst pixel",
        "time", "given up", "rejects", "problems",
    ]  # fmt: skip
    return table(header, rows)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("cases", nargs="*", help="names or patterns (default: all)")
    parser.add_argument(
        "--methods", nargs="+", default=[name for name in METHODS if name != UNGUIDED],
        choices=NAMES, metavar="METHOD",
        help="beside OFF; METHOD-AUTO, -CONVERGING and -FAST with the radiance cache (default: all without)",
    )  # fmt: skip
    parser.add_argument("--seeds", type=int, default=0, help="renders per method, 2 or more (default: the case's)")
    parser.add_argument("--samples", type=int, default=0, help="per pixel (default: the case's)")
    parser.add_argument(
        "--forced", action="store_true",
        help="guide wherever it can be done, whether or not it pays: no trial, no learned share",
    )  # fmt: skip
    parser.add_argument(
        "--steps", type=int, default=TRAINING_STEPS, help="of training between iterations (default: %(default)s)"
    )
    parser.add_argument("--threads", type=int, default=0, help="0 = all cores")
    parser.add_argument("--out", type=Path, default=Path("out/stability"), help="folder (default: %(default)s)")


def stability(chosen: argparse.Namespace) -> int:
    """Run the suite, print the matrix, write page and figures; returns how many cells are biased or not finite.

    Raises
    ------
    ValueError
        For a case that does not exist, or a single seed.
    """
    from benchmarks.stability_page import matrix_text, write_page

    cases = find_cases(chosen.cases)
    if chosen.seeds == 1:
        raise ValueError("stability needs at least 2 seeds, for standard errors")
    store = Store(chosen.out)
    results: list[Figures] = []
    references: dict[str, Float32Array] = {}
    for case in cases:
        found, references[case.name] = measure_case(
            case, chosen.methods, store, seeds=chosen.seeds, samples=chosen.samples, threads=chosen.threads,
            forced=chosen.forced, steps=chosen.steps,
        )  # fmt: skip
        results += found
    print("\n" + result_table(results) + "\n\n" + matrix_text(results))
    facts = environment.describe()
    kind = "forced" if chosen.forced else "chosen"
    settings = f"{'guided everywhere' if chosen.forced else 'as by default'}, commit {facts['commit']}, {facts['cpu']}"
    write_page(chosen.out / f"{kind}.html", results, cases, references, settings)
    summary = {
        "environment": facts, "forced": chosen.forced, "steps": chosen.steps,
        "cases": {case.name: {"purpose": case.purpose, "samples": chosen.samples or case.samples} for case in cases},
        "results": [asdict(r) | {"problems": r.problems, "is_biased": r.bias.is_biased} for r in results],
    }  # fmt: skip
    (chosen.out / f"{kind}.json").write_text(json.dumps(summary, indent=1) + "\n", encoding="utf-8")
    print(f"\nwrote {chosen.out / kind}.html and .json")
    return sum("biased" in r.problems or "not finite" in r.problems for r in results)
