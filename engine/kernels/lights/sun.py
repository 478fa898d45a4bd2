# SPDX-License-Identifier: GPL-3.0-or-later
"""Suns: discs at infinity, or a single direction."""

import math

from engine.kernels.constants import DISTANT, INV_TWO_PI
from engine.kernels.lights.lamp import Lamp, LampPoint
from engine.kernels.lights.mapping import uniform_cone
from engine.kernels.vector import dot, subtract
from engine.runtime.jit import kernel
from engine.state.lights import FIRST_LAMP, LAMP_FLAG_DELTA, LAMP_FLAGS, LAMP_KIND_COLUMNS, LAMP_P, LAMP_PROGRAM

SUN = FIRST_LAMP + 3

# Columns of `LightArrays.lamps`. LAMP_P is the unit direction towards the sun.
#: 1 - cos of its half angle.
ONE_MINUS_COS = LAMP_KIND_COLUMNS
#: World directions to the x and the y of its own space.
TO_X = LAMP_KIND_COLUMNS + 1
TO_Y = LAMP_KIND_COLUMNS + 4


@kernel
def coordinates_on_sun(lights, row, wi):
    """Texture coordinates u and v, which only programs read: barycentrics in Cycles' manner of the disc seen.

    It maps the cone to the disc and keeps areas: the radius is sin(a / 2) over that of the rim.
    """
    lamps, none = lights.lamps, 0.0 * wi[0]
    one_minus_cos = lamps[row, ONE_MINUS_COS]
    if lights.lamp_table[row, LAMP_PROGRAM] < 0 or not one_minus_cos > 0.0:
        return none + 0.5, none
    mean = (wi[0] + lamps[row, LAMP_P], wi[1] + lamps[row, LAMP_P + 1], wi[2] + lamps[row, LAMP_P + 2])
    # sin(a / 2)^2 is half of 1 - cos(a).
    scaled = 0.5 / (math.sqrt(0.5 * one_minus_cos) * math.sqrt(dot(mean, mean)))
    x = dot(wi, (lamps[row, TO_X], lamps[row, TO_X + 1], lamps[row, TO_X + 2])) * scaled
    y = dot(wi, (lamps[row, TO_Y], lamps[row, TO_Y + 1], lamps[row, TO_Y + 2])) * scaled
    return y + 0.5, -x - y


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
    u, v = coordinates_on_sun(lights, row, wi)
    return LampPoint(pdf, wi, DISTANT, (-wi[0], -wi[1], -wi[2]), none + 1.0, u, v)


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
    u, v = coordinates_on_sun(lights, row, direction)
    return (-direction[0], -direction[1], -direction[2]), u, v


LAMP = Lamp(SUN, True, sample_sun, sun_pdf, hit_sun, leaving_sun, place_sun)
