# SPDX-License-Identifier: GPL-3.0-or-later
"""Adds a film to another of the same picture, whose samples are others: those of another seed, say."""

from __future__ import annotations

import numpy as np

from engine.kernels.mattes import merge_mattes
from engine.render.film import Film
from engine.render.strata import StrataFilm
from engine.state.columns import columns_of
from engine.state.film import FilmTile, Merge


def add_film(film: Film, other: Film) -> None:
    """Add the sums of `other`, which has the same size, layout and strata, to those of `film`."""
    slots = film.layout.data.options.matte_slots
    if isinstance(film, StrataFilm) and isinstance(other, StrataFilm):
        _add_sums(film.by_stratum.sums, other.by_stratum.sums, slots)
        _keep_first(film.sums, other.sums)
        film.combine(np.arange(film.width * film.height))
    else:
        _add_sums(film.sums, other.sums, slots)


def _add_sums(sums: FilmTile, others: FilmTile, matte_slots: int) -> None:
    """Both are weighted already, so that columns are added as they are."""
    _keep_first(sums, others)
    for name, declared in columns_of(FilmTile).items():
        values, added = getattr(sums, name), getattr(others, name)
        if declared.merge == Merge.MATTES and len(values):
            rows = np.arange(len(values))
            merge_mattes(values, rows, added, rows, matte_slots, np.ones(len(rows), np.float32))
        elif declared.merge != Merge.FIRST:
            values += added


def _keep_first(sums: FilmTile, others: FilmTile) -> None:
    """What is of the first sample, for pixels that have none yet."""
    is_empty = sums.count == 0
    for name, declared in columns_of(FilmTile).items():
        values = getattr(sums, name)
        if declared.merge == Merge.FIRST and len(values):
            values[is_empty] = getattr(others, name)[is_empty]
