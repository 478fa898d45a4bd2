# SPDX-License-Identifier: GPL-3.0-or-later
"""Operations on linear colours (3-tuples): mixing, HSV and HSL, curves of tone, black bodies and wavelengths."""

import math

import numpy as np

from engine.kernels.constants import LUMINANCE_B, LUMINANCE_G, LUMINANCE_R
from engine.kernels.limits import at_least, clamp_unit
from engine.kernels.rounding import floor_of
from engine.runtime.jit import kernel

#: Blender's names of the blend modes; a mode's code is its place here. The last four work on the whole colour.
BLEND_MODES = (
    "MIX", "DARKEN", "MULTIPLY", "BURN", "LIGHTEN", "SCREEN", "DODGE", "ADD", "OVERLAY", "SOFT_LIGHT", "LINEAR_LIGHT",
    "DIFFERENCE", "EXCLUSION", "SUBTRACT", "DIVIDE", "HUE", "SATURATION", "COLOR", "VALUE",
)  # fmt: skip

(
    _MIX, _DARKEN, _MULTIPLY, _BURN, _LIGHTEN, _SCREEN, _DODGE, _ADD, _OVERLAY, _SOFT_LIGHT, _LINEAR_LIGHT,
    _DIFFERENCE, _EXCLUSION, _SUBTRACT, _DIVIDE, _HUE, _SATURATION, _COLOR, _VALUE,
) = range(len(BLEND_MODES))  # fmt: skip

COLOR_RGB = 0
COLOR_HSV = 1
COLOR_HSL = 2


@kernel
def luminance(color):
    """Rec.709 luminance Y."""
    return color[0] * LUMINANCE_R + color[1] * LUMINANCE_G + color[2] * LUMINANCE_B


@kernel
def srgb_to_linear(c):
    """Decode one sRGB value (IEC 61966-2-1); negative values become 0."""
    if c < 0.04045:
        return max(c, 0.0) / 12.92
    return math.pow((c + 0.055) / 1.055, 2.4)


@kernel
def linear_to_srgb(c):
    """Encode one linear value as sRGB; negative values become 0."""
    if c < 0.0031308:
        return max(c, 0.0) * 12.92
    return 1.055 * math.pow(c, 1.0 / 2.4) - 0.055


@kernel
def rgb_to_hsv(color):
    """Hue, saturation and value, hue in turns."""
    r, g, b = color
    value = max(r, max(g, b))
    chroma = value - min(r, min(g, b))
    saturation = chroma / value if value != 0.0 else 0.0
    if saturation == 0.0:
        return 0.0, 0.0, value
    hue = 0.0
    if r == value:
        hue = (g - b) / chroma
    elif g == value:
        hue = 2.0 + (b - r) / chroma
    else:
        hue = 4.0 + (r - g) / chroma
    hue /= 6.0
    if hue < 0.0:
        hue += 1.0
    return hue, saturation, value


@kernel
def hsv_to_rgb(color):
    """Linear RGB of hue (turns), saturation and value; hues outside [0, 1] are the last sector's, as in Cycles."""
    hue, saturation, value = color
    if saturation == 0.0:
        return value, value, value
    if hue == 1.0:
        hue = 0.0
    hue *= 6.0
    sector = floor_of(hue)
    fraction = hue - np.float32(sector)
    p = value * (1.0 - saturation)
    q = value * (1.0 - saturation * fraction)
    t = value * (1.0 - saturation * (1.0 - fraction))
    if sector == 0:
        return value, t, p
    if sector == 1:
        return q, value, p
    if sector == 2:
        return p, value, t
    if sector == 3:
        return p, q, value
    if sector == 4:
        return t, p, value
    return value, p, q


@kernel
def rgb_to_hsl(color):
    """Hue (turns), saturation and lightness."""
    r, g, b = color
    high = max(r, max(g, b))
    low = min(r, min(g, b))
    lightness = min(1.0, (high + low) / 2.0)
    if high == low:
        return 0.0, 0.0, lightness
    chroma = high - low
    saturation = chroma / (2.0 - high - low) if lightness > 0.5 else chroma / (high + low)
    hue = 0.0
    if high == r:
        hue = (g - b) / chroma + (6.0 if g < b else 0.0)
    elif high == g:
        hue = (b - r) / chroma + 2.0
    else:
        hue = (r - g) / chroma + 4.0
    return hue / 6.0, saturation, lightness


