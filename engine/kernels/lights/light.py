# SPDX-License-Identifier: GPL-3.0-or-later
"""What light sampling is asked, and what it answers: the records that stages and kinds of lights share."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

_Vector = tuple[float, float, float]


class Receiver(NamedTuple):
    """Who asks for light.

    Attributes
    ----------
    p, n : tuple of 3 float32, world space
        Where it stands [m], and its unit normal as the light tree sees it.
    has_transmission : bool
        It also scatters light that comes from behind n.
    leaves_dim : bool
        The background's dim parts are left to scattering (`finds_all`).
    tree : int
        The light tree by which it receives light (`engine.kernels.lights.linking`).
    """

    p: _Vector
    n: _Vector
    has_transmission: bool
    leaves_dim: bool
    tree: int | np.int64


class Choice(NamedTuple):
    """An emitter that has been chosen.

    Attributes
    ----------
    emitter : int
        Row of `lights.emitters`, -1 = none.
    pmf : float32
        With which it was chosen; of the background that of the patch, if one was.
    patch : int
        Cluster of the background in which to draw a direction, -1: anywhere.
    """

    emitter: int | np.int64
    pmf: float
    patch: int | np.int64


class LightSample(NamedTuple):
    """A point on a light, or a direction towards one that is infinitely far away.

    Attributes
    ----------
    pdf : float32 [sr^-1], 0 = no sample
        In solid angle at the receiver, times the probability of choosing the emitter; of a delta light that alone.
    emitter, kind : int
        Row of `lights.emitters`, and its LIGHT_*.
    wi : tuple of 3 float32
        Unit direction towards the light.
    distance : float32 [m]
        DISTANT for suns and the background.
    point, ng : tuple of 3 float32
        Position and unit normal on the light, which faces the receiver; of distant lights wi and -wi.
    u, v : float32
        Barycentrics on a triangle, texture coordinates on a lamp.
    instance, triangle : int
        -1 for lamps and the background.
    program : int
        To evaluate for the emission, -1 = `radiance` is final.
    radiance : tuple of 3 float32 [W m^-2 sr^-1]
        What the light emits towards the receiver, or the factor on its program's emission. Of a delta light what it
        contributes per unit of BSDF and cosine, 1 / distance^2 included.
    visibility : int
        VISIBLE_* bits of the light.
    cast_shadow : bool
    max_bounces : int
        The light takes no part beyond this depth.
    use_mis : bool
        False: its weight is 1, nothing else finds this light.
    shows_back : bool
        The light is a triangle, and the receiver sees its back.
    pmf : float32
        As in `Choice`.
    """

    pdf: float
    emitter: int
    kind: int
    wi: _Vector
    distance: float
    point: _Vector
    ng: _Vector
    u: float
    v: float
    instance: int
    triangle: int
    program: int
    radiance: _Vector
    visibility: int
    cast_shadow: bool
    max_bounces: int
    use_mis: bool
    shows_back: bool
    pmf: float
