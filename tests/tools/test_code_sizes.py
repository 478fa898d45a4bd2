# SPDX-License-Identifier: GPL-3.0-or-later
"""Limits to the size of files, classes and functions: what counts, and a list whose sizes only fall."""

from __future__ import annotations

from pathlib import Path

import pytest

from tools import code_sizes
from tools.code_sizes import faults, list_text, lowered, oversized, read_list


def function_of(line_count: int, head: str = "def f():", indent: str = "") -> str:
    """A function of so many lines."""
    return indent + head + "\n" + f"{indent}    x = 1\n" * (line_count - 1)


def parameters(count: int) -> str:
    return ", ".join(f"a{index}" for index in range(count))


@pytest.mark.parametrize(
    "source, found",
    [
        ("x = 1\n" * 500, {}),
        ("x = 1\n" * 501, {("a.py", "file lines"): 501}),
        (function_of(80), {}),
        (function_of(81), {("a.py: f", "function lines"): 81}),
        (function_of(81, "async def f():"), {("a.py: f", "function lines"): 81}),
        ("@decorated\n@twice\n" + function_of(80), {}),
        ("class C:\n" + function_of(81, indent="    "), {("a.py: C.f", "function lines"): 81}),
        ("if x:\n" + function_of(81, indent="    "), {("a.py: f", "function lines"): 81}),
        (function_of(90) + function_of(85), {("a.py: f", "function lines"): 90}),
        (function_of(301, "class C:"), {("a.py: C", "class lines"): 301}),
        (f"def f({parameters(10)}): pass", {}),
        (f"def f({parameters(9)}, /, b, *, c): pass", {("a.py: f", "parameters"): 11}),
        (f"def f({parameters(9)}, *rest, **others): pass", {("a.py: f", "parameters"): 11}),
        (f"class C:\n    def f(self, {parameters(10)}): pass", {}),
        (f"class C:\n    def f(self, {parameters(11)}): pass", {("a.py: C.f", "parameters"): 11}),
        (f"def f(self, {parameters(10)}): pass", {("a.py: f", "parameters"): 11}),
        (f"def f():\n    def g({parameters(11)}): pass", {("a.py: f.g", "parameters"): 11}),
    ],
)
def test_what_is_above_a_limit_is_found(source: str, found: dict[tuple[str, str], int]) -> None:
    assert oversized({"a.py": source}) == found


LISTED = {("a.py", "file lines"): 600}


@pytest.mark.parametrize(
    "found, sentences",
    [
        ({("a.py", "file lines"): 600}, []),
        ({("a.py", "file lines"): 601}, ["a.py: file lines 601, and 600 are allowed: divide it"]),
        (
            {("a.py", "file lines"): 590},
            ["a.py: file lines 600 listed, 590 now: run `python -m tools.code_sizes --lower`"],
        ),
        ({}, ["a.py: file lines 600 listed, not above 500 now, or gone: run `python -m tools.code_sizes --lower`"]),
        (
            {**LISTED, ("b.py: f", "parameters"): 11},
            ["b.py: f: parameters 11, and 10 are allowed: divide it"],
        ),
    ],
)
def test_listed_sizes_must_be_true(found: dict[tuple[str, str], int], sentences: list[str]) -> None:
    assert faults(found, LISTED) == sentences


def test_the_list_is_only_lowered() -> None:
    listed = {("a.py", "file lines"): 600, ("a.py: f", "parameters"): 12, ("b.py", "file lines"): 700}
    found = {("a.py", "file lines"): 550, ("a.py: f", "parameters"): 13, ("c.py", "file lines"): 501}
    assert lowered(found, listed) == {("a.py", "file lines"): 550, ("a.py: f", "parameters"): 12}


def test_the_list_is_read_as_it_was_written() -> None:
    sizes = {("a.py: C.f", "parameters"): 12, ("a.py", "file lines"): 600}
    assert read_list(list_text(sizes)) == sizes


@pytest.mark.parametrize("line", ["file lines\tmany\ta.py", "file lines 600 a.py", "columns\t600\ta.py"])
def test_a_line_that_is_no_size_is_named(line: str) -> None:
    with pytest.raises(ValueError, match=line.replace("\t", r"\\t")):
        read_list(line)


def test_the_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """Without a list one is written; then it is lowered, and never raised."""
    sources = {"a.py": "x = 1\n" * 600}
    monkeypatch.setattr(code_sizes, "repository_sources", lambda: sources)
    monkeypatch.setattr(code_sizes, "LISTED", tmp_path / "code_sizes.txt")
    assert code_sizes.main([]) == 1
    assert code_sizes.main(["--lower"]) == 0
    assert code_sizes.main([]) == 0
    sources["a.py"] = "x = 1\n" * 550
    assert code_sizes.main([]) == 1
    assert code_sizes.main(["--lower"]) == 0
    assert read_list(code_sizes.LISTED.read_text("utf-8")) == {("a.py", "file lines"): 550}
    sources["a.py"] = "x = 1\n" * 551
    capsys.readouterr()
    assert code_sizes.main(["--lower"]) == 1
    assert "551, and 550 are allowed" in capsys.readouterr().err


def test_all_python_of_the_repository_is_measured() -> None:
    sources = code_sizes.repository_sources()
    assert len(sources) > 500 and {"tools/code_sizes.py", "tests/tools/test_code_sizes.py"} <= set(sources)
