# SPDX-License-Identifier: GPL-3.0-or-later
"""Lamps as rows of `LightArrays`: what all have in common, and one function for each kind.

Blender's units: points, spots and areas in watts, suns in W m^-2, with Cycles' meaning of each shape's radiance:

- point and spot of radius r: power / (4 pi^2 r^2); as a sphere, or with soft falloff as a disc facing the receiver;
- area: power / (pi area), times the spread's own normalisation;
- sun of half angle a: irradiance / (pi sin(a)^2);

where a lamp that is not normalised takes 1 for 4 pi r^2, the area and pi sin(a)^2.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from engine.array_types import Float32Array, Int32Array
from engine.builder import light_tree as lt
from engine.builder.emission import ProgramInfo
from engine.scene.description import Light, Notice
from engine.state import lights as la


@dataclass
class Lamp:
    """One usable lamp: its rows, and what the tree (or the list of distant emitters) needs.

    Attributes
    ----------
    values : float32 (LAMP_WIDTH,)
    table : int32 (LAMP_TABLE_WIDTH,)
    bounds : float32 (BOUNDS_WIDTH,)
        Not read of suns.
    visibility : int
        VISIBLE_* bits.
    distant : tuple of 3 floats or None
        Suns: cosine and sine of the half angle, irradiance [W m^-2].
    """

    values: Float32Array
    table: Int32Array
    bounds: Float32Array
    visibility: int
    distant: tuple[float, float, float] | None

    @property
    def order(self) -> int:
        """Sorting key: those that rays may cross, then deltas, then suns with an angle, then those without."""
        is_delta = bool(self.table[la.LAMP_FLAGS] & la.LAMP_FLAG_DELTA)
        if self.distant is None:
            return int(is_delta)
        return 2 + int(is_delta)


@dataclass
class _Emission:
    """A lamp's strength, with what its program makes of it.

    Attributes
    ----------
    strength : float64 (3,)
        Colour times energy, times the program's emission where that is constant.
    estimate : float64 (3,)
        Factor on `strength` that the program is expected to give; 1 without a program.
    temperature : float
        [K] of the black body whose colour it is, 0 = none.
    program : int
        That has to run, -1 = none.
    """

    strength: np.ndarray
    estimate: np.ndarray
    temperature: float
    program: int

    @property
    def mean(self) -> float:
        """Magnitude, mean of channels."""
        return float(np.abs(self.strength * self.estimate).mean())


@dataclass
class _Draft:
    """A lamp that the function of its kind completes.

    Attributes
    ----------
    matrix : float64 (4, 4)
        Object to world.
    mean : float
        Of its emission (`_Emission.mean`).
    flags : int
        LAMP_FLAG_* bits.
    scale : float
        Radiance over strength.
    values, bounds : float64 (LAMP_WIDTH,), (BOUNDS_WIDTH,)
    distant : as `Lamp.distant`
    """

    matrix: np.ndarray
    mean: float
    flags: int
    scale: float = 1.0
    values: np.ndarray = field(default_factory=lambda: np.zeros(la.LAMP_WIDTH, np.float64))
    bounds: np.ndarray = field(default_factory=lambda: np.zeros(lt.BOUNDS_WIDTH, np.float64))
    distant: tuple[float, float, float] | None = None

    @property
    def position(self) -> np.ndarray:
        """World [m], (3,)."""
        return self.matrix[:3, 3]

    @property
    def columns(self) -> np.ndarray:
        """Its own axes in the world, (3, 3)."""
        return self.matrix[:3, :3]

    @property
    def direction(self) -> np.ndarray:
        """Of its own -z, unit, (3,)."""
        return _unit(-self.matrix[:3, 2])

    def make_delta(self) -> None:
        """No ray finds it by chance."""
        self.flags = (self.flags | la.LAMP_FLAG_DELTA) & ~la.LAMP_FLAG_MIS


def _unit(vector: np.ndarray) -> np.ndarray:
    norm = float(np.linalg.norm(vector))
    return vector / norm if norm > 0.0 else vector


def _is_grey(color: npt.ArrayLike) -> bool:
    r, g, b = np.asarray(color, np.float64)
    return bool(r == g == b)


# ---------------------------------------------------------------------------------------------------------------------
# Kinds: each completes a draft; False where the lamp cannot light anything.


def _convert_point(light: Light, draft: _Draft) -> bool:
    radius = max(0.0, light.radius)
    if not light.use_soft_falloff and radius > 0.0:
        draft.flags |= la.LAMP_FLAG_SPHERE
    if radius > 0.0:
        area = 4.0 * math.pi * radius**2 if light.is_normalized else 1.0
        draft.scale = 1.0 / (math.pi * area)
        intensity = draft.mean * draft.scale * math.pi * radius**2
    else:
        draft.make_delta()
        draft.scale = 1.0 / (4.0 * math.pi) if light.is_normalized else 1.0 / math.pi
        intensity = draft.mean * draft.scale
    draft.values[la.LAMP_RADIUS] = radius
    bounds = draft.bounds
    bounds[lt.BOUNDS_LOWER : lt.BOUNDS_LOWER + 3] = draft.position - radius
    bounds[lt.BOUNDS_UPPER : lt.BOUNDS_UPPER + 3] = draft.position + radius
    bounds[lt.BOUNDS_ENERGY] = intensity
    bounds[lt.BOUNDS_AXIS + 2] = 1.0
    bounds[lt.BOUNDS_NORMALS] = math.pi
    bounds[lt.BOUNDS_EMISSION] = 0.5 * math.pi
    bounds[lt.BOUNDS_SPREAD] = 0.5 * radius**2
    bounds[lt.BOUNDS_RADIUS_SQUARED] = radius**2
    return True


def _convert_spot(light: Light, draft: _Draft) -> bool:
    """A point within a cone, which the transform may squeeze."""
    _convert_point(light, draft)
    columns, values, bounds = draft.columns, draft.values, draft.bounds
    if abs(float(np.linalg.det(columns))) < 1e-30:
        return False
    half = 0.5 * light.spot_angle
    cosine = math.cos(half)
    lengths = np.linalg.norm(columns, axis=0)
    values[la.LAMP_DIRECTION : la.LAMP_DIRECTION + 3] = draft.direction
    values[la.LAMP_INVERSE : la.LAMP_INVERSE + 9] = np.linalg.inv(columns).ravel()
    values[la.LAMP_COS_SPOT] = cosine
    smooth = (1.0 - cosine) * light.spot_blend
    values[la.LAMP_SPOT_SCALE] = min(1e30, 1.0 / max(smooth, 1e-30))
    widest = math.tan(min(half, 0.5 * math.pi - 1e-4)) * max(lengths[0], lengths[1]) / lengths[2]
    values[la.LAMP_ONE_MINUS_COS] = 1.0 - 1.0 / math.sqrt(1.0 + widest**2)
    # Full strength within the inner cone, fading to the outer one.
    inner = math.acos(min(1.0, cosine + smooth))
    narrowest = math.tan(min(inner, 0.5 * math.pi - 1e-4)) * min(lengths[0], lengths[1]) / lengths[2]
    bounds[lt.BOUNDS_AXIS : lt.BOUNDS_AXIS + 3] = draft.direction
    bounds[lt.BOUNDS_NORMALS] = math.atan(narrowest)
    bounds[lt.BOUNDS_EMISSION] = math.atan(widest) - math.atan(narrowest) + 2e-3
    return True


def _convert_area(light: Light, draft: _Draft) -> bool:
    columns, values, bounds = draft.columns, draft.values, draft.bounds
    is_ellipse = light.shape in ("DISK", "ELLIPSE")
    size_y = light.size_x if light.shape in ("SQUARE", "DISK") else light.size_y
    along_u, along_v = columns[:, 0] * light.size_x, columns[:, 1] * size_y
    length_u, length_v = float(np.linalg.norm(along_u)), float(np.linalg.norm(along_v))
    area = length_u * length_v * (0.25 * math.pi if is_ellipse else 1.0)
    if not area > 0.0:
        return False
    draft.flags |= la.LAMP_FLAG_ELLIPSE if is_ellipse else 0
    spread = min(math.pi, max(0.0, light.spread))
    scale = 1.0 / math.pi / (area if light.is_normalized else 1.0)
    radiance = draft.mean * scale
    peak = 1.0
    half = 0.5 * spread
    if spread <= 0.0:
        # Parallel light: the radiance's integral over directions is what counts.
        draft.make_delta()
        scale *= math.pi
        radiance = draft.mean * (scale / math.pi)
        peak = 1e4
    elif spread < math.pi - 1e-6:
        values[la.LAMP_TAN_SPREAD] = math.tan(half)
        values[la.LAMP_SPREAD_SCALE] = 1.0 / (math.tan(half) - half) if half > 0.05 else 3.0 / half**3
        peak = values[la.LAMP_TAN_SPREAD] * values[la.LAMP_SPREAD_SCALE]
    draft.scale = scale
    # A sheared lamp is made rectangular again: its normal is its plane's, on the side of its own -z.
    axis_u = along_u / length_u
    axis_v = _unit(along_v - (along_v @ axis_u) * axis_u)
    normal = np.cross(axis_u, axis_v)
    direction = normal if normal @ draft.direction >= 0.0 else -normal
    along_v = axis_v * length_v
    values[la.LAMP_AXIS_U : la.LAMP_AXIS_U + 3] = axis_u
    values[la.LAMP_AXIS_V : la.LAMP_AXIS_V + 3] = axis_v
    values[la.LAMP_DIRECTION : la.LAMP_DIRECTION + 3] = direction
    values[la.LAMP_LENGTH_U], values[la.LAMP_LENGTH_V] = length_u, length_v
    extent = 0.5 * (np.abs(along_u) + np.abs(along_v))
    bounds[lt.BOUNDS_LOWER : lt.BOUNDS_LOWER + 3] = draft.position - extent
    bounds[lt.BOUNDS_UPPER : lt.BOUNDS_UPPER + 3] = draft.position + extent
    bounds[lt.BOUNDS_ENERGY] = radiance * area * peak
    bounds[lt.BOUNDS_AXIS : lt.BOUNDS_AXIS + 3] = direction
    bounds[lt.BOUNDS_EMISSION] = half + 1e-3
    bounds[lt.BOUNDS_SPREAD] = area * peak / math.pi
    bounds[lt.BOUNDS_RADIUS_SQUARED] = 0.25 * (
        max(length_u, length_v) ** 2 if is_ellipse else length_u**2 + length_v**2
    )
    return True


def _convert_sun(light: Light, draft: _Draft) -> bool:
    half = 0.5 * min(math.pi, max(0.0, light.angle))
    draft.values[la.LAMP_P : la.LAMP_P + 3] = -draft.direction
    draft.values[la.LAMP_ONE_MINUS_COS] = 2.0 * math.sin(0.5 * half) ** 2
    irradiance = draft.mean
    if half > 0.0:
        disc = math.pi * math.sin(half) ** 2
        draft.scale = 1.0 / disc if light.is_normalized else 1.0
        irradiance = draft.mean * draft.scale * disc
    else:
        draft.make_delta()
    draft.distant = (math.cos(half), math.sin(half), irradiance)
    return True


#: By `Light.kind`: the kind that kernels know, and who converts it.
_KINDS: dict[str, tuple[int, Callable[[Light, _Draft], bool]]] = {
    "POINT": (la.LIGHT_POINT, _convert_point),
    "SPOT": (la.LIGHT_SPOT, _convert_spot),
    "AREA": (la.LIGHT_AREA, _convert_area),
    "SUN": (la.LIGHT_SUN, _convert_sun),
}


# ---------------------------------------------------------------------------------------------------------------------
# What all kinds have in common


def _emission_of(light: Light, strength: np.ndarray, program: int, info: ProgramInfo) -> _Emission:
    """What a lamp's `program` (-1 = none) makes of its colour times energy, `strength`."""
    if program < 0:
        return _Emission(strength, np.ones(3), light.temperature, -1)
    estimate = np.asarray(info.emission_estimate[program], np.float64)
    temperature = light.temperature
    if info.temperature[program] > 0.0 and _is_grey(light.color):
        temperature = float(info.temperature[program])
    elif not _is_grey(estimate):
        temperature = 0.0
    if info.emission_is_constant[program]:
        return _Emission(strength * estimate, np.ones(3), temperature, -1)
    return _Emission(strength, estimate, temperature, program)


