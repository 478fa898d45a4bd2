# SPDX-License-Identifier: GPL-3.0-or-later
"""docs/columns.md says what the declarations say."""

from __future__ import annotations

import re

import pytest

from engine.guiding.records.vertices import VertexRecords
from engine.runtime.bundle import Bundle
from engine.state.columns import columns_of
from engine.state.film import FilmTile
from engine.state.lanes import PathState
from tools.columns_page import PAGE, page


def test_the_page_is_the_one_that_is_generated() -> None:
    assert PAGE.read_text("utf-8") == page(), "run python -m tools.columns_page"


@pytest.mark.parametrize("table", [FilmTile, VertexRecords, PathState])
def test_every_column_has_a_line(table: type[Bundle]) -> None:
    section = page().split(f"### {table.__name__}\n")[1].split("\n### ")[0]
    for name, declared in columns_of(table).items():
        (line,) = [text for text in section.split("\n") if re.match(rf"- `{name}`(?: \([^)]*\))?: ", text)]
        assert declared.about in line
