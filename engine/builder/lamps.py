# SPDX-License-Identifier: GPL-3.0-or-later
"""Lamps as rows of `LightArrays`: the table of their kinds, and what all have in common.

`engine/kernels/lights/lamps.py` has the other half of the table: what kernels know of each kind. A kind's file here
(`suns.py` is an example) says what its radiance is in Blender's units, watts, or W m^-2 of suns.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Any

import numpy as np
import numpy.typing as npt

from engine.array_types import Float32Array, Int32Array
from engine.builder import light_tree as lt
from engine.builder.area_lamps import AREAS
from engine.builder.emission import ProgramInfo
from engine.builder.lamp_kind import LampColumns, LampDraft, LampKind
from engine.builder.point_lamps import POINTS, SPOTS
from engine.builder.suns import SUNS
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
        Not read of those that are infinitely far away.
    distant : float64 (L, 3)
        Lamps that are infinitely far away: cosine and sine of the half angle, irradiance [W m^-2].
    """

    values: Float32Array
    table: Int32Array
    bounds: Float32Array
    distant: np.ndarray

    @property
    def is_distant(self) -> npt.NDArray[np.bool_]:
        """Which are infinitely far away, (L,)."""
        distant = [kind.lamp.kind for kind in LAMP_KINDS.values() if kind.lamp.is_distant]
        return np.isin(self.table[:, la.LAMP_KIND], distant)

    @property
    def order(self) -> npt.NDArray[np.int64]:
        """Those that rays may cross: 0, then deltas: 1, and the same of those infinitely far away: 2 and 3; (L,)."""
        is_delta = (self.table[:, la.LAMP_FLAGS] & la.LAMP_FLAG_DELTA) != 0
        return 2 * self.is_distant.astype(np.int64) + is_delta


#: Of a lamp whose program has given nothing where it was looked at.
_ESTIMATE_OF_UNSEEN = 0.05


def _draft(lamps: LampColumns) -> LampDraft:
    count = len(lamps.index)
    draft = LampDraft(
        scale=np.ones(count),
        is_usable=np.ones(count, bool),
        flags=lamps.flags.copy(),
        values=np.zeros((count, la.LAMP_WIDTH)),
        bounds=np.zeros((count, lt.BOUNDS_WIDTH)),
        distant=np.zeros((count, 3)),
    )
    draft.values[:, la.LAMP_P : la.LAMP_P + 3] = lamps.matrix[:, :3, 3]
    return draft


def _is_grey(colors: np.ndarray) -> np.ndarray:
    return np.asarray((colors[..., 0] == colors[..., 1]) & (colors[..., 1] == colors[..., 2]))


#: By `Light.kind`.
LAMP_KINDS: dict[str, LampKind] = {"POINT": POINTS, "SPOT": SPOTS, "AREA": AREAS, "SUN": SUNS}


#: Kinds of lamps that may lie in a surface.
_FLAT = {name: kind.corners for name, kind in LAMP_KINDS.items() if kind.corners is not None}


def corners_of_flat(lights: Sequence[Light]) -> tuple[np.ndarray, npt.NDArray[np.int64]]:
    """Corners of flat lamps (`LampKind.corners`), float64 (K, 4, 3) [m], and their indices, (K,)."""
    index = [k for k, light in enumerate(lights) if light.kind in _FLAT]
    corners = np.zeros((len(index), 4, 3))
    for row, k in enumerate(index):
        corners[row] = _FLAT[lights[k].kind](lights[k])
    return corners, np.array(index, np.int64)


def places_of_flat(lights: Sequence[Light]) -> list[tuple[Any, ...]]:
    """All that `corners_of_flat` goes by, and the lamps' names, for a digest."""
    fields = {name: LAMP_KINDS[name].measures + LAMP_KINDS[name].choices for name in _FLAT}
    return [
        (light.name, light.transform, *(getattr(light, name) for name in fields[light.kind]))
        for light in lights if light.kind in fields
    ]  # fmt: skip


# ---------------------------------------------------------------------------------------------------------------------
# What all kinds have in common

#: Fields of `Light` whose columns are taken as they are: their types as columns.
_TAKEN: dict[str, Any] = {
    "kind": str, "temperature": np.float64, "is_normalized": bool, "visibility": np.int64, "max_bounces": np.int64,
    "light_group": np.int64,
}  # fmt: skip
#: The same of fields that only some kinds have; those of choices are what they are.
_TAKEN_OF_KINDS: dict[str, Any] = {
    **{name: np.float64 for kind in LAMP_KINDS.values() for name in kind.measures},
    **{name: None for kind in LAMP_KINDS.values() for name in kind.choices},
}


