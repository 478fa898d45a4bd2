# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernels chosen by a number."""

from __future__ import annotations

from typing import Any

import pytest

from engine.runtime.jit import by_number, kernel


@kernel
def _sum(a: float, b: float) -> float:
    return a + b


@kernel
def _product(a: float, b: float) -> float:
    return a * b


@kernel
def _first(a: float, b: float) -> float:
    return a


_chosen = by_number({3: _sum, 5: _sum, 8: _product, 9: _first}, "_chosen", __name__)


@kernel
def _called(number: int, a: float, b: float) -> Any:
    return _chosen(number, a, b)


@pytest.mark.parametrize(("number", "wanted"), [(3, 5.0), (5, 5.0), (8, 6.0), (9, 2.0), (77, 2.0)])
def test_a_number_decides_and_the_last_kernel_takes_the_rest(number: int, wanted: float) -> None:
    assert _chosen(number, 2.0, 3.0) == wanted
    assert _called(number, 2.0, 3.0) == wanted
