# SPDX-License-Identifier: GPL-3.0-or-later
"""Total error is taken apart into what it is made of, whatever noise the references have."""

import numpy as np
import pytest

from benchmarks.total_error import total_error


@pytest.mark.parametrize(("bias", "deviation"), [(0.0, 0.2), (0.1, 0.05), (0.3, 0.0)])
def test_bias_and_variance_are_told_apart(bias, deviation):
    rng = np.random.default_rng(1)
    truth = np.ones((200, 300, 3))
    references = [truth + rng.normal(0.0, 0.03, truth.shape) for _ in range(2)]
    images = [truth + bias + rng.normal(0.0, deviation, truth.shape) for _ in range(3)]
    error = total_error(images, tuple(references))
    # Pixels left out are a thousandth of those with the largest errors.
    assert error.total == pytest.approx((bias**2 + deviation**2) / 1.01, rel=0.03, abs=5e-4)
    assert error.variance == pytest.approx(deviation**2 / 1.01, rel=0.03, abs=1e-12)
    assert error.bias_squared == pytest.approx(bias**2 / 1.01, rel=0.03, abs=5e-4)
    assert error.difference == pytest.approx(bias, abs=2e-3)
