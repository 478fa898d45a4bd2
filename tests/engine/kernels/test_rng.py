# SPDX-License-Identifier: GPL-3.0-or-later
"""The sampler: stratified in every pair of a set's dimensions, uniform, independent between sets and between blocks of
pixels, and spread over the pixels of a block together."""

import numpy as np
import pytest
from scipy import stats
from scipy.stats import qmc

from engine.kernels.pixel_shifts import shift_table
from engine.kernels.rng import pixel_hash, sample_4d
from engine.kernels.rng_eight import sample_eight
from engine.runtime.jit import kernel
from engine.state.lanes import DRAW_WIDTH, allocate_light_draws


@kernel
def _draw(seed, column, row, first, dimension, out):
    rng = pixel_hash(seed, column, row)
    for i in range(out.shape[0]):
        a, b, c, d = sample_4d(rng, first + i, dimension)
        out[i, 0] = a
        out[i, 1] = b
        out[i, 2] = c
        out[i, 3] = d


def _plain_sample(rng, sample, dimension):
    """One set of numbers by the book, in Python's integers."""
    mask = 0xFFFFFFFF

    def reverse(x):
        return int(f"{x:032b}"[::-1], 2)

    def combine(a, b):
        x = a ^ ((b * 0x9E3779B9 + 0x7F4A7C15) & mask)
        x ^= x >> 16
        x = x * 0x7FEB352D & mask
        x ^= x >> 15
        x = x * 0x846CA68B & mask
        return x ^ (x >> 16)

    def scramble(x, seed):
        x ^= x * 0x3D20ADEA & mask
        x = (x + seed) & mask
        x = x * ((seed >> 16) | 1) & mask
        x ^= x * 0x05526C56 & mask
        return x ^ (x * 0x53A22864 & mask)

    seed = combine(rng >> 6, dimension)
    shifts = shift_table()[scramble(rng, seed * 0x9E3779B1 & mask) % 64]
    index = reverse(scramble(reverse(sample), seed))
    if sample < 1 << 16:
        index &= 0xFFFF
    numbers = []
    for axis, point in enumerate(qmc.Sobol(4, scramble=False, bits=32)._sv):
        x = 0
        for bit in range(32):
            if index >> bit & 1:
                x ^= int(point[bit])
        numbers.append((reverse(scramble(reverse(x) ^ int(shifts[axis]), combine(seed, axis + 1))) >> 8) * 2.0**-24)
    return numbers


@pytest.mark.parametrize("sample", [0, 1, 77, 65535, 65536, 1_000_000])
def test_numbers_are_scrambled_sobol_points(sample):
    """Direction numbers of scipy, which are those of Joe and Kuo too."""
    found = draw(1, first=sample)[0]
    assert np.allclose(found, _plain_sample(int(pixel_hash(1, 7, 3)), sample, 3), rtol=0.0, atol=2.0**-24)


def draw(count, *, seed=1, pixel=(7, 3), dimension=3, first=0):
    out = np.zeros((count, 4), np.float32)
    _draw(seed, *pixel, first, dimension, out)
    return out


def test_every_power_of_two_is_stratified_in_one_dimension():
    points = draw(1024)
    for count in (16, 256, 1024):
        for axis in range(4):
            assert len(set((points[:count, axis] * count).astype(int))) == count


def test_first_two_dimensions_are_a_net():
    """Every elementary interval of a (0, 2)-sequence's first 256 points holds exactly one."""
    points = draw(256)
    for x_cells in (1, 2, 4, 16, 64, 256):
        y_cells = 256 // x_cells
        cells = (points[:, 0] * x_cells).astype(int) * y_cells + (points[:, 1] * y_cells).astype(int)
        assert len(set(cells)) == 256


def test_values_lie_in_the_unit_interval():
    points = draw(1 << 16)
    assert points.min() >= 0.0
    assert points.max() < 1.0


def test_sets_blocks_and_seeds_are_independent():
    """Correlation of 4096 numbers: |r| < 4.5 / sqrt(N) fails by chance once in 100,000 pairs (13 pairs here)."""
    reference = draw(4096)[:, 0]
    others = [draw(4096, dimension=d)[:, 0] for d in range(4, 10)]
    others += [draw(4096, pixel=p)[:, 0] for p in ((8, 3), (7, 8), (1000, 500))]
    others += [draw(4096, seed=s)[:, 0] for s in (2, 3, 99)]
    others += [draw(4096, seed=2, pixel=(8, 3))[:, 0]]
    for other in others:
        assert abs(np.corrcoef(reference, other)[0, 1]) < 4.5 / np.sqrt(4096)


