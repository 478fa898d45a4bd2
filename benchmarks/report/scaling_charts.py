# SPDX-License-Identifier: GPL-3.0-or-later
"""What `scaling` measured, on the page."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

from benchmarks.report import html
from benchmarks.report.charts import plain_log_axes, save_themed
from benchmarks.report.look import Theme, look
from benchmarks.scaling_fit import SCALING_FILE, Curve, curves_of
from benchmarks.tables import format_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def scaling_chart(path: Path, curves: list[Curve]) -> None:
    """A panel a curve: what was measured, and the power that fits."""
    columns = 3
    rows = -(-len(curves) // columns)

    def draw(figure: Figure, theme: Theme) -> None:
        panels = figure.subplots(rows, columns, squeeze=False).ravel()
        for axes, curve in zip(panels, curves, strict=False):
            style = look(curve.rival)
            axes.plot(curve.xs, curve.ys, color=style.colour, marker=style.marker, linestyle="none")
            fit = [curve.fit.predict(x) for x in curve.xs]
            axes.plot(curve.xs, fit, color=theme.text, linewidth=1.0, linestyle="--")
            plain_log_axes(axes)
            axes.set_title(f"{curve.name}: {curve.fit}")
            axes.set_xlabel(curve.x)
            axes.set_ylabel(curve.y)
        for axes in panels[len(curves) :]:
            axes.set_visible(False)

    save_themed(path, (4.2 * columns, 3.1 * rows), draw)


def scaling_section(folder: Path, to: Path) -> str:
    """The section of the page; '' where nothing was measured."""
    if not (folder / SCALING_FILE).is_file():
        return ""
    stored = json.loads((folder / SCALING_FILE).read_text(encoding="utf-8"))
    curves = curves_of(stored)
    scaling_chart(to / "scaling.png", curves)
    rows: list[list[html.Cell]] = [
        [c.name, c.rival, c.x, c.y, str(c.fit).removeprefix("exponent "), f"{c.xs[0]:g} to {c.xs[-1]:g}"]
        for c in curves
    ]
    header = ["cost against", "rival", "from", "of", "exponent", "range"]
    said = ", ".join(f"{c.name} {format_figure(c.fit.exponent)}" for c in curves)
    environment = stored.get("environment", {})
    return (
        '<section aria-labelledby="scaling"><h2 id="scaling">Scaling</h2>'
        + html.chart(
            "scaling.png",
            f"Cost against what it depends on, logarithmic. Exponents: {said}",
            "Dashed: the power that fits best in logarithms, its exponent with its standard error. "
            f"{environment.get('cpu', '')}, commit {environment.get('commit', '')}.",
        )
        + html.details("Exponents", html.table("Cost grows with this power of", header, rows, rival_column=1))
        + "</section>"
    )
