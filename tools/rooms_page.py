# SPDX-License-Identifier: GPL-3.0-or-later
"""`python -m tools.rooms_page` writes the list of rooms in docs/architecture.md from the docstrings of packages.

Their order is that of import-linter's layers in pyproject.toml, the highest first.
"""

from __future__ import annotations

import ast
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "architecture.md"

_BEGIN = "<!-- rooms: written by python -m tools.rooms_page -->\n"
_END = "<!-- end of the rooms -->\n"
_TOP = ("benchmarks", "demo", "addon", "engine", "tools")


def page() -> str:
    """The page with the list of rooms as the sources have it now."""
    before, rest = PAGE.read_text("utf-8").split(_BEGIN)
    _former, after = rest.split(_END)
    return "".join([before, _BEGIN, "\n", *_rows(), "\n", _END, after])


def first_sentence(docstring: str) -> str:
    """A docstring's summary line, without its full stop."""
    return docstring.strip().partition("\n")[0].rstrip(".")


def rooms_of(folder: Path, layers: dict[str, list[str]]) -> list[Path]:
    """Rooms right below a package: those of its layers if it has any, else its packages by name."""
    package = ".".join(folder.relative_to(ROOT).parts)
    if package in layers:
        paths = [folder / name for name in layers[package]]
        return [path if path.is_dir() else path.with_suffix(".py") for path in paths]
    return sorted(path.parent for path in folder.glob("*/__init__.py"))


def layers_of(contracts: list[dict[str, Any]]) -> dict[str, list[str]]:
    """By package the names of its layers, from the top down."""
    return {
        container: [name for layer in contract["layers"] for name in re.split(r"\s*[|:]\s*", layer.strip("() "))]
        for contract in contracts
        for container in contract.get("containers", ())
        if contract["type"] == "layers"
    }


def _rows() -> Iterator[str]:
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
    layers = layers_of(settings["tool"]["importlinter"]["contracts"])
    for name in _TOP:
        yield from _rows_of(ROOT / name, layers, "")


def _rows_of(room: Path, layers: dict[str, list[str]], indent: str) -> Iterator[str]:
    is_package = room.is_dir()
    source = room / "__init__.py" if is_package else room
    docstring = ast.get_docstring(ast.parse(source.read_text("utf-8")))
    if not docstring:
        raise ValueError(f"{source.relative_to(ROOT)} has no docstring: its first line says what the room is for")
    yield f"{indent}- `{room.name}{'/' if is_package else ''}` {first_sentence(docstring)}.\n"
    if is_package:
        for below in rooms_of(room, layers):
            yield from _rows_of(below, layers, indent + "  ")


if __name__ == "__main__":
    PAGE.write_text(page(), "utf-8")
