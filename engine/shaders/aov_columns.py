# SPDX-License-Identifier: GPL-3.0-or-later
"""Where a lane keeps the values that programs give AOVs."""

from __future__ import annotations

from collections.abc import Sequence

from engine.scene.passes import Aov
from engine.shaders.compiled_program import AovColumns

#: Columns of a colour, with alpha, and of a value.
COLOR_WIDTH = 4
VALUE_WIDTH = 1


def aov_width(aovs: Sequence[Aov]) -> int:
    """Columns of all AOVs."""
    return sum(COLOR_WIDTH if aov.is_color else VALUE_WIDTH for aov in aovs)


def aov_columns(aovs: Sequence[Aov]) -> tuple[AovColumns, ...]:
    """Columns of each AOV, one behind the other."""
    width = aov_width(aovs)
    return tuple(
        AovColumns(aov.name, aov.is_color, aov_width(aovs[:index]), width) for index, aov in enumerate(aovs)
    )
