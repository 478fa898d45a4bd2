# SPDX-License-Identifier: GPL-3.0-or-later
"""Arrays that the workers of a run share."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.helpers.kept_arrays import KeptArrays


def test_whoever_comes_second_makes_nothing(tmp_path: Path) -> None:
    made = np.random.default_rng(0).random((3, 4)).astype(np.float32)
    first = KeptArrays(tmp_path).get("numbers", lambda: made)
    second = KeptArrays(tmp_path).get("numbers", lambda: pytest.fail("it was made again"))
    np.testing.assert_array_equal(first, made, strict=True)
    np.testing.assert_array_equal(second, made, strict=True)
    assert [path.name for path in tmp_path.iterdir()] == ["numbers.npy"]


def test_what_cannot_be_made_is_not_there_for_others(tmp_path: Path) -> None:
    def fail() -> np.ndarray:
        raise OSError("no")

    with pytest.raises(OSError, match="no"):
        KeptArrays(tmp_path).get("numbers", fail)
    assert list(tmp_path.iterdir()) == []
