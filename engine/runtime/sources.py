# SPDX-License-Identifier: GPL-3.0-or-later
"""Which sources a kernel is made of: numba's own cache does not see an edited callee in another file."""

from __future__ import annotations

import hashlib
import importlib.util
import re
from collections.abc import Iterable
from functools import cache
from pathlib import Path

#: The engine's own name: `engine`, or a part of Blender's packages in an extension.
PACKAGE = __package__.rpartition(".")[0]
ROOT = Path(__file__).resolve().parents[1]


@cache
def _module_file(name: str) -> Path | None:
    """Source file of `name` if it belongs to the engine, else None."""
    if not name.startswith(PACKAGE):
        return None
    parts = name.removeprefix(PACKAGE).strip(".")
    base = ROOT.joinpath(*parts.split(".")) if parts else ROOT
    for file in (base.with_suffix(".py"), base / "__init__.py"):
        if file.is_file():
            return file
    return None


#: Import statements, in functions too; text of a docstring that reads like one does no harm.
_IMPORT = re.compile(r"^[ \t]*(?:from[ \t]+([.\w]+)[ \t]+)?import[ \t]+(\([^)]*\)|[^\n]+)", re.MULTILINE)
_COMMENT = re.compile(r"#[^\n]*")
#: What a module that imports others by name says of them: their packages.
_FOUND_BY_NAME = re.compile(r"^FOUND_BY_NAME = \(([^)]*)\)", re.MULTILINE)
_STRING = re.compile(r'"([^"]*)"')


@cache
def imported_modules(name: str, file: Path) -> frozenset[str]:
    """Engine modules that module `name` imports, read from its source without running it.

    By regular expression: to parse all sources at every start would take longer than to load all kernels.
    """
    package = name if file.name == "__init__.py" else name.rpartition(".")[0]
    found: set[str] = set()
    for source, names in _IMPORT.findall(_text(file).decode()):
        imported = [item.split()[0] for item in _COMMENT.sub("", names).strip("() \t").split(",") if item.split()]
        if not source:
            found.update(imported)
            continue
        base = importlib.util.resolve_name(source, package) if source.startswith(".") else source
        found.add(base)
        found.update(f"{base}.{item}" for item in imported)
    for names in _FOUND_BY_NAME.findall(_text(file).decode()):
        for given in _STRING.findall(names):
            base = importlib.util.resolve_name(given, package)
            folder = _module_file(base)
            assert folder is not None, f"{name} finds modules by name in {base}, which is no package of the engine"
            found.update(f"{base}.{module.stem}" for module in folder.parent.glob("*.py") if module != file)
    return frozenset(module for module in found if _module_file(module) is not None)


@cache
def _text(file: Path) -> bytes:
    return file.read_bytes()


def reached_files(name: str, file: Path) -> list[Path]:
    """Sources of module `name` and of every engine module it reaches, in an order that the package's name leaves.

    The module itself may lie outside the engine (tests and benchmarks have kernels too).
    """
    seen: dict[str, Path] = {}
    pending = [(name, file)]
    while pending:
        module, module_file = pending.pop()
        if module not in seen:
            seen[module] = module_file
            for imported in imported_modules(module, module_file):
                imported_file = _module_file(imported)
                if imported_file is not None:
                    pending.append((imported, imported_file))
    return [seen[module] for module in sorted(seen)]


@cache
def source_hash(name: str, file: Path) -> str:
    """Hash of module `name` and of every engine module it reaches, so that an edited callee is never missed."""
    return hash_of(reached_files(name, file))


def hash_of(files: Iterable[Path]) -> str:
    """Hash of sources, in this order."""
    digest = hashlib.sha256()
    for file in files:
        digest.update(_text(file))
    return digest.hexdigest()[:16]
