# SPDX-License-Identifier: GPL-3.0-or-later
"""Angles by polynomials are those of the library."""

from __future__ import annotations

import numpy as np
import pytest

from engine.kernels.angles import sine_and_cosine, upper_angle
from engine.runtime.jit import kernel


@kernel
def _angles(y, x, out):
    for i in range(y.shape[0]):
        out[i] = upper_angle(y[i], x[i])


@kernel
def _sines(angles, out):
    for i in range(angles.shape[0]):
        out[i, 0], out[i, 1] = sine_and_cosine(angles[i])


def test_angles_of_the_upper_half_plane() -> None:
    """All around, of tiny, great and equal lengths, and along the axes."""
    expected = np.concatenate([np.linspace(0.0, np.pi, 10_001), np.geomspace(1e-7, 1.0, 1000)])
    for size in (1e-15, 1.0, 1e15):
        y, x = (size * np.sin(expected)).astype(np.float32), (size * np.cos(expected)).astype(np.float32)
        y = np.maximum(y, np.float32(0.0))
        out = np.zeros(len(y), np.float32)
        _angles(y, x, out)
        exact = np.arctan2(y.astype(np.float64), x.astype(np.float64))
        np.testing.assert_allclose(out, exact, rtol=4e-7, atol=1e-30)


@pytest.mark.parametrize(
    "y, x, angle", [(0, 0, 0), (0, 1, 0), (1, 0, np.pi / 2), (0, -1, np.pi), (1, -1, 0.75 * np.pi)]
)
def test_angles_of_the_axes(y: float, x: float, angle: float) -> None:
    out = np.zeros(1, np.float32)
    _angles(np.array([y], np.float32), np.array([x], np.float32), out)
    assert out[0] == pytest.approx(angle, rel=3e-7)


def test_sines_and_cosines_of_a_half_circle() -> None:
    angles = np.concatenate([np.linspace(0.0, np.pi, 10_001), np.geomspace(1e-7, 1.0, 1000)]).astype(np.float32)
    out = np.zeros((len(angles), 2), np.float32)
    _sines(angles, out)
    exact = angles.astype(np.float64)
    np.testing.assert_allclose(out[:, 0], np.sin(exact), atol=3e-7)
    np.testing.assert_allclose(out[:, 1], np.cos(exact), atol=3e-7)
    small = angles < 1.5
    np.testing.assert_allclose(out[small, 0], np.sin(exact[small]), rtol=3e-7)
