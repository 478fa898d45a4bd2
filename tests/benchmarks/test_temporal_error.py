# SPDX-License-Identifier: GPL-3.0-or-later
"""Errors of sequences: the references' noise does not count, and an error that stays is none over time."""

import numpy as np
import pytest

from benchmarks.temporal_error import References, sequence_errors

SHAPE, COUNT = (30, 40, 3), 8


def test_noise_of_pictures_counts_and_that_of_references_does_not():
    """All moves 2 pixels to the right a frame; pictures are a tenth too bright, and noisy."""
    rng = np.random.default_rng(3)
    first, second, pictures = (
        [1.0 + bias + spread * rng.standard_normal(SHAPE) for _ in range(COUNT)]
        for bias, spread in ((0.0, 0.3), (0.0, 0.3), (0.1, 0.05))
    )
    vectors = [np.broadcast_to(np.float32((-2.0, 0.0, -2.0, 0.0)), (*SHAPE[:2], 4))] * COUNT
    ones = [np.ones(SHAPE)] * COUNT
    found = sequence_errors(pictures, References(first, second, ones, vectors))
    even = sequence_errors(pictures, References(ones, ones, ones, vectors))
    assert even.total == pytest.approx(0.0125 / 1.01, rel=0.02)
    assert even.temporal == pytest.approx(0.0025 / 1.01, rel=0.05)
    assert found.whole == pytest.approx(even.whole, rel=0.15)
    assert found.temporal == pytest.approx(even.temporal, rel=0.3)
    # Four frames back it was 8 pixels to the left: the picture is 40 wide, and half of the frames are looked at.
    assert even.disoccluded_share == pytest.approx(0.5 * 8 / 40)
    assert even.disoccluded == pytest.approx(even.total, rel=0.1)
