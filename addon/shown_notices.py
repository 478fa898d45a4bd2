# SPDX-License-Identifier: GPL-3.0-or-later
"""Notices to the user of Blender: each once in a render job, however many frames have it."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import bpy

from .log import logger

if TYPE_CHECKING:
    from engine.scene.description import Notice

#: Those shown since the render job began.
_shown: set[Notice] = set()


def show_notices(engine: bpy.types.RenderEngine, notices: Iterable[Notice]) -> None:
    """Report what has not been reported yet; without windows the log has it too."""
    for notice in notices:
        if notice not in _shown:
            _shown.add(notice)
            text = f"{notice.subject}: {notice.problem}; {notice.fallback}"
            if bpy.app.background:
                logger.warning(text)
            engine.report({"WARNING"}, text)


@bpy.app.handlers.persistent
def forget_notices(*_args: Any) -> None:
    """Show all again: another job begins."""
    _shown.clear()
