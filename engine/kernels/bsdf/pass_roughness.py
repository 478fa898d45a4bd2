# SPDX-License-Identifier: GPL-3.0-or-later
"""Roughness of a surface as a pass shows it: what its nodes say."""

import math

import numpy as np

from engine.kernels.bsdf.kinds import (
    ALPHA_X,
    ALPHA_Y,
    FIRST_HAIR,
    FIRST_MICROFACET,
    LAST_DIFFUSE,
    LAST_MICROFACET,
    THIN_GLASS,
)
from engine.kernels.bsdf.oren_nayar import OREN_A, OREN_B, OREN_NAYAR
from engine.runtime.jit import kernel
from engine.state.lanes import CLOSURE_WEIGHT

#: Of lobes that do not count.
_NONE = np.float32(-1.0)


@kernel
def _lobe_roughness(closures, lane, i):
    """Roughness of a lobe as its node has it; 1 of lobes that have none, and below 0 of those that do not count."""
    kind, param = closures.kind[lane, i], closures.param
    if kind == OREN_NAYAR:
        return param[lane, i, OREN_B] / param[lane, i, OREN_A]
    if FIRST_MICROFACET <= kind <= LAST_MICROFACET or kind == THIN_GLASS:
        return np.float32(math.sqrt(math.sqrt(max(param[lane, i, ALPHA_X] * param[lane, i, ALPHA_Y], 0.0))))
    return np.float32(1.0) if FIRST_HAIR <= kind <= LAST_DIFFUSE else _NONE


@kernel
def pass_roughness(closures, lane):
    """Roughness of a shaded surface: float32, the mean of its lobes by their weight, and 1 where none has any.

    As in Cycles lobes that know no roughness do not count, so that of a Principled BSDF it is what its node says: plain
    diffuse ones, those of cloth, of light that goes in below the surface, and of what lets light through unbent.
    """
    total = rough = np.float32(0.0)
    for i in range(closures.count[lane]):
        roughness = _lobe_roughness(closures, lane, i)
        if roughness >= 0.0:
            param = closures.param
            weight = abs(
                param[lane, i, CLOSURE_WEIGHT] + param[lane, i, CLOSURE_WEIGHT + 1] + param[lane, i, CLOSURE_WEIGHT + 2]
            )
            total += weight
            rough += weight * roughness
    return rough / total if total > 0.0 else np.float32(1.0)
