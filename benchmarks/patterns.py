# SPDX-License-Identifier: GPL-3.0-or-later
"""Choosing from a table by names and patterns typed on a command line."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from fnmatch import fnmatchcase


def matching(names: Iterable[str], patterns: Sequence[str], kind: str) -> list[str]:
    """Names that match any of the patterns, each once, by pattern; all names where no pattern is given.

    Parameters
    ----------
    names : iterable of str
        What there is.
    patterns : sequence of str
        As in a shell: `*`, `?`, `[...]`.
    kind : str
        What the names are of, in a message: 'case', ...

    Raises
    ------
    ValueError
        If a pattern matches nothing; it names what there is.
    """
    known = list(names)
    if not patterns:
        return known
    found: list[str] = []
    for pattern in patterns:
        names_found = [name for name in known if fnmatchcase(name, pattern)]
        if not names_found:
            raise ValueError(f"no {kind} {pattern!r}; there are: {', '.join(known)}")
        found += names_found
    return list(dict.fromkeys(found))
