# SPDX-License-Identifier: GPL-3.0-or-later
"""Cells of denoised pictures: what differs is found, and what is noise is not, though pixels err together."""

from __future__ import annotations

import numpy as np

from benchmarks.denoised_cells import compare_denoised
from benchmarks.images import Float32Array
from benchmarks.picture_means import picture_means

SIGMAS = 4.5


def blotched(seed: int, spread: float = 0.03) -> Float32Array:
    """A grey picture, as of a denoiser: blotches as large as cells, and little noise of single pixels."""
    rng = np.random.default_rng((seed, 3))
    blotches = np.kron(rng.normal(0.0, spread, (4, 6)), np.ones((9, 8)))
    picture = 0.5 * (1.0 + blotches + rng.normal(0.0, 0.1 * spread, (36, 48)))
    return np.repeat(picture[..., None], 3, axis=2).astype(np.float32)


def is_found(a: list[Float32Array], b: list[Float32Array]) -> tuple[bool, bool]:
    """Whether a difference is found in cells, and in the whole picture."""
    compared = compare_denoised(*(picture_means(images, 4, 6) for images in (a, b)))
    of_cells, of_mean = compared.limits(SIGMAS)
    return bool((np.abs(compared.difference) > of_cells).any()), abs(compared.mean_difference) > of_mean


def test_blotches_are_no_difference() -> None:
    """A hundred pairs, of 24 cells each: by chance about one in 6,000."""
    for first in range(0, 600, 6):
        seeds = [[blotched(first + k + 3 * of) for k in range(3)] for of in (0, 1)]
        assert is_found(*seeds) == (False, False)


def test_a_cell_and_a_picture_that_differ_are_found() -> None:
    a, b = ([blotched(k + 3 * of, 0.005) for k in range(3)] for of in (0, 1))
    assert is_found(a, b) == (False, False)
    brighter = [image.copy() for image in a]
    for image in brighter:
        image[9:18, 8:16] *= 1.08
    assert is_found(brighter, b)[0]
    assert is_found([1.03 * image for image in a], b)[1]
