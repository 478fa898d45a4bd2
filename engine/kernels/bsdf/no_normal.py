# SPDX-License-Identifier: GPL-3.0-or-later
"""Lobes whose normal is no number, as where a node has divided by zero: none is kept, which is what Cycles shows.

Measured there, of a mix of such a BSDF and diffuse 0.8 under a white sky: rough Glossy, Glass, Metallic and Principled
leave nothing, since they make the sum of all lobes no number; Diffuse, Translucent, Toon, Subsurface Scattering and
Refraction, and all that is smooth, leave 0.4, what the other one has. So no kernel behind the interpreter meets such a
normal. Not followed: smooth ones also reflect 0 to 0.4 from nowhere there, and Sheen takes a third of the other.
"""

from engine.kernels.bsdf.kinds import (
    ALPHA_X,
    ALPHA_Y,
    CLOSURE_IS_LOST,
    DELTA_ALPHA_SQUARED,
    FIRST_MICROFACET,
    LAST_MICROFACET,
    LINKED_GLOSSY,
    LINKED_REFRACTION,
    REFRACTION,
    TRANSPARENT,
)
from engine.kernels.bsdf.linked import FACETS, MODEL_MASK, address_of
from engine.runtime.jit import kernel


@kernel
def _takes_others(param, lane, i, kind):
    """Whether a lobe has rough facets that reflect."""
    if kind < FIRST_MICROFACET or kind > LAST_MICROFACET or kind == REFRACTION or kind == LINKED_REFRACTION:
        return False
    if kind == LINKED_GLOSSY and address_of(param, lane, i) & MODEL_MASK < FACETS:
        return False
    return param[lane, i, ALPHA_X] * param[lane, i, ALPHA_Y] > DELTA_ALPHA_SQUARED


@kernel
def drop_lobes(closures, lane, first):
    """Take out the lobes from `first` on, but for what alpha lets through; note whether they take all others along."""
    if first < closures.count[lane] and closures.kind[lane, first] == TRANSPARENT:
        first += 1
    for i in range(first, closures.count[lane]):
        if _takes_others(closures.param, lane, i, closures.kind[lane, i]):
            closures.flags[lane] |= CLOSURE_IS_LOST
    closures.count[lane] = first
