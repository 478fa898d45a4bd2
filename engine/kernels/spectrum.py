# SPDX-License-Identifier: GPL-3.0-or-later
"""Colours at a path's wavelengths, and what a path has gathered as a colour again.

Everything that shaders and lights say is RGB. It becomes values at the wavelengths where it meets a path
(`engine.spectral.upsampling`), and RGB once more on the film (`engine.spectral.wavelengths`).
"""

import numpy as np

from engine.kernels.constants import FLOAT_MAX
from engine.kernels.shader.color_math import luminance
from engine.runtime.jit import kernel
from engine.spectral.blackbody import blackbody_over_d65
from engine.spectral.upsampling import evaluate_spectrum, spectrum_coefficients
from engine.spectral.wavelengths import rgb_weight, rotate_hero, wavelength_at
from engine.state.lanes import RGB


@kernel
def start_wavelengths(spectrum, paths, lane, u):
    """Draw a path's wavelengths by one number: the hero, then the others at equal steps round the density's [0, 1).

    References: Wilkie et al. 2014, "Hero Wavelength Spectral Sampling".
    """
    paths.hero[lane] = u
    for c in range(len(paths.channels)):
        paths.wavelength[lane, c] = wavelength_at(spectrum, rotate_hero(u, c))
        paths.share[lane, c] = 1.0 / np.float32(len(paths.channels))


@kernel
def to_rec709(spectrum, r, g, b):
    """A colour of the scene's working space in Rec.709."""
    matrix = spectrum.to_rec709
    # Greys are left alone, so that they stay greys to the last bit.
    if matrix.shape[0] > 0 and not (r == g and g == b):
        return (
            matrix[0, 0] * r + matrix[0, 1] * g + matrix[0, 2] * b,
            matrix[1, 0] * r + matrix[1, 1] * g + matrix[1, 2] * b,
            matrix[2, 0] * r + matrix[2, 1] * g + matrix[2, 2] * b,
        )
    return r, g, b


@kernel
def color_coefficients(spectrum, r, g, b):
    """`spectrum_coefficients` of a colour in the scene's working space."""
    r, g, b = to_rec709(spectrum, r, g, b)
    return spectrum_coefficients(spectrum, r, g, b)


@kernel
def upsample_light(spectrum, paths, lane, r, g, b, temperature, out, row):
    """Write emission, a colour, at the path's wavelengths.

    Twice as much light has the same spectrum twice: that of the colour with the largest channel 1/2.

    Parameters
    ----------
    spectrum : SpectralTables
    temperature : float32 [K]
        Not 0: the spectrum is a black body's, of the colour's luminance.
    out : float32 (R, >= C)
        Row `row` is written.
    """
    largest = max(r, max(g, b))
    if not abs(r) + abs(g) + abs(b) < FLOAT_MAX:
        # What is not a number stays so, and is counted where the path ends.
        for c in range(len(paths.channels)):
            out[row, c] = r + g + b
        return
    if not largest > 0.0:
        for c in range(len(paths.channels)):
            out[row, c] = 0.0
        return
    if temperature > 0.0:
        light = luminance(to_rec709(spectrum, r, g, b))
        for c in range(len(paths.channels)):
            out[row, c] = light * blackbody_over_d65(spectrum, temperature, paths.wavelength[lane, c])
        return
    twice = 2.0 * largest
    scale, c0, c1, c2 = color_coefficients(spectrum, r / twice, g / twice, b / twice)
    for c in range(len(paths.channels)):
        out[row, c] = evaluate_spectrum(scale * twice, c0, c1, c2, paths.wavelength[lane, c])


@kernel
def upsample_parameter(spectrum, paths, lane, param, i, column):
    """A closure's colour at the path's wavelengths, in place."""
    scale, c0, c1, c2 = color_coefficients(
        spectrum, param[lane, i, column], param[lane, i, column + 1], param[lane, i, column + 2]
    )
    for c in range(len(paths.channels)):
        param[lane, i, column + c] = evaluate_spectrum(scale, c0, c1, c2, paths.wavelength[lane, c])


@kernel
def filter_by(spectrum, paths, lane, radiance, row, r, g, b):
    """Multiply row `row` of `radiance` by a colour; return the largest channel left."""
    largest = 0.0
    if len(paths.channels) == RGB:
        radiance[row, 0] *= r
        radiance[row, 1] *= g
        radiance[row, 2] *= b
        for c in range(RGB):
            largest = max(largest, abs(radiance[row, c]))
    else:
        scale, c0, c1, c2 = color_coefficients(spectrum, r, g, b)
        for c in range(len(paths.channels)):
            radiance[row, c] *= evaluate_spectrum(scale, c0, c1, c2, paths.wavelength[lane, c])
            largest = max(largest, abs(radiance[row, c]))
    return largest


@kernel
def to_rgb(spectrum, paths, lane, values, row):
    """What row `row` of `values`, gathered by a path, adds to its pixel: a colour.

    Expected over the wavelengths it is the colour; of one path components may be negative.
    """
    if len(paths.channels) == RGB:
        return values[row, 0], values[row, 1], values[row, 2]
    red = 0.0
    green = 0.0
    blue = 0.0
    for c in range(len(paths.channels)):
        r, g, b = rgb_weight(spectrum, rotate_hero(paths.hero[lane], c))
        red += r * values[row, c]
        green += g * values[row, c]
        blue += b * values[row, c]
    share = 1.0 / np.float32(len(paths.channels))
    return red * share, green * share, blue * share
