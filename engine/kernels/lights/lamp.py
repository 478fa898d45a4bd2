# SPDX-License-Identifier: GPL-3.0-or-later
"""What a file of a lamp is made of: the record of its kind, and what its samples are."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

_Vector = tuple[float, float, float]


class LampPoint(NamedTuple):
    """A point of a lamp that has been drawn for a receiver.

    Attributes
    ----------
    pdf : float32 [sr^-1]
        In solid angle at the receiver; 1 of a delta lamp, 0 = none.
    wi : tuple of 3 float32
        Unit direction towards it.
    distance : float32 [m]
        DISTANT of a lamp that is infinitely far away.
    ng : tuple of 3 float32
        Unit normal of the lamp there, on the receiver's side.
    factor : float32
        On the lamp's radiance: what leaves it towards the receiver; 1 / distance^2 included where a delta lamp's
        strength is a radiant intensity.
    u, v : float32
        Texture coordinates.
    """

    pdf: float
    wi: _Vector
    distance: float
    ng: _Vector
    factor: float
    u: float
    v: float


@dataclass(frozen=True)
class Lamp:
    """A kind of lamp: a light that is neither a surface nor the background, and a row of `LightArrays.lamps`.

    Kernels take `lights`, the `LightArrays`, and the lamp's row. What they say is of the lamp alone: the probability
    with which the light tree chooses it is multiplied in by whoever calls them.

    Attributes
    ----------
    kind : int
        Its number in `LightArrays.emitters`, a free one from FIRST_LAMP on (`engine.state.lights`).
    is_distant : bool
        Infinitely far away: it has a row of `LightArrays.distant` in place of a node of the light tree, and rays meet
        it where they leave the scene.
    sample : kernel
        (lights, row, receiver, u0, u1) -> LampPoint, for a `Receiver`.
    pdf : kernel
        (lights, row, receiver, wi, distance) -> density [sr^-1] of `sample` for a hit at `distance` along wi.
    hit : kernel
        (lights, row, origin, direction, t_min, t_max) -> distance [m] between t_min and t_max at which a ray meets it,
        -1 = not; DISTANT if the ray goes towards a lamp that is infinitely far away. Not asked of delta lamps.
    leaving : kernel
        (lights, row, p, wi) -> share of its radiance that leaves along -wi towards p: `LampPoint.factor` of a hit.
    place : kernel
        (lights, row, origin, direction, t) -> normal on the ray's side and texture coordinates u, v where a ray meets
        it: `LampPoint.ng`, `u` and `v` of a hit.
    """

    kind: int
    is_distant: bool
    sample: Any
    pdf: Any
    hit: Any
    leaving: Any
    place: Any
