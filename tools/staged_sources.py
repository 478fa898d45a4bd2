# SPDX-License-Identifier: GPL-3.0-or-later
"""The sources of the add-on as Blender gets them. Needs no package, so that any Python can install them."""

from __future__ import annotations

import ast
import shutil
from collections.abc import Sequence
from pathlib import Path

if __package__:
    from .blender_ranges import ROOT
else:
    from blender_ranges import ROOT

PACKAGES = ("addon", "engine")
FILES = ("__init__.py", "LICENSE", "README.md", "CHANGELOG.md")
#: Kernels that were compiled for this checkout: they are of no use elsewhere.
COMPILED = ROOT / "engine" / "compiled"


def relative_imports(source: str, folder: Sequence[str]) -> str:
    """Source with `from engine.x import y` written as `from ..engine.x import y`.

    Parameters
    ----------
    source : str
        Text of a module.
    folder : sequence of str
        Folders between the extension's root and the module: `('addon', 'export')`.

    Raises
    ------
    ValueError
        For `import engine.x`, which has no relative form.
    """
    lines = source.splitlines(keepends=True)
    dots = "." * (len(folder) + 1)
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ImportFrom) and node.level == 0 and (node.module or "").split(".")[0] in PACKAGES:
            row = node.lineno - 1
            lines[row] = lines[row].replace(f"from {node.module}", f"from {dots}{node.module}", 1)
        elif isinstance(node, ast.Import):
            for alias in node.names:
                if alias.name.split(".")[0] not in PACKAGES:
                    continue
                parent, _, name = alias.name.rpartition(".")
                if not alias.asname or len(node.names) > 1:
                    better = f"from {parent} import {name}" if parent else "from the package"
                    raise ValueError(f"line {node.lineno}: write `import {alias.name}` as `{better}`")
                row = node.lineno - 1
                lines[row] = lines[row].replace(
                    f"import {alias.name} as", f"from {dots}{parent} import {name} as", 1
                )
    return "".join(lines)


def absolute_imports(source: str) -> list[str]:
    """Imports of our packages that are still absolute."""
    found = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ImportFrom) and node.level == 0:
            found.append(node.module or "")
        elif isinstance(node, ast.Import):
            found.extend(alias.name for alias in node.names)
    return [name for name in found if name.split(".")[0] in PACKAGES]


def stage_sources(target: Path) -> None:
    """Copy what the extension holds into `target`, which is emptied first."""
    shutil.rmtree(target, ignore_errors=True)
    target.mkdir(parents=True)
    for name in FILES:
        shutil.copy(ROOT / name, target / name)
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*")):
            relative = path.relative_to(ROOT)
            if not path.is_file() or "__pycache__" in relative.parts or path.is_relative_to(COMPILED):
                continue
            destination = target / relative
            destination.parent.mkdir(parents=True, exist_ok=True)
            if path.suffix != ".py":
                shutil.copy(path, destination)
                continue
            text = relative_imports(path.read_text(encoding="utf-8"), relative.parts[:-1])
            if left := absolute_imports(text):
                raise ValueError(f"{relative}: cannot make relative: {', '.join(left)}")
            destination.write_text(text, encoding="utf-8")
