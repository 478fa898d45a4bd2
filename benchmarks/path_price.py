# SPDX-License-Identifier: GPL-3.0-or-later
"""At what price of a path does a method win? `python -m benchmarks.path_price SCENE... --to CHART.svg`.

A guided path costs what tracing and shading it cost, and what guiding it costs. Renderers differ in the first: by their
language, their processor, their shaders. So methods are rendered at equal samples, their time is taken apart, and their
efficiency over the mixture field's is told for paths that are dearer or cheaper to trace than here. Training is left
out: this is what a network brings once it has been trained, for nothing.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.report.look import LOOKS, Look
from benchmarks.scene_files import expand, open_scene, restore_defaults
from benchmarks.stability import method_settings
from benchmarks.tables import table
from benchmarks.total_error import total_error
from engine.scene.description import SceneDescription
from engine.settings import RenderSettings

#: What others are compared with.
BASE = "VMM"
METHODS = (BASE, "OFF", "TABLE_RIS", "NEURAL_RIS", "NPM_PRODUCT", "NASG")
#: Clocks of what only guided paths do (`engine.wavefront.stages`).
GUIDES = frozenset(
    "prepare_guides guide_lights sample_source draw_candidates predict_radiance guide_resample collect_records".split()
)
#: Candidates at every guided vertex, where a method resamples.
CANDIDATES = 4
REFERENCE_SEEDS = (1001, 1002)
_COLUMNS = 4


@dataclass(frozen=True)
class MethodCost:
    """What a sample of a method costs, and what it leaves.

    error : float, total error of a picture of equal samples, median over seeds
    path_seconds : float, of a path's tracing and shading [s of one thread]
    guide_seconds : float, of guiding it [s of one thread]
    """

    error: float
    path_seconds: float
    guide_seconds: float

    def cost(self, price: float) -> float:
        """Seconds of a path in a renderer whose tracing and shading cost `price` times what they cost here."""
        return price * self.path_seconds + self.guide_seconds

    def efficiency(self, base: MethodCost, price: float) -> float:
        """Efficiency, 1 / (error x cost), over another method's in such a renderer; `price` inf: guiding is free."""
        if math.isinf(price):
            return base.error * base.path_seconds / (self.error * self.path_seconds)
        return base.error * base.cost(price) / (self.error * self.cost(price))

    def break_even(self, base: MethodCost) -> float:
        """Price from which on it is as efficient as another method, or up to which, where guiding it costs less.

        Returns
        -------
        float
            0: at any price; inf: at none.
        """
        gain = base.error / self.error
        # gain (p P_base + G_base) = p P + G
        slope = gain * base.path_seconds - self.path_seconds
        rest = self.guide_seconds - gain * base.guide_seconds
        if slope <= 0.0:
            return math.inf if rest >= 0.0 else rest / slope
        return max(rest / slope, 0.0)


def measure(description: SceneDescription, settings: RenderSettings) -> tuple[np.ndarray, float, float]:
    """A picture, float32 (height, width, 3), and a path's seconds without guiding and for it, of one thread."""
    from engine.render.session import Session

    session = Session(settings)
    try:
        session.load(description)
        result = session.render()
    finally:
        session.close()
    report = result.report
    guides = sum(seconds for stage, seconds in report.stage_seconds.items() if stage in GUIDES)
    rest = sum(report.stage_seconds.values()) - guides
    image = np.ascontiguousarray(result.passes["Combined"][::-1, :, :3])
    return image, rest / report.path_count, guides / report.path_count


def measure_scene(
    description: SceneDescription, base: RenderSettings, methods: Sequence[str], seeds: int, steps: int
) -> dict[str, MethodCost]:
    """Costs of methods on one scene; they take turns."""
    def settings(method: str, seed: int, **changes: Any) -> RenderSettings:
        found = method_settings(method, base, forced=True, steps=steps)
        return replace(found, seed=seed, radiance_cache="OFF", candidate_count=CANDIDATES, **changes)

    first, second = (
        measure(description, settings(BASE, seed, samples=16 * base.samples))[0] for seed in REFERENCE_SEEDS
    )
    found: dict[str, list[tuple[np.ndarray, float, float]]] = {method: [] for method in methods}
    for seed in range(1, seeds + 1):
        for method in methods:
            found[method].append(measure(description, settings(method, seed)))
    return {
        method: MethodCost(
            total_error([image for image, _, _ in renders], (first, second)).total,
            float(np.median([path for _, path, _ in renders])), float(np.median([guide for _, _, guide in renders])),
        )
        for method, renders in found.items()
    }  # fmt: skip


