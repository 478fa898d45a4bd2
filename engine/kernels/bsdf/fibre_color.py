# SPDX-License-Identifier: GPL-3.0-or-later
"""What a fibre absorbs, by the colours of the Principled Hair BSDF.

References
----------
Chiang, Bitterli, Tappan and Burley 2016, "A Practical and Controllable Hair and Fur Model for Production Path Tracing",
equation 9; d'Eon et al. 2011, "An Energy-Conserving Hair Reflectance Model", for melanin.
"""

import math

from engine.kernels.memory import read3
from engine.kernels.vector import add
from engine.runtime.jit import kernel

# How colours are given.
FIBRE_ABSORPTION = 0
FIBRE_MELANIN = 1
FIBRE_COLOR = 2


@kernel
def color_fit(x):
    """Logarithm of the colour of many fibres over the root of what one absorbs, but for the sign; by roughness."""
    return ((((0.245 * x + 5.574) * x - 10.73) * x + 2.532) * x - 0.215) * x + 5.969


@kernel
def _absorption_of(color, roughness):
    """Absorption of fibres that look of a colour where there are many; by the roughness around them."""
    fit = color_fit(roughness)
    r = math.log(max(color[0], 1e-30)) / fit
    g = math.log(max(color[1], 1e-30)) / fit
    b = math.log(max(color[2], 1e-30)) / fit
    return r * r, g * g, b * b


@kernel
def _absorption_of_melanin(melanin, redness):
    """Absorption of a fibre by what it has of eumelanin and pheomelanin."""
    amount = -math.log(max(1.0 - melanin, 0.0001))
    eu, pheo = amount * (1.0 - redness), amount * redness
    return 0.506 * eu + 0.343 * pheo, 0.841 * eu + 0.733 * pheo, 1.653 * eu + 1.924 * pheo


@kernel
def absorption(mode, memory, code, pc, random, around):
    """Absorption per radius [1], of an instruction whose operands begin with `color or absorption, tint, melanin,
    redness, its randomness`.

    Parameters
    ----------
    mode : int
        FIBRE_*.
    random : float32 in [-1, 1]
        Of the strand.
    around : float32
        Roughness around the fibre.
    """
    color = read3(memory, code[pc + 3])
    if mode == FIBRE_MELANIN:
        amount = memory[code[pc + 5]] * (1.0 + random * min(max(memory[code[pc + 7]], 0.0), 1.0))
        of_tint = _absorption_of(read3(memory, code[pc + 4]), around)
        return add(_absorption_of_melanin(amount, memory[code[pc + 6]]), of_tint)
    if mode == FIBRE_COLOR:
        return _absorption_of(color, around)
    return color


@kernel
def passed_along_radius(sigma):
    """What a fibre lets through along its radius: a colour."""
    return math.exp(-max(sigma[0], 0.0)), math.exp(-max(sigma[1], 0.0)), math.exp(-max(sigma[2], 0.0))
