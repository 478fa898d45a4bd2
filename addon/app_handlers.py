# SPDX-License-Identifier: GPL-3.0-or-later
"""Functions that Blender calls when something happens: added and taken away together."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

#: A list of `bpy.app.handlers`, and what is to be in it.
Handlers = Iterable[tuple[list[Any], Any]]


def add_handlers(pairs: Handlers) -> None:
    """Have Blender call them."""
    for handlers, handler in pairs:
        handlers.append(handler)


def remove_handlers(pairs: Handlers) -> None:
    """Have it call them no longer; those that are not there stay away."""
    for handlers, handler in pairs:
        if handler in handlers:
            handlers.remove(handler)
