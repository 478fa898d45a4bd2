# SPDX-License-Identifier: GPL-3.0-or-later
"""Arithmetic of von Mises-Fisher lobes, written so that LLVM turns loops over lobes into vector code.

A lobe is v(w) = C(kappa) exp(-kappa |w - mu|^2 / 2): for unit vectors |w - mu|^2 / 2 is 1 - cos, but it keeps its
precision where cos is close to 1 (at kappa 1e4 the cosine itself is off by a percent of the lobe's width) and can never
be negative, so sampling and density need no clamp that could differ between them.
"""

import numpy as np

from engine.kernels.exponential import exp_nonpositive
from engine.runtime.jit import kernel

#: Below this a lobe is uniform, in sampling and density alike.
UNIFORM_KAPPA = np.float32(1e-3)


@kernel
def spread(kappa):
    """(1 - exp(-2 kappa)) / (2 kappa): C(kappa) = 1 / (4 pi spread), 1 for a uniform lobe."""
    divided = (1.0 - exp_nonpositive(-2.0 * kappa)) / (2.0 * max(kappa, 1e-4))
    series = 1.0 - kappa * (1.0 - 0.6666667 * kappa)
    return divided if kappa > 0.01 else series
