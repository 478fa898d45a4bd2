# SPDX-License-Identifier: GPL-3.0-or-later
"""Whole numbers and truth in materials (Blender 5.3): as numbers where constant, as Math nodes where they vary.

Blender computes with 32 bits; what varies is exact up to 2^24 here.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from engine.scene.description import Link

#: Makes a Math node: its operation and up to three values, links or numbers.
Make = Callable[..., Link]

#: Steps of Euclid's algorithm for numbers up to 2^24.
_EUCLID_STEPS = 36


def wrapped(value: int) -> int:
    """What 32 bits keep of a whole number."""
    return (value + 2**31) % 2**32 - 2**31


def _truncated(a: int, b: int) -> int:
    quotient = abs(a) // abs(b)
    return quotient if (a < 0) == (b < 0) else -quotient


def _rounded(a: int, b: int) -> int:
    return _truncated(wrapped(2 * a + (b if (a < 0) == (b < 0) else -b)), wrapped(2 * b))


def _power(a: int, b: int) -> int:
    if b >= 0:
        return pow(a, b, 2**32)
    return {1: 1, -1: -1 if b % 2 else 1}.get(a, 0)


def _unless_zero(function: Callable[[int, int], int]) -> Callable[[int, int, int], int]:
    return lambda a, b, c: function(a, b) if b else 0


_CONSTANT: dict[str, Callable[[int, int, int], int]] = {
    "ADD": lambda a, b, c: a + b,
    "SUBTRACT": lambda a, b, c: a - b,
    "MULTIPLY": lambda a, b, c: a * b,
    "MULTIPLY_ADD": lambda a, b, c: a * b + c,
    "ABSOLUTE": lambda a, b, c: abs(a),
    "NEGATE": lambda a, b, c: -a,
    "POWER": lambda a, b, c: _power(a, b),
    "MINIMUM": lambda a, b, c: min(a, b),
    "MAXIMUM": lambda a, b, c: max(a, b),
    "SIGN": lambda a, b, c: (a > 0) - (a < 0),
    "DIVIDE": _unless_zero(_truncated),
    "DIVIDE_ROUND": _unless_zero(_rounded),
    "DIVIDE_FLOOR": _unless_zero(lambda a, b: a // b),
    "DIVIDE_CEIL": _unless_zero(lambda a, b: -(-a // b)),
    "FLOORED_MODULO": _unless_zero(lambda a, b: a % b),
    "MODULO": _unless_zero(lambda a, b: a - b * _truncated(a, b)),
    "GCD": lambda a, b, c: math.gcd(a, b),
    "LCM": lambda a, b, c: math.lcm(a, b),
}


def constant_integer(operation: str, a: int, b: int, c: int) -> int | None:
    """What an Integer Math node makes of constants; None: its operation is not known."""
    function = _CONSTANT.get(operation)
    return None if function is None else wrapped(function(a, b, c))


def _quotient(make: Make, operation: str, a: Any, b: Any) -> Any:
    """A division: half a unit is added before, so that rounding cannot take a whole number to the next."""
    if operation == "DIVIDE":
        return make("TRUNC", make("DIVIDE", make("MULTIPLY_ADD", make("SIGN", a), 0.5, a), b))
    if operation == "DIVIDE_ROUND":
        doubled = make("MULTIPLY_ADD", make("ABSOLUTE", a), 2.0, make("ADD", make("ABSOLUTE", b), 0.5))
        size = make("TRUNC", make("DIVIDE", doubled, make("MULTIPLY", make("ABSOLUTE", b), 2.0)))
        return make("MULTIPLY", size, make("MULTIPLY", make("SIGN", a), make("SIGN", b)))
    half = 0.5 if operation == "DIVIDE_FLOOR" else -0.5
    nearer = make("MULTIPLY_ADD", make("SIGN", b), half, a)
    return make("FLOOR" if half > 0.0 else "CEIL", make("DIVIDE", nearer, b))


def _varying_power(make: Make, a: Any, b: Any) -> Any:
    # Of zero there is no power below zero: 0 counts, as of all numbers from two on.
    without = make("MULTIPLY", make("COMPARE", a, 0.0, 0.5), make("LESS_THAN", b, 0.0))
    power = make("POWER", make("MULTIPLY_ADD", without, 2.0, a), b)
    return make("TRUNC", make("MULTIPLY_ADD", make("SIGN", power), 0.25, power))


def _divisor(make: Make, a: Any, b: Any) -> Any:
    """The greatest that both have in common, by Euclid."""
    a, b = make("ABSOLUTE", a), make("ABSOLUTE", b)
    for _ in range(_EUCLID_STEPS):
        a, b = make("MULTIPLY_ADD", a, make("COMPARE", b, 0.0, 0.5), b), make("MODULO", a, b)
    return a


def varying_integer(make: Make, operation: str, a: Any, b: Any, c: Any) -> Any:
    """What an Integer Math node makes of whole numbers that vary; None: its operation is not known."""
    if operation in ("ADD", "SUBTRACT", "MULTIPLY", "MINIMUM", "MAXIMUM", "MODULO"):
        return make(operation, a, b)
    if operation in ("ABSOLUTE", "SIGN"):
        return make(operation, a)
    if operation == "MULTIPLY_ADD":
        return make(operation, a, b, c)
    if operation == "NEGATE":
        return make("MULTIPLY", a, -1.0)
    if operation == "POWER":
        return _varying_power(make, a, b)
    if operation in ("DIVIDE", "DIVIDE_ROUND", "DIVIDE_FLOOR", "DIVIDE_CEIL"):
        return _quotient(make, operation, a, b)
    if operation == "FLOORED_MODULO":
        return make("MODULO", make("ADD", make("MODULO", a, b), b), b)
    if operation == "GCD":
        return _divisor(make, a, b)
    if operation == "LCM":
        share = make("ROUND", make("DIVIDE", make("ABSOLUTE", a), _divisor(make, a, b)))
        return make("MULTIPLY", share, make("ABSOLUTE", b))
    return None


def _not(make: Make, value: Any) -> Any:
    return make("SUBTRACT", 1.0, value)


_NEGATED = {"NAND": "AND", "NOR": "OR", "XNOR": "XOR"}


def varying_truth(make: Make, operation: str, a: Any, b: Any) -> Any:
    """What a Boolean Math node makes of zeros and ones; None: its operation is not known."""
    if operation in _NEGATED:
        return _not(make, varying_truth(make, _NEGATED[operation], a, b))
    if operation == "AND":
        return make("MULTIPLY", a, b)
    if operation == "OR":
        return make("MAXIMUM", a, b)
    if operation == "NOT":
        return _not(make, a)
    if operation == "XOR":
        return make("ABSOLUTE", make("SUBTRACT", a, b))
    if operation == "IMPLY":
        return make("MAXIMUM", _not(make, a), b)
    if operation == "NIMPLY":
        return make("MULTIPLY", a, _not(make, b))
    return None


def constant_truth(operation: str, a: bool, b: bool) -> bool | None:
    """What a Boolean Math node makes of constants; None: its operation is not known."""
    if operation in _NEGATED:
        return not constant_truth(_NEGATED[operation], a, b)
    values = {"AND": a and b, "OR": a or b, "NOT": not a, "XOR": a != b, "IMPLY": b or not a, "NIMPLY": a and not b}
    return values.get(operation)
