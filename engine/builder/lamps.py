# SPDX-License-Identifier: GPL-3.0-or-later
"""Lamps as rows of `LightArrays`: what all have in common, and one function for each kind.

All lamps of a kind are converted at once: a scene may have a hundred thousand.

Blender's units: points, spots and areas in watts, suns in W m^-2, with Cycles' meaning of each shape's radiance:

- point and spot of radius r: power / (4 pi^2 r^2); as a sphere, or with soft falloff as a disc facing the receiver;
- area: power / (pi area), times the spread's own normalisation;
- sun of half angle a: irradiance / (pi sin(a)^2);

where a lamp that is not normalised takes 1 for 4 pi r^2, the area and pi sin(a)^2.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, fields
from operator import attrgetter
from typing import Any

import numpy as np
import numpy.typing as npt

from engine.array_types import Float32Array, Int32Array
from engine.builder import light_tree as lt
from engine.builder.emission import ProgramInfo
from engine.kernels.constants import FLOAT_MAX
from engine.scene.description import Light, Notice
from engine.state import lights as la


@dataclass
class Lamps:
    """Usable lamps, L of them: their rows, and what the tree (or the list of distant emitters) needs.

    Sorted by `order`, and by their place in the description.

    Attributes
    ----------
    values : float32 (L, LAMP_WIDTH)
    table : int32 (L, LAMP_TABLE_WIDTH)
    bounds : float32 (L, BOUNDS_WIDTH)
        Not read of suns.
    distant : float64 (L, 3)
        Suns: cosine and sine of the half angle, irradiance [W m^-2].
    """

    values: Float32Array
    table: Int32Array
    bounds: Float32Array
    distant: np.ndarray

    @property
    def is_sun(self) -> npt.NDArray[np.bool_]:
        """Which are infinitely far away, (L,)."""
        return np.asarray(self.table[:, la.LAMP_KIND] == la.LIGHT_SUN)

    @property
    def order(self) -> npt.NDArray[np.int64]:
        """Those that rays may cross: 0, then deltas: 1, suns with an angle: 2, and those without: 3; (L,)."""
        is_delta = (self.table[:, la.LAMP_FLAGS] & la.LAMP_FLAG_DELTA) != 0
        return 2 * self.is_sun.astype(np.int64) + is_delta


@dataclass
class _Columns:
    """Fields of `Light`, an array each, of N lamps; colour times energy as `strength`.

    Attributes
    ----------
    matrix : float64 (N, 4, 4)
        Object to world.
    strength, estimate : float64 (N, 3)
        Colour times energy, times the program's emission where that is constant; factor on it that the program is
        expected to give, 1 without a program.
    temperature : float64 (N,)
        [K] of the black body whose colour it is, 0 = none.
    program : int64 (N,)
        That has to run, -1 = none.
    """

    index: np.ndarray
    kind: np.ndarray
    shape: np.ndarray
    matrix: np.ndarray
    strength: np.ndarray
    estimate: np.ndarray
    temperature: np.ndarray
    program: np.ndarray
    radius: np.ndarray
    angle: np.ndarray
    spot_angle: np.ndarray
    spot_blend: np.ndarray
    size_x: np.ndarray
    size_y: np.ndarray
    spread: np.ndarray
    is_normalized: np.ndarray
    use_soft_falloff: np.ndarray
    flags: np.ndarray
    visibility: np.ndarray
    max_bounces: np.ndarray
    light_group: np.ndarray

    def pick(self, chosen: np.ndarray) -> _Columns:
        """Those lamps alone."""
        return _Columns(*(getattr(self, column.name)[chosen] for column in fields(self)))

    @property
    def mean(self) -> np.ndarray:
        """Magnitude of the emission, mean of channels, (N,)."""
        return np.abs(self.strength * self.estimate).mean(axis=1)

    @property
    def axes(self) -> np.ndarray:
        """Its own axes in the world, as columns, (N, 3, 3)."""
        return self.matrix[:, :3, :3]

    @property
    def direction(self) -> np.ndarray:
        """Of its own -z, unit, (N, 3)."""
        return _unit(-self.matrix[:, :3, 2])


@dataclass
class _Draft:
    """Rows that the function of their kind completes.

    Attributes
    ----------
    scale : float64 (N,)
        Radiance over strength.
    is_usable : bool (N,)
        False where a lamp cannot light anything.
    flags : int64 (N,)
        LAMP_FLAG_* bits.
    values, bounds, distant : float64
        As in `Lamps`.
    """

    scale: np.ndarray
    is_usable: np.ndarray
    flags: np.ndarray
    values: np.ndarray
    bounds: np.ndarray
    distant: np.ndarray

    def make_delta(self, chosen: np.ndarray) -> None:
        """No ray finds these by chance."""
        self.flags[chosen] = (self.flags[chosen] | la.LAMP_FLAG_DELTA) & ~la.LAMP_FLAG_MIS


def _draft(lamps: _Columns) -> _Draft:
    count = len(lamps.index)
    draft = _Draft(
        scale=np.ones(count),
        is_usable=np.ones(count, bool),
        flags=lamps.flags.copy(),
        values=np.zeros((count, la.LAMP_WIDTH)),
        bounds=np.zeros((count, lt.BOUNDS_WIDTH)),
        distant=np.zeros((count, 3)),
    )
    draft.values[:, la.LAMP_P : la.LAMP_P + 3] = lamps.matrix[:, :3, 3]
    return draft


def _norm(vectors: np.ndarray) -> np.ndarray:
    return np.sqrt((vectors * vectors).sum(axis=-1))


def _unit(vectors: np.ndarray) -> np.ndarray:
    norm = _norm(vectors)[..., None]
    return np.where(norm > 0.0, vectors / np.where(norm > 0.0, norm, 1.0), vectors)


def _unit_as_cycles(vectors: np.ndarray) -> np.ndarray:
    """Unit vectors, rounded as Cycles rounds them: what lies in a lamp's plane hides it or not by the last bit."""
    with np.errstate(over="ignore"):
        single = vectors.astype(np.float32)
        squares = single * single
        norm = np.sqrt(squares[..., 0] + squares[..., 1] + squares[..., 2])[..., None]
    is_usable = np.isfinite(norm) & (norm > 0.0)
    inverse = np.float32(1.0) / np.where(is_usable, norm, np.float32(1.0))
    return np.where(is_usable, single * inverse, _unit(vectors)).astype(np.float64)


