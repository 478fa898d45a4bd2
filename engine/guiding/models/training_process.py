# SPDX-License-Identifier: GPL-3.0-or-later
"""The process that trains networks, as whoever renders has it made ready and ended. Loads nothing before it is needed.
"""

from __future__ import annotations

import sys
from importlib import import_module
from importlib.util import resolve_name

from engine.methods import TRAINING_PROCESS

_NAME = resolve_name(TRAINING_PROCESS, __package__)


def stand_by(device: str) -> None:
    """Have a process get ready for the next training, on what `training_device` asks for; returns at once and never
    raises.
    """
    import_module(_NAME).stand_by(device)


def dismiss() -> None:
    """End the process that stands by, if there is one."""
    if _NAME in sys.modules:
        sys.modules[_NAME].dismiss()
