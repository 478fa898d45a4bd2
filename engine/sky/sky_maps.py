# SPDX-License-Identifier: GPL-3.0-or-later
"""How maps of skies are laid out, and what they are computed from.

A map has the sun in the middle of its columns, which go once around; rows rise from straight down to straight up, with
most of them near the horizon: a row's elevation is `sign(l) l^2 pi / 2` of the l from -1 to 1 that rises evenly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from engine.array_types import Float32Array, FloatArray

MAP_WIDTH = 512
MAP_HEIGHT = 256


@dataclass(frozen=True)
class Atmosphere:
    """What a map of the sky depends on.

    Attributes
    ----------
    sun_elevation : float [rad], in [-pi / 2, pi / 2]
    altitude : float [m]
        Of who looks at the sky.
    air_density, aerosol_density, ozone_density : float
        Relative to the earth's.
    """

    sun_elevation: float
    altitude: float
    air_density: float
    aerosol_density: float
    ozone_density: float


def row_elevations() -> FloatArray:
    """Elevation of the centres of a map's rows [rad]."""
    l = 2.0 * (np.arange(MAP_HEIGHT) + 0.5) / MAP_HEIGHT - 1.0
    return np.sign(l) * l * l * 0.5 * np.pi


def mirrored(half: Float32Array) -> Float32Array:
    """A whole map of its first half of columns."""
    return np.concatenate([half, half[:, ::-1]], axis=1)


def horizon_angle(altitude: float) -> float:
    """How far below level the earth's edge is seen [rad], from an altitude [m]."""
    radius = 6_371_000.0
    return float(0.5 * np.pi - np.arcsin(min(radius / (radius + altitude), 1.0)))
