# SPDX-License-Identifier: GPL-3.0-or-later
"""Rivals over the better Cycles by efficiency, scene by scene, with intervals that say how far seeds can be trusted."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np

from benchmarks import metrics
from benchmarks.block_noise import student_score
from benchmarks.images import Float32Array
from benchmarks.rendering import Render, image_stack
from benchmarks.rivals import CYCLES_RIVALS
from benchmarks.tables import format_figure, geometric_mean, table

#: Probability with which an interval holds the ratio, for costs of seeds that are normal.
CONFIDENCE = 0.95
#: Seeds from which on an interval is given.
LEAST_SEEDS = 4


@dataclass(frozen=True)
class Cost:
    """Error times seconds of one rival: what a render of error 1 takes, if the error falls as 1 / time.

    value : trimmed variance over seeds times the mean of the seconds that tracing took [s]
    relative_error : standard error of `value` over `value`; nan for fewer than LEAST_SEEDS seeds
    freedom : degrees of freedom of `relative_error`
    """

    value: float
    relative_error: float
    freedom: int


@dataclass(frozen=True)
class Ratio:
    """A cost over another, and its interval of CONFIDENCE; nan where nothing is known of it."""

    value: float
    low: float
    high: float

    def __str__(self) -> str:
        interval = "" if math.isnan(self.low) else f" ({format_figure(self.low)} to {format_figure(self.high)})"
        return f"{format_figure(self.value)}{interval}"


def cost(images: Sequence[Float32Array], seconds: Sequence[float], denominator: Float32Array) -> Cost:
    """Cost of a rival by renders of independent seeds, and how far these differ.

    A seed's part is its own squared distance from the mean of all (`metrics.seed_deviations`) times its own seconds, so
    a seed that chose worse than the others widens the interval. The mean holds every seed's noise, so parts differ less
    than seeds do, by (n - 2) / (n - 1).
    """
    value = metrics.seed_variance(images, denominator).trimmed * float(np.mean(seconds))
    if len(images) < LEAST_SEEDS or value <= 0.0:
        return Cost(value, math.nan, 0)
    single = [
        error.trimmed * spent
        for error, spent in zip(metrics.seed_deviations(images, denominator), seconds, strict=True)
    ]
    count = len(single)
    deviation = float(np.std(single, ddof=1)) * (count - 1) / (count - 2)
    return Cost(value, deviation / math.sqrt(count) / float(np.mean(single)), count - 1)


def ratio(base: Cost, other: Cost) -> Ratio:
    """Efficiency of `other` over that of `base`, with an interval by Student's t of the ratio's logarithm.

    The degrees of freedom are those of Welch (1947).
    """
    if not base.value * other.value > 0.0:
        return Ratio(math.nan, math.nan, math.nan)
    value = base.value / other.value
    parts = [cost.relative_error**2 for cost in (base, other)]
    if not all(math.isfinite(part) for part in parts):
        return Ratio(value, math.nan, math.nan)
    variance = sum(parts)
    spread = sum(part**2 / cost.freedom for part, cost in zip(parts, (base, other), strict=True))
    freedom = variance**2 / spread if spread > 0.0 else math.inf
    width = student_score(NormalDist().inv_cdf(0.5 + CONFIDENCE / 2.0), freedom) * math.sqrt(variance)
    return Ratio(value, value * math.exp(-width), value * math.exp(width))


def over_better_cycles(renders: Mapping[str, Sequence[Render]], denominator: Float32Array | None) -> dict[str, Ratio]:
    """Efficiency of each of our rivals over that of the better Cycles of one scene; empty without Cycles or seeds.

    Parameters
    ----------
    renders : renders of one budget by rival
    denominator : what errors are relative to; None: the mean of all renders
    """
    enough = {name: list(some) for name, some in renders.items() if len(some) >= 3}
    if not any(name in enough for name in CYCLES_RIVALS):
        return {}
    if denominator is None:
        denominator = np.mean(np.stack([image for some in enough.values() for image in image_stack(some)]), axis=0)
    costs = {
        name: cost(image_stack(some), [render.record.render_seconds for render in some], denominator)
        for name, some in enough.items()
    }
    better = min((costs[name] for name in CYCLES_RIVALS if name in costs), key=lambda one: one.value)
    return {name: ratio(better, own) for name, own in costs.items() if name not in CYCLES_RIVALS}


def over_better_cycles_table(found: Mapping[tuple[str, str], Mapping[str, Ratio]]) -> str:
    """A line for each scene, a column for each budget and rival, and the geometric mean of scenes.

    Parameters
    ----------
    found : {(scene, budget): what `over_better_cycles` found}
    """
    scenes = list(dict.fromkeys(scene for scene, _ in found))
    columns = list(dict.fromkeys((budget, rival) for (_, budget), ratios in found.items() for rival in ratios))
    rows: list[list[float | int | str | None]] = []
    for scene in scenes:
        ratios = [found.get((scene, budget), {}).get(rival) for budget, rival in columns]
        rows.append([scene, *("-" if one is None else str(one) for one in ratios)])
    # A mean over other scenes than the next column's would compare nothing.
    means = []
    for budget, rival in columns:
        values = [one.value for (_, b), all_of in found.items() if b == budget and (one := all_of.get(rival))]
        means.append(format_figure(geometric_mean(values)) if len(values) == len(scenes) else "-")
    return table(
        ["scene", *(f"{rival}, {budget}" for budget, rival in columns)], [*rows, ["geometric mean", *means]]
    )
