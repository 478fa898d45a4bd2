# SPDX-License-Identifier: GPL-3.0-or-later
"""Charts as PNG files, each for a light and a dark page."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from benchmarks.report.collect import Batch
from benchmarks.report.figures import (
    MEASURES,
    RELMSE_TRIMMED,
    TIME_KINDS,
    Point,
    interpolate,
    learning_end,
    mean_time,
    pareto_front,
    series,
)
from benchmarks.report.look import KINDS, THEMES, Theme, look
from benchmarks.tables import format_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_DPI = 110
#: Whose rays are drawn by bare Embree's time: ours as it is, and without guiding.
_LIMIT_RIVALS = ("OFF", "AUTO")


def save_themed(path: Path, size: tuple[float, float], draw: Callable[[Figure, Theme], None]) -> None:
    """Draw a figure of so many inches once a theme: `path`, and beside it the same with the theme's suffix."""
    import matplotlib
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    for theme in THEMES:
        colours: dict[Any, Any] = {
            "figure.facecolor": theme.ground, "axes.facecolor": theme.ground, "savefig.facecolor": theme.ground,
            "text.color": theme.text, "axes.labelcolor": theme.text, "axes.edgecolor": theme.text,
            "xtick.color": theme.text, "ytick.color": theme.text, "grid.color": theme.grid, "hatch.color": theme.ground,
            "legend.facecolor": theme.ground, "legend.edgecolor": theme.grid, "legend.framealpha": 0.85,
            "font.size": 10.0, "axes.spines.top": False, "axes.spines.right": False, "axes.titlesize": 11.0,
        }  # fmt: skip
        with matplotlib.rc_context(colours):
            figure = Figure(figsize=size, layout="constrained")
            FigureCanvasAgg(figure)
            draw(figure, theme)
            figure.savefig(path.with_name(f"{path.stem}{theme.suffix}.png"), dpi=_DPI, metadata={"Software": None})


def plain_log_axes(axes: Axes, which: str = "xy") -> None:
    """Logarithmic axes whose ticks are written out, also where they span less than a decade."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    for axis, name in ((axes.xaxis, "x"), (axes.yaxis, "y")):
        if name not in which:
            continue
        (axes.set_xscale if name == "x" else axes.set_yscale)("log")
        low, high = sorted(axis.get_view_interval())
        decades = math.log10(high / low) if low > 0.0 else 9.0
        digits = (1.0, 2.0, 3.0, 5.0, 7.0) if decades < 1.0 else (1.0, 2.0, 5.0) if decades < 2.5 else (1.0,)
        axis.set_major_locator(LogLocator(subs=digits, numticks=12))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_minor_locator(NullLocator())
    axes.grid(True, which="major", linewidth=0.6)
    axes.set_axisbelow(True)


def _legend(figure: Figure, axes: Iterable[Axes]) -> None:
    """One legend below all panels, each name once, in as many columns as fit."""
    entries: dict[str, Any] = {}
    for one in axes:
        for handle, name in zip(*one.get_legend_handles_labels(), strict=True):
            entries.setdefault(name, handle)
    width = sum(0.65 + 0.085 * len(name) for name in entries)  # about [inches]
    rows = math.ceil(width / figure.get_figwidth())
    columns = math.ceil(len(entries) / max(rows, 1))
    figure.legend(entries.values(), entries.keys(), loc="outside lower center", ncols=columns, fontsize=9)


def draw_errors(
    axes: Axes, points: Sequence[Point], rivals: Sequence[str], measure: str, over: str, theme: Theme,
    own_error: float = math.nan, bare_rate: float = 0.0,
) -> None:  # fmt: skip
    """Lines of one measure over "seconds" or "samples", with bands, and a star where training ended.

    `own_error`: of the reference; drawn as a dashed line where the axis comes near it. `bare_rate`: rays a second of
    bare Embree by all threads; over seconds errors are drawn dotted at the time that their rays alone would take.
    """
    for rival in rivals:
        line = series(points, rival, measure)
        # Logarithms have no zero.
        line = [p for p in line if p.errors[measure].centre > 0.0 and getattr(p, over) > 0.0]
        if not line:
            continue
        style = look(rival)
        x = [getattr(p, over) for p in line]
        y = [p.errors[measure].centre for p in line]
        low, high = [p.errors[measure].low for p in line], [p.errors[measure].high for p in line]
        axes.fill_between(x, low, high, color=style.colour, alpha=0.18, linewidth=0.0)
        if len(line) == 1:
            axes.vlines(x, low, high, color=style.colour, alpha=0.5)
        axes.plot(x, y, color=style.colour, marker=style.marker, linestyle=style.line, label=rival, markersize=6)
        if over == "seconds" and bare_rate > 0.0 and rival in _LIMIT_RIVALS and all(p.ray_count > 0.0 for p in line):
            limit = [p.ray_count / bare_rate for p in line]
            name = f"{rival}, its rays by bare Embree"
            axes.plot(limit, y, color=style.colour, linestyle=":", linewidth=1.6, label=name)
        end = learning_end(line)
        if end is not None:
            at = end[0] if over == "samples" else end[1]
            axes.plot(
                [at], [interpolate(at, x, y)], marker="*", markersize=15, markerfacecolor="none", linestyle="none",
                markeredgecolor=theme.text, label="end of training", zorder=5,
            )  # fmt: skip
            axes.axvline(at, color=style.colour, linewidth=0.9, linestyle=(0, (2, 2)))
    plain_log_axes(axes)
    if own_error > 0.0:
        least, most = axes.get_ylim()
        if own_error > 0.1 * least:
            axes.axhline(own_error, color=theme.text, linestyle="--", linewidth=1.0, label="the reference's own error")
            axes.set_ylim(min(least, 0.8 * own_error), most)
            plain_log_axes(axes)
    axes.set_title(measure)
    axes.set_xlabel("render time [s]" if over == "seconds" else "samples per pixel")


def error_chart(
    path: Path, points: Sequence[Point], rivals: Sequence[str], over: str, own_errors: dict[str, float],
    bare_rate: float = 0.0,
) -> None:  # fmt: skip
    """All measures that are known, a panel each; `own_errors` are the reference's, by measure; see `draw_errors`."""
    known = [name for name in MEASURES if any(name in p.errors for p in points)]

    def draw(figure: Figure, theme: Theme) -> None:
        panels = figure.subplots(1, len(known), squeeze=False).ravel()
        for axes, name in zip(panels, known, strict=True):
            draw_errors(axes, points, rivals, name, over, theme, own_errors.get(name, math.nan), bare_rate)
        _legend(figure, panels)

    save_themed(path, (max(2.85 * len(known), 7.2), 3.5), draw)