def price_table(found: Mapping[str, Mapping[str, MethodCost]]) -> str:
    """A line for each scene and method."""
    rows: list[list[float | int | str | None]] = []
    for scene, costs in found.items():
        base = costs[BASE]
        rows.extend(
            [
                scene, method, base.error / cost.error, 1e6 * cost.path_seconds, 1e6 * cost.guide_seconds,
                cost.efficiency(base, 1.0), cost.efficiency(base, math.inf), cost.break_even(base),
            ]
            for method, cost in costs.items()
        )  # fmt: skip
    header = (
        "scene", "method", "gain at equal samples", "path us", "guiding us", f"over {BASE}", "if guiding were free",
        "even at price",
    )  # fmt: skip
    return table(header, rows)


def draw(found: Mapping[str, Mapping[str, MethodCost]], to: Path) -> None:
    """A chart with a panel for each scene: efficiency over the mixture field's by the price of a path."""
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    prices = np.geomspace(0.5, 64.0, 50)
    columns = min(len(found), _COLUMNS)
    rows = -(-len(found) // columns)
    figure = Figure(figsize=(2.6 * columns, 2.3 * rows + 0.4), layout="constrained")
    FigureCanvasSVG(figure)
    panels = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True).ravel()
    for at, (panel, (scene, costs)) in enumerate(zip(panels, found.items(), strict=False)):
        panel.tick_params(labelbottom=at + columns >= len(found))  # The last row need not be full.
        base = costs[BASE]
        for method, cost in costs.items():
            look = LOOKS.get(method, Look("black", "x"))
            values = [cost.efficiency(base, price) for price in prices]
            panel.loglog(prices, values, label=method, color=look.colour, linestyle=look.line)
            panel.plot([1.0], [cost.efficiency(base, 1.0)], color=look.colour, marker=look.marker, markersize=4)
        panel.set_title(f"{scene}: {1e6 * base.path_seconds:.3g} us a path", fontsize="small")
        panel.grid(visible=True, alpha=0.3)
        for axis, ticks in ((panel.xaxis, (0.5, 1, 2, 4, 8, 16, 32, 64)), (panel.yaxis, (0.25, 0.5, 0.7, 1, 1.4, 2))):
            axis.set_ticks(ticks)
            axis.set_major_formatter("{x:g}")
            axis.set_ticks([], minor=True)
    for panel in panels[len(found) :]:
        panel.set_visible(False)
    figure.supxlabel("price of tracing and shading a path, here 1", fontsize="small")
    figure.supylabel(f"efficiency over {BASE}", fontsize="small")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=6, fontsize="small")
    figure.savefig(to, metadata={"Date": None})


def _scenes(chosen: argparse.Namespace) -> Iterator[tuple[str, SceneDescription, RenderSettings]]:
    """Scenes at Blender's default settings, with what a render of them is told."""
    import bpy

    from addon.export import export_scene
    from addon.properties import render_settings
    from benchmarks.rivals import Budget, find_rival

    for source in expand(chosen.scenes):
        scene = open_scene(source, chosen.pixels)
        find_rival(BASE).configure(scene, Budget(chosen.samples), 1, chosen.threads)
        restore_defaults(scene)
        yield source.name, export_scene(bpy.context.evaluated_depsgraph_get()), render_settings(scene)


def main(arguments: Sequence[str] | None = None) -> int:
    """Render, print a table and draw a chart; returns the exit status."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.path_price", description=__doc__)
    parser.add_argument("scenes", nargs="+", help=".blend files, folders of them, or builtin:NAME")
    parser.add_argument("--methods", nargs="+", default=METHODS, help=f"guiding methods (default: {' '.join(METHODS)})")
    parser.add_argument("--samples", type=int, default=63, help="per pixel (default: %(default)s)")
    parser.add_argument("--pixels", type=int, default=4096, help="of each scene, about (default: %(default)s)")
    parser.add_argument("--seeds", type=int, default=2, help="renders of each (default: %(default)s)")
    parser.add_argument("--threads", type=int, default=1, help="(default: %(default)s)")
    parser.add_argument("--steps", type=int, default=64, help="of training an iteration (default: %(default)s)")
    parser.add_argument("--out", type=Path, default=Path("out/path_price.json"), help="figures (default: %(default)s)")
    parser.add_argument("--to", type=Path, help="where the chart is to be")
    chosen = parser.parse_args(arguments)
    methods = list(dict.fromkeys((BASE, *chosen.methods)))
    found: dict[str, dict[str, MethodCost]] = {}
    chosen.out.parent.mkdir(parents=True, exist_ok=True)
    try:
        for name, description, base in _scenes(chosen):
            found[name] = measure_scene(description, base, methods, chosen.seeds, chosen.steps)
            figures = {
                scene: {method: asdict(cost) for method, cost in costs.items()} for scene, costs in found.items()
            }
            chosen.out.write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")
    except ValueError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print(price_table(found))
    if chosen.to is not None:
        draw(found, chosen.to)
    return 0


if __name__ == "__main__":
    sys.exit(main())
