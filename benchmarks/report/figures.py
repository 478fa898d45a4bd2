# SPDX-License-Identifier: GPL-3.0-or-later
"""What the page says in figures: errors with the spread of seeds, fronts, efficiencies, time by kind of work."""

from __future__ import annotations

import math
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from benchmarks import metrics
from benchmarks.images import Float32Array
from benchmarks.rendering import RenderRecord, image_stack
from benchmarks.report.collect import Batch, SceneResults
from benchmarks.rivals import CYCLES_RIVALS, Budget
from benchmarks.tables import geometric_mean

RELMSE, RELMSE_TRIMMED, MAPE, FLIP = "relMSE", "relMSE, trimmed", "MAPE", "FLIP"
MEASURES = (RELMSE, RELMSE_TRIMMED, MAPE, FLIP)
#: Seeds from which on the variance over them is an error.
LEAST_SEEDS = 3

#: Stages of the engine by kind of work; the others are shading.
_STAGE_KINDS = {
    "intersect_closest": "tracing",
    "intersect_shadow": "tracing",
    "prepare_guides": "inference",
    "guide_lights": "inference",
    "sample_source": "inference",
    "draw_candidates": "inference",
    "predict_radiance": "inference",
    "guide_resample": "inference",
    "collect_records": "fitting",
}
#: "rendering" is of renderers that do not tell more.
TIME_KINDS = ("tracing", "shading", "inference", "fitting", "training", "waiting", "rendering")


@dataclass(frozen=True)
class Spread:
    """A figure and the least and largest that single seeds give."""

    centre: float
    low: float
    high: float


def spread(values: Sequence[float]) -> Spread:
    """Median and range."""
    return Spread(float(statistics.median(values)), float(min(values)), float(max(values)))


@dataclass
class Point:
    """One rival under one budget.

    errors : by measure: those of `MEASURES` that are known
    seed_error : trimmed, by the variance over seeds whatever `errors` are by; nan of less than LEAST_SEEDS
    seconds, samples : medians over seeds
    ray_count : all rays of a render, median over seeds; 0 of renderers that do not count them
    training_end : samples per pixel after which nothing more was learned; None where it went on, or never began
    chosen : method that choosing by itself settled on; '' where nothing was chosen
    """

    rival: str
    budget: Budget
    seed_count: int
    seconds: float
    samples: float
    memory_mib: float
    ray_count: float = 0.0
    errors: dict[str, Spread] = field(default_factory=dict)
    seed_error: float = math.nan
    training_end: float | None = None
    chosen: str = ""


def training_end(record: RenderRecord) -> float | None:
    """Samples per pixel after which a render learned nothing more; None where it went on, or never began."""
    learning = record.details.get("learning", {})
    ends = [int(learning.get(name, 0) or 0) for name in ("stopped_at", "network_stopped_at")]
    return float(min(end for end in ends if end)) if any(ends) else None


def chosen_method(record: RenderRecord) -> str:
    """What a render that chooses its method by itself has chosen (`details["learning"]["chosen"]`)."""
    return str(record.details.get("learning", {}).get("chosen", "") or "")


def denominator(scene: SceneResults) -> Float32Array:
    """What errors are relative to: the reference, or the mean of all renders of the largest budget."""
    if scene.reference is not None:
        return scene.reference.image
    return np.mean(np.stack([image for batch in scene.final() for image in image_stack(batch.renders)]), axis=0)


def measure(batch: Batch, scene: SceneResults, truth: Float32Array) -> Point:
    """Errors of one rival under one budget, against the reference or else by the variance over seeds."""
    images, records = image_stack(batch.renders), batch.records
    point = Point(
        batch.rival,
        batch.budget,
        len(images),
        float(statistics.median(r.render_seconds for r in records)),
        float(statistics.median(r.samples for r in records)),
        max(r.peak_memory_mib for r in records),
        float(statistics.median(sum(r.rays.values()) for r in records)),
    )
    ends = [end for record in records if (end := training_end(record)) is not None]
    point.training_end = float(statistics.median(ends)) if 2 * len(ends) > len(records) else None
    choices = [choice for record in records if (choice := chosen_method(record))]
    point.chosen = statistics.mode(choices) if choices else ""
    if len(images) >= LEAST_SEEDS:
        pooled, single = metrics.seed_variance(images, truth), metrics.seed_deviations(images, truth)
        point.seed_error = pooled.trimmed
        if scene.reference is None:
            whole, trimmed = [one.whole for one in single], [one.trimmed for one in single]
            point.errors[RELMSE] = Spread(pooled.whole, min(whole), max(whole))
            # What a seed leaves out when trimmed is not what all do together: the range may miss the pooled figure.
            low, high = min(*trimmed, pooled.trimmed), max(*trimmed, pooled.trimmed)
            point.errors[RELMSE_TRIMMED] = Spread(pooled.trimmed, low, high)
    if scene.reference is not None:
        errors = [metrics.relative_squared_error(image, truth) for image in images]
        point.errors[RELMSE] = spread([error.whole for error in errors])
        point.errors[RELMSE_TRIMMED] = spread([error.trimmed for error in errors])
        point.errors[MAPE] = spread([metrics.absolute_percentage_error(image, truth) for image in images])
        point.errors[FLIP] = spread([metrics.flip(image, truth) for image in images])
    return point


