# SPDX-License-Identifier: GPL-3.0-or-later
"""docs/blender.md: no setting of Cycles is missing, and what works is read."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from tools.blender_page import PAGE, owners, page, settings_of
from tools.cycles_settings import PANELS, Row

ADDON = Path(__file__).resolve().parents[2] / "addon"


def rows() -> list[tuple[str, Row]]:
    return [(owner, row) for _title, owner, panel in PANELS for row in panel]


def test_the_page_is_the_one_that_is_generated(blender: Any) -> None:
    if blender.app.version[:2] != (5, 0):
        pytest.skip("labels are those of Blender 5.0")
    assert PAGE.read_text("utf-8") == page(), "run python -m tools.blender_page"


def test_every_setting_of_cycles_is_on_the_page_once(blender: Any) -> None:
    named = [(owner, row.name) for owner, row in rows()]
    assert len(named) == len(set(named))
    there = {(owner, name) for owner, properties in owners().items() for name in settings_of(properties)}
    assert there - set(named) == set()
    assert {(owner, row.name) for owner, row in rows() if not row.is_newer} - there == set()


def test_what_works_is_read_and_what_is_of_no_use_is_not() -> None:
    source = "\n".join(path.read_text("utf-8") for path in sorted(ADDON.rglob("*.py")))
    words = set(re.findall(r"\w+", source))
    for owner, row in rows():
        if row.verdict in ("works", "said"):
            assert row.name in words, f"{owner}.{row.name} is {row.verdict}, but the add-on does not know it"
        elif owner == "scene.cycles":
            assert row.name not in words, f"{owner}.{row.name} is '{row.verdict}', but the add-on knows it"
