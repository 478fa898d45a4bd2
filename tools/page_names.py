# SPDX-License-Identifier: GPL-3.0-or-later
"""`python -m tools.page_names`: names that pages give beside a file must be defined in that file.

A page says by a file and a name where something is: `` `engine/runtime/jit.py: kernel` ``, `` `ris/orca.py` `FLOOR` ``,
`` `worker/training.py` (`Training`, `Training.step`) `` or `` `SOURCES` in `engine/methods.py` ``. The file's path may
begin at any folder.
"""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path

from tools.repository_files import ROOT, repository_files

_CODE_BLOCK = re.compile(r"^ *```.*?^ *```[^\n]*$", re.MULTILINE | re.DOTALL)
_NAME = r"[A-Za-z_]\w*(?:\.[A-Za-z_]\w*)*"
#: A span of code that is a name, called or not, and no file.
_NAME_SPAN = rf"`(?!\w+\.(?:md|py|sh)`)({_NAME})(?:\([^`\n]*\))?`"
_FILE = r"`([\w./-]*\w\.py)"
_NAME_WITHIN = re.compile(rf"{_FILE}:\s+({_NAME})`")
_NAME_AFTER = re.compile(rf"{_FILE}`:?\s+(?:\(\s*)?{_NAME_SPAN}")
_ANOTHER_AFTER = re.compile(rf"(?:,\s+|\s+and\s+|,\s+and\s+){_NAME_SPAN}")
_NAME_BEFORE = re.compile(rf"{_NAME_SPAN}\s+(?:in|of)\s+{_FILE}`")


def names_in_page(text: str) -> list[tuple[str, str]]:
    """File and name, of each name that a page gives beside a file, blocks of code left out."""
    text = _CODE_BLOCK.sub("", text)
    named = [(found.group(1), found.group(2)) for found in _NAME_WITHIN.finditer(text)]
    named += [(found.group(2), found.group(1)) for found in _NAME_BEFORE.finditer(text)]
    for first in _NAME_AFTER.finditer(text):
        named.append((first.group(1), first.group(2)))
        end = first.end()
        while another := _ANOTHER_AFTER.match(text, end):
            named.append((first.group(1), another.group(1)))
            end = another.end()
    return named


def _target_names(target: ast.expr) -> Iterator[str]:
    if isinstance(target, ast.Name):
        yield target.id
    elif isinstance(target, ast.Tuple | ast.List):
        for element in target.elts:
            yield from _target_names(element)


def _attributes_set(method: ast.AST) -> Iterator[str]:
    for node in ast.walk(method):
        if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store) and isinstance(node.value, ast.Name):
            yield from [node.attr] if node.value.id == "self" else []


def _names_below(node: ast.AST, owner: str = "") -> Iterator[str]:
    """Names that a module or a class binds, in branches too; a class's begin with its own and a dot."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.ClassDef):
            yield owner + child.name
            yield from _names_below(child, f"{owner}{child.name}.")
        elif isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef):
            yield owner + child.name
            yield from (owner + name for name in _attributes_set(child) if owner)
        elif isinstance(child, ast.Assign | ast.AnnAssign):
            targets = child.targets if isinstance(child, ast.Assign) else [child.target]
            yield from (owner + name for target in targets for name in _target_names(target))
        else:
            yield from _names_below(child, owner)


def defined_names(source: str) -> set[str]:
    """Functions, classes and constants of a file; methods, fields and attributes with their class before them.

    What a file imports is defined elsewhere, and what a function or a base class defines is not counted.

    Raises
    ------
    SyntaxError
        The source is no Python.
    """
    return set(_names_below(ast.parse(source)))


def stale_names(pages: Mapping[str, str], files: Mapping[str, Path]) -> list[str]:
    """A sentence for each name that no file of its path defines.

    Parameters
    ----------
    pages : Mapping[str, str]
        Text by the page's name.
    files : Mapping[str, Path]
        Where Python files are, by their path in the repository.
    """
    defined: dict[str, set[str] | None] = {}
    sentences = []
    for page, text in pages.items():
        for file, name in names_in_page(text):
            if file not in defined:
                found = [path for key, path in files.items() if f"/{key}".endswith(f"/{file}")]
                names = (defined_names(path.read_text("utf-8")) for path in found)
                defined[file] = set().union(*names) if found else None
            known = defined[file]
            if known is None:
                sentences.append(f"{page}: there is no {file}, which should define {name}")
            elif name not in known:
                sentences.append(f"{page}: {file} does not define {name}")
    return sentences


def main() -> int:
    pages = {path.relative_to(ROOT).as_posix(): path.read_text("utf-8") for path in repository_files("*.md")}
    files = {path.relative_to(ROOT).as_posix(): path for path in repository_files("*.py")}
    sentences = stale_names(pages, files)
    print("\n".join(sentences), file=sys.stderr, end="\n" if sentences else "")
    return 1 if sentences else 0


if __name__ == "__main__":
    raise SystemExit(main())
