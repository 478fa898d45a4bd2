# SPDX-License-Identifier: GPL-3.0-or-later
"""What a file of a closure is made of: the record of its kind of lobe, and what its instruction is given."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

_Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Lobe:
    """A diffuse kind of lobe: one without roughness or delta part, whose rays are diffuse rays.

    Attributes
    ----------
    kind : int
        Its number in `Closures.kind`, a free one below FIRST_TRANSLUCENT if it reflects, below LAST_DIFFUSE if it
        transmits (`bsdf.kinds`).
    evaluate : kernel
        (param, channels, lane, i, n, wo, wi, factor, out, row) -> pdf [sr^-1]. Adds `factor` times f |cos| of closure
        `i` to out[row].
    sample : kernel
        (param, lane, i, n, wo, u1, u2) -> wi, unit, with the density that `evaluate` returns.
    colors : tuple of int
        Columns of `Closures.param` where its colours begin but for the weight, to be made values at a path's
        wavelengths.
    """

    kind: int
    evaluate: Any
    sample: Any
    colors: tuple[int, ...] = ()


@dataclass(frozen=True)
class HairLobe:
    """A kind of lobe that a fibre has. It looks at no normal but its own, so that samples go to any side.

    Attributes
    ----------
    kind, evaluate, colors
        As of a `Lobe`; kinds from FIRST_HAIR on. Of the Hair BSDF `n` is zero but for light samples (`hair.py`).
    sample : kernel
        (param, channels, lane, i, wo, u0, u1, u2) -> wi, unit, with the density that `evaluate` returns; zero where
        it has none.
    roughness : kernel
        (param, lane, i) -> roughness.
    albedo : kernel
        (param, lane, i, wo, c) -> what it scatters of a channel, about, as Cycles estimates it for colours of passes;
        without the weight.
    """

    kind: int
    evaluate: Any
    sample: Any
    roughness: Any
    albedo: Any
    colors: tuple[int, ...] = ()


class View(NamedTuple):
    """Where closures are added, as far as all of them need it.

    Attributes
    ----------
    wo, ng, ns : tuple of 3 float32
        Direction to the viewer, geometric and smooth shading normal on the viewer's side.
    tangent : tuple of 3 float32
        Of the curve, not unit; 0 on other surfaces.
    random : float32 in [0, 1)
        For what a closure draws once.
    footprint : float32
        Radius of what a camera's ray sees of the surface [m], -1 of other rays.
    """

    wo: _Vector
    ng: _Vector
    ns: _Vector
    is_backfacing: bool
    tangent: _Vector
    random: float
    footprint: float
