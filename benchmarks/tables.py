# SPDX-License-Identifier: GPL-3.0-or-later
"""Plain-text tables that are Markdown too."""

from __future__ import annotations

import math
from collections.abc import Sequence


def format_figure(value: float | int | str | None, digits: int = 3) -> str:
    """A figure to so many significant digits; '-' for none or nan."""
    if value is None:
        return "-"
    if isinstance(value, str):
        return value
    if isinstance(value, float) and not math.isfinite(value):
        return "-" if math.isnan(value) else "inf"
    return f"{value:.{digits}g}" if abs(value) < 10**digits else f"{value:.0f}"


def table(header: Sequence[str], rows: Sequence[Sequence[float | int | str | None]]) -> str:
    """A Markdown table with aligned columns, text to the left and figures to the right."""
    cells = [[format_figure(value) for value in row] for row in rows]
    widths = [
        max(len(name), *(len(row[i]) for row in cells), 3) if cells else len(name) for i, name in enumerate(header)
    ]
    is_text = [all(isinstance(row[i], str) for row in rows) for i in range(len(header))]

    def line(values: Sequence[str]) -> str:
        padded = [v.ljust(w) if text else v.rjust(w) for v, w, text in zip(values, widths, is_text, strict=True)]
        return "| " + " | ".join(padded) + " |"

    rule = (
        "|"
        + "|".join("-" * (w + 2) if text else "-" * (w + 1) + ":" for w, text in zip(widths, is_text, strict=True))
        + "|"
    )
    return "\n".join([line(header), rule, *(line(row) for row in cells)])


def geometric_mean(values: Sequence[float]) -> float:
    """Geometric mean of positive finite values; nan if there are none."""
    usable = [math.log(v) for v in values if math.isfinite(v) and v > 0.0]
    return math.exp(sum(usable) / len(usable)) if usable else math.nan
