# SPDX-License-Identifier: GPL-3.0-or-later
"""Python modules that Blender brings.

In Blender they can be imported. As a module, Blender keeps its own packages where Python does not look for them.
"""

from __future__ import annotations

import importlib
import importlib.util
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from types import ModuleType

import bpy


@cache
def find_bundled(*names: str) -> ModuleType | None:
    """The module, by the first of its names that there is; None where Blender brings none, or it cannot be loaded."""
    for name in names:
        try:
            return importlib.import_module(name)
        except ImportError:
            pass
    for name, file in _files(names):
        is_package = file.name == "__init__.py"
        spec = importlib.util.spec_from_file_location(
            name, file, submodule_search_locations=[str(file.parent)] if is_package else None
        )
        if spec is None or spec.loader is None:
            continue
        module = importlib.util.module_from_spec(spec)
        # A package looks itself up while it is loaded.
        sys.modules[name] = module
        try:
            spec.loader.exec_module(module)
        except ImportError:
            del sys.modules[name]
            continue
        return module
    return None


def _files(names: tuple[str, ...]) -> Iterator[tuple[str, Path]]:
    scripts = bpy.utils.system_resource("SCRIPTS")
    for name in names if scripts else ():
        for pattern in (f"{name}/__init__.py", f"{name}.*"):
            found = sorted(Path(scripts).parent.glob(f"python/lib/python*/site-packages/{pattern}"))
            yield from ((name, file) for file in found)
