# SPDX-License-Identifier: GPL-3.0-or-later
"""Pieces of HTML: escaped text, tables, charts for light and dark pages, bars in cells."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

from benchmarks.report.look import DARK, GLYPHS, look
from benchmarks.tables import format_figure

Cell = float | int | str | None


def chart(file: str, alt: str, caption: str) -> str:
    """A chart that `charts.save_themed` wrote, in the theme of the page."""
    dark = file.replace(".png", f"{DARK.suffix}.png")
    return (
        f'<figure><picture><source srcset="{escape(dark)}" media="(prefers-color-scheme: dark)">'
        f'<img src="{escape(file)}" alt="{escape(alt)}" loading="lazy"></picture>'
        f"<figcaption>{escape(caption)}</figcaption></figure>"
    )


def key(rival: str) -> str:
    """A rival's name behind its mark, in its colour."""
    style = look(rival)
    mark = f'<span class="key" style="color:{style.colour}" aria-hidden="true">{GLYPHS[style.marker]}</span>'
    return f"{mark} {escape(rival)}"


def table(caption: str, header: Sequence[str], rows: Sequence[Sequence[Cell]], rival_column: int | None = None) -> str:
    """A table of figures to three digits; names in `rival_column` get their marks."""
    head = "".join(f'<th scope="col">{escape(name)}</th>' for name in header)
    body = []
    for row in rows:
        cells = []
        for index, value in enumerate(row):
            text = key(str(value)) if index == rival_column else escape(format_figure(value))
            cells.append(f'<th scope="row">{text}</th>' if index == 0 else f"<td>{text}</td>")
        body.append(f"<tr>{''.join(cells)}</tr>")
    return (
        f'<div class="scroll"><table><caption>{escape(caption)}</caption><thead><tr>{head}</tr></thead>'
        f"<tbody>{''.join(body)}</tbody></table></div>"
    )


def bar_table(caption: str, header: Sequence[str], rows: Sequence[tuple[str, Sequence[float]]]) -> str:
    """A row a rival, a column a scene: each figure over a bar as long as it, to the scale of its column."""
    head = "".join(f'<th scope="col" class="bars">{escape(name)}</th>' for name in header)
    columns = len(header) - 1
    largest = [max((values[i] for _, values in rows if values[i] > 0.0), default=1.0) for i in range(columns)]
    body = []
    for rival, values in rows:
        cells = [f'<th scope="row">{key(rival)}</th>']
        for value, most in zip(values, largest, strict=True):
            if not value > 0.0:
                cells.append('<td class="bars">-</td>')
                continue
            best = ' class="best"' if value == most else ""
            bar = f'<span class="bar" style="width:{100.0 * value / most:.1f}%;background:{look(rival).colour}"></span>'
            cells.append(f'<td class="bars"><span{best}>{escape(format_figure(value))}</span>{bar}</td>')
        body.append(f"<tr>{''.join(cells)}</tr>")
    return (
        f'<div class="scroll"><table><caption>{escape(caption)}</caption><thead><tr>{head}</tr></thead>'
        f"<tbody>{''.join(body)}</tbody></table></div>"
    )


def details(summary: str, content: str) -> str:
    """Content that opens when asked for."""
    return f"<details><summary>{escape(summary)}</summary>{content}</details>"