def _is_grey(colors: np.ndarray) -> np.ndarray:
    return np.asarray((colors[..., 0] == colors[..., 1]) & (colors[..., 1] == colors[..., 2]))


# ---------------------------------------------------------------------------------------------------------------------
# Kinds: each completes drafts of its lamps.


def _convert_points(lamps: _Columns, draft: _Draft) -> None:
    values, bounds = draft.values, draft.bounds
    radius = np.maximum(0.0, lamps.radius)
    squared = radius * radius
    is_round = radius > 0.0
    draft.flags[is_round & ~lamps.use_soft_falloff] |= la.LAMP_FLAG_SPHERE
    draft.make_delta(~is_round)
    area = np.where(lamps.is_normalized & is_round, 4.0 * math.pi * squared, 1.0)
    of_delta = np.where(lamps.is_normalized, 1.0 / (4.0 * math.pi), 1.0 / math.pi)
    draft.scale = np.where(is_round, 1.0 / (math.pi * area), of_delta)
    intensity = lamps.mean * draft.scale
    values[:, la.LAMP_RADIUS] = radius
    position = lamps.matrix[:, :3, 3]
    bounds[:, lt.BOUNDS_LOWER : lt.BOUNDS_LOWER + 3] = position - radius[:, None]
    bounds[:, lt.BOUNDS_UPPER : lt.BOUNDS_UPPER + 3] = position + radius[:, None]
    bounds[:, lt.BOUNDS_ENERGY] = np.where(is_round, intensity * math.pi * squared, intensity)
    bounds[:, lt.BOUNDS_AXIS + 2] = 1.0
    bounds[:, lt.BOUNDS_NORMALS] = math.pi
    bounds[:, lt.BOUNDS_EMISSION] = 0.5 * math.pi
    bounds[:, lt.BOUNDS_SPREAD] = 0.5 * squared
    bounds[:, lt.BOUNDS_RADIUS_SQUARED] = squared


