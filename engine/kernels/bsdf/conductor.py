# SPDX-License-Identifier: GPL-3.0-or-later
"""Reflection at a metal of refractive index n + ik.

References: Born and Wolf 1999, "Principles of Optics", section 14.4.1 (there n (1 + ik)); Gulbrandsen 2014, "Artist
Friendly Metallic Fresnel".
"""

import math

import numpy as np

from engine.kernels.bsdf.closures import read3
from engine.kernels.bsdf.fresnel import f82_mean
from engine.runtime.jit import kernel

#: Cosine at which the F82 model has its tint.
F82_COSINE = np.float32(1.0 / 7.0)
#: What larger n and k count as: squares of squares stay finite.
MOST_INDEX = np.float32(1e4)


@kernel
def f82_curve(f0, b, cosine):
    """The F82 curve (`fresnel.f82_b`)."""
    s = min(max(1.0 - cosine, 0.0), 1.0)
    s5 = s * s * s * s * s
    return min(max(f0 + (1.0 - f0) * s5 - b * cosine * s5 * s, 0.0), 1.0)


@kernel
def f82_b_of_value(f0, f82):
    """Coefficient of the F82 term of a curve that has the value `f82` at `F82_COSINE`."""
    f = 6.0 / 7.0
    f5 = f * f * f * f * f
    return (7.0 / (f5 * f)) * (f0 + (1.0 - f0) * f5 - f82)


@kernel
def _ratio(a, b):
    return a / b if b != 0.0 else np.float32(0.0)


@kernel
def _refracted(cosine, outside, n, k):
    """Parts of the complex product of refractive index and cosine behind the surface, squares first: u^2, v^2."""
    t1 = n * n - k * k - outside * outside * (1.0 - cosine * cosine)
    t2 = math.sqrt(t1 * t1 + 4.0 * n * n * k * k)
    return max(0.5 * (t2 + t1), 0.0), max(0.5 * (t2 - t1), 0.0)


@kernel
def conductor_reflectances(cosine, outside, n, k):
    """Reflectance of light polarised across (s) and in (p) the plane of incidence; `outside` is the index there."""
    u2, v2 = _refracted(cosine, outside, n, k)
    u, v = math.sqrt(u2), math.sqrt(v2)
    along = outside * cosine
    r_s = _ratio((along - u) * (along - u) + v2, (along + u) * (along + u) + v2)
    t3, t4 = (n * n - k * k) * cosine, 2.0 * n * k * cosine
    less_u, less_v = t3 - outside * u, t4 - outside * v
    more_u, more_v = t3 + outside * u, t4 + outside * v
    return r_s, _ratio(less_u * less_u + less_v * less_v, more_u * more_u + more_v * more_v)


@kernel
def conductor_phases(cosine, outside, n, k):
    """Phase shifts of both polarisations as exp(i phi): real and imaginary part of s, then of p.

    Their signs are such that both agree at grazing angles.
    """
    u2, v2 = _refracted(cosine, outside, n, k)
    u, v = math.sqrt(u2), math.sqrt(v2)
    along = outside * cosine
    re_s, im_s = along * along - u2 - v2, -2.0 * along * v
    size_s = math.sqrt(re_s * re_s + im_s * im_s)
    dense = (n * n + k * k) * cosine
    re_p = dense * dense - outside * outside * (u2 + v2)
    im_p = 2.0 * along * (2.0 * n * k * u - (n * n - k * k) * v)
    size_p = math.sqrt(re_p * re_p + im_p * im_p)
    if size_s > 0.0:
        re_s, im_s = re_s / size_s, im_s / size_s
    else:
        re_s, im_s = np.float32(1.0), np.float32(0.0)
    if size_p > 0.0:
        re_p, im_p = re_p / size_p, im_p / size_p
    else:
        re_p, im_p = np.float32(1.0), np.float32(0.0)
    return re_s, im_s, re_p, im_p


@kernel
def fresnel_conductor(cosine, n, k):
    """Reflectance of unpolarised light from air."""
    r_s, r_p = conductor_reflectances(cosine, 1.0, n, k)
    return 0.5 * (r_s + r_p)


@kernel
def conductor_mean(n, k):
    """Mean reflectance over the hemisphere, of the F82 curve through its values at 0 and 82 degrees."""
    f0, f82 = fresnel_conductor(1.0, n, k), fresnel_conductor(F82_COSINE, n, k)
    return min(max(f82_mean(f0, f82_b_of_value(f0, f82)), 0.0), 1.0)


@kernel
def index_of_colors(f0, f82):
    """n and k of a metal that reflects `f0` straight on and `f82` at `F82_COSINE` (Gulbrandsen's r and g)."""
    r = min(max(f0, 0.0), 0.999)
    root = math.sqrt(r)
    n = (1.0 + root) / (1.0 - root) * (1.0 - f82) + (1.0 - r) / (1.0 + r) * f82
    k = math.sqrt(max((r * (n + 1.0) * (n + 1.0) - (n - 1.0) * (n - 1.0)) / (1.0 - r), 0.0))
    return n, k


@kernel
def limited(color):
    """n or k as they come: not negative, no more than `MOST_INDEX`, 0 where they are no number."""
    r = min(color[0], MOST_INDEX) if color[0] > 0.0 else np.float32(0.0)
    g = min(color[1], MOST_INDEX) if color[1] > 0.0 else np.float32(0.0)
    b = min(color[2], MOST_INDEX) if color[2] > 0.0 else np.float32(0.0)
    return r, g, b


@kernel
def index_at(param, lane, i, column, wavelength):
    """n or k, given for red, green and blue, at a wavelength [nm]: straight lines between 610, 550 and 465 nm."""
    red, green, blue = read3(param, lane, i, column)
    if wavelength >= 550.0:
        return green + (red - green) * min((wavelength - 550.0) / 60.0, 1.0)
    return green + (blue - green) * min((550.0 - wavelength) / 85.0, 1.0)