def test_first_samples_of_many_pixels_are_uniform():
    """Kolmogorov-Smirnov over pixels of 4000 blocks, four dimensions, at 0.001 with Sidak's correction."""
    points = np.concatenate([draw(1, pixel=(8 * (p % 80), 8 * (p // 80))) for p in range(4000)])
    threshold = 1.0 - (1.0 - 0.001) ** 0.25
    for axis in range(4):
        assert stats.kstest(points[:, axis], "uniform").pvalue > threshold


@pytest.mark.parametrize("first", [1, 77, 4096])
def test_a_sample_depends_on_its_index_alone(first):
    assert np.array_equal(draw(8, first=first), draw(first + 8)[first:])


def _net_quality(points, first, second):
    """The smallest t such that every elementary interval of 2^t / N has 2^t of the N points, in two dimensions."""
    levels = len(points).bit_length() - 1
    for t in range(levels):
        if all(
            (_counts(points[:, first], a, points[:, second], levels - t - a) == 1 << t).all()
            for a in range(levels - t + 1)
        ):
            return t
    return levels


def _counts(x, x_bits, y, y_bits):
    cells = ((x * (1 << x_bits)).astype(int) << y_bits) + (y * (1 << y_bits)).astype(int)
    return np.bincount(cells, minlength=1 << (x_bits + y_bits))


#: Columns and rows of pixels that are neighbours in a block.
GROUPS = [(2, 1), (2, 2), (4, 2), (4, 4), (8, 4), (8, 8)]


def _together(columns, rows, count, dimension, spacing=1):
    pixels = [(40 + spacing * x, 16 + spacing * y) for y in range(rows) for x in range(columns)]
    return np.concatenate([draw(count, pixel=pixel, dimension=dimension) for pixel in pixels])


@pytest.mark.parametrize("first, second", [(0, 1), (1, 2)])
@pytest.mark.parametrize("columns, rows", GROUPS)
def test_pixels_of_a_block_are_spread_together(columns, rows, first, second):
    """Whatever power of two of samples there is, and in every set alike."""
    found = [_net_quality(_together(columns, rows, 1 << k, 5), first, second) for k in range(7)]
    assert max(found) <= 3 and np.mean(found) <= 1.75
    assert found == [_net_quality(_together(columns, rows, 1 << k, 8), first, second) for k in range(7)]


def test_pixels_of_several_blocks_are_not():
    """The last test can fail: points of 64 pixels that are independent are not spread at all."""
    assert min(_net_quality(_together(8, 8, 1 << k, 5, spacing=8), 0, 1) for k in range(7)) >= 4


def test_each_set_has_an_order_of_its_own():
    """Which of two pixels has the larger number says nothing of another set: |r| < 4.5 / sqrt(N) fails by chance once
    in 100,000 pairs (45 pairs here)."""
    signs = np.zeros((10, 1536))
    for dimension in range(10):
        first = np.concatenate([draw(1, pixel=(8 * block, 0), dimension=dimension) for block in range(1536)])[:, 0]
        other = np.concatenate([draw(1, pixel=(8 * block + 2, 0), dimension=dimension) for block in range(1536)])[:, 0]
        signs[dimension] = np.sign(first - other)
    correlation = np.corrcoef(signs)[np.triu_indices(10, 1)]
    assert np.abs(correlation).max() < 4.5 / np.sqrt(1536)


@kernel
def _draw_eight(hashes, draws, one_by_one, side_by_side):
    for first in range(0, hashes.shape[1], DRAW_WIDTH):
        for k in range(DRAW_WIDTH):
            for row in range(3):
                draws.hashes[row, k] = hashes[row, first + k]
        sample_eight(draws)
        for k in range(DRAW_WIDTH):
            i = first + k
            one_by_one[i, 0], one_by_one[i, 1], one_by_one[i, 2], one_by_one[i, 3] = sample_4d(
                hashes[0, i], np.int32(hashes[1, i]), np.int32(hashes[2, i])
            )
            for c in range(4):
                side_by_side[i, c] = draws.real[0, c, k]


def test_eight_paths_at_once_have_the_same_numbers() -> None:
    """Early and late samples in the same eight, and in eight alone."""
    rng = np.random.default_rng(8)
    hashes = rng.integers(0, 1 << 32, (3, 4096), np.uint32)
    hashes[1] >>= rng.choice([1, 8, 16, 17, 24], 4096).astype(np.uint32)
    hashes[1, :1024] &= 0xFFFF
    hashes[2] >>= 12
    one_by_one, side_by_side = np.zeros((2, 4096, 4), np.float32)
    _draw_eight(hashes, allocate_light_draws(), one_by_one, side_by_side)
    np.testing.assert_array_equal(side_by_side, one_by_one)
    assert len(np.unique(side_by_side)) > 10_000