def _convert_spots(lamps: _Columns, draft: _Draft) -> None:
    """Points within a cone, which the transform may squeeze."""
    _convert_points(lamps, draft)
    draft.is_usable = np.abs(np.linalg.det(lamps.axes)) >= 1e-30
    axes = np.where(draft.is_usable[:, None, None], lamps.axes, np.eye(3))
    values, bounds = draft.values, draft.bounds
    half = 0.5 * lamps.spot_angle
    cosine = np.cos(half)
    lengths = np.sqrt((axes * axes).sum(axis=1))
    values[:, la.LAMP_DIRECTION : la.LAMP_DIRECTION + 3] = lamps.direction
    values[:, la.LAMP_INVERSE : la.LAMP_INVERSE + 9] = np.linalg.inv(axes).reshape(-1, 9)
    values[:, la.LAMP_COS_SPOT] = cosine
    smooth = (1.0 - cosine) * lamps.spot_blend
    values[:, la.LAMP_SPOT_SCALE] = np.minimum(1e30, 1.0 / np.maximum(smooth, 1e-30))
    longer, shorter = np.maximum(lengths[:, 0], lengths[:, 1]), np.minimum(lengths[:, 0], lengths[:, 1])
    widest = np.tan(np.minimum(half, 0.5 * math.pi - 1e-4)) * longer / lengths[:, 2]
    values[:, la.LAMP_ONE_MINUS_COS] = 1.0 - 1.0 / np.sqrt(1.0 + widest * widest)
    # Full strength within the inner cone, fading to the outer one.
    inner = np.arccos(np.minimum(1.0, cosine + smooth))
    narrowest = np.tan(np.minimum(inner, 0.5 * math.pi - 1e-4)) * shorter / lengths[:, 2]
    bounds[:, lt.BOUNDS_AXIS : lt.BOUNDS_AXIS + 3] = lamps.direction
    bounds[:, lt.BOUNDS_NORMALS] = np.arctan(narrowest)
    bounds[:, lt.BOUNDS_EMISSION] = np.arctan(widest) - np.arctan(narrowest) + 2e-3


