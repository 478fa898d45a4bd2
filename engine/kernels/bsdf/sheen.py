# SPDX-License-Identifier: GPL-3.0-or-later
"""Sheen: a layer of fibres, fitted by a linearly transformed cosine.

References: Zeltner, Burley and Chiang 2022, "Practical Multiple-Scattering Sheen Using Linearly Transformed Cosines".
"""

import math

from engine.kernels.bsdf.closures import append_closure, read3, weight_below
from engine.kernels.bsdf.lobe import Lobe
from engine.kernels.bsdf.lookup import SHEEN_FIT, read_table
from engine.kernels.bsdf.warp import concentric_disk
from engine.kernels.constants import INV_PI
from engine.kernels.vector import cross, dot, normalize, orthonormal_basis, to_local, to_world
from engine.runtime.jit import kernel
from engine.state.lanes import CLOSURE_KIND_PARAMS, CLOSURE_WEIGHT

SHEEN = 3

# Columns of Closures.param.
SHEEN_A = CLOSURE_KIND_PARAMS + 1
SHEEN_B = CLOSURE_KIND_PARAMS + 2
SHEEN_TANGENT = CLOSURE_KIND_PARAMS + 3  # 3 columns


@kernel
def append_sheen(closures, tables, lane, sheen_weight, weight, wo, n, roughness):
    """Append a sheen lobe of weight `sheen_weight` and return what it leaves of `weight` to the layers below."""
    cos_o = dot(n, wo)
    roughness = max(roughness, 1e-3)
    a = read_table(tables.data, SHEEN_FIT, 32, roughness, cos_o)
    b = read_table(tables.data, SHEEN_FIT + 32 * 32, 32, roughness, cos_o)
    albedo = read_table(tables.data, SHEEN_FIT + 2 * 32 * 32, 32, roughness, cos_o)
    if abs(a) < 1e-5 or albedo < 1e-5:
        return weight
    sheen_weight = (sheen_weight[0] * albedo, sheen_weight[1] * albedo, sheen_weight[2] * albedo)
    i = append_closure(closures, lane, SHEEN, sheen_weight, n)
    if i < 0:
        return weight
    bitangent = cross(n, wo)
    tangent, _ = orthonormal_basis(n)
    if dot(bitangent, bitangent) > 1e-12:
        tangent = cross(normalize(bitangent), n)
    closures.param[lane, i, SHEEN_A] = a
    closures.param[lane, i, SHEEN_B] = b
    for k in range(3):
        closures.param[lane, i, SHEEN_TANGENT + k] = tangent[k]
    return weight_below(sheen_weight, weight)


@kernel
def sheen_pdf(param, lane, i, n, wi):
    """Density of the transformed cosine, which is also f cos without the albedo [sr^-1]."""
    a = param[lane, i, SHEEN_A]
    b = param[lane, i, SHEEN_B]
    tangent = read3(param, lane, i, SHEEN_TANGENT)
    x, y, z = to_local(wi, tangent, cross(n, tangent), n)
    if z <= 0.0:
        return 0.0
    across = a * x + b * z
    along = a * y
    ratio = a / (across * across + along * along + z * z)
    return INV_PI * z * ratio * ratio


@kernel
def eval_sheen(param, channels, lane, i, n, wo, wi, factor, out, row):
    """See `Lobe.evaluate`."""
    if dot(n, wi) <= 0.0:
        return 0.0
    pdf = sheen_pdf(param, lane, i, n, wi)
    for c in range(len(channels)):
        out[row, c] += param[lane, i, CLOSURE_WEIGHT + c] * pdf * factor
    return pdf


@kernel
def sample_sheen(param, lane, i, n, wo, u1, u2):
    """Direction with density `sheen_pdf`, see `Lobe.sample`."""
    a = param[lane, i, SHEEN_A]
    b = param[lane, i, SHEEN_B]
    tangent = read3(param, lane, i, SHEEN_TANGENT)
    x, y = concentric_disk(u1, u2)
    z = math.sqrt(max(1.0 - x * x - y * y, 0.0))
    return to_world(normalize((x - z * b, y, z * a)), tangent, cross(n, tangent), n)


LOBE = Lobe(SHEEN, eval_sheen, sample_sheen)
