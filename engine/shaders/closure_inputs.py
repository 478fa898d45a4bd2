# SPDX-License-Identifier: GPL-3.0-or-later
"""Inputs of closures as their nodes' entries ask for them."""

from __future__ import annotations

import math
from typing import Any

from engine.shaders.program import Constant, Value
from engine.shaders.table import COLOR, FLOAT, VECTOR, Implicit, Socket

ZERO = Constant((0.0,))
ONE = Constant((1.0,))
BLACK = Constant((0.0, 0.0, 0.0))
WHITE = Constant((1.0, 1.0, 1.0))


def normal(builder: Any, identifier: str = "Normal") -> Value:
    """A normal, the smooth one where nothing is linked."""
    return builder.input(Socket(identifier, VECTOR, Implicit.NORMAL))


def color(builder: Any, identifier: str = "Color", default: float = 0.8) -> Value:
    """A colour; `default` is a grey."""
    return builder.input(Socket(identifier, COLOR, (default, default, default)))


def number(builder: Any, identifier: str, default: float) -> Value:
    """A number."""
    return builder.input(Socket(identifier, FLOAT, default))


def known(value: Value) -> float | None:
    """A number that can be folded; None where it depends on the point, or is infinite."""
    number = value.value[0] if isinstance(value, Constant) else math.nan
    return number if math.isfinite(number) else None
