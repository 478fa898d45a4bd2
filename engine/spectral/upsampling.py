# SPDX-License-Identifier: GPL-3.0-or-later
"""Smooth spectra of linear Rec.709 colours (Jakob and Hanika 2019).

A spectrum is S(c0 t^2 + c1 t + c2), S(x) = 1/2 + x / (2 sqrt(1 + x^2)), over t = (wavelength - 540 nm) / 105 nm; it
lies in [0, 1], and some three coefficients give any colour of Rec.709 from 0 to 1 under D65. They come from a table
over the largest channel and the ratios of the other two to it, computed by `engine.spectral.precompute`. It differs
from theirs in what is interpolated, so that 140 kB suffice:

- the table holds q = x / (1 + sqrt(1 + x^2)) at t = -1, 0 and 1, which is in (-1, 1) and near linear in the colour
  where coefficients run to infinity; the axis of the largest channel is even in the q of a grey;
- below `LEAST_VALUE` the spectrum of a brighter colour is scaled down.

Colours with a channel above 1 are scaled too: nothing limits them to 1, so that their spectrum is that of the colour
with the largest channel 1/2, from 2 on, and of one between for continuity. Greys are constant exactly.

Negative channels are taken for 0: colours outside of Rec.709 lose that much saturation. So is NaN; infinity is 1e30.

Emission takes the same spectra: all spectra are relative to D65, which is in what the film makes of a wavelength
(`engine.spectral.wavelengths.rgb_weight`), so that white emission is D65.

Round trips to Rec.709 miss by a Delta E 2000 of 0.09 on average, by less than 0.25 for 99 of 100 colours evenly spread
over the cube (0.4 where dark ones are favoured) and by 1.2 at worst, next to white. The primaries, their mixtures and
greys are exact.
"""

from __future__ import annotations

import math

import numpy as np

from engine.runtime.jit import kernel

#: Nodes of the table: largest channel, each ratio.
VALUE_COUNT = 10
RATIO_COUNT = 20
TABLE_SHAPE = (3, VALUE_COUNT, RATIO_COUNT, RATIO_COUNT, 3)
#: Largest channel at the table's first node.
LEAST_VALUE = 0.25
#: Middle and unit of t [nm].
MIDDLE = 540.0
UNIT = 105.0
#: As c2: the spectrum is 1 exactly. Coefficients of the table stay below 1e5.
FLAT = np.float32(1e9)

_LEAST_VALUE = np.float32(LEAST_VALUE)
_LARGEST = np.float32(1e30)
_SMALLEST = np.float32(1e-30)
_MIDDLE = np.float32(MIDDLE)
_PER_UNIT = np.float32(1.0 / UNIT)


@kernel
def value_to_q(value):
    """The q of a grey: x / (1 + sqrt(1 + x^2)) where S(x) is `value`, in [0, 1]."""
    return (2.0 * value - 1.0) / (1.0 + 2.0 * math.sqrt(value * (1.0 - value)))


@kernel
def q_to_x(q):
    """The x of x / (1 + sqrt(1 + x^2))."""
    return 2.0 * q / (1.0 - q * q)


@kernel
def ratio_to_axis(ratio):
    """Where a ratio of channels in [0, 1] stands on its axis, whose nodes are densest at both ends."""
    near = min(ratio, 1.0 - ratio)
    axis = math.sqrt(0.5 * near)
    return axis if ratio < 0.5 else 1.0 - axis


_FIRST_Q = np.float32((2.0 * LEAST_VALUE - 1.0) / (1.0 + 2.0 * math.sqrt(LEAST_VALUE * (1.0 - LEAST_VALUE))))


@kernel
def _cell(axis, node_count):
    position = min(max(axis, 0.0), 1.0) * np.float32(node_count - 1)
    cell = min(int(position), node_count - 2)
    return cell, position - np.float32(cell)


@kernel
def _interpolate(data, corner, fraction_x, fraction_y, fraction_z):
    """One of the numbers of a node between the eight nodes of a cell."""
    column = 3
    row = column * RATIO_COUNT
    plane = row * RATIO_COUNT
    a = data[corner] + (data[corner + column] - data[corner]) * fraction_x
    b = data[corner + row] + (data[corner + row + column] - data[corner + row]) * fraction_x
    near = a + (b - a) * fraction_y
    corner += plane
    a = data[corner] + (data[corner + column] - data[corner]) * fraction_x
    b = data[corner + row] + (data[corner + row + column] - data[corner + row]) * fraction_x
    far = a + (b - a) * fraction_y
    return near + (far - near) * fraction_z


@kernel
def _clean(channel):
    return min(channel, _LARGEST) if channel > 0.0 else np.float32(0.0)


@kernel
def spectrum_coefficients(tables, r, g, b):
    """Spectrum of a colour.

    Parameters
    ----------
    tables : SpectralTables
    r, g, b : float32
        Linear Rec.709, any size.

    Returns
    -------
    scale, c0, c1, c2 : float32
        For `evaluate_spectrum`. `scale` is 1 where the largest channel is between `LEAST_VALUE` and 1 and the colour is
        not grey.
    """
    r, g, b = _clean(r), _clean(g), _clean(b)
    largest = max(r, max(g, b))
    if largest == min(r, min(g, b)) or largest < _SMALLEST:
        return largest, np.float32(0.0), np.float32(0.0), FLAT
    value = max(largest, _LEAST_VALUE) if largest <= 1.0 else max(1.0 / largest, 0.5)
    if largest == r:
        channel, first, second = 0, g, b
    elif largest == g:
        channel, first, second = 1, b, r
    else:
        channel, first, second = 2, r, g
    x, fraction_x = _cell(ratio_to_axis(min(first / largest, 1.0)), RATIO_COUNT)
    y, fraction_y = _cell(ratio_to_axis(min(second / largest, 1.0)), RATIO_COUNT)
    z, fraction_z = _cell((value_to_q(value) - _FIRST_Q) / (1.0 - _FIRST_Q), VALUE_COUNT)
    data = tables.coefficients
    corner = 3 * (((channel * VALUE_COUNT + z) * RATIO_COUNT + y) * RATIO_COUNT + x)
    short = q_to_x(_interpolate(data, corner, fraction_x, fraction_y, fraction_z))
    middle = q_to_x(_interpolate(data, corner + 1, fraction_x, fraction_y, fraction_z))
    long = q_to_x(_interpolate(data, corner + 2, fraction_x, fraction_y, fraction_z))
    # The parabola through -1, 0 and 1.
    return largest / value, 0.5 * (short + long) - middle, 0.5 * (long - short), middle


@kernel
def evaluate_spectrum(scale, c0, c1, c2, wavelength):
    """Value of a spectrum, relative to D65 where it is emission.

    Parameters
    ----------
    scale, c0, c1, c2 : float32
        From `spectrum_coefficients`.
    wavelength : float32  [nm]

    Returns
    -------
    float32
        At most `scale`.
    """
    if c2 >= FLAT:
        return scale
    t = (wavelength - _MIDDLE) * _PER_UNIT
    x = (c0 * t + c1) * t + c2
    # S(x), or 1 - S(x), without cancellation: (s + x) / 2s = 1 / (2s (s - x)).
    s = math.sqrt(1.0 + x * x)
    rest = 0.5 / (s * (s + abs(x)))
    return scale * (rest if x < 0.0 else 1.0 - rest)
