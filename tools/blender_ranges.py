# SPDX-License-Identifier: GPL-3.0-or-later
"""Which Blenders one build of the extension serves: those with the same version of Python.

To support a Blender with another Python, add a range here and a lock file for that Python.
"""

from __future__ import annotations

import re
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent


@dataclass(frozen=True)
class BlenderRange:
    """Blenders from `first` up to, but without, `end`.

    Attributes
    ----------
    name : str
        What the names of zips say.
    python : str
        Version of Python in these Blenders.
    first : str
        Oldest of them, as in the manifest's `blender_version_min`.
    end : str
        First one that is too new, as in the manifest's `blender_version_max`; '' if none is known yet.
    """

    name: str
    python: str
    first: str
    end: str = ""

    def holds(self, version: str) -> bool:
        """Whether the Blender of that version, '4.5' or '5.2.3', is one of these."""
        return _numbers(self.first) <= _numbers(version) and not (self.end and _numbers(self.end) <= _numbers(version))


#: 4.2 is the first Blender that knows extensions.
RANGES = (
    BlenderRange("blender-4.2-to-5.0", "3.11", first="4.2.0", end="5.1.0"),
    BlenderRange("blender-5.1-and-later", "3.13", first="5.1.0"),
)


def _numbers(version: str) -> tuple[int, ...]:
    numbers = tuple(int(part) for part in version.split("."))
    return numbers + (0,) * (3 - len(numbers))


def range_of(version: str) -> BlenderRange:
    """The range that the Blender of that version, '4.5' or '5.2.3', belongs to.

    Raises
    ------
    ValueError
        For what is no version, and where the extension does not work.
    """
    if not re.fullmatch(r"\d+(\.\d+){0,2}", version):
        raise ValueError(f"{version!r} is no version of Blender, such as 4.5")
    for candidate in RANGES:
        if candidate.holds(version):
            return candidate
    raise ValueError(f"there is no extension for Blender {version}: the oldest with extensions is {RANGES[0].first}")


def lock_file(python: str) -> Path:
    """The file that pins all packages for that version of Python; it may not exist."""
    return ROOT / f"requirements-{python}.lock"


def pinned(python: str, packages: Collection[str]) -> list[str]:
    """The lines `name==version` of `packages` in the lock file for that version of Python."""
    lines = lock_file(python).read_text(encoding="utf-8").splitlines()
    return [line for line in lines if line.partition("==")[0] in packages]
