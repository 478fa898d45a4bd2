# SPDX-License-Identifier: GPL-3.0-or-later
"""`python -m benchmarks sweep`: the same scenes and rivals under budgets that grow in steps, for `report` to draw."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from benchmarks import environment
from benchmarks.equal_time import CONFIDENCE, LEAST_SEEDS, Ratio, over_better_cycles, over_better_cycles_table
from benchmarks.reference import NOTABLE_SHARE, Reference, load_reference
from benchmarks.rendering import Failure, render_scene
from benchmarks.rivals import Budget, Rival, denoised_label
from benchmarks.run import RivalResult, evaluate
from benchmarks.scene_files import SceneSource
from benchmarks.tables import table


def budgets(samples: Sequence[int], seconds: Sequence[float]) -> list[Budget]:
    """Budgets of a sweep, the smallest first: by time if `seconds` holds any, else by samples."""
    chosen = [Budget(1, value) for value in seconds] if seconds else [Budget(value) for value in samples]
    return sorted(set(chosen), key=lambda budget: (budget.seconds, budget.samples))


def sweep_table(results: Sequence[tuple[Budget, RivalResult]]) -> str:
    """A line for each scene, rival and budget; medians over seeds."""
    rows: list[list[float | int | str | None]] = [
        [
            r.scene, r.rival, denoised_label(r.rival), str(budget), r.seed_count, r.samples, r.render_seconds,
            r.seed_error, r.seed_error_trimmed, r.reference_error, r.reference_error_trimmed, r.mape, r.flip,
        ]
        for budget, r in results
    ]  # fmt: skip
    header = [
        "scene", "rival", "denoised", "budget", "seeds", "spp", "render s", "seed err", "trimmed", "ref err", "trimmed",
        "MAPE", "FLIP",
    ]  # fmt: skip
    return table(header, rows)


def reference_remarks(reference: Reference, results: Sequence[RivalResult]) -> list[str]:
    """Where the reference is too noisy for what is measured against it."""
    if reference.facts is None:
        return ["the reference does not say what it was made of, nor how large its own error is"]
    remarks = []
    for r in results:
        share = reference.facts.error_trimmed / max(r.reference_error_trimmed, 1e-30)
        if share > NOTABLE_SHARE:
            remarks.append(f"{r.rival}: the reference's own error is {share:.0%} of what is measured (trimmed)")
    return remarks


def sweep(
    sources: Sequence[SceneSource],
    rivals: Sequence[Rival],
    steps: Sequence[Budget],
    seed_count: int,
    *,
    out: Path,
    pixels: int = 0,
    references: Path | None = None,
    threads: int = 0,
    resume: bool = True,
    **how: bool,
) -> int:
    """Render under every budget into `out/BUDGET/SCENE`, print, write `out/sweep.json`; returns the number of failures.

    `how`: `isolate` and `at_defaults` of `render_scene`; `reference` writes nothing to compare the latter with.

    Raises
    ------
    ValueError
        If a reference was made of something else.
    """
    results: list[tuple[Budget, RivalResult]] = []
    failures: list[tuple[str, Failure]] = []
    remarks: list[str] = []
    ratios: dict[tuple[str, str], dict[str, Ratio]] = {}
    for source in sources:
        reference = load_reference(references, source.name)
        if references is not None and reference is None:
            remarks.append(f"{source.name}: no reference in {references}")
        size = (reference.image.shape[1], reference.image.shape[0]) if reference is not None else None
        for budget in steps:
            renders, failed = render_scene(
                source, rivals, budget, seed_count, out=out / str(budget), pixels=pixels, size=size, threads=threads,
                resume=resume, check=reference.require if reference is not None else lambda _: None, **how,
            )  # fmt: skip
            failures += [(source.name, failure) for failure in failed]
            found = list(evaluate(source.name, renders, reference.image if reference is not None else None).values())
            results += [(budget, result) for result in found]
            over = over_better_cycles(renders, reference.image if reference is not None else None)
            if over:
                ratios[source.name, str(budget)] = over
            if reference is not None:
                remarks += [f"{source.name}, {budget}, {text}" for text in reference_remarks(reference, found)]
    facts = environment.describe()
    print(f"\n{seed_count} seeds, {threads or facts['cores']} threads, commit {facts['commit']}, {facts['cpu']}\n")
    print(sweep_table(results))
    if ratios:
        print(f"\nEfficiency over the better Cycles (with intervals of {CONFIDENCE:.0%} from {LEAST_SEEDS} seeds on)\n")
        print(over_better_cycles_table(ratios))
    for text in dict.fromkeys(remarks):
        print(text)
    for name, failure in failures:
        print(f"failed: {name}, {failure.rival}: {failure.message}")
    out.mkdir(parents=True, exist_ok=True)
    summary = {
        "environment": facts,
        "results": [{"budget": str(budget), **asdict(result)} for budget, result in results],
        "over_better_cycles": [
            {"scene": scene, "budget": budget, "rival": rival, **asdict(ratio)}
            for (scene, budget), over in ratios.items()
            for rival, ratio in over.items()
        ],
        "failures": [{"scene": name, **asdict(failure)} for name, failure in failures],
    }
    (out / "sweep.json").write_text(json.dumps(summary, indent=1) + "\n", encoding="utf-8")
    return len(failures)
