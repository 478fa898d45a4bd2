# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenes without extent along an axis."""

from __future__ import annotations

import bpy

from benchmarks.scenes.failures import coplanar
from benchmarks.scenes.registry import scene


@scene("fail-plane", samples=128)
def plane() -> None:
    """Everything in one plane: positions have no extent along an axis. No faces overlap, which would be black."""
    coplanar()
    for index, y in enumerate((-3.0, 3.25)):
        bpy.data.objects[f"Floor {index}"].location.y = y
