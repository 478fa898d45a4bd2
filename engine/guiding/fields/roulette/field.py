# SPDX-License-Identifier: GPL-3.0-or-later
"""`RouletteField`: how much light surfaces send back for what it costs to find, by cell, in a hash table.

Cells are those of `hash_grid`. There are small ones, and large ones that answer where no small one is known. The
direction of the light plays no part: a look-up finds one number, in a table that stays near the core, and costs next to
nothing.
"""

from typing import Any

import numpy as np

from engine.array_types import Float32Array, Uint32Array
from engine.guiding.fields.hash_grid import claim_place, find_place, grid_cell
from engine.kernels.constants import NAN
from engine.runtime.bundle import Bundle
from engine.runtime.jit import kernel
from engine.state.columns import aligned_bytes

#: Sizes of cells, the smallest first, and how many times the side of the one before each has.
LEVEL_COUNT = 2
LEVEL_GROWTH = 4
#: Places of the table, a power of two, and how many of them a cell may be in.
SLOT_COUNT = 1 << 14
_PROBE_COUNT = 4
_PLACE_WIDTH = 2

# Elements of RouletteField.numbers.
NUMBER_INVERSE_SIZE = 0
NUMBER_SCALE = 1
NUMBER_LEAST = 2
NUMBER_COUNT = 3


class RouletteField(Bundle):
    """Cells of surface, S places.

    tag : uint32 (S,), by which a cell knows its place again; 0: the place is free
    importance : float32 (S,), square root of the second moment of the radiance that the cell's surfaces send back along
        a path, over the cost of what follows there
    mask : uint32 (1,), S - 1
    numbers : float32 (NUMBER_COUNT,), the inverse of the side of the smallest cells [1 / m]; by what importance times
        throughput times the root of the pixel's weight makes a survival probability; the least of these
    """

    _rows = True
    tag: Uint32Array
    importance: Float32Array
    mask: Uint32Array
    numbers: Float32Array

    def __reduce__(self) -> Any:
        used = np.flatnonzero(self.tag)
        return _with_places, (len(self.tag), self.numbers, used, self.tag[used], self.importance[used])


def empty_roulette_field(size: float = 1.0, slot_count: int = SLOT_COUNT) -> RouletteField:
    """A field that knows nothing, with room for so many cells, the smallest of this size [m]."""
    places = aligned_bytes(slot_count * _PLACE_WIDTH * 4).view(np.float32).reshape(slot_count, _PLACE_WIDTH)
    return RouletteField(
        places.view(np.uint32)[:, 0], places[:, 1], np.full(1, slot_count - 1, np.uint32),
        np.array([1.0 / size, 1.0, 1.0], np.float32),
    )


def copy_of_roulette_field(field: RouletteField) -> RouletteField:
    """The same in arrays of its own."""
    other = empty_roulette_field(slot_count=len(field.tag))
    other.tag[:], other.importance[:], other.numbers[:] = field.tag, field.importance, field.numbers
    return other


def _with_places(
    slot_count: int, numbers: np.ndarray, used: np.ndarray, tag: np.ndarray, importance: np.ndarray
) -> RouletteField:
    """A field from another process: strides are a part of its type, so it is made here."""
    field = empty_roulette_field(slot_count=slot_count)
    field.tag[used], field.importance[used], field.numbers[:] = tag, importance, numbers
    return field


def no_roulette_field() -> RouletteField:
    """A field of which nothing is asked."""
    return empty_roulette_field(slot_count=1)


@kernel
def roulette_key(field, p, n, program, level):
    """First place, and tag (not 0), of the cell of a level at p on the side that n faces: int, uint32.

    Parameters
    ----------
    p : tuple of 3 float32, world [m]; n : tuple of 3 float32, unit
    program : int, of the surface's shader
    level : int in [0, LEVEL_COUNT)
    """
    inverse = field.numbers[NUMBER_INVERSE_SIZE]
    if level > 0:
        inverse *= np.float32(1.0 / LEVEL_GROWTH)
    x, y, z, kind = grid_cell(p, n, program * LEVEL_COUNT + level, inverse)
    mixed = np.uint32(
        np.uint32(x * np.uint32(0x9E3779B1)) ^ np.uint32(y * np.uint32(0x85EBCA77))
        ^ np.uint32(z * np.uint32(0xC2B2AE3D)) ^ np.uint32(kind * np.uint32(0x27D4EB2F))
    )
    mixed = np.uint32(np.uint32(mixed ^ (mixed >> np.uint32(15))) * np.uint32(0x2C1B3C6D))
    number = np.uint32(np.uint32(mixed ^ (mixed >> np.uint32(12))) * np.uint32(0x297A2D39))
    place = np.uint32(number ^ (number >> np.uint32(15))) & field.mask[0]
    return np.int64(place), max(mixed, np.uint32(1))


@kernel
def find_importance(field, p, n, program):
    """Importance of the smallest cell at a point that is known: float32, NaN where none is.

    Parameters
    ----------
    p, n, program
        As for `roulette_key`.
    """
    for level in range(LEVEL_COUNT):
        place, tag = roulette_key(field, p, n, program, level)
        slot = find_place(field, place, tag, _PROBE_COUNT)
        if slot >= 0:
            return field.importance[slot]
    return NAN


@kernel
def claim_roulette_cell(field, place, tag):
    """Where in the table a cell is, made if there is none; -1 where the table has no room near."""
    return claim_place(field, place, tag, _PROBE_COUNT)