def measure_scene(scene: SceneResults) -> list[Point]:
    """Every rival under every budget."""
    truth = denominator(scene)
    return [measure(batch, scene, truth) for batch in scene.batches]


def series(points: Sequence[Point], rival: str, measure: str) -> list[Point]:
    """A rival's points that have a measure, the quickest first."""
    return sorted((p for p in points if p.rival == rival and measure in p.errors), key=lambda p: p.seconds)


def learning_end(line: Sequence[Point]) -> tuple[float, float] | None:
    """Where on a rival's line training ended: samples and seconds, those in between two budgets interpolated.

    None where it went on to the end of the longest render.
    """
    if not line or line[-1].training_end is None:
        return None
    end = line[-1].training_end
    ordered = sorted(line, key=lambda p: p.samples)
    samples, seconds = [p.samples for p in ordered], [p.seconds for p in ordered]
    if end < samples[0] or end > samples[-1]:
        nearest = 0 if end < samples[0] else -1
        return end, seconds[nearest] * end / max(samples[nearest], 1e-9)
    return end, float(np.exp(np.interp(np.log(end), np.log(samples), np.log(seconds))))


def interpolate(x: float, xs: Sequence[float], ys: Sequence[float]) -> float:
    """Value at x of a line through points, straight between logarithms; the nearest point's outside."""
    order = np.argsort(xs)
    return float(np.exp(np.interp(math.log(x), np.log(np.asarray(xs)[order]), np.log(np.asarray(ys)[order]))))


def pareto_front(points: Sequence[Point], measure: str) -> list[Point]:
    """Those than which no other is both quicker and better, the quickest first."""
    front: list[Point] = []
    known = (p for p in points if measure in p.errors)
    for point in sorted(known, key=lambda p: (p.seconds, p.errors[measure].centre)):
        if not front or point.errors[measure].centre < front[-1].errors[measure].centre:
            front.append(point)
    return front


# ---------------------------------------------------------------------------------------------------------------------
# Efficiency

BETTER_CYCLES = "better of Cycles"


def efficiency(point: Point, by_seeds: bool = False) -> float:
    """1 / (trimmed relMSE x seconds); nan where it is not known."""
    if by_seeds:
        error = point.seed_error
    else:
        error = point.errors[RELMSE_TRIMMED].centre if RELMSE_TRIMMED in point.errors else math.nan
    return 1.0 / (error * point.seconds) if error * point.seconds > 0.0 else math.nan


@dataclass
class Ratios:
    """Efficiency of rivals over that of `base`, by scene.

    values : {rival: {scene: ratio}}
    """

    base: str
    scenes: list[str]
    values: dict[str, dict[str, float]]

    def mean(self, rival: str) -> float:
        """Geometric mean over all scenes; nan for a rival that lacks one, since the others' means hold it."""
        own = self.values[rival]
        return geometric_mean(list(own.values())) if len(own) == len(self.scenes) else math.nan


def efficiency_ratios(
    finals: Mapping[str, Sequence[Point]], base: str | None = None, by_seeds: bool = False
) -> Ratios | None:
    """Efficiencies relative to a rival; None where it has none.

    Parameters
    ----------
    finals : points of the largest budget by scene
    base : a rival's name or BETTER_CYCLES; None: the first Cycles rival that is there
    """
    table: dict[str, dict[str, float]] = {}
    for scene, points in finals.items():
        for point in points:
            value = efficiency(point, by_seeds)
            if math.isfinite(value):
                table.setdefault(point.rival, {})[scene] = value
    cycles = [name for name in CYCLES_RIVALS if name in table]
    if len(cycles) > 1:
        better = {scene: max(table[name].get(scene, 0.0) for name in cycles) for scene in finals}
        after = max(list(table).index(name) for name in cycles) + 1
        rows = list(table.items())
        table = dict([*rows[:after], (BETTER_CYCLES, {s: v for s, v in better.items() if v > 0.0}), *rows[after:]])
    base = base or (cycles[0] if cycles else None)
    if base is None or base not in table:
        return None
    of_base = table[base]
    scenes = [scene for scene in finals if scene in of_base]
    values = {
        rival: {scene: row[scene] / of_base[scene] for scene in scenes if scene in row} for rival, row in table.items()
    }
    return Ratios(base, scenes, values)


# ---------------------------------------------------------------------------------------------------------------------
# Time


def time_by_kind(record: RenderRecord) -> dict[str, float]:
    """Seconds of all threads together of one render, by TIME_KINDS."""
    total = record.render_seconds * record.threads
    stages = record.details.get("stage_seconds", {})
    if not stages:
        return {"rendering": total}
    kinds = dict.fromkeys(TIME_KINDS[:-2], 0.0)
    for stage, seconds in stages.items():
        kinds[_STAGE_KINDS.get(stage, "shading")] += float(seconds)
    learning = record.details.get("learning", {})
    kinds["fitting"] += float(learning.get("field_seconds", 0.0))
    kinds["training"] = float(learning.get("training_seconds", 0.0)) + float(learning.get("source_seconds", 0.0))
    kinds["waiting"] = max(total - sum(kinds.values()), 0.0)
    return kinds


def mean_time(batch: Batch) -> dict[str, float]:
    """Mean over seeds of `time_by_kind`."""
    each = [time_by_kind(record) for record in batch.records]
    return {kind: statistics.fmean(one.get(kind, 0.0) for one in each) for kind in each[0]}
