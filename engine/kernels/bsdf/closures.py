# SPDX-License-Identifier: GPL-3.0-or-later
"""The list of closures of a lane: start it, append to it, ask what is in it, blur it."""

import numpy as np

from engine.kernels.bsdf.kinds import (
    ALPHA_X,
    ALPHA_Y,
    BUMP,
    CHIANG,
    CHIANG_WIDTHS,
    CLOSURE_IS_ON_STRAND,
    CLOSURE_NO_BUMP_CORRECTION,
    DELTA_ALPHA_SQUARED,
    FIRST_MICROFACET,
    FIRST_TRANSLUCENT,
    HAS_DELTA,
    HAS_EVAL,
    HAS_TRANSMISSION,
    HAS_TRANSPARENT,
    HUANG,
    HUANG_ALPHA,
    LAST_MICROFACET,
    REFRACTION,
    SMOOTH_N,
    SUBSURFACE,
    THIN_GLASS,
    TRANSPARENT,
    WEIGHT_CUTOFF,
)
from engine.kernels.constants import FLOAT_MAX
from engine.runtime.jit import kernel
from engine.state.lanes import CLOSURE_CHANNELS, CLOSURE_N, CLOSURE_SAMPLE_WEIGHT, CLOSURE_WEIGHT, MAX_CLOSURES

#: Cosine between normals that are one but for rounding.
_SAME_NORMAL = np.float32(1.0 - 1e-5)


@kernel
def reset_closures(closures, lane, ns, flags):
    """Empty a lane before its shader runs.

    Parameters
    ----------
    ns : tuple of 3 float32
        Smooth shading normal on the viewer's side.
    flags : int
        CLOSURE_NO_* bits: no bump correction; caustics of a kind switched off and the path had a diffuse bounce.
    """
    closures.count[lane] = 0
    closures.holdout[lane] = 0.0
    for c in range(CLOSURE_CHANNELS):
        closures.emission[lane, c] = 0.0
        closures.transparency[lane, c] = 0.0
    for k in range(3):
        closures.ns[lane, k] = ns[k]
    closures.flags[lane] = flags


@kernel
def average(color):
    """Mean of a 3-tuple."""
    return (color[0] + color[1] + color[2]) * (1.0 / 3.0)


@kernel
def read3(param, lane, i, column):
    """Three columns of a closure, a vector or an RGB colour."""
    return param[lane, i, column], param[lane, i, column + 1], param[lane, i, column + 2]


@kernel
def store_color(param, lane, i, column, color):
    """Write an RGB 3-tuple into the four columns of a colour parameter."""
    param[lane, i, column] = color[0]
    param[lane, i, column + 1] = color[1]
    param[lane, i, column + 2] = color[2]
    param[lane, i, column + 3] = 0.0


@kernel
def keeps_to_geometry(closures, lane, ng):
    """Whether all lobes are about the geometric normal, so that sampling them leaves out no direction that they have.

    Directions below the surface but above a smooth or bumped normal are lit by light sampling alone.
    """
    for i in range(closures.count[lane]):
        if closures.kind[lane, i] >= TRANSPARENT:
            continue
        n = read3(closures.param, lane, i, CLOSURE_N)
        if not abs(n[0] * ng[0] + n[1] * ng[1] + n[2] * ng[2]) > _SAME_NORMAL:
            return False
    return True


@kernel
def append_closure(closures, lane, kind, weight, n):
    """Append a lobe and return its index; -1 if it weighs nothing (or is not finite) or the lane is full.

    The sample weight starts as the mean weight; negative weights count as 0.
    """
    weight = (max(weight[0], 0.0), max(weight[1], 0.0), max(weight[2], 0.0))
    sample_weight = average(weight)
    i = closures.count[lane]
    if not (sample_weight >= WEIGHT_CUTOFF and sample_weight < FLOAT_MAX) or i >= MAX_CLOSURES:
        return -1
    closures.count[lane] = i + 1
    closures.kind[lane, i] = kind
    param = closures.param
    store_color(param, lane, i, CLOSURE_WEIGHT, weight)
    param[lane, i, CLOSURE_SAMPLE_WEIGHT] = sample_weight
    is_bumped = False
    for k in range(3):
        is_bumped = is_bumped or n[k] != closures.ns[lane, k]
        param[lane, i, CLOSURE_N + k] = n[k]
    bump = 0.0
    if is_bumped and closures.flags[lane] & CLOSURE_IS_ON_STRAND == 0:
        bump = 2.0 if closures.flags[lane] & CLOSURE_NO_BUMP_CORRECTION != 0 else 1.0
        for k in range(3):
            param[lane, i, SMOOTH_N + k] = closures.ns[lane, k]
    param[lane, i, BUMP] = bump
    return i


@kernel
def weight_below(layer, weight):
    """What a layer of albedo `layer` (its weight included) leaves of `weight`: by the channel it reflects most."""
    share = 0.0
    for c in range(3):
        if weight[c] > 0.0:
            share = max(share, layer[c] / weight[c])
    left = max(1.0 - share, 0.0)
    return weight[0] * left, weight[1] * left, weight[2] * left


@kernel(forceinline=True)
def summarize(closures, lane):
    """Bits HAS_EVAL, HAS_TRANSMISSION (of non-delta lobes), HAS_DELTA, HAS_TRANSPARENT of a lane."""
    bits = 0
    for i in range(closures.count[lane]):
        kind = closures.kind[lane, i]
        if kind == TRANSPARENT:
            bits |= HAS_TRANSPARENT
        elif kind == SUBSURFACE:
            # Its light comes out elsewhere.
            continue
        elif kind >= FIRST_MICROFACET:
            if closures.param[lane, i, ALPHA_X] * closures.param[lane, i, ALPHA_Y] > DELTA_ALPHA_SQUARED:
                bits |= HAS_EVAL
                if kind >= REFRACTION:
                    bits |= HAS_TRANSMISSION
            else:
                bits |= HAS_DELTA
        else:
            bits |= HAS_EVAL
            if kind >= FIRST_TRANSLUCENT:
                bits |= HAS_TRANSMISSION
    return bits


@kernel
def blur_glossy(closures, lane, roughness, blurs_delta):
    """Raise the alphas of a lane's microfacet lobes, and widths of fibres, to at least `roughness` (filter glossy).

    Parameters
    ----------
    blurs_delta : int, not 0: delta lobes too
    """
    for i in range(closures.count[lane]):
        kind = closures.kind[lane, i]
        if kind == CHIANG:
            for column in range(CHIANG_WIDTHS, CHIANG_WIDTHS + 3):
                closures.param[lane, i, column] = max(closures.param[lane, i, column], roughness)
        elif kind == HUANG:
            closures.param[lane, i, HUANG_ALPHA] = max(closures.param[lane, i, HUANG_ALPHA], roughness)
        elif FIRST_MICROFACET <= kind <= LAST_MICROFACET or kind == THIN_GLASS:
            alphas = closures.param[lane, i, ALPHA_X] * closures.param[lane, i, ALPHA_Y]
            if blurs_delta == 0 and not alphas > DELTA_ALPHA_SQUARED:
                continue
            closures.param[lane, i, ALPHA_X] = max(closures.param[lane, i, ALPHA_X], roughness)
            closures.param[lane, i, ALPHA_Y] = max(closures.param[lane, i, ALPHA_Y], roughness)