def _take(lights: list[Light], taken: dict[str, Any]) -> dict[str, np.ndarray]:
    """Columns of these fields by name."""
    columns = zip(*map(attrgetter(*taken), lights), strict=True)
    return {name: np.array(column, kind) for (name, kind), column in zip(taken.items(), columns, strict=True)}


def _read(lights: list[Light], info: ProgramInfo) -> tuple[LampColumns, np.ndarray]:
    """Columns of lights, at least one, as they are without their programs, and of each its program, int64 (N,)."""
    use_mis, cast_shadow = np.array([(light.use_mis, light.cast_shadow) for light in lights], bool).T
    energy = np.array([light.energy for light in lights], np.float64)
    count = len(lights)
    programs = np.full(count, -1, np.int64)
    known = min(count, len(info.light_program))
    programs[:known] = info.light_program[:known]
    return LampColumns(
        index=np.arange(count),
        matrix=np.array([light.transform for light in lights], np.float64),
        strength=np.array([light.color for light in lights], np.float64) * energy[:, None],
        estimate=np.ones((count, 3)),
        program=np.full(count, -1, np.int64),
        flags=np.where(use_mis, la.LAMP_FLAG_MIS, 0) | np.where(cast_shadow, la.LAMP_FLAG_SHADOW, 0),
        own=_take(lights, _TAKEN_OF_KINDS),
        **_take(lights, _TAKEN),
    ), programs


def _apply_programs(lamps: LampColumns, colors: np.ndarray, programs: np.ndarray, info: ProgramInfo) -> None:
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
    # Nothing where it was looked at is not nothing anywhere.
    seen = np.where(estimate.any(axis=1)[:, None], estimate, _ESTIMATE_OF_UNSEEN)
    lamps.estimate[has_program] = np.where(is_constant[:, None], 1.0, seen)
    lamps.program[has_program] = np.where(is_constant, -1, own)


def _notice(lights: list[Light], is_finite: np.ndarray, has_size: np.ndarray, notices: list[Notice]) -> None:
    """What cannot be rendered as it is meant, in the order of the lights."""
    for index in np.flatnonzero(~is_finite | ~has_size).tolist():
        subject = f"light {lights[index].name}"
        if not is_finite[index]:
            notices.append(Notice(subject, "its transform or strength is NaN or infinite", "it is left out"))
            continue
        notices.append(Notice(subject, "its size, angle or spread is NaN or infinite", "it is left out"))


def _has_size(lamps: LampColumns) -> np.ndarray:
    """Which lamps have numbers for all that says how large they are, bool (N,)."""
    known = np.isfinite(lamps.temperature)
    for name, kind in LAMP_KINDS.items():
        measures = np.stack([lamps.own[measure] for measure in kind.measures])
        known &= (lamps.kind != name) | np.isfinite(measures).all(axis=0)
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
    _notice(lights, is_finite, has_size, notices)
    is_usable = is_finite & has_size & lamps.strength.any(axis=1) & lamps.estimate.any(axis=1)
    for index in np.flatnonzero(is_usable & ~np.isin(lamps.kind, tuple(LAMP_KINDS)))[:1].tolist():
        raise ValueError(f"light {lights[index].name}: kind is {lights[index].kind!r}, choose {', '.join(LAMP_KINDS)}")
    for name, kind in LAMP_KINDS.items():
        chosen = np.flatnonzero(is_usable & (lamps.kind == name))
        if len(chosen):
            _fill(rows, chosen, lamps.pick(chosen), kind, is_usable)
    order = np.argsort(rows.order, kind="stable")
    order = order[is_usable[order]]
    return Lamps(rows.values[order], rows.table[order], rows.bounds[order], rows.distant[order])


def _fill(rows: Lamps, chosen: np.ndarray, lamps: LampColumns, kind: LampKind, is_usable: np.ndarray) -> None:
    """Write the rows of lamps of one kind, `chosen` out of all; those that cannot light anything are not usable."""
    draft = _draft(lamps)
    kind.convert(lamps, draft)
    is_usable[chosen] = draft.is_usable
    values, table = draft.values, np.zeros((len(chosen), la.LAMP_TABLE_WIDTH), np.int64)
    values[:, la.LAMP_RADIANCE : la.LAMP_RADIANCE + 3] = lamps.strength * draft.scale[:, None]
    values[:, la.LAMP_ESTIMATE : la.LAMP_ESTIMATE + 3] = lamps.estimate
    values[:, la.LAMP_TEMPERATURE] = lamps.temperature
    table[:, la.LAMP_KIND] = kind.lamp.kind
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