@kernel
def hsl_to_rgb(color):
    """Linear RGB of hue (turns), saturation and lightness."""
    hue, saturation, lightness = color
    r = clamp_unit(abs(hue * 6.0 - 3.0) - 1.0)
    g = clamp_unit(2.0 - abs(hue * 6.0 - 2.0))
    b = clamp_unit(2.0 - abs(hue * 6.0 - 4.0))
    chroma = (1.0 - abs(2.0 * lightness - 1.0)) * saturation
    return (r - 0.5) * chroma + lightness, (g - 0.5) * chroma + lightness, (b - 0.5) * chroma + lightness


@kernel
def _blend_channel(mode, t, a, b):
    """Blend modes that treat each channel alone."""
    s = 1.0 - t
    if mode == _SCREEN:
        return 1.0 - (s + t * (1.0 - b)) * (1.0 - a)
    if mode == _OVERLAY:
        if a < 0.5:
            return a * (s + 2.0 * t * b)
        return 1.0 - (s + 2.0 * t * (1.0 - b)) * (1.0 - a)
    if mode == _DIVIDE:
        return s * a + t * a / b if b != 0.0 else a
    if mode == _DODGE:
        if a == 0.0:
            return 0.0
        rest = 1.0 - t * b
        return min(a / rest, 1.0) if rest > 0.0 else 1.0
    if mode == _BURN:
        rest = s + t * b
        return clamp_unit(1.0 - (1.0 - a) / rest) if rest > 0.0 else 0.0
    if mode == _SOFT_LIGHT:
        screen = 1.0 - (1.0 - b) * (1.0 - a)
        return s * a + t * ((1.0 - a) * b * a + a * screen)
    if mode == _LINEAR_LIGHT:
        return a + t * (2.0 * b - 1.0)
    if mode == _ADD:
        b = a + b
    elif mode == _MULTIPLY:
        b = a * b
    elif mode == _SUBTRACT:
        b = a - b
    elif mode == _DIFFERENCE:
        b = abs(a - b)
    elif mode == _EXCLUSION:
        return at_least(a + t * (b - 2.0 * a * b), 0.0)
    elif mode == _DARKEN:
        b = min(a, b)
    elif mode == _LIGHTEN:
        b = max(a, b)
    return a + t * (b - a)


@kernel
def _blend_hsv(mode, t, first, second):
    """Blend modes that take hue, saturation or value from `second`."""
    hue, saturation, value = rgb_to_hsv(first)
    other = rgb_to_hsv(second)
    is_partial = False
    if mode == _SATURATION:
        if saturation == 0.0:
            return first
        saturation += t * (other[1] - saturation)
    elif mode == _VALUE:
        value += t * (other[2] - value)
    else:
        if other[1] == 0.0:
            return first
        hue = other[0]
        if mode == _COLOR:
            saturation = other[1]
        is_partial = True
    mixed = hsv_to_rgb((hue, saturation, value))
    if is_partial:
        return (
            first[0] + t * (mixed[0] - first[0]),
            first[1] + t * (mixed[1] - first[1]),
            first[2] + t * (mixed[2] - first[2]),
        )
    return mixed


@kernel
def blend(mode, t, first, second):
    """Mix two colours.

    Parameters
    ----------
    mode : int
        Index into BLEND_MODES.
    t : float32
        Share of the effect; the caller clamps.
    """
    if mode >= _HUE:
        return _blend_hsv(mode, t, first, second)
    return (
        _blend_channel(mode, t, first[0], second[0]),
        _blend_channel(mode, t, first[1], second[1]),
        _blend_channel(mode, t, first[2], second[2]),
    )


@kernel
def hue_saturation_value(color, hue, saturation, value, factor):
    """The Hue/Saturation/Value node: hue 0.5 leaves the hue as it is; never negative."""
    h, s, v = rgb_to_hsv(color)
    h = h + hue + 0.5
    h -= np.float32(floor_of(h))
    r, g, b = hsv_to_rgb((h, clamp_unit(s * saturation), v * value))
    rest = 1.0 - factor
    return (
        at_least(factor * r + rest * color[0], 0.0),
        at_least(factor * g + rest * color[1], 0.0),
        at_least(factor * b + rest * color[2], 0.0),
    )


