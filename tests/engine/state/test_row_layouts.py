# SPDX-License-Identifier: GPL-3.0-or-later
"""Columns within the rows of one array follow each other as they are declared."""

from __future__ import annotations

from engine.state.columns import RowLayout


def test_columns_lie_side_by_side_and_rows_fill_whole_lines() -> None:
    layout = RowLayout()
    assert [layout.take(3), layout.take(), layout.take(4)] == [0, 3, 4]
    assert layout.width() == 8
    assert layout.take() == 8
    assert layout.width() == 9
    assert layout.width(4) == 12