def _convert_areas(lamps: _Columns, draft: _Draft) -> None:
    axes, values, bounds = lamps.axes, draft.values, draft.bounds
    is_ellipse = np.isin(lamps.shape, ("DISK", "ELLIPSE"))
    size_y = np.where(np.isin(lamps.shape, ("SQUARE", "DISK")), lamps.size_x, lamps.size_y)
    along_u, along_v = axes[:, :, 0] * lamps.size_x[:, None], axes[:, :, 1] * size_y[:, None]
    length_u, length_v = _norm(along_u), _norm(along_v)
    area = length_u * length_v * np.where(is_ellipse, 0.25 * math.pi, 1.0)
    draft.is_usable = area > 0.0
    # Whatever: the rows of those that are not usable are not taken.
    area = np.where(draft.is_usable, area, 1.0)
    draft.flags[is_ellipse] |= la.LAMP_FLAG_ELLIPSE
    spread = np.minimum(math.pi, np.maximum(0.0, lamps.spread))
    half = 0.5 * spread
    # Parallel light: the radiance's integral over directions is what counts.
    is_parallel = spread <= 0.0
    draft.make_delta(is_parallel)
    scale = 1.0 / math.pi / np.where(lamps.is_normalized, area, 1.0)
    draft.scale = np.where(is_parallel, scale * math.pi, scale)
    radiance = lamps.mean * np.where(is_parallel, draft.scale / math.pi, scale)
    is_narrow = ~is_parallel & (spread < math.pi - 1e-6)
    narrow = np.where(is_narrow, half, 1.0)
    tangent = np.tan(narrow)
    # The difference cancels where they are small.
    excess = np.where(narrow > 0.05, tangent - narrow, narrow * narrow * narrow / 3.0)
    spread_scale = 1.0 / excess
    values[:, la.LAMP_TAN_SPREAD] = np.where(is_narrow, tangent, 0.0)
    values[:, la.LAMP_SPREAD_SCALE] = np.where(is_narrow, spread_scale, 0.0)
    peak = np.where(is_parallel, 1e4, np.where(is_narrow, tangent * spread_scale, 1.0))
    # A sheared lamp is made rectangular again: its normal is its plane's, on the side of its own -z.
    axis_u = _unit_as_cycles(along_u)
    sheared = (_unit(along_v) * axis_u).sum(axis=1)
    straight = _unit(along_v - (along_v * axis_u).sum(axis=1)[:, None] * axis_u)
    axis_v = np.where((abs(sheared) > 1e-6)[:, None], straight, _unit_as_cycles(along_v))
    normal = np.cross(axis_u, axis_v)
    is_away = (normal * lamps.direction).sum(axis=1) < 0.0
    direction = np.where(is_away[:, None], -normal, normal)
    along_v = axis_v * length_v[:, None]
    values[:, la.LAMP_AXIS_U : la.LAMP_AXIS_U + 3] = axis_u
    values[:, la.LAMP_AXIS_V : la.LAMP_AXIS_V + 3] = axis_v
    values[:, la.LAMP_DIRECTION : la.LAMP_DIRECTION + 3] = direction
    values[:, la.LAMP_LENGTH_U], values[:, la.LAMP_LENGTH_V] = length_u, length_v
    position = lamps.matrix[:, :3, 3]
    extent = 0.5 * (np.abs(along_u) + np.abs(along_v))
    bounds[:, lt.BOUNDS_LOWER : lt.BOUNDS_LOWER + 3] = position - extent
    bounds[:, lt.BOUNDS_UPPER : lt.BOUNDS_UPPER + 3] = position + extent
    bounds[:, lt.BOUNDS_ENERGY] = radiance * area * peak
    bounds[:, lt.BOUNDS_AXIS : lt.BOUNDS_AXIS + 3] = direction
    bounds[:, lt.BOUNDS_EMISSION] = half + 1e-3
    bounds[:, lt.BOUNDS_SPREAD] = area * peak / math.pi
    longest = np.maximum(length_u, length_v)
    bounds[:, lt.BOUNDS_RADIUS_SQUARED] = 0.25 * np.where(
        is_ellipse, longest * longest, length_u * length_u + length_v * length_v
    )


def _convert_suns(lamps: _Columns, draft: _Draft) -> None:
    half = 0.5 * np.minimum(math.pi, np.maximum(0.0, lamps.angle))
    sine, sine_half = np.sin(half), np.sin(0.5 * half)
    draft.values[:, la.LAMP_P : la.LAMP_P + 3] = -lamps.direction
    draft.values[:, la.LAMP_ONE_MINUS_COS] = 2.0 * (sine_half * sine_half)
    has_angle = half > 0.0
    disc = np.where(has_angle, math.pi * (sine * sine), 1.0)
    draft.scale = np.where(has_angle & lamps.is_normalized, 1.0 / disc, 1.0)
    draft.make_delta(~has_angle)
    draft.distant = np.stack([np.cos(half), sine, lamps.mean * draft.scale * disc], axis=1)


#: By `Light.kind`: the kind that kernels know, and who converts it.
_KINDS: dict[str, tuple[int, Callable[[_Columns, _Draft], None]]] = {
    "POINT": (la.LIGHT_POINT, _convert_points),
    "SPOT": (la.LIGHT_SPOT, _convert_spots),
    "AREA": (la.LIGHT_AREA, _convert_areas),
    "SUN": (la.LIGHT_SUN, _convert_suns),
}


# ---------------------------------------------------------------------------------------------------------------------
# What all kinds have in common

