# SPDX-License-Identifier: GPL-3.0-or-later
"""A column of the film is declared once: allocated, merged, carried through strata and to other processes by that."""

from __future__ import annotations

import numpy as np
import pytest

from engine.array_types import Float32Array
from engine.cluster.work import pack_traced, unpack_traced
from engine.render.film import Film
from engine.render.strata import StrataFilm
from engine.render.traced import TracedTiles
from engine.state import film as film_state
from engine.state.columns import column, columns_of, rows_of
from engine.state.data_passes import DataLayout, DataOptions
from engine.state.film import FilmLayout, FilmTile, Merge, allocate_tile
from engine.state.unit import ALL_STRATA, UnitCosts

#: Of a film that has all columns.
LAYOUT = FilmLayout(
    use_features=True, use_residual=True, use_half=True, use_denoising=True, light_part_count=2, has_catchers=True,
    data=DataLayout(DataOptions(matte_slots=2), width=3, matte_count=2),
)
PIXELS = np.array([5, 1])
STRATA = 2


class ToyTile(FilmTile):
    """A film with two columns more."""

    toy: Float32Array = column("toys", "P", 2, merge=Merge.SUM)
    first_toy: Float32Array = column("that of the first sample", "P", needs="use_half", merge=Merge.FIRST)


class UnmergedTile(FilmTile):
    """A film with a column that nobody merges."""

    toy: Float32Array = column("toys", "P")


class UndeclaredTile(FilmTile):
    """A film with a field that is no column."""

    toy: Float32Array


def tile_of(rows, rng):
    """Sums with something in every column of every row."""
    tile = allocate_tile(rows, 3, LAYOUT)
    for values in tile:
        values[...] = rng.uniform(1.0, 2.0, values.shape)
    tile.count[:] = rng.integers(1, 5, rows)
    tile.mattes[..., 0] = 7.0
    return tile


def test_a_toy_column_is_merged_as_it_says(monkeypatch):
    monkeypatch.setattr(film_state, "FilmTile", ToyTile)
    rng = np.random.default_rng(1)
    film, tile, other = Film(4, 2, LAYOUT), tile_of(2, rng), tile_of(2, rng)
    film.merge(PIXELS, tile, 0.5)
    film.merge(PIXELS, other, 2.0)
    np.testing.assert_allclose(film.sums.toy[PIXELS], 0.5 * tile.toy + 2.0 * other.toy, rtol=1e-6)
    np.testing.assert_array_equal(film.sums.first_toy[PIXELS], tile.first_toy)
    assert np.count_nonzero(film.sums.toy) == 4 and np.count_nonzero(film.sums.first_toy) == 2
    assert len(Film(4, 2).sums.first_toy) == 0 and len(Film(4, 2).sums.toy) == 8


def test_a_toy_column_is_the_mean_of_its_strata(monkeypatch):
    monkeypatch.setattr(film_state, "FilmTile", ToyTile)
    rng = np.random.default_rng(2)
    film, tile, late = StrataFilm(4, 2, STRATA, LAYOUT), tile_of(4, rng), tile_of(2, rng)
    by_pixel = film.merge_stratum(PIXELS, tile, 1.0, ALL_STRATA)
    film.merge_stratum(PIXELS, late, 1.0, 1)
    toys, counts = tile.toy.reshape(2, STRATA, 2).copy(), tile.count.reshape(2, STRATA, 1).astype(float)
    np.testing.assert_allclose(by_pixel.toy[:2], toys.sum(axis=1), rtol=1e-6)
    toys[:, 1] += late.toy
    counts[:, 1] += late.count[:, None]
    mean = film.sums.toy[PIXELS] / film.sums.weight[PIXELS, None]
    np.testing.assert_allclose(mean, (toys / counts).mean(axis=1), rtol=1e-5)
    np.testing.assert_array_equal(film.sums.first_toy[PIXELS], tile.first_toy[::STRATA])


def test_a_toy_column_goes_to_other_processes(monkeypatch):
    monkeypatch.setattr(film_state, "FilmTile", ToyTile)
    sums = tile_of(4, np.random.default_rng(3))
    there = unpack_traced(pack_traced(TracedTiles(sums, [UnitCosts()], None)), LAYOUT).sums
    np.testing.assert_array_equal(there.toy, sums.toy)
    np.testing.assert_array_equal(there.first_toy, sums.first_toy)
    np.testing.assert_array_equal(rows_of(there, 1, 3).toy, sums.toy[1:3])


@pytest.mark.parametrize("stratum", [None, ALL_STRATA, 1])
def test_no_column_stays_black(stratum):
    rng = np.random.default_rng(4)
    film = Film(4, 2, LAYOUT) if stratum is None else StrataFilm(4, 2, STRATA, LAYOUT)
    tile = tile_of(4 if stratum == ALL_STRATA else 2, rng)
    film.merge(PIXELS, tile) if stratum is None else film.merge_stratum(PIXELS, tile, 1.0, stratum)
    for name in columns_of(FilmTile):
        merged = getattr(film.sums, name)[PIXELS]
        assert merged.size and (merged != 0).any(axis=tuple(range(1, merged.ndim))).all(), name


def test_all_ways_to_merge_are_in_use():
    """So that the tests above see each of them."""
    assert {declared.merge for declared in columns_of(FilmTile).values()} == set(Merge)


@pytest.mark.parametrize(
    "table, sentence",
    [(UnmergedTile, "toy does not say how it is merged"), (UndeclaredTile, "toy is not declared by column")],
)
def test_a_column_that_nobody_merges_is_refused(table, sentence, monkeypatch):
    monkeypatch.setattr(film_state, "FilmTile", table)
    with pytest.raises(TypeError, match=sentence):
        Film(4, 2, LAYOUT).merge(PIXELS, allocate_tile(2, 3, LAYOUT))
