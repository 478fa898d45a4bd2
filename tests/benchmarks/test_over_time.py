# SPDX-License-Identifier: GPL-3.0-or-later
"""What ours have over the better Cycles at the same seconds, and the chart of it."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.over_time import Lines, Point, draw, over_better_cycles, ratio_table

LINES: Lines = {
    "cycles": [Point(1.0, 0.4), Point(2.0, 0.1)],
    "cycles-guided": [Point(1.0, 0.2), Point(2.0, 0.3)],
    "AUTO-AUTO": [Point(1.1, 0.1), Point(2.1, 0.02)],
}


def test_the_better_cycles_is_that_of_the_same_seconds() -> None:
    assert over_better_cycles(LINES) == {("AUTO-AUTO", 0): pytest.approx(2.0), ("AUTO-AUTO", 1): pytest.approx(5.0)}
    assert over_better_cycles({"AUTO-AUTO": LINES["AUTO-AUTO"]}) == {}


def test_the_table_ends_in_geometric_means() -> None:
    other = LINES | {"AUTO-AUTO": [Point(1.1, 0.025), Point(2.1, 0.02)]}
    said = ratio_table({"room": LINES, "cave": other}).splitlines()
    assert "AUTO-AUTO, 1.1 s" in said[0]
    assert said[-1].split("|")[2].strip() == "4"


def test_the_chart_has_a_panel_for_each_scene(tmp_path: Path) -> None:
    draw({"room": LINES, "cave": LINES}, "total error", tmp_path / "chart.svg")
    assert (tmp_path / "chart.svg").stat().st_size > 5000
