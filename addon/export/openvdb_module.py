# SPDX-License-Identifier: GPL-3.0-or-later
"""OpenVDB as Blender brings it."""

from __future__ import annotations

from types import ModuleType

from .bundled_modules import find_bundled


def find_openvdb() -> ModuleType | None:
    """The module, None where Blender brings none, or one that cannot be loaded."""
    # Older Blenders have it under another name.
    return find_bundled("openvdb", "pyopenvdb")
