# SPDX-License-Identifier: GPL-3.0-or-later
"""Limits to the size of files, classes and functions, which `make lint` checks.

What was larger when the limits came is listed in code_sizes.txt with its size. A size there may only fall: something
that grows, or is new above a limit, fails, and so does a listed size that is no longer true.

- `python -m tools.code_sizes`: checks.
- `python -m tools.code_sizes --lower`: lowers the listed sizes to what they are now, and drops what is within the
  limits. Nothing is added, nothing raised. Where there is no list it writes one.
"""

from __future__ import annotations

import argparse
import ast
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from tools.repository_files import ROOT, repository_files

LISTED = Path(__file__).with_suffix(".txt")

#: The largest that is allowed, by what is measured. A class or a function counts from its first line to its last,
#: docstring included and decorators not; `self` and `cls` are no parameters.
LIMITS = {"file lines": 500, "class lines": 300, "function lines": 80, "parameters": 10}

#: Name as `file.py` or `file.py: Class.method`, and what is measured.
Key = tuple[str, str]

_HEAD = """\
# What is larger than the limits in code_sizes.py. Sizes here only fall: `python -m tools.code_sizes --lower`.
"""


def _parameter_count(function: ast.FunctionDef | ast.AsyncFunctionDef, is_method: bool) -> int:
    arguments = function.args
    named = [*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs]
    if is_method and named and named[0].arg in ("self", "cls"):
        named = named[1:]
    return len(named) + (arguments.vararg is not None) + (arguments.kwarg is not None)


def _sizes_below(node: ast.AST, file: str, qualifier: str) -> Iterator[tuple[Key, int]]:
    for child in ast.iter_child_nodes(node):
        if not isinstance(child, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            yield from _sizes_below(child, file, qualifier)
            continue
        name = qualifier + child.name
        lines = (child.end_lineno or child.lineno) - child.lineno + 1
        if isinstance(child, ast.ClassDef):
            yield (f"{file}: {name}", "class lines"), lines
        else:
            yield (f"{file}: {name}", "function lines"), lines
            yield (f"{file}: {name}", "parameters"), _parameter_count(child, isinstance(node, ast.ClassDef))
        yield from _sizes_below(child, file, f"{name}.")


def oversized(sources: Mapping[str, str]) -> dict[Key, int]:
    """What is above a limit, with its size.

    The largest of several functions of one name counts (variants, properties' setters).

    Parameters
    ----------
    sources : Mapping[str, str]
        Text by file name.

    Raises
    ------
    SyntaxError
        A text is no Python.
    """
    found: dict[Key, int] = {}
    for file, text in sources.items():
        sizes = [((file, "file lines"), len(text.splitlines())), *_sizes_below(ast.parse(text, file), file, "")]
        for key, size in sizes:
            if size > LIMITS[key[1]]:
                found[key] = max(size, found.get(key, 0))
    return found


def faults(found: Mapping[Key, int], listed: Mapping[Key, int]) -> list[str]:
    """A sentence for each size above what is allowed, and for each listed one that is no longer true."""
    sentences = []
    for (name, measure), size in found.items():
        allowed = listed.get((name, measure), LIMITS[measure])
        if size > allowed:
            sentences.append(f"{name}: {measure} {size}, and {allowed} are allowed: divide it")
    for (name, measure), size in listed.items():
        now = found.get((name, measure), 0)
        if now < size:
            state = f"{now} now" if now else f"not above {LIMITS[measure]} now, or gone"
            sentences.append(f"{name}: {measure} {size} listed, {state}: run `python -m tools.code_sizes --lower`")
    return sorted(sentences)


def lowered(found: Mapping[Key, int], listed: Mapping[Key, int]) -> dict[Key, int]:
    """The listed sizes without those that are within the limits, each at most as large as it was."""
    return {key: min(size, found[key]) for key, size in listed.items() if key in found}


def read_list(text: str) -> dict[Key, int]:
    """Sizes from the text of the list.

    Raises
    ------
    ValueError
        Naming the line that is no size.
    """
    sizes: dict[Key, int] = {}
    for line in text.splitlines():
        if not line or line.startswith("#"):
            continue
        try:
            measure, size, name = line.split("\t")
            sizes[name, measure] = int(size)
        except ValueError:
            raise ValueError(f"{LISTED.name}: not a measure, a size and a name between tabs: {line!r}") from None
        if measure not in LIMITS:
            raise ValueError(f"{LISTED.name}: no such measure: {line!r}")
    return sizes


def list_text(sizes: Mapping[Key, int]) -> str:
    """The text of the list, in an order of its own."""
    return _HEAD + "".join(f"{measure}\t{size}\t{name}\n" for (name, measure), size in sorted(sizes.items()))


def repository_sources() -> dict[str, str]:
    """All Python of the repository, files that are not yet added included."""
    return {path.relative_to(ROOT).as_posix(): path.read_text("utf-8") for path in repository_files("*.py")}


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m tools.code_sizes", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--lower", action="store_true", help="lower the listed sizes to what they are now")
    options = parser.parse_args(arguments)
    found = oversized(repository_sources())
    if options.lower:
        sizes = lowered(found, read_list(LISTED.read_text("utf-8"))) if LISTED.is_file() else found
        LISTED.write_text(list_text(sizes), "utf-8")
    sentences = faults(found, read_list(LISTED.read_text("utf-8")) if LISTED.is_file() else {})
    print("\n".join(sentences), file=sys.stderr, end="\n" if sentences else "")
    return 1 if sentences else 0


if __name__ == "__main__":
    raise SystemExit(main())