def front_chart(path: Path, points: Sequence[Point], rivals: Sequence[str]) -> None:
    """Error against time of everything, the front of what nothing beats, and what was chosen where something chose."""

    def draw(figure: Figure, theme: Theme) -> None:
        axes = figure.subplots()
        front = [p for p in pareto_front(points, RELMSE_TRIMMED) if p.errors[RELMSE_TRIMMED].centre > 0.0]
        axes.plot(
            [p.seconds for p in front], [p.errors[RELMSE_TRIMMED].centre for p in front], color=theme.text,
            linewidth=1.2, drawstyle="steps-post", label="front", zorder=1,
        )  # fmt: skip
        for rival in rivals:
            line = [p for p in series(points, rival, RELMSE_TRIMMED) if p.errors[RELMSE_TRIMMED].centre > 0.0]
            style = look(rival)
            axes.plot(
                [p.seconds for p in line], [p.errors[RELMSE_TRIMMED].centre for p in line], color=style.colour,
                marker=style.marker, linestyle="none", label=rival, markersize=8, zorder=3,
            )  # fmt: skip
        plain_log_axes(axes)
        for p in points:
            if p.chosen and RELMSE_TRIMMED in p.errors:
                at = (p.seconds, p.errors[RELMSE_TRIMMED].centre)
                axes.plot(
                    *at, marker="o", markersize=17, markerfacecolor="none", markeredgecolor=theme.text,
                    markeredgewidth=1.6, linestyle="none", label=f"{p.rival}, and what it chose", zorder=4,
                )  # fmt: skip
                axes.annotate(p.chosen, at, xytext=(11, 8), textcoords="offset points", fontsize=9)
        axes.set_xlabel("render time [s]")
        axes.set_ylabel(RELMSE_TRIMMED)
        _legend(figure, [axes])

    save_themed(path, (7.2, 4.6), draw)


def bar_chart(path: Path, values: dict[str, float], unit: str, mark: float = math.nan) -> None:
    """A horizontal bar a rival with its figure; `mark` draws a line."""

    def draw(figure: Figure, theme: Theme) -> None:
        axes = figure.subplots()
        names = [name for name, value in values.items() if math.isfinite(value)]
        for row, name in enumerate(names):
            axes.barh(row, values[name], color=look(name).colour, height=0.66)
            axes.annotate(
                format_figure(values[name]), (values[name], row), xytext=(5, 0), textcoords="offset points",
                va="center", bbox={"facecolor": theme.ground, "edgecolor": "none", "pad": 1.0},
            )  # fmt: skip
        axes.set_yticks(range(len(names)), names)
        axes.invert_yaxis()
        axes.margins(x=0.12)
        axes.set_xlim(left=0.0)
        if math.isfinite(mark):
            axes.axvline(mark, color=theme.text, linewidth=1.0, linestyle="--")
        axes.set_xlabel(unit)
        axes.tick_params(axis="y", length=0)

    save_themed(path, (7.2, 0.9 + 0.36 * max(len(values), 1)), draw)


def time_chart(path: Path, batches: Sequence[Batch]) -> None:
    """Thread seconds of each rival, stacked by kind of work."""

    def draw(figure: Figure, theme: Theme) -> None:
        axes = figure.subplots()
        for row, batch in enumerate(batches):
            start = 0.0
            kinds = mean_time(batch)
            for kind in TIME_KINDS:
                seconds = kinds.get(kind, 0.0)
                if seconds > 0.0:
                    colour, hatch = KINDS[kind]
                    axes.barh(row, seconds, left=start, color=colour, hatch=hatch, height=0.66)
                    start += seconds
        for kind in TIME_KINDS:  # the legend in this order, whoever is drawn first
            if any(mean_time(batch).get(kind, 0.0) > 0.0 for batch in batches):
                axes.barh(0, 0.0, color=KINDS[kind][0], hatch=KINDS[kind][1], label=kind)
        axes.set_yticks(range(len(batches)), [batch.rival for batch in batches])
        axes.invert_yaxis()
        axes.set_xlabel("seconds of all threads together")
        axes.tick_params(axis="y", length=0)
        _legend(figure, [axes])

    save_themed(path, (7.2, 1.5 + 0.36 * len(batches)), draw)
