# SPDX-License-Identifier: GPL-3.0-or-later
"""Sheen: a layer of fibres, fitted by a linearly transformed cosine.

References: Zeltner, Burley and Chiang 2022, "Practical Multiple-Scattering Sheen Using Linearly Transformed Cosines".
"""

import math

from engine.jit import kernel
from engine.kernels.bsdf.closures import append_closure
from engine.kernels.bsdf.kinds import SHEEN, SHEEN_A, SHEEN_B, SHEEN_TANGENT
from engine.kernels.bsdf.lookup import read_plane
from engine.kernels.bsdf.warp import concentric_disk
from engine.kernels.constants import INV_PI
from engine.kernels.vector import cross, dot, normalize, orthonormal_basis, to_local, to_world


@kernel
def append_sheen(closures, tables, lane, sheen_weight, weight, wo, n, roughness):
    """Append a sheen lobe of weight `sheen_weight` and return what it leaves of `weight` to the layers below."""
    cos_o = dot(n, wo)
    roughness = max(roughness, 1e-3)
    a = read_plane(tables.sheen, 0, roughness, cos_o)
    b = read_plane(tables.sheen, 1, roughness, cos_o)
    albedo = read_plane(tables.sheen, 2, roughness, cos_o)
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
    param = closures.param
    param[lane, i, SHEEN_A] = a
    param[lane, i, SHEEN_B] = b
    for k in range(3):
        param[lane, i, SHEEN_TANGENT + k] = tangent[k]
    share = 0.0
    for c in range(3):
        if weight[c] > 0.0:
            share = max(share, sheen_weight[c] / weight[c])
    left = min(max(1.0 - share, 0.0), 1.0)
    return weight[0] * left, weight[1] * left, weight[2] * left


@kernel
def sheen_frame(closures, lane, i, n):
    """Tangent and bitangent of a sheen lobe; the tangent points away from the viewer's side as `wo` leans."""
    param = closures.param
    tangent = (param[lane, i, SHEEN_TANGENT], param[lane, i, SHEEN_TANGENT + 1], param[lane, i, SHEEN_TANGENT + 2])
    return tangent, cross(n, tangent)


@kernel
def sheen_pdf(closures, lane, i, n, wi):
    """Density of the transformed cosine, which is also f cos without the albedo [sr^-1]."""
    a = closures.param[lane, i, SHEEN_A]
    b = closures.param[lane, i, SHEEN_B]
    tangent, bitangent = sheen_frame(closures, lane, i, n)
    x, y, z = to_local(wi, tangent, bitangent, n)
    if z <= 0.0:
        return 0.0
    across = a * x + b * z
    along = a * y
    ratio = a / (across * across + along * along + z * z)
    return INV_PI * z * ratio * ratio


@kernel
def sample_sheen(closures, lane, i, n, u0, u1):
    """Direction with density `sheen_pdf`."""
    a = closures.param[lane, i, SHEEN_A]
    b = closures.param[lane, i, SHEEN_B]
    tangent, bitangent = sheen_frame(closures, lane, i, n)
    x, y = concentric_disk(u0, u1)
    z = math.sqrt(max(1.0 - x * x - y * y, 0.0))
    return to_world(normalize((x - z * b, y, z * a)), tangent, bitangent, n)
