# SPDX-License-Identifier: GPL-3.0-or-later
"""Which surface passes of one surface show: the first that is opaque enough."""

from engine.kernels.bsdf.portal import passed_share
from engine.runtime.jit import kernel


@kernel
def mean_transparency(closures, lane):
    """Mean over channels of what a shaded surface lets through, in [0, 1]; `closures` as shaders leave them."""
    total = 0.0
    for c in range(3):
        total += passed_share(closures, lane, c)
    return total * (1.0 / 3.0)


@kernel
def is_pass_surface(closures, lane, alpha_threshold):
    """Whether a surface's alpha reaches the view layer's threshold; with a threshold of 0 every surface's does."""
    return alpha_threshold == 0.0 or 1.0 - mean_transparency(closures, lane) >= alpha_threshold
