# SPDX-License-Identifier: GPL-3.0-or-later
"""Grids of voxels in tiles: what is read comes back, what is empty takes no room, and what is no number is counted."""

from __future__ import annotations

import numpy as np
import pytest

from engine.scene.grids import TILE, pack_grid, unpack_values


def _packed(values, first=(0, 0, 0)):
    """The grid of dense values, float32 (X, Y, Z, C), the first of which has this index."""
    last = tuple(np.array(first) + values.shape[:3] - 1)

    def read(start, shape):
        out = np.zeros((*shape, values.shape[-1]), np.float32)
        source, target = [], []
        for begin, size, lowest, count in zip(start, shape, first, values.shape, strict=False):
            low, high = max(begin, lowest), min(begin + size, lowest + count)
            source.append(slice(low - lowest, max(high, low) - lowest))
            target.append(slice(low - begin, max(high, low) - begin))
        out[tuple(target)] = values[tuple(source)]
        return out

    return pack_grid("key", np.eye(4), first, last, read)


def _value(grid, index):
    place = np.array(index) - grid.first
    tile = grid.tiles[tuple(place // TILE)]
    return 0.0 if tile < 0 else unpack_values(grid)[tile, np.ravel_multi_index(tuple(place % TILE), (TILE,) * 3)]


@pytest.mark.parametrize("width", [1, 3])
@pytest.mark.parametrize("first", [(0, 0, 0), (-13, 5, 100)])
def test_voxels_come_back_to_a_65535th_of_their_tiles_range(width, first):
    values = np.random.default_rng(1).normal(size=(20, 9, 17, width)).astype(np.float32)
    grid, found = _packed(values, first)
    assert found.not_finite == 0 and found.negative == (values < 0.0).sum()
    for local in [(0, 0, 0), (19, 8, 16), (7, 3, 11)]:
        index = np.array(local) + first
        assert np.allclose(_value(grid, index), values[local], atol=np.ptp(values) / 60_000)


def test_empty_tiles_take_no_room_and_the_others_16_bits_a_voxel():
    values = np.zeros((64, 64, 64, 1), np.float32)
    values[8:16, 8:24, 40:48] = 1.0
    grid, _ = _packed(values)
    assert len(grid.voxels) == 2 and (grid.tiles >= 0).sum() == 2
    assert grid.nbytes <= 2 * (512 * 2 + 8) + 8**3 * 4


def test_what_is_no_number_becomes_0_and_is_counted():
    values = np.ones((8, 8, 8, 1), np.float32)
    values[0, 0, 0], values[1, 0, 0] = np.nan, np.inf
    grid, found = _packed(values)
    assert found.not_finite == 2 and _value(grid, (0, 0, 0)) == 0.0 and _value(grid, (2, 0, 0)) == 1.0
