# SPDX-License-Identifier: GPL-3.0-or-later
"""The stability suite's matrix, for a terminal and as a page: what fails where."""

from __future__ import annotations

import base64
import html
import io
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from benchmarks.images import Float32Array, auto_exposure, tone_map
from benchmarks.tables import format_figure, table

if TYPE_CHECKING:
    from benchmarks.stability_cases import Case
    from benchmarks.stability_figures import Figures

#: Problem: symbol, colour, what it means; the first that applies is shown. Symbols, since not all see colours.
SYMBOLS = {
    "not finite": ("∞", "#c0392b", "pixels that are no numbers"),
    "biased": ("✗", "#c0392b", "biased"),
    "noticed": ("!", "#d35400", "the engine had to give up a part of guiding"),
    "noisier": ("▲", "#e59866", "more than 1.2 times the error of unguided rendering"),
    "blind": ("?", "#b2babb", "too noisy to see a bias of 2%"),
}
BETTER = ("●", "#58b368", "at most 0.8 of the error of unguided rendering")
SAME = ("·", "#d5ead8", "neither much better nor much worse")
_THUMBNAIL_WIDTH = 144


def mark(figures: Figures) -> tuple[str, str, str]:
    """Symbol, colour and meaning of a cell."""
    for problem in SYMBOLS:
        if problem in figures.problems:
            return SYMBOLS[problem]
    return BETTER if figures.error <= 0.8 else SAME


def matrix_text(results: Sequence[Figures]) -> str:
    """Cases down, methods across: a symbol, and the error over that of unguided rendering."""
    methods = list(dict.fromkeys(r.method for r in results))
    cells = {(r.case, r.method): f"{mark(r)[0]} {format_figure(r.error, 2)}" for r in results}
    rows: list[list[float | int | str | None]] = [
        [case, *(cells.get((case, method), "") for method in methods)]
        for case in dict.fromkeys(r.case for r in results)
    ]
    legend = ", ".join(f"{symbol} {meaning}" for symbol, _, meaning in (*SYMBOLS.values(), BETTER, SAME))
    return f"{table(['case', *methods], rows)}\n\n{legend}"


def _thumbnail(image: Float32Array) -> str:
    """A picture as a data URL, pixels enlarged."""
    from PIL import Image

    factor = max(_THUMBNAIL_WIDTH // image.shape[1], 1)
    pixels = tone_map(image, auto_exposure(image))
    pixels = np.repeat(np.repeat(pixels, factor, axis=0), factor, axis=1)
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, "PNG", optimize=True)
    return "data:image/png;base64," + base64.b64encode(buffer.getvalue()).decode("ascii")


def _cell(figures: Figures) -> str:
    symbol, colour, meaning = mark(figures)

    def shown(value: float) -> str:
        return format_figure(value, 2)

    lines = [
        f"{figures.method} on {figures.case}: {meaning}" if len(figures.problems) < 2
        else f"{figures.method} on {figures.case}: {', '.join(figures.problems)}",
        f"bias: {figures.bias}",
        f"variance {figures.variance:.2f} ± {figures.variance_error:.2f} (all pixels {shown(figures.variance_whole)})",
        f"total error {shown(figures.total)} of that of unguided rendering",
        f"worst pixels {shown(figures.worst_pixel)}, time {shown(figures.time)}, all over unguided rendering",
        f"{figures.seed_count} seeds, given up in {figures.stopped:.0%} of them, {figures.reject_count} rejects",
        *figures.notices,
    ]  # fmt: skip
    worst = "" if math.isnan(figures.worst_pixel) else f"px {shown(figures.worst_pixel)}"
    return (
        f'<td style="background:{colour}" title="{html.escape(chr(10).join(lines), quote=True)}">'
        f"<b>{symbol}</b> {shown(figures.error)}<br><small>{worst}<br>t {shown(figures.time)}</small></td>"
    )


def write_page(
    path: Path, results: Sequence[Figures], cases: Sequence[Case], references: Mapping[str, Float32Array], facts: str
) -> None:
    """Write the matrix as one HTML file, pictures included; figures show where the pointer rests."""
    methods = list(dict.fromkeys(r.method for r in results))
    by_cell = {(r.case, r.method): r for r in results}
    head = "".join(f"<th>{html.escape(method.replace('_', ' '))}</th>" for method in methods)
    body = []
    for case in cases:
        cells = "".join(
            _cell(by_cell[case.name, method]) if (case.name, method) in by_cell else "<td></td>" for method in methods
        )
        picture = _thumbnail(references[case.name])
        body.append(
            f'<tr><td class="case"><img src="{picture}" alt="{case.name}"><div><b>{case.name}</b><br>'
            f"{html.escape(case.purpose)}.</div></td>{cells}</tr>"
        )
    legend = "".join(
        f'<span style="background:{colour}"><b>{symbol}</b> {html.escape(meaning)}</span>'
        for symbol, colour, meaning in (*SYMBOLS.values(), BETTER, SAME)
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(
        f"""<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>Where guiding fails</title><style>
body {{ font: 14px/1.35 system-ui, sans-serif; margin: 1.5em; color: #222; background: #fff; }}
table {{ border-collapse: collapse; }}
th {{ position: sticky; top: 0; background: #fff; padding: 4px 6px; font-weight: 600; max-width: 6em; }}
td {{ border: 1px solid #fff; padding: 4px 6px; text-align: center; vertical-align: middle; }}
td.case {{ text-align: left; display: flex; gap: 10px; width: 420px; }}
td.case img {{ image-rendering: pixelated; width: {_THUMBNAIL_WIDTH}px; height: auto; align-self: center; }}
.legend span {{ padding: 2px 8px; margin-right: 6px; display: inline-block; }}
</style></head><body>
<h1>Where guiding fails</h1>
<p>{html.escape(facts)}. In each cell: error over that of unguided rendering at equal samples (without the worst
0.1% of pixels; with a radiance cache the total error, else the variance), squared error that one pixel in a thousand
exceeds (px) and processor time (t), over those of unguided rendering. Rest the pointer on a cell for bias, the bias
that would have been found, and rejects.</p>
<p class="legend">{legend}</p>
<table><thead><tr><th>case</th>{head}</tr></thead><tbody>
{"".join(body)}
</tbody></table></body></html>
""",
        encoding="utf-8",
    )
