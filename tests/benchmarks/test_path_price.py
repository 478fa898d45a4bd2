# SPDX-License-Identifier: GPL-3.0-or-later
"""At what price of a path a method wins."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest

from benchmarks.path_price import BASE, MethodCost, main

MIXTURE = MethodCost(error=1.0, path_seconds=4e-6, guide_seconds=2e-6)


@pytest.mark.parametrize("price", [0.5, 1.0, 8.0])
def test_efficiency_is_of_errors_and_of_both_parts_of_the_cost(price: float) -> None:
    resampled = MethodCost(error=0.5, path_seconds=5e-6, guide_seconds=12e-6)
    seconds = 4e-6 * price + 2e-6, 5e-6 * price + 12e-6
    assert resampled.efficiency(MIXTURE, price) == pytest.approx(2.0 * seconds[0] / seconds[1])
    assert resampled.efficiency(MIXTURE, math.inf) == pytest.approx(2.0 * 4.0 / 5.0)


@pytest.mark.parametrize(
    ("other", "price"),
    [
        (MethodCost(0.5, 5e-6, 12e-6), 8.0 / 3.0),
        # It costs less and errs less: at any price.
        (MethodCost(0.5, 4e-6, 1e-6), 0.0),
        # It errs as much and costs more: at none.
        (MethodCost(1.0, 5e-6, 12e-6), math.inf),
        # It errs more, and guiding costs it less: up to a price.
        (MethodCost(1.25, 4e-6, 1e-6), 0.75),
    ],
)
def test_at_the_price_where_they_are_even_both_are_as_efficient(other: MethodCost, price: float) -> None:
    found = other.break_even(MIXTURE)
    assert found == pytest.approx(price)
    if 0.0 < found < math.inf:
        assert other.efficiency(MIXTURE, found) == pytest.approx(1.0)


def test_a_scene_is_measured_and_drawn(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    figures, chart = tmp_path / "figures.json", tmp_path / "chart.svg"
    command = ["builtin:fail-keyhole", "--methods", "OFF", "--samples", "8", "--pixels", "256", "--seeds", "1"]
    assert main([*command, "--out", str(figures), "--to", str(chart)]) == 0
    costs = json.loads(figures.read_text())["fail-keyhole"]
    assert set(costs) == {BASE, "OFF"} and costs[BASE]["guide_seconds"] > 0.0 == costs["OFF"]["guide_seconds"]
    assert min(costs[BASE]["path_seconds"], costs["OFF"]["path_seconds"], costs["OFF"]["error"]) > 0.0
    assert "<svg" in chart.read_text() and "fail-keyhole" in capsys.readouterr().out
