# SPDX-License-Identifier: GPL-3.0-or-later
"""docs/architecture.md lists the rooms as the sources have them."""

from __future__ import annotations

from tools.rooms_page import PAGE, ROOT, first_sentence, layers_of, page, rooms_of

MOST_WORDS = 3000


def test_the_list_of_rooms_is_the_one_that_is_generated() -> None:
    assert PAGE.read_text("utf-8") == page(), "run python -m tools.rooms_page"


def test_every_package_is_a_room() -> None:
    packages = [path.parent for name in ("addon", "engine") for path in (ROOT / name).rglob("__init__.py")]
    rows = [line.strip() for line in page().split("\n")]
    assert len(packages) > 30
    assert [str(path) for path in packages if not any(row.startswith(f"- `{path.name}/` ") for row in rows)] == []


def test_rooms_come_in_the_order_of_their_layers() -> None:
    contracts = [{"type": "layers", "containers": ["engine"], "layers": ["viewport | cluster", "settings"]}]
    layers = layers_of(contracts)
    assert layers == {"engine": ["viewport", "cluster", "settings"]}
    assert [path.name for path in rooms_of(ROOT / "engine", layers)] == ["viewport", "cluster", "settings.py"]


def test_a_summary_is_one_line() -> None:
    assert first_sentence("Learns light.\n\nMore of it.") == "Learns light"


def test_the_page_stays_short() -> None:
    assert len(PAGE.read_text("utf-8").split()) <= MOST_WORDS
