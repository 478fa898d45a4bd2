# SPDX-License-Identifier: GPL-3.0-or-later
"""Suns: discs at infinity, or a single direction."""

from engine.kernels.constants import DISTANT, INV_TWO_PI
from engine.kernels.lights.lamp import Lamp, LampPoint
from engine.kernels.lights.mapping import uniform_cone
from engine.kernels.vector import dot, subtract
from engine.runtime.jit import kernel
from engine.state.lights import FIRST_LAMP, LAMP_FLAG_DELTA, LAMP_FLAGS, LAMP_KIND_COLUMNS, LAMP_P

SUN = FIRST_LAMP + 3

#: Column of `LightArrays.lamps`: 1 - cos of its half angle. LAMP_P is the unit direction towards the sun.
ONE_MINUS_COS = LAMP_KIND_COLUMNS


@kernel
def sample_sun(lights, row, receiver, u0, u1):
    """See `Lamp.sample`."""
    wi = (lights.lamps[row, LAMP_P], lights.lamps[row, LAMP_P + 1], lights.lamps[row, LAMP_P + 2])
    none = 0.0 * u0
    pdf = none + 1.0
    if not lights.lamp_table[row, LAMP_FLAGS] & LAMP_FLAG_DELTA:
        one_minus_cos = lights.lamps[row, ONE_MINUS_COS]
        wi, _ = uniform_cone(wi, one_minus_cos, u0, u1)
        pdf = INV_TWO_PI / one_minus_cos
    return LampPoint(pdf, wi, DISTANT, (-wi[0], -wi[1], -wi[2]), none + 1.0, none, none)


@kernel
def sun_pdf(lights, row, receiver, wi, distance):
    """See `Lamp.pdf`."""
    return INV_TWO_PI / lights.lamps[row, ONE_MINUS_COS]


@kernel
def hit_sun(lights, row, origin, direction, t_min, t_max):
    """See `Lamp.hit`."""
    axis = (lights.lamps[row, LAMP_P], lights.lamps[row, LAMP_P + 1], lights.lamps[row, LAMP_P + 2])
    chord = subtract(direction, axis)
    if 0.5 * dot(chord, chord) <= lights.lamps[row, ONE_MINUS_COS]:
        return DISTANT
    return 0.0 * t_min - 1.0


@kernel
def leaving_sun(lights, row, p, wi):
    """See `Lamp.leaving`."""
    return 0.0 * p[0] + 1.0


@kernel
def place_sun(lights, row, origin, direction, t):
    """See `Lamp.place`."""
    none = 0.0 * t
    return (-direction[0], -direction[1], -direction[2]), none, none


LAMP = Lamp(SUN, True, sample_sun, sun_pdf, hit_sun, leaving_sun, place_sun)