@kernel
def gamma_channel(c, gamma):
    """c ** gamma where c is positive; anything to the power of 0 is 1."""
    if gamma == 0.0:
        return 1.0
    return math.pow(c, gamma) if c > 0.0 else c


# Fit of Planck's law in linear Rec.709, normalised to luminance 1, per interval of temperature [K]:
# a / T + b T + c for red and green, ((a T + b) T + c) T + d for blue. Figures as in Cycles (kernel/tables.h).
_BLACKBODY_LIMITS = np.array((965.0, 1167.0, 1449.0, 1902.0, 3315.0, 6365.0), np.float32)
_BLACKBODY_RED = np.array(
    (
        (1.61919106e03, -2.05010916e-03, 5.02995757e00),
        (2.48845471e03, -1.11330907e-03, 3.22621544e00),
        (3.34143193e03, -4.86551192e-04, 1.76486769e00),
        (4.09461742e03, -1.27446582e-04, 7.25731635e-01),
        (4.67028036e03, 2.91258199e-05, 1.26703442e-01),
        (4.59509185e03, 2.87495649e-05, 1.50345020e-01),
        (3.78717450e03, 9.35907826e-06, 3.99075871e-01),
    ),
    np.float32,
)
_BLACKBODY_GREEN = np.array(
    (
        (-4.88999748e02, 6.04330754e-04, -7.55807526e-02),
        (-7.55994277e02, 3.16730098e-04, 4.78306139e-01),
        (-1.02363977e03, 1.20223470e-04, 9.36662319e-01),
        (-1.26571316e03, 4.87340896e-06, 1.27054498e00),
        (-1.42529332e03, -4.01150431e-05, 1.43972784e00),
        (-1.17554822e03, -2.16378048e-05, 1.30408023e00),
        (-5.00799571e02, -4.59832026e-06, 1.09098763e00),
    ),
    np.float32,
)
_BLACKBODY_BLUE = np.array(
    (
        (5.96945309e-11, -4.85742887e-08, -9.70622247e-05, -4.07936148e-03),
        (2.40430366e-11, 5.55021075e-08, -1.98503712e-04, 2.89312858e-02),
        (-1.40949732e-11, 1.89878968e-07, -3.56632824e-04, 9.10767778e-02),
        (-3.61460868e-11, 2.84822009e-07, -4.93211319e-04, 1.56723440e-01),
        (-1.97075738e-11, 1.75359352e-07, -2.50542825e-04, -2.22783266e-02),
        (-1.61997957e-13, -1.64216008e-08, 3.86216271e-04, -7.38077418e-01),
        (6.72650283e-13, -2.73078809e-08, 4.24098264e-04, -7.52335691e-01),
    ),
    np.float32,
)


@kernel
def blackbody(temperature):
    """Linear Rec.709 colour of a black body, luminance about 1, without negative channels.

    Parameters
    ----------
    temperature : float32
        [K]; below 800 and above 12000 the colour stays.
    """
    if temperature >= 12000.0:
        return 0.8262954810464208, 0.9945080501520986, 1.566307710274283
    if temperature < 800.0:
        return 5.413294490189271, 0.0, 0.0
    i = 0
    while i < 6 and temperature >= _BLACKBODY_LIMITS[i]:
        i += 1
    t = temperature
    inverse = 1.0 / t
    red = _BLACKBODY_RED[i, 0] * inverse + _BLACKBODY_RED[i, 1] * t + _BLACKBODY_RED[i, 2]
    green = _BLACKBODY_GREEN[i, 0] * inverse + _BLACKBODY_GREEN[i, 1] * t + _BLACKBODY_GREEN[i, 2]
    blue = (_BLACKBODY_BLUE[i, 0] * t + _BLACKBODY_BLUE[i, 1]) * t + _BLACKBODY_BLUE[i, 2]
    blue = blue * t + _BLACKBODY_BLUE[i, 3]
    return at_least(red, 0.0), at_least(green, 0.0), at_least(blue, 0.0)
