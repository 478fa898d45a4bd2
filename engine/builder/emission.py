# SPDX-License-Identifier: GPL-3.0-or-later
"""What light sampling needs to know about shader programs, and which sides of which materials it samples."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from engine.array_types import Float32Array, Int32Array
from engine.state import lights as la

#: `ProgramInfo.sampling_mode`: sides sampled, or AUTO (decided by `resolve_sampling`).
SAMPLING_AUTO = -1
SAMPLING_NONE = 0
SAMPLING_FRONT = la.EMITTER_FRONT
SAMPLING_BACK = la.EMITTER_BACK
SAMPLING_FRONT_BACK = la.EMITTER_FRONT | la.EMITTER_BACK
#: By `Material.emission_sampling`.
SAMPLING_MODES = {
    "AUTO": SAMPLING_AUTO,
    "NONE": SAMPLING_NONE,
    "FRONT": SAMPLING_FRONT,
    "BACK": SAMPLING_BACK,
    "FRONT_BACK": SAMPLING_FRONT_BACK,
}

#: Weaker emission than this is left to scattered rays to find, in automatic mode (as Cycles does).
_AUTO_THRESHOLD = 0.5


@dataclass
class ProgramInfo:
    """What light sampling needs to know about shader programs, P of them (materials, lights, world).

    Attributes
    ----------
    has_emission : bool (P,)
    emission_is_constant : bool (P,)
        Emission is `emission_estimate` wherever and however it is seen.
    emission_estimate : float32 (P, 3)
        Radiance of surfaces, factor on the strength of lights.
    temperature : float32 (P,)
        [K] of those that emit as a black body does, else 0.
    sampling_mode : int (P,)
        SAMPLING_*; only read for materials.
    light_program : int32 (lights,)
        Program of each light's graph, -1 = none.
    world_program : int
        -1 = none.
    """

    has_emission: npt.NDArray[np.bool_]
    emission_is_constant: npt.NDArray[np.bool_]
    emission_estimate: Float32Array
    temperature: Float32Array
    sampling_mode: npt.NDArray[np.int32]
    light_program: Int32Array = field(default_factory=lambda: np.zeros(0, np.int32))
    world_program: int = -1


def resolve_sampling(info: ProgramInfo) -> npt.NDArray[np.int32]:
    """Sides of each program that are sampled as a light (P,), with AUTO decided."""
    mode = np.asarray(info.sampling_mode, np.int32)
    strong = np.abs(info.emission_estimate).max(axis=1, initial=0.0) > _AUTO_THRESHOLD
    mode = np.where(mode == SAMPLING_AUTO, np.where(strong, SAMPLING_FRONT_BACK, SAMPLING_NONE), mode)
    emits = np.asarray(info.has_emission, bool) & (np.abs(info.emission_estimate).max(axis=1, initial=0.0) > 0.0)
    return np.where(emits, mode, SAMPLING_NONE).astype(np.int32)
