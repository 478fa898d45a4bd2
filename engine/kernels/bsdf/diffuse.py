# SPDX-License-Identifier: GPL-3.0-or-later
"""Lambert's lobe, and the Diffuse BSDF."""

import numpy as np

from engine.kernels.bsdf.closures import append_closure
from engine.kernels.bsdf.kinds import DIFFUSE
from engine.kernels.bsdf.lobe import Lobe
from engine.kernels.bsdf.normals import safe_normal
from engine.kernels.bsdf.oren_nayar import add_oren_nayar
from engine.kernels.bsdf.warp import sample_cosine
from engine.kernels.constants import INV_PI
from engine.kernels.memory import read3
from engine.kernels.vector import dot, scale
from engine.runtime.jit import kernel
from engine.state.lanes import CLOSURE_WEIGHT

#: Roughness below which the Diffuse BSDF is Lambert's (Cycles).
MIN_DIFFUSE_ROUGHNESS = np.float32(1e-5)


@kernel
def add_diffuse(closures, lane, weight, n, roughness, color=None, tints_by_bounce=True):
    """Lobe of the Diffuse BSDF: Lambert at roughness 0, else `add_oren_nayar`.

    `weight` includes the colour. `color` is the colour alone, used between facets if rough; None = `weight`.
    `tints_by_bounce`: see `add_oren_nayar`.
    """
    if not roughness >= MIN_DIFFUSE_ROUGHNESS:  # NaN too
        append_closure(closures, lane, DIFFUSE, weight, n)
    elif color is None:
        add_oren_nayar(closures, lane, weight, weight, n, roughness, tints_by_bounce)
    else:
        add_oren_nayar(closures, lane, weight, color, n, roughness, tints_by_bounce)


@kernel(forceinline=True)
def run_diffuse(closures, tables, lane, view, weight, memory, code, pc):
    """Instruction `weight, normal, color, roughness | whether facets tint by bounce`."""
    n = safe_normal(read3(memory, code[pc + 3]), view.ns)
    color = read3(memory, code[pc + 4])
    add_diffuse(closures, lane, scale(color, weight), n, memory[code[pc + 5]], color, code[pc + 6])


@kernel
def add_cosine(param, channels, lane, i, cos_i, factor, out, row):
    """`Lobe.evaluate` of a Lambertian lobe whose axis has the cosine `cos_i` with the direction."""
    if cos_i <= 0.0:
        return 0.0
    pdf = cos_i * INV_PI
    for c in range(len(channels)):
        out[row, c] += param[lane, i, CLOSURE_WEIGHT + c] * pdf * factor
    return pdf


@kernel
def eval_lambert(param, channels, lane, i, n, wo, wi, factor, out, row):
    """See `Lobe.evaluate`."""
    return add_cosine(param, channels, lane, i, dot(n, wi), factor, out, row)


LOBE = Lobe(DIFFUSE, eval_lambert, sample_cosine)
