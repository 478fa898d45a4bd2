# SPDX-License-Identifier: GPL-3.0-or-later
"""Names of code that pages give beside a file: which are found, and which are stale."""

from __future__ import annotations

from pathlib import Path

import pytest

from tools.page_names import defined_names, names_in_page, stale_names


@pytest.mark.parametrize(
    "text, named",
    [
        ("see `a/b.py: f`.", [("a/b.py", "f")]),
        ("| `a/b.py` `C.f`; `c.py` `G` |", [("a/b.py", "C.f"), ("c.py", "G")]),
        ("`a/b.py`: `f`", [("a/b.py", "f")]),
        ("`a/b.py` (`f`, `g` and `H`), `i`", [("a/b.py", "f"), ("a/b.py", "g"), ("a/b.py", "H")]),
        ("`a/b.py`\n(`f`,\n`g`)", [("a/b.py", "f"), ("a/b.py", "g")]),
        ("`f` in `a/b.py`, `g` of `c.py`", [("a/b.py", "f"), ("c.py", "g")]),
        ("`a/b.py` `f(seed) -> int`", []),
        ("`a/b.py` `f(seed)`", [("a/b.py", "f")]),
        ("`a.py` and `b.py`, `c.py` `README.md`", []),
        ("`a.py` holds `f`; (`b.py`). `g`", []),
        ("```\n`a.py` `f`\n```\n", []),
    ],
)
def test_names_beside_files_are_found(text: str, named: list[tuple[str, str]]) -> None:
    assert names_in_page(text) == named


def test_what_a_file_defines() -> None:
    source = """
from other import imported
A, (B, C) = 1, (2, 3)
D: int = 4
if A:
    def f():
        local = 1
        def inner(): pass
@kernel
async def g(): pass
class H(Base):
    FIELD = 1
    count: int
    def method(self):
        self.set, other.set_elsewhere = 1, 2
        self.read()
    class Inner:
        x = 1
"""
    members = {"H", "H.FIELD", "H.count", "H.method", "H.set", "H.Inner", "H.Inner.x"}
    assert defined_names(source) == {"A", "B", "C", "D", "f", "g"} | members


def test_stale_names_are_said(tmp_path: Path) -> None:
    """A path may begin at any folder; of several files that it means, one must define the name."""
    files = {"engine/a/b.py": "def f(): pass", "addon/a/b.py": "def g(): pass", "engine/aa/b.py": "def h(): pass"}
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(parents=True)
        (tmp_path / name).write_text(text, "utf-8")
    page = "`a/b.py` (`f`, `g`, `h`), `engine/a/b.py: g` `engine/aa/b.py` `h`, `gone.py` `f`"
    assert sorted(stale_names({"page.md": page}, {name: tmp_path / name for name in files})) == [
        "page.md: a/b.py does not define h",
        "page.md: engine/a/b.py does not define g",
        "page.md: there is no gone.py, which should define f",
    ]
