# SPDX-License-Identifier: GPL-3.0-or-later
"""`python -m tools.pixel_shifts`: search for the columns in `engine/kernels/pixel_shifts.py`, and print them.

What is wanted: of 2^k samples of each of 2^q pixels, in any one or two dimensions, every elementary interval of 2^t / N
of the N = 2^(k + q) points has 2^t of them, with t as small as can be, for all k and q at once. Whether that holds is a
matter of ranks over GF(2): rows are leading digits, columns those of the sequence and of the shifts (Niederreiter 1992,
"Random Number Generation and Quasi-Monte Carlo Methods", theorem 4.28). Columns are annealed one bit of the place after
the other, the finest first. The result depends on the seed alone.
"""

from __future__ import annotations

import argparse
import math

import numba
import numpy as np

from engine.kernels.pixel_shifts import DIGITS, PLACE_BITS
from engine.kernels.rng import SOBOL

#: Sets of dimensions that are looked at, one (-1: no second) or two, and how much they count: positions and directions
#: are drawn by the first two of a set, or by the second and third.
_SETS = ((0, -1), (1, -1), (2, -1), (3, -1), (0, 1), (1, 2), (0, 2), (2, 3), (0, 3), (1, 3))
_WEIGHTS = (1.0, 1.0, 1.0, 0.5, 1.0, 1.0, 0.5, 0.5, 0.25, 0.25)
#: Samples are 2^k with k up to this, and count the less the more there are.
_MOST_K = 6
_PER_K = 0.3
_SECOND_DIMENSION = 20  # bit at which its digits begin


def sobol_columns() -> np.ndarray:
    """First digits of the sequence's generator matrices: int64 (4, DIGITS), digit r is bit r."""
    columns = [SOBOL[16 * (bit // 4) + (1 << bit % 4)] & np.uint32((1 << DIGITS) - 1) for bit in range(DIGITS)]
    return np.ascontiguousarray(np.array(columns, np.int64).T)


@numba.njit
def _has_full_rank(columns, rank):
    """Whether the columns, whose digits may be bits of 0 to 40, span `rank` dimensions."""
    basis = np.zeros(41, np.int64)
    found = 0
    for column in columns:
        x = column
        while x != 0:
            lowest = x & -x
            place = 0
            while (lowest >> place) != 1:
                place += 1
            if basis[place] == 0:
                basis[place] = x
                found += 1
                break
            x ^= basis[place]
    return found == rank


@numba.njit
def quality(sequence, shifts, first, second, k, q):
    """The smallest t of 2^k samples of 2^q pixels.

    Parameters
    ----------
    sequence, shifts : int64 (4, columns)
    first, second : int
        Dimensions; -1 as the second: only one.
    """
    count = k + q
    columns = np.zeros(count, np.int64)
    for t in range(count):
        is_net = True
        for of_first in range(count - t + 1):
            of_second = count - t - of_first
            if second < 0 and of_second > 0:
                continue
            for j in range(count):
                a = sequence[first, j] if j < k else shifts[first, j - k]
                columns[j] = a & ((1 << of_first) - 1)
                if second >= 0:
                    b = sequence[second, j] if j < k else shifts[second, j - k]
                    columns[j] |= (b & ((1 << of_second) - 1)) << _SECOND_DIMENSION
            if not _has_full_rank(columns, count - t):
                is_net = False
                break
        if is_net:
            return t
    return count


@numba.njit
def _penalty(sequence, shifts, q, sets, weights):
    total = 0.0
    for i in range(len(sets)):
        for k in range(_MOST_K + 1):
            t = quality(sequence, shifts, sets[i, 0], sets[i, 1], k, q)
            total += weights[i] * t * t / (1.0 + _PER_K * k)
    return total


@numba.njit
def _search(sequence, sets, weights, tries, seed):
    """Columns by annealing, and their penalty."""
    np.random.seed(seed)
    shifts = np.zeros((4, PLACE_BITS), np.int64)
    total = 0.0
    for q in range(1, PLACE_BITS + 1):
        digits = min(DIGITS, _MOST_K + q)
        for dimension in range(4):
            shifts[dimension, q - 1] = np.random.randint(0, 1 << DIGITS)
        current = _penalty(sequence, shifts, q, sets, weights)
        least, best = current, shifts.copy()
        for i in range(tries):
            temperature = 1.01 - i / tries
            dimension = np.random.randint(0, 4)
            before = shifts[dimension, q - 1]
            for _ in range(np.random.randint(1, 4)):
                shifts[dimension, q - 1] ^= 1 << np.random.randint(0, digits)
            found = _penalty(sequence, shifts, q, sets, weights)
            if found <= current or np.random.random() < math.exp((current - found) / temperature):
                current = found
                if found < least:
                    least, best = found, shifts.copy()
            else:
                shifts[dimension, q - 1] = before
        shifts = best
        total += least
    return total, shifts


def main() -> None:
    """Search, and print the columns with the quality that they give."""
    parser = argparse.ArgumentParser(prog="python -m tools.pixel_shifts", description="Columns of pixels' shifts.")
    parser.add_argument("--tries", type=int, default=10_000, help="for each bit of a place (default: %(default)s)")
    parser.add_argument("--seeds", type=int, default=4, help="searches; the best is kept (default: %(default)s)")
    chosen = parser.parse_args()
    sequence, sets, weights = sobol_columns(), np.array(_SETS), np.array(_WEIGHTS)
    found = [_search(sequence, sets, weights, chosen.tries, seed) for seed in range(chosen.seeds)]
    total, shifts = min(found, key=lambda result: result[0])
    for first, second in _SETS:
        print(f"dimension {first}" if second < 0 else f"dimensions {first} and {second}", "(rows q, columns k)")
        for q in range(1, PLACE_BITS + 1):
            print("  ", *(quality(sequence, shifts, first, second, k, q) for k in range(_MOST_K + 1)))
    print(f"penalty {total:.1f}")
    for columns in shifts:
        print("(" + ", ".join(f"0x{int(column):04X}" for column in columns) + "),")


if __name__ == "__main__":
    main()
