# SPDX-License-Identifier: GPL-3.0-or-later
"""OpenVDB as Blender brings it."""

from __future__ import annotations

import importlib
import importlib.util
import sys
from functools import cache
from pathlib import Path
from types import ModuleType

import bpy

#: Older Blenders have it under another name.
_NAMES = ("openvdb", "pyopenvdb")


@cache
def find_openvdb() -> ModuleType | None:
    """The module, None where Blender brings none, or one that cannot be loaded.

    In Blender it can be imported. As a module, Blender keeps its own packages where Python does not look for them.
    """
    for name in _NAMES:
        try:
            return importlib.import_module(name)
        except ImportError:
            pass
    scripts = bpy.utils.system_resource("SCRIPTS")
    for name in _NAMES if scripts else ():
        for file in sorted(Path(scripts).parent.glob(f"python/lib/python*/site-packages/{name}.*")):
            spec = importlib.util.spec_from_file_location(name, file)
            if spec is None or spec.loader is None:
                continue
            try:
                module = importlib.util.module_from_spec(spec)
                spec.loader.exec_module(module)
            except ImportError:
                continue
            sys.modules[name] = module
            return module
    return None
