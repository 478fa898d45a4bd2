# SPDX-License-Identifier: GPL-3.0-or-later
"""Error over time, biased pictures included: `python -m benchmarks.over_time RESULTS REFERENCES --to CHART.svg`.

A panel for each scene that `sweep --seconds` rendered, a line for each rival: total error, or FLIP of denoised
pictures. Besides, each of ours over the better Cycles at the same seconds.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.report.collect import Batch, SceneResults, collect
from benchmarks.report.look import LOOKS, Look
from benchmarks.rivals import CYCLES_RIVALS, DENOISED
from benchmarks.tables import format_figure, geometric_mean, table
from benchmarks.total_error import flip_of, total_error, two_references

_COLUMNS = 4


class Point(NamedTuple):
    """What a rival came to in some time [s], both medians over seeds."""

    seconds: float
    error: float


#: Points by rival, in the order of time; and rivals by scene.
Lines = dict[str, list[Point]]


def lines_of(scene: SceneResults, references: tuple[np.ndarray, np.ndarray], *, is_denoised: bool) -> Lines:
    """Total errors of a scene's pictures, or FLIP of its denoised ones.

    Parameters
    ----------
    scene : SceneResults
    references : two of float (height, width, 3 or 4)
    is_denoised : bool
    """
    lines: Lines = {}
    for batch in scene.batches:
        if batch.rival.endswith(DENOISED) != is_denoised:
            continue
        seconds = float(np.median([record.render_seconds for record in batch.records]))
        lines.setdefault(batch.rival.removesuffix(DENOISED), []).append(
            Point(seconds, _error(batch, references, is_denoised=is_denoised))
        )
    return {rival: sorted(points) for rival, points in lines.items()}


def _error(batch: Batch, references: tuple[np.ndarray, np.ndarray], *, is_denoised: bool) -> float:
    images = [render.image for render in batch.renders]
    return flip_of(images, references) if is_denoised else total_error(images, references).total


def over_better_cycles(lines: Lines) -> dict[tuple[str, int], float]:
    """Error of the better Cycles over that of each of ours, by rival and budget, the first being 0."""
    cycles = [lines[name] for name in CYCLES_RIVALS if name in lines]
    common = min((len(points) for points in cycles), default=0)
    return {
        (rival, place): min(one[place].error for one in cycles) / point.error
        for rival, points in lines.items() if rival not in CYCLES_RIVALS
        for place, point in enumerate(points[:common])
    }  # fmt: skip


def ratio_table(found: Mapping[str, Lines]) -> str:
    """A line for each scene with what ours have over the better Cycles, and the geometric means."""
    ratios = {scene: over_better_cycles(lines) for scene, lines in found.items()}
    columns = list(dict.fromkeys(column for of_scene in ratios.values() for column in of_scene))
    seconds = {
        (rival, place): float(np.median([lines[rival][place].seconds for lines in found.values() if rival in lines]))
        for rival, place in columns
    }
    rows: list[list[float | int | str | None]] = [
        [scene, *(of_scene.get(column) for column in columns)] for scene, of_scene in ratios.items()
    ]
    means = [geometric_mean([of_scene[c] for of_scene in ratios.values() if c in of_scene]) for c in columns]
    header = ["scene", *(f"{rival}, {format_figure(seconds[rival, place])} s" for rival, place in columns)]
    return table(header, [*rows, ["geometric mean", *means]])


def draw(found: Mapping[str, Lines], measure: str, to: Path) -> None:
    """A chart with a panel for each scene."""
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure
    from matplotlib.ticker import LogLocator, NullLocator

    columns = min(len(found), _COLUMNS)
    rows = -(-len(found) // columns)
    figure = Figure(figsize=(2.6 * columns, 2.3 * rows + 0.4), layout="constrained")
    FigureCanvasSVG(figure)
    panels = figure.subplots(rows, columns, squeeze=False, sharex=True).ravel()
    for panel, (scene, lines) in zip(panels, found.items(), strict=False):
        for rival, points in lines.items():
            look = LOOKS.get(rival, Look("black", "x"))
            panel.loglog(
                [point.seconds for point in points], [point.error for point in points], label=rival,
                color=look.colour, marker=look.marker, linestyle=look.line,
            )  # fmt: skip
        panel.set_title(scene, fontsize="small")
        panel.grid(visible=True, alpha=0.3)
        for axis in (panel.xaxis, panel.yaxis):
            axis.set_major_locator(LogLocator(subs=(1.0, 1.5, 2.0, 3.0, 5.0, 7.0)))
            axis.set_major_formatter("{x:g}")
            axis.set_minor_locator(NullLocator())
    for panel in panels[len(found) :]:
        panel.set_visible(False)
    figure.supxlabel("seconds", fontsize="small")
    figure.supylabel(measure, fontsize="small")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=5, fontsize="small")
    figure.savefig(to, metadata={"Date": None})


def main(arguments: Sequence[str] | None = None) -> int:
    """Draw a chart and print a table; returns the exit status."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.over_time", description=__doc__)
    parser.add_argument("results", type=Path, help="folder that `sweep` wrote")
    parser.add_argument("references", type=Path, help="folder that `run` wrote, with two renders of each scene")
    parser.add_argument("--denoised", action="store_true", help="FLIP of denoised pictures")
    parser.add_argument("--to", type=Path, help="where the chart is to be")
    chosen = parser.parse_args(arguments)
    try:
        (scenes, _), (others, _) = collect(chosen.results), collect(chosen.references)
        found = {
            scene.name: lines_of(scene, two_references(scene, others), is_denoised=chosen.denoised) for scene in scenes
        }
    except ValueError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print(ratio_table(found))
    if chosen.to is not None:
        draw(found, "FLIP" if chosen.denoised else "total error", chosen.to)
    return 0


if __name__ == "__main__":
    sys.exit(main())
