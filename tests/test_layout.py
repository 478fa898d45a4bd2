# SPDX-License-Identifier: GPL-3.0-or-later
"""Where tests lie, what they import and what they touch: folders mirror the packages, what tests share lies with the
helpers, and tests know of the product what anybody may know.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

TESTS = Path(__file__).resolve().parent
ROOT = TESTS.parent

#: Names that begin with an underscore and are public all the same: named tuples' methods, and those of `Bundle`.
PUBLIC_ALL_THE_SAME = {"_asdict", "_fields", "_make", "_replace"}
#: Private names of others, by the file that needs them.
OF_OTHERS = {
    "tests/engine/state/test_lane_columns.py": {"_numba_type_"},  # numba's own name of a type that an object has
    "tests/engine/kernels/test_rng.py": {"_sv"},  # scipy's direction numbers, which nothing else of scipy gives
    "tests/helpers/killed_renders.py": {"_exit"},  # of `os`: a fork must not run what its parent does at its end
}
#: Calls that take the name of an attribute as a string.
BY_STRING = {"delattr", "getattr", "hasattr", "setattr"}


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


def is_private(name: str) -> bool:
    """Whether a name, or the last part of a dotted one, is private."""
    last = name.rpartition(".")[2]
    return last.startswith("_") and not last.endswith("__") and last not in PUBLIC_ALL_THE_SAME


def touched_privates(source: str) -> list[str]:
    """Private names that a file imports, or reads or sets of anything that it has not made itself."""
    tree = ast.parse(source)
    own_classes = {node.name for node in ast.walk(tree) if isinstance(node, ast.ClassDef)}
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute):
            owner = node.value.func if isinstance(node.value, ast.Call) else node.value
            is_own = isinstance(owner, ast.Name) and owner.id in {"self", "cls", "super", *own_classes}
            found += [] if is_own else [node.attr]
        elif isinstance(node, ast.Import):
            found += [part for alias in node.names for part in alias.name.split(".")]
        elif isinstance(node, ast.ImportFrom):
            found += [*(node.module or "").split("."), *(alias.name for alias in node.names)]
        elif isinstance(node, ast.Call):
            function = node.func
            called = function.attr if isinstance(function, ast.Attribute) else getattr(function, "id", "")
            if called in BY_STRING:
                texts = [argument.value for argument in node.args[:2] if isinstance(argument, ast.Constant)]
                found += [text for text in texts if isinstance(text, str)]
    return [name for name in found if is_private(name)]


@pytest.mark.parametrize(
    "source, names",
    [
        ("choice._trial = 1", ["_trial"]),
        ("assert make()._table.rows", ["_table"]),
        ("from engine.accel import _library, trace", ["_library"]),
        ("import engine._hidden.room", ["_hidden"]),
        ("from engine._hidden import room", ["_hidden"]),
        ("def f():\n    monkeypatch.setattr(choice, '_TAKEN', 0)", ["_TAKEN"]),
        ("monkeypatch.setattr('engine.policy.choice._TAKEN', 0)", ["engine.policy.choice._TAKEN"]),
        ("getattr(model, '_sums')", ["_sums"]),
        ("class A(B):\n    def f(self):\n        return self._x + super()._y + A._z", []),
        ("from __future__ import annotations\nfrom addon.__main__ import main\nx.__dict__", []),
        ("camera._replace(width=2)._asdict()\n_own(2)", []),
        ("monkeypatch.setattr(choice, 'TAKEN', '_b')", []),
    ],
)
def test_private_names_are_found(source: str, names: list[str]) -> None:
    assert touched_privates(source) == names


def test_tests_and_benchmarks_touch_nothing_private() -> None:
    """What only a test knows of ties it to how a thing is done, where it should say what is done."""
    found = [
        f"{name}: {touched}"
        for folder in (TESTS, ROOT / "benchmarks")
        for file in sorted(folder.rglob("*.py"))
        for name in [file.relative_to(ROOT).as_posix()]
        for touched in touched_privates(file.read_text("utf-8"))
        if touched not in OF_OTHERS.get(name, ())
    ]
    assert found == []


def test_both_pythons_compile_kernels_by_the_same_numba() -> None:
    """Else what the Makefile says of tests of the estimator is no reason to leave them out on Python 3.13."""
    of_311, of_313 = (
        {line for line in (ROOT / f"requirements-{version}.lock").read_text().splitlines() if line.startswith(names)}
        for version in ("3.11", "3.13") for names in [("numba==", "llvmlite==")]
    )  # fmt: skip
    assert of_311 == of_313 and len(of_311) == 2
