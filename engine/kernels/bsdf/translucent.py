# SPDX-License-Identifier: GPL-3.0-or-later
"""Lambert's lobe behind the surface, and the Translucent BSDF."""

from engine.kernels.bsdf.closures import append_closure
from engine.kernels.bsdf.diffuse import add_cosine
from engine.kernels.bsdf.kinds import FIRST_TRANSLUCENT
from engine.kernels.bsdf.lobe import Lobe
from engine.kernels.bsdf.normals import safe_normal, valid_specular_normal
from engine.kernels.bsdf.warp import sample_cosine
from engine.kernels.memory import read3
from engine.kernels.vector import dot, negate, scale
from engine.runtime.jit import kernel

TRANSLUCENT = FIRST_TRANSLUCENT


@kernel
def add_translucent(closures, lane, weight, n):
    """Lambert's lobe behind the surface; `n` as `ensure_valid_specular_reflection` returns it."""
    append_closure(closures, lane, TRANSLUCENT, weight, n)


@kernel(forceinline=True)
def run_translucent(closures, tables, lane, view, weight, memory, code, pc):
    """Instruction `weight, normal, color`."""
    n = safe_normal(read3(memory, code[pc + 3]), view.ns)
    n = valid_specular_normal(closures, lane, view.ng, view.wo, n)
    add_translucent(closures, lane, scale(read3(memory, code[pc + 4]), weight), n)


@kernel
def eval_translucent(param, channels, lane, i, n, wo, wi, factor, out, row):
    """See `Lobe.evaluate`."""
    return add_cosine(param, channels, lane, i, -dot(n, wi), factor, out, row)


@kernel
def sample_translucent(param, lane, i, n, wo, u1, u2):
    """See `Lobe.sample`."""
    return sample_cosine(param, lane, i, negate(n), wo, u1, u2)


LOBE = Lobe(TRANSLUCENT, eval_translucent, sample_translucent)
