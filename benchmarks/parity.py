# SPDX-License-Identifier: GPL-3.0-or-later
"""`python -m benchmarks parity`: is it the picture Cycles makes?

Three questions a scene, at equal samples per pixel:

- the mean of every channel (alpha too) within 0.5%;
- every cell of an 8 x 8 grid within 2% or 4 standard errors, whichever is larger, where a standard error above 1% on
  more than 5% of the cells means that more samples are needed before a pass says anything;
- the trimmed relative error, from the variance over seeds, at most 1.25 times Cycles' own.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from benchmarks import environment, metrics
from benchmarks.images import Float32Array
from benchmarks.rendering import image_stack, render_scene
from benchmarks.rivals import Budget, Rival, find_rival
from benchmarks.scene_files import SceneSource
from benchmarks.tables import table

MEAN_ALLOWANCE = 0.005
CELL_ALLOWANCE = 0.02
CELL_SIGMAS = 4.0
CELL_ERROR_LIMIT = 0.01
CELL_ERROR_SHARE = 0.05
ERROR_RATIO_LIMIT = 1.25


@dataclass
class ParityResult:
    """The comparison of one scene; differences are relative to Cycles.

    mean_difference, mean_error : the channel with the worst difference, and its standard error
    cell_worst, cell_worst_sigmas : largest difference of a cell, and the largest in standard errors
    cells_beyond : cells outside the allowance; cells_noisy : share of cells whose standard error is above 1%
    error_ratio : trimmed error over seeds, ours over Cycles'; nan with fewer than 3 seeds
    is_noisy : standard errors are too large for a pass to say anything
    verdict : 'same', 'as documented', 'noisy' (nothing found, but too noisy to tell), or 'differs: ' and why
    """

    scene: str
    samples: int
    seed_count: int
    mean_difference: float
    mean_error: float
    cell_worst: float
    cell_worst_sigmas: float
    cells_beyond: int
    cells_noisy: float
    error_ratio: float
    is_noisy: bool
    verdict: str
    note: str = ""


def compare(
    scene: str,
    ours: Sequence[Float32Array],
    theirs: Sequence[Float32Array],
    samples: int,
    note: str = "",
    allowance: float = 0.0,
    error_ratio_limit: float = ERROR_RATIO_LIMIT,
) -> ParityResult:
    """Compare two renderers' pictures of one scene, one picture a seed, at least 2 of each.

    A difference of means above the allowance that is still within 4 standard errors counts as noise, not as found.
    `allowance` is the size of a documented difference, `note` its name: within it the verdict is 'as documented'.
    `error_ratio_limit` is by how much our error may exceed Cycles'.
    """
    if ours[0].shape != theirs[0].shape:
        return ParityResult(
            scene, samples, len(ours), math.nan, math.nan, math.nan, math.nan, 0, math.nan, math.nan, False,
            f"differs: size {ours[0].shape[1]}x{ours[0].shape[0]} for {theirs[0].shape[1]}x{theirs[0].shape[0]}", note,
        )  # fmt: skip
    problems, is_noisy = [], False
    bad_pixels = sum(int((~np.isfinite(image)).any(axis=-1).sum()) for image in ours)
    if bad_pixels:
        problems.append(f"{bad_pixels} pixels NaN or infinite")
        ours = [np.nan_to_num(image) for image in ours]

    mean_difference, mean_error = metrics.compare_means(ours, theirs)
    excess = np.abs(mean_difference) > max(MEAN_ALLOWANCE, allowance)
    found = excess & (np.abs(mean_difference) > CELL_SIGMAS * mean_error)
    worst_channel = int(np.argmax(np.abs(mean_difference)))
    if found.any():
        channels = "".join("RGBA"[channel] for channel in np.flatnonzero(found))
        problems.append(f"mean of {channels} by {100 * mean_difference[worst_channel]:+.2f}%")
    is_noisy |= bool(excess.any()) or bool((mean_error > MEAN_ALLOWANCE / 2).any())

    cells = metrics.compare_cells(ours, theirs)
    beyond = cells.exceeds(max(CELL_ALLOWANCE, allowance), CELL_SIGMAS)
    if beyond.any():
        row, column = np.unravel_index(np.argmax(np.where(beyond, np.abs(cells.difference), 0.0)), beyond.shape)
        problems.append(f"{beyond.sum()} cells, worst {100 * cells.difference[row, column]:+.1f}% at ({column}, {row})")
    noisy_share = float((cells.standard_error > CELL_ERROR_LIMIT).mean())
    is_noisy |= noisy_share > CELL_ERROR_SHARE

    error_ratio = math.nan
    if len(ours) >= 3:
        denominator = np.mean(np.stack([*ours, *theirs]), axis=0)
        mine, cycles = metrics.seed_variance(ours, denominator), metrics.seed_variance(theirs, denominator)
        # Both noise-free (flat emitters, furnaces): the ratio says nothing.
        error_ratio = (
            mine.trimmed / cycles.trimmed if cycles.trimmed > 1e-9 else (1.0 if mine.trimmed < 1e-7 else math.inf)
        )
        if error_ratio > error_ratio_limit:
            problems.append(f"error {error_ratio:.2f} times Cycles'")

    sigmas = np.abs(cells.difference) / np.maximum(cells.standard_error, 1e-9)
    verdict = "noisy" if is_noisy else "as documented" if allowance else "same"
    if problems:
        verdict = "differs: " + "; ".join(problems)
    return ParityResult(
        scene,
        samples,
        len(ours),
        float(mean_difference[worst_channel]),
        float(mean_error[worst_channel]),
        float(np.abs(cells.difference).max()),
        float(np.where(np.abs(cells.difference) > 1e-4, sigmas, 0.0).max()),
        int(beyond.sum()),
        noisy_share,
        float(error_ratio),
        is_noisy,
        verdict,
        note,
    )


def parity_table(results: Sequence[ParityResult]) -> str:
    """The comparison as a table, in percent where it says so."""
    rows = [
        [
            r.scene,
            f"{r.samples} x {r.seed_count}",
            f"{100 * r.mean_difference:+.2f} ± {100 * r.mean_error:.2f}",
            100 * r.cell_worst,
            r.cell_worst_sigmas,
            r.cells_beyond,
            100 * r.cells_noisy,
            r.error_ratio,
            r.verdict + (f" [{r.note}]" if r.note else ""),
        ]
        for r in results
    ]
    header = ["scene", "spp", "mean %", "cell %", "cell sigma", "beyond", "noisy %", "error ratio", "verdict"]
    return table(header, rows)


def parity(
    sources: Sequence[SceneSource],
    rival: Rival,
    samples: int,
    seed_count: int,
    *,
    out: Path,
    pixels: int = 0,
    threads: int = 0,
    resume: bool = False,
    most_seeds: int = 0,
    without_lamps: bool = False,
) -> int:
    """Compare every scene, print the table, write JSON; returns how many differ or failed.

    While standard errors are too large to tell, seeds are doubled, up to `most_seeds`. `without_lamps` hides
    them from the camera (`hide_lamps`).

    Raises
    ------
    ValueError
        For fewer than 2 seeds.
    """
    if seed_count < 2:
        raise ValueError("parity needs at least 2 seeds, for standard errors")
    rivals = [find_rival("cycles"), rival]
    results: list[ParityResult] = []
    failed: list[str] = []
    for source in sources:
        seeds, keep = seed_count, resume
        while True:
            renders, failures = render_scene(
                source,
                rivals,
                Budget(samples),
                seeds,
                out=out,
                pixels=pixels,
                threads=threads,
                resume=keep,
                without_lamps=without_lamps,
            )
            if failures:
                break
            ours, theirs = image_stack(renders[rival.name]), image_stack(renders["cycles"])
            result = compare(source.name, ours, theirs, samples, source.note(), source.allowance())
            if not result.is_noisy or 2 * seeds > most_seeds:
                break
            seeds, keep = 2 * seeds, True
        if failures:
            failed += [f"{source.name}, {failure.rival}: {failure.message}" for failure in failures]
            continue
        results.append(result)
        print(f"  {source.name}: {results[-1].verdict}", flush=True)
    return conclude(f"{rival.name} against Cycles", results, failed, out)


def conclude(title: str, results: Sequence[ParityResult], failed: Sequence[str], out: Path) -> int:
    """Print the table, write JSON; returns how many differ or failed."""
    print(f"\n{title}, samples x seeds as in the table, commit {environment.describe()['commit']}\n")
    print(parity_table(results))
    for text in failed:
        print(f"failed: {text}")
    differing = [r for r in results if r.verdict.startswith("differs")]
    counts = {verdict: sum(r.verdict == verdict for r in results) for verdict in ("same", "as documented", "noisy")}
    tally = ", ".join(f"{count} {verdict}" for verdict, count in counts.items())
    print(f"\n{tally}, {len(differing)} differ, {len(failed)} failed")
    out.mkdir(parents=True, exist_ok=True)
    summary = {"environment": environment.describe(), "results": [asdict(r) for r in results], "failed": failed}
    (out / "parity.json").write_text(json.dumps(summary, indent=1) + "\n", encoding="utf-8")
    return len(differing) + len(failed)
