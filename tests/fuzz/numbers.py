# SPDX-License-Identifier: GPL-3.0-or-later
"""Random numbers of fuzzed scenes: mostly as users type them, now and then extreme."""

from __future__ import annotations

import math
from random import Random

EXTREMES = (0.0, 1.0, -1.0, 1e-6, -1e-3, 1e-2, 1e3, 1e6, 0.5, 3.0, 100.0)


def chance(random: Random, probability: float) -> bool:
    """True with this probability."""
    return random.random() < probability


def number(random: Random, low: float = 0.0, high: float = 1.0, extreme: float = 0.15) -> float:
    """A number between the limits, or with the probability `extreme` one of `EXTREMES`."""
    return random.choice(EXTREMES) if chance(random, extreme) else random.uniform(low, high)


def color(random: Random) -> tuple[float, float, float, float]:
    """Linear RGB and an alpha; at times gray, black, white, or outside of 0 to 1."""
    kind = random.random()
    if kind < 0.1:
        value = random.choice((0.0, 0.5, 1.0))
        return value, value, value, 1.0
    if kind < 0.2:
        return number(random, extreme=0.5), number(random, extreme=0.5), number(random, extreme=0.5), 1.0
    return random.random(), random.random(), random.random(), random.choice((1.0, 1.0, random.random()))


def vector(random: Random, size: float = 1.0, extreme: float = 0.1) -> tuple[float, float, float]:
    """Three numbers between -size and size, or extreme ones."""
    return tuple(number(random, -size, size, extreme) for _ in range(3))  # type: ignore[return-value]


def angles(random: Random) -> tuple[float, float, float]:
    """Euler angles, at times right ones."""
    if chance(random, 0.3):
        return tuple(random.choice((0.0, math.pi / 2, math.pi)) for _ in range(3))  # type: ignore[return-value]
    return tuple(random.uniform(-math.pi, math.pi) for _ in range(3))  # type: ignore[return-value]