def _convert_lamp(light: Light, index: int, program: int, info: ProgramInfo, notices: list[Notice]) -> Lamp | None:
    """Rows of a lamp, or None where it cannot light anything."""
    strength = np.asarray(light.color, np.float64) * light.energy
    matrix = np.asarray(light.transform, np.float64)
    if not (np.isfinite(strength).all() and np.isfinite(matrix).all()):
        notices.append(Notice(f"light {light.name}", "its transform or strength is NaN or infinite", "it is left out"))
        return None
    emission = _emission_of(light, strength, program, info)
    flags = (la.LAMP_FLAG_MIS if light.use_mis else 0) | (la.LAMP_FLAG_SHADOW if light.cast_shadow else 0)
    if emission.program >= 0:
        # A ray that crosses the lamp does not run its program: the lamp is left to sampling alone, which does.
        flags &= ~la.LAMP_FLAG_MIS
        notices.append(
            Notice(
                f"light {light.name}",
                "its nodes give an emission that varies",
                "it is sampled exactly, but rays that hit it by chance (mirror reflections) do not see it; to the "
                "camera it shows its mean",
            )
        )
    if not np.any(emission.strength) or not np.any(emission.estimate):
        return None
    if light.kind not in _KINDS:
        raise ValueError(f"light {light.name}: kind is {light.kind!r}, choose {', '.join(_KINDS)}")
    kind, convert = _KINDS[light.kind]
    draft = _Draft(matrix, emission.mean, flags)
    values = draft.values
    values[la.LAMP_P : la.LAMP_P + 3] = draft.position
    if not convert(light, draft):
        return None
    values[la.LAMP_RADIANCE : la.LAMP_RADIANCE + 3] = emission.strength * draft.scale
    values[la.LAMP_ESTIMATE : la.LAMP_ESTIMATE + 3] = emission.estimate
    values[la.LAMP_TEMPERATURE] = emission.temperature
    table = np.zeros(la.LAMP_TABLE_WIDTH, np.int32)
    table[la.LAMP_KIND] = kind
    table[la.LAMP_FLAGS] = draft.flags
    table[la.LAMP_VISIBILITY] = light.visibility
    table[la.LAMP_MAX_BOUNCES] = min(light.max_bounces, 1 << 20)
    table[la.LAMP_PROGRAM] = emission.program
    table[la.LAMP_LIGHT] = index
    table[la.LAMP_LIGHT_GROUP] = light.light_group
    return Lamp(values.astype(np.float32), table, draft.bounds.astype(np.float32), light.visibility, draft.distant)


def convert_lamps(lights: list[Light], info: ProgramInfo, notices: list[Notice]) -> list[Lamp]:
    """Usable lamps, sorted by `Lamp.order`; what cannot be rendered as it is meant is added to `notices`.

    Raises
    ------
    ValueError
        A lamp is of a kind that does not exist.
    """
    lamps = []
    for index, light in enumerate(lights):
        program = int(info.light_program[index]) if index < len(info.light_program) else -1
        lamp = _convert_lamp(light, index, program, info, notices)
        if lamp is not None:
            lamps.append(lamp)
    return sorted(lamps, key=lambda lamp: lamp.order)