#: Fields of `Light` whose columns are taken as they are: their types as columns.
_TAKEN: dict[str, Any] = {
    "kind": str, "shape": str, "temperature": np.float64, "radius": np.float64, "angle": np.float64,
    "spot_angle": np.float64, "spot_blend": np.float64, "size_x": np.float64, "size_y": np.float64,
    "spread": np.float64, "is_normalized": bool, "use_soft_falloff": bool, "visibility": np.int64,
    "max_bounces": np.int64, "light_group": np.int64,
}  # fmt: skip


def _read(lights: list[Light], info: ProgramInfo) -> tuple[_Columns, np.ndarray]:
    """Columns of lights, at least one, as they are without their programs, and of each its program, int64 (N,)."""
    columns = dict(zip(_TAKEN, zip(*map(attrgetter(*_TAKEN), lights), strict=True), strict=True))
    use_mis, cast_shadow = np.array([(light.use_mis, light.cast_shadow) for light in lights], bool).T
    energy = np.array([light.energy for light in lights], np.float64)
    count = len(lights)
    programs = np.full(count, -1, np.int64)
    known = min(count, len(info.light_program))
    programs[:known] = info.light_program[:known]
    return _Columns(
        index=np.arange(count),
        matrix=np.array([light.transform for light in lights], np.float64),
        strength=np.array([light.color for light in lights], np.float64) * energy[:, None],
        estimate=np.ones((count, 3)),
        program=np.full(count, -1, np.int64),
        flags=np.where(use_mis, la.LAMP_FLAG_MIS, 0) | np.where(cast_shadow, la.LAMP_FLAG_SHADOW, 0),
        **{name: np.array(columns[name], kind) for name, kind in _TAKEN.items()},
    ), programs


def _apply_programs(lamps: _Columns, colors: np.ndarray, programs: np.ndarray, info: ProgramInfo) -> None:
    """What lamps' programs (-1 = none) make of their strengths; `colors`: theirs, (N, 3)."""
    has_program = programs >= 0
    own = programs[has_program]
    estimate = info.emission_estimate[own].astype(np.float64)
    of_body = info.temperature[own].astype(np.float64)
    is_body = (of_body > 0.0) & _is_grey(colors[has_program])
    kept = np.where(_is_grey(estimate), lamps.temperature[has_program], 0.0)
    lamps.temperature[has_program] = np.where(is_body, of_body, kept)
    is_constant = info.emission_is_constant[own]
    lamps.strength[has_program] *= np.where(is_constant[:, None], estimate, 1.0)
    lamps.estimate[has_program] = np.where(is_constant[:, None], 1.0, estimate)
    lamps.program[has_program] = np.where(is_constant, -1, own)
    # A ray that crosses the lamp does not run its program: the lamp is left to sampling alone, which does.
    lamps.flags[lamps.program >= 0] &= ~la.LAMP_FLAG_MIS


def _notice(
    lamps: _Columns, lights: list[Light], is_finite: np.ndarray, has_size: np.ndarray, notices: list[Notice]
) -> None:
    """What cannot be rendered as it is meant, in the order of the lights."""
    for index in np.flatnonzero(~is_finite | ~has_size | (lamps.program >= 0)).tolist():
        subject = f"light {lights[index].name}"
        if not is_finite[index]:
            notices.append(Notice(subject, "its transform or strength is NaN or infinite", "it is left out"))
            continue
        if not has_size[index]:
            notices.append(Notice(subject, "its size, angle or spread is NaN or infinite", "it is left out"))
            continue
        notices.append(
            Notice(
                subject,
                "its nodes give an emission that varies",
                "it is sampled exactly, but rays that hit it by chance (mirror reflections) do not see it; to the "
                "camera it shows its mean",
            )
        )


#: What says how large a lamp is, by its kind.
_MEASURES = {
    "POINT": ("radius",), "SPOT": ("radius", "spot_angle", "spot_blend"), "SUN": ("angle",),
    "AREA": ("size_x", "size_y", "spread"),
}  # fmt: skip


