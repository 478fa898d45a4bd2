# SPDX-License-Identifier: GPL-3.0-or-later
"""Where Blender keeps the libraries that it brings, in whichever of its processes this is."""

from __future__ import annotations

import importlib.util
import os
import stat
import sys
from collections.abc import Iterator
from pathlib import Path

#: Folders below Blender's that hold its libraries, by platform and by whether it is Blender or `bpy`.
_LIBRARY_FOLDERS = ("lib", "blender.shared", ".")
#: From Blender's Python (`Blender/5.0/python/bin/python3.11`) up to where its libraries are.
_ANCESTORS_OF_PYTHON = 4


def package_folder(name: str) -> Path | None:
    """Folder of an installed package, without importing it; None if there is no such package."""
    try:
        spec = importlib.util.find_spec(name)
    except (ImportError, ValueError):
        return None
    return None if spec is None or not spec.origin else Path(spec.origin).parent


def _blender_folders() -> Iterator[Path]:
    """Folders that Blender or `bpy` may lie in, the best first."""
    bpy = package_folder("bpy")
    if bpy is not None:
        yield bpy
    # A process that `bpy` has started finds the scripts' package of that name first, which has no libraries.
    yield from (folder for entry in sys.path if (folder := Path(entry) / "bpy").is_dir())
    executable = Path(sys.executable).resolve()
    yield from list(executable.parents)[:_ANCESTORS_OF_PYTHON]


def _is_for_all(folder: Path) -> bool:
    """Whether anybody may put a library there, as where temporary files lie, which a Blender may have been put into."""
    try:
        return os.name == "posix" and bool(folder.stat().st_mode & stat.S_IWOTH)
    except OSError:
        return False


def find_libraries(patterns: tuple[str, ...], further: tuple[Path, ...] = ()) -> list[Path]:
    """Files that may be a library of Blender's, the best first.

    Parameters
    ----------
    patterns : tuple of str
        Names of the file on the platforms, with wildcards.
    further : tuple of Path
        Folders to look into when Blender has none, such as those of a package.
    """
    found = [
        path
        for root in (*_blender_folders(), *further)
        for folder in _LIBRARY_FOLDERS
        if not _is_for_all(root / folder)
        for pattern in patterns
        for path in sorted((root / folder).glob(pattern))
    ]
    return list(dict.fromkeys(found))
