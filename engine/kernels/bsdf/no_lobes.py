# SPDX-License-Identifier: GPL-3.0-or-later
"""Closures that are no lobes: transparency, holdout, emission."""

from engine.kernels.bsdf.closures import append_closure, average
from engine.kernels.bsdf.kinds import TRANSPARENT, WEIGHT_CUTOFF
from engine.runtime.jit import kernel
from engine.state.lanes import CLOSURE_SAMPLE_WEIGHT, CLOSURE_WEIGHT


@kernel
def add_transparent(closures, lane, weight):
    """Let light straight through; all transparent closures of a lane share one lobe."""
    sample_weight = abs(average(weight))
    if not (sample_weight >= WEIGHT_CUTOFF):
        return
    for c in range(3):
        closures.transparency[lane, c] += weight[c]
    for i in range(closures.count[lane]):
        if closures.kind[lane, i] == TRANSPARENT:
            for c in range(3):
                closures.param[lane, i, CLOSURE_WEIGHT + c] += weight[c]
            closures.param[lane, i, CLOSURE_SAMPLE_WEIGHT] += sample_weight
            return
    ns = closures.ns
    append_closure(closures, lane, TRANSPARENT, weight, (ns[lane, 0], ns[lane, 1], ns[lane, 2]))


@kernel
def add_holdout(closures, lane, weight):
    """Punch a hole into alpha: adds the mean weight to `Closures.holdout`."""
    closures.holdout[lane] += average(weight)


@kernel
def add_emission(closures, lane, weight):
    """Emit `weight` as radiance."""
    for c in range(3):
        closures.emission[lane, c] += weight[c]