def _has_size(lamps: _Columns) -> np.ndarray:
    """Of which lamps all that says how large they are is a number, bool (N,)."""
    known = np.isfinite(lamps.temperature)
    for kind, names in _MEASURES.items():
        measures = np.stack([getattr(lamps, name) for name in names])
        known &= (lamps.kind != kind) | np.isfinite(measures).all(axis=0)
    return known


def convert_lamps(lights: list[Light], info: ProgramInfo, notices: list[Notice]) -> Lamps:
    """Usable lamps; what cannot be rendered as it is meant is added to `notices`.

    Raises
    ------
    ValueError
        A lamp is of a kind that does not exist.
    """
    rows = Lamps(
        values=np.zeros((len(lights), la.LAMP_WIDTH), np.float32),
        table=np.zeros((len(lights), la.LAMP_TABLE_WIDTH), np.int32),
        bounds=np.zeros((len(lights), lt.BOUNDS_WIDTH), np.float32),
        distant=np.zeros((len(lights), 3)),
    )
    if not lights:
        return rows
    lamps, programs = _read(lights, info)
    is_finite = np.isfinite(lamps.strength).all(axis=1) & np.isfinite(lamps.matrix).all(axis=(1, 2))
    has_size = _has_size(lamps)
    programs[~(is_finite & has_size)] = -1
    _apply_programs(lamps, np.array([light.color for light in lights], np.float64), programs, info)
    _notice(lamps, lights, is_finite, has_size, notices)
    is_usable = is_finite & has_size & lamps.strength.any(axis=1) & lamps.estimate.any(axis=1)
    for index in np.flatnonzero(is_usable & ~np.isin(lamps.kind, tuple(_KINDS)))[:1].tolist():
        raise ValueError(f"light {lights[index].name}: kind is {lights[index].kind!r}, choose {', '.join(_KINDS)}")
    for name, (kind, convert) in _KINDS.items():
        chosen = np.flatnonzero(is_usable & (lamps.kind == name))
        if len(chosen):
            _fill(rows, chosen, lamps.pick(chosen), kind, convert, is_usable)
    order = np.argsort(rows.order, kind="stable")
    order = order[is_usable[order]]
    return Lamps(rows.values[order], rows.table[order], rows.bounds[order], rows.distant[order])


def _fill(
    rows: Lamps, chosen: np.ndarray, lamps: _Columns, kind: int, convert: Callable[[_Columns, _Draft], None],
    is_usable: np.ndarray,
) -> None:
    """Write the rows of lamps of one kind, `chosen` out of all; those that cannot light anything are not usable."""
    draft = _draft(lamps)
    convert(lamps, draft)
    is_usable[chosen] = draft.is_usable
    values, table = draft.values, np.zeros((len(chosen), la.LAMP_TABLE_WIDTH), np.int64)
    values[:, la.LAMP_RADIANCE : la.LAMP_RADIANCE + 3] = lamps.strength * draft.scale[:, None]
    values[:, la.LAMP_ESTIMATE : la.LAMP_ESTIMATE + 3] = lamps.estimate
    values[:, la.LAMP_TEMPERATURE] = lamps.temperature
    table[:, la.LAMP_KIND] = kind
    table[:, la.LAMP_FLAGS] = draft.flags
    table[:, la.LAMP_VISIBILITY] = lamps.visibility
    table[:, la.LAMP_MAX_BOUNCES] = np.minimum(lamps.max_bounces, 1 << 20)
    table[:, la.LAMP_PROGRAM] = lamps.program
    table[:, la.LAMP_LIGHT] = lamps.index
    table[:, la.LAMP_LIGHT_GROUP] = lamps.light_group
    # What is too bright, or too large, for float32 is as bright and large as can be.
    rows.values[chosen], rows.bounds[chosen] = (
        np.clip(numbers, -FLOAT_MAX, FLOAT_MAX) for numbers in (values, draft.bounds)
    )
    rows.table[chosen], rows.distant[chosen] = table, draft.distant
