# SPDX-License-Identifier: GPL-3.0-or-later
"""The sampler: stratified in every pair of a set's dimensions, uniform, independent between sets and pixels."""

import numpy as np
import pytest
from scipy import stats
from scipy.stats import qmc

from engine.kernels.rng import pixel_hash, sample_4d
from engine.runtime.jit import kernel


@kernel
def _draw(seed, pixel, first, dimension, out):
    rng = pixel_hash(seed, pixel)
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

    seed = combine(rng, dimension)
    index = reverse(scramble(reverse(sample), seed))
    if sample < 1 << 16:
        index &= 0xFFFF
    numbers = []
    for axis, point in enumerate(qmc.Sobol(4, scramble=False, bits=32)._sv):
        x = 0
        for bit in range(32):
            if index >> bit & 1:
                x ^= int(point[bit])
        numbers.append((reverse(scramble(reverse(x), combine(seed, axis + 1))) >> 8) * 2.0**-24)
    return numbers


@pytest.mark.parametrize("sample", [0, 1, 77, 65535, 65536, 1_000_000])
def test_numbers_are_scrambled_sobol_points(sample):
    """Direction numbers of scipy, which are those of Joe and Kuo too."""
    found = draw(1, first=sample)[0]
    assert np.allclose(found, _plain_sample(int(pixel_hash(1, 7)), sample, 3), rtol=0.0, atol=2.0**-24)


def draw(count, *, seed=1, pixel=7, dimension=3, first=0):
    out = np.zeros((count, 4), np.float32)
    _draw(seed, pixel, first, dimension, out)
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


def test_sets_pixels_and_seeds_are_independent():
    """Correlation of 4096 numbers: |r| < 4.5 / sqrt(N) fails by chance once in 100,000 pairs (13 pairs here)."""
    reference = draw(4096)[:, 0]
    others = [draw(4096, dimension=d)[:, 0] for d in range(4, 10)]
    others += [draw(4096, pixel=p)[:, 0] for p in (8, 9, 1000)]
    others += [draw(4096, seed=s)[:, 0] for s in (2, 3, 99)]
    others += [draw(4096, seed=2, pixel=8)[:, 0]]
    for other in others:
        assert abs(np.corrcoef(reference, other)[0, 1]) < 4.5 / np.sqrt(4096)


def test_first_samples_of_many_pixels_are_uniform():
    """Kolmogorov-Smirnov over 4000 pixels, four dimensions, at 0.001 with Sidak's correction."""
    points = np.concatenate([draw(1, pixel=p) for p in range(4000)])
    threshold = 1.0 - (1.0 - 0.001) ** 0.25
    for axis in range(4):
        assert stats.kstest(points[:, axis], "uniform").pvalue > threshold


@pytest.mark.parametrize("first", [1, 77, 4096])
def test_a_sample_depends_on_its_index_alone(first):
    assert np.array_equal(draw(8, first=first), draw(first + 8)[first:])
