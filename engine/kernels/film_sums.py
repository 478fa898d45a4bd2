# SPDX-License-Identifier: GPL-3.0-or-later
"""Sums of a unit of work, added to those of the whole film.

Rounded after each product and each sum, as numpy does: no flag lets LLVM join them.
"""

from enum import Enum
from typing import Any

import numpy as np

from engine.runtime.jit import kernel, written_kernel
from engine.state.columns import columns_of
from engine.state.film import FilmTile, Merge


@kernel(fastmath=False)
def _add_rows(target, pixels, rows, factor):
    if target.shape[0] == 0:
        return
    for k in range(len(pixels)):
        for c in range(target.shape[1]):
            target[pixels[k], c] += rows[k, c] * factor


@kernel(fastmath=False)
def _add_numbers(target, pixels, numbers, factor):
    if target.shape[0] == 0:
        return
    for k in range(len(pixels)):
        target[pixels[k]] += numbers[k] * factor


@kernel(fastmath=False)
def _add_counts(target, pixels, counts):
    for k in range(len(pixels)):
        target[pixels[k]] += counts[k]


@kernel(fastmath=False)
def _add_weights(target, pixels, counts, factor):
    for k in range(len(pixels)):
        weight = np.float64(target[pixels[k]]) + np.float64(counts[k]) * np.float64(factor)
        target[pixels[k]] = np.float32(weight)


#: Call that adds a column, by how it is merged; None: the film does it (`engine.render.film`).
_CALLS: dict[Enum | None, str | None] = {
    Merge.SUM: "{add}(film.{name}, pixels, tile.{name}, factor)",
    Merge.SQUARED_SUM: "{add}(film.{name}, pixels, tile.{name}, squared)",
    Merge.TOTAL: "{add}(film.{name}, pixels, tile.{name}, factor)",
    Merge.COUNT: "_add_counts(film.{name}, pixels, tile.{name})",
    Merge.WEIGHT: "_add_weights(film.{name}, pixels, tile.count, factor)",
    Merge.SQUARED_WEIGHT: "_add_weights(film.{name}, pixels, tile.count, squared)",
    Merge.FIRST: None,
    Merge.MATTES: None,
}


#: Of classes of sums that have been merged.
_ADDERS: dict[type[FilmTile], Any] = {}


def sums_adder(table: type[FilmTile]) -> Any:
    """A kernel that adds rows of sums to pixels of a film: all columns but those of the first sample and mattes.

    Returns
    -------
    kernel (film, pixels, tile, factor)
        It takes two `table`, the pixels of the rows as int64 (N,), each once, and the weight of each of the samples as
        float32.

    Raises
    ------
    TypeError
        If a column does not say how it is merged: its pass would be black.
    """
    if table not in _ADDERS:
        _ADDERS[table] = _write_adder(table)
    return _ADDERS[table]


def _write_adder(table: type[FilmTile]) -> Any:
    lines = ["def add_sums(film, pixels, tile, factor):", "    squared = factor * factor"]
    for name, declared in columns_of(table).items():
        if declared.merge not in _CALLS:
            raise TypeError(f"{table.__name__}.{name} does not say how it is merged")
        call = _CALLS[declared.merge]
        if call is not None:
            add = "_add_numbers" if len(declared.shape) == 1 else "_add_rows"
            lines.append("    " + call.format(name=name, add=add))
    return written_kernel("add_sums", lines, globals(), fastmath=False)
