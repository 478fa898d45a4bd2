# SPDX-License-Identifier: GPL-3.0-or-later
"""Where tests lie and what they import: folders mirror the packages, and what tests share lies with the helpers."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

TESTS = Path(__file__).resolve().parent
ROOT = TESTS.parent


def imported_modules(source: str) -> Iterator[str]:
    """Modules that a file imports, at its top or within functions; of `from a import b` both `a` and `a.b`."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            module = "." * node.level + (node.module or "")
            yield module
            yield from (f"{module}.{alias.name}" for alias in node.names)


def forbidden_imports(source: str) -> list[str]:
    """Imports of a test or a helper from other files of tests than helpers, relative imports among them."""
    return [
        name
        for name in imported_modules(source)
        if name.startswith(".") or (name.split(".")[0] == "tests" and len(name.split(".")) > 1)
        if name.split(".")[1] != "helpers"
    ]


@pytest.mark.parametrize(
    "source, count",
    [
        ("from tests.engine.test_accel import at", 2),
        ("def f():\n    import tests.engine.test_accel", 1),
        ("from tests.engine import test_accel", 2),
        ("from tests import conftest", 1),
        ("from . import test_accel", 2),
        ("from tests.helpers.chi2 import pool\nfrom tests.helpers import chi2\nimport engine.accel", 0),
    ],
)
def test_imports_from_tests_are_found(source: str, count: int) -> None:
    assert len(forbidden_imports(source)) == count


def test_tests_and_helpers_import_from_helpers_only() -> None:
    files = sorted(TESTS.rglob("*.py"))
    assert len(files) > 100
    found = [
        f"{file.relative_to(ROOT)}: {name}" for file in files for name in forbidden_imports(file.read_text("utf-8"))
    ]
    assert found == []


def test_folders_mirror_the_packages() -> None:
    folders = {file.parent.relative_to(TESTS) for file in TESTS.rglob("test_*.py")} - {Path()}
    assert len(folders) > 10
    assert [str(folder) for folder in sorted(folders) if not (ROOT / folder).is_dir()] == []


def test_helpers_hold_no_tests() -> None:
    assert list((TESTS / "helpers").rglob("test_*.py")) == []
