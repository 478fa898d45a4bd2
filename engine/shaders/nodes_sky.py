# SPDX-License-Identifier: GPL-3.0-or-later
"""Entry of the node table for Sky Texture: maps and formulas of engine.sky as tables of colours."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from engine.array_types import Float32Array, FloatArray
from engine.kernels.shader import sky as kernels
from engine.kernels.shader.ops_texture import OP_SKY
from engine.scene.description import Node
from engine.shaders.options import choice, flag
from engine.shaders.table import COLOR, VECTOR, Implicit, NodeTable, Operation, Socket
from engine.sky import daylight, multiple_scattering, single_scattering
from engine.sky.sky_maps import Atmosphere, horizon_angle
from engine.spectral.observer import XYZ_TO_REC709

_TYPES = ("SINGLE_SCATTERING", "MULTIPLE_SCATTERING", "PREETHAM", "HOSEK_WILKIE")
_MODELS = {"SINGLE_SCATTERING": single_scattering, "MULTIPLE_SCATTERING": multiple_scattering}
#: Maps that are kept, of 1.5 MiB each: whoever turns the sun back finds it there.
_KEPT = 16


@dataclass(frozen=True)
class Sun:
    """The sun's disc of a Sky Texture.

    Attributes
    ----------
    direction : tuple of float
        Unit vector towards its centre.
    half_angle : float [rad]
    """

    direction: tuple[float, float, float]
    half_angle: float


@lru_cache(_KEPT)
def _map(kind: str, atmosphere: Atmosphere) -> Float32Array:
    result = _MODELS[kind].sky_map(atmosphere)
    result.setflags(write=False)
    return result


def sun_angles(elevation: float, rotation: float) -> tuple[float, float]:
    """Elevation in [-pi / 2, pi / 2] and rotation in [0, 2 pi] of the same sun, turned as Cycles turns it [rad]."""
    elevation = math.remainder(elevation, 2.0 * math.pi)
    if abs(elevation) >= 0.5 * math.pi:
        elevation = math.copysign(math.pi, elevation) - elevation
        rotation += math.pi
    return elevation, 2.0 * math.pi - rotation % (2.0 * math.pi)


def _direction(elevation: float, rotation: float) -> tuple[float, float, float]:
    """Unit vector of an elevation, and of an azimuth from y towards -x [rad]."""
    across = math.cos(elevation)
    return -across * math.sin(rotation), across * math.cos(rotation), math.sin(elevation)


def sun_of(node: Node) -> Sun | None:
    """The sun's disc that a Sky Texture shows; None: it shows none."""
    properties = node.properties
    if properties.get("sky_type", "MULTIPLE_SCATTERING") not in _MODELS or not properties.get("sun_disc", True):
        return None
    size = float(properties.get("sun_size", 0.009512))
    elevation, rotation = sun_angles(properties.get("sun_elevation", 0.2618), properties.get("sun_rotation", 0.0))
    altitude = float(properties.get("altitude", 100.0))
    if not size > 0.0 or elevation + 0.5 * size <= -horizon_angle(altitude):
        return None
    return Sun(_direction(elevation, rotation), 0.5 * size)


def _of_map(node: Node, kind: str, from_xyz: FloatArray) -> Float32Array:
    number = {name: float(value) for name, value in node.properties.items() if isinstance(value, (int, float))}
    elevation, rotation = sun_angles(number.get("sun_elevation", 0.2618), number.get("sun_rotation", 0.0))
    altitude = number.get("altitude", 100.0)
    atmosphere = Atmosphere(
        elevation, altitude, number.get("air_density", 1.0), number.get("aerosol_density", 1.0),
        number.get("ozone_density", 1.0),
    )  # fmt: skip
    size = number.get("sun_size", 0.009512) if flag(node, "sun_disc", True) else 0.0
    texels = _map(kind, atmosphere)
    table = np.zeros(kernels.MAP_TEXELS + texels.size, np.float32)
    if size > 0.0:
        ends = _MODELS[kind].sun_ends(atmosphere, size) * number.get("sun_intensity", 1.0)
        table[: kernels.MAP_ELEVATION] = (ends @ from_xyz.T).ravel()
    table[kernels.MAP_ELEVATION] = elevation
    table[kernels.MAP_ROTATION] = rotation
    table[kernels.MAP_HALF_ANGLE] = 0.5 * size
    table[kernels.MAP_LOWEST] = -horizon_angle(altitude)
    table[kernels.MAP_AXIS : kernels.MAP_RIM] = _direction(elevation, rotation)
    # A little more than the rim: what lies close to it is looked at by its angle.
    table[kernels.MAP_RIM] = (1.01 * math.tan(0.25 * size) + 1e-5) ** 2
    table[kernels.MAP_TEXELS :] = (texels @ from_xyz.T.astype(np.float32)).ravel()
    return table


def _of_formula(node: Node, kind: str, from_xyz: FloatArray) -> Float32Array:
    x, y, z = (float(value) for value in node.properties.get("sun_direction", (0.0, 0.0, 1.0)))
    turbidity = float(node.properties.get("turbidity", 2.2))
    if kind == "PREETHAM":
        sky = daylight.preetham((x, y, z), turbidity)
    else:
        sky = daylight.hosek_wilkie((x, y, z), turbidity, float(node.properties.get("ground_albedo", 0.3)))
    sun = _direction(0.5 * math.pi - sky.theta, -sky.phi)
    return np.concatenate(
        [sky.coefficients.ravel(), sky.radiance, sun, [sky.horizon], from_xyz.ravel()]
    ).astype(np.float32)


def _sky(node: Node, builder: Any) -> Operation:
    kind = _TYPES[choice(node, builder, "sky_type", _TYPES, "MULTIPLE_SCATTERING")]
    to_xyz = builder.to_xyz
    from_xyz = (XYZ_TO_REC709 if to_xyz is None else np.linalg.inv(to_xyz)).astype(np.float64)
    if kind in _MODELS:
        table, code = _of_map(node, kind, from_xyz), kernels.SKY_MAP
    else:
        table = _of_formula(node, kind, from_xyz)
        code = kernels.SKY_CHROMATIC_DAYLIGHT if kind == "PREETHAM" else kernels.SKY_DAYLIGHT
    vector = Socket("Vector", VECTOR, Implicit.GENERATED)
    return Operation(OP_SKY, (vector,), (Socket("Color", COLOR),), (builder.add_table(table), code))


NODES: NodeTable = {"ShaderNodeTexSky": _sky}
