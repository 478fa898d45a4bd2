# SPDX-License-Identifier: GPL-3.0-or-later
"""Leaf kernels compute compiled what they compute as plain Python: types, fast-math, call rewiring change nothing."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.helpers import kernel_values

ROOT = Path(__file__).resolve().parents[3]
#: Of the largest value of a column. A sharp coat's lobe magnifies roundings 400 times (2.4e-5), most values are within
#: 1e-6; a wrong branch or type is off by far more.
TOLERANCE = 1e-4


@pytest.fixture(scope="module")
def compiled() -> dict[str, np.ndarray]:
    return kernel_values.values()


@pytest.fixture(scope="module")
def interpreted(tmp_path_factory: pytest.TempPathFactory) -> dict[str, np.ndarray]:
    file = tmp_path_factory.mktemp("plain") / "values.npz"
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1", "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-m", "tests.helpers.kernel_values", str(file)]
    done = subprocess.run(command, env=environment, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    with np.load(file) as arrays:
        return dict(arrays)


def test_random_numbers_are_the_same_bit_for_bit(
    compiled: dict[str, np.ndarray], interpreted: dict[str, np.ndarray]
) -> None:
    assert len(np.unique(compiled["random"])) > 200
    np.testing.assert_array_equal(compiled["random"], interpreted["random"])


def test_kernels_agree_with_plain_python(compiled: dict[str, np.ndarray], interpreted: dict[str, np.ndarray]) -> None:
    assert compiled.keys() == interpreted.keys() and len(compiled) > 30
    wrong = []
    for name, expected in interpreted.items():
        expected = expected.astype(np.float64)
        assert np.isfinite(expected).all() and (expected.any() or name == "mirror evaluated"), name
        error = np.abs(compiled[name] - expected).reshape(len(expected), -1)
        size = np.abs(expected).reshape(len(expected), -1).max(axis=0)
        worst = float((error / np.where(size > 0.0, size, 1.0)).max())
        if not worst <= TOLERANCE:
            wrong.append(f"{name}: {worst:.2g}")
    assert not wrong
