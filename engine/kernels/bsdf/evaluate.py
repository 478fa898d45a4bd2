# SPDX-License-Identifier: GPL-3.0-or-later
"""Value, density and samples of all lobes of a lane together.

Lobes are chosen by sample weight; the density of a direction is the mixture's (Veach 1997, section 9.2.4: one-sample
model with balance heuristic).
"""

from engine.jit import kernel
from engine.kernels.bsdf.diffuse import oren_nayar_f_cos
from engine.kernels.bsdf.kinds import (
    DIFFUSE,
    IS_BUMPED,
    LAST_DIFFUSE,
    OREN_MULTIPLE,
    OREN_NAYAR,
    TRANSLUCENT,
    TRANSPARENT,
)
from engine.kernels.bsdf.normals import bump_shadowing
from engine.kernels.bsdf.warp import sample_cosine_hemisphere
from engine.kernels.constants import INV_PI
from engine.kernels.vector import dot, negate
from engine.state import (
    CLOSURE_N,
    CLOSURE_SAMPLE_WEIGHT,
    CLOSURE_WEIGHT,
    RAY_DIFFUSE,
    RAY_REFLECT,
    RAY_TRANSMIT,
    RAY_TRANSPARENT,
)


@kernel
def closure_normal(closures, lane, i):
    """Unit normal of a closure."""
    param = closures.param
    return param[lane, i, CLOSURE_N], param[lane, i, CLOSURE_N + 1], param[lane, i, CLOSURE_N + 2]


@kernel
def eval_diffuse_kind(closures, lane, i, kind, n, wo, wi, factor, out, row):
    """Add `factor` times f cos of a diffuse lobe to out[row] and return its pdf [sr^-1]."""
    param = closures.param
    cos_i = dot(n, wi)
    if kind == TRANSLUCENT:
        cos_i = -cos_i
    if cos_i <= 0.0:
        return 0.0
    pdf = cos_i * INV_PI
    if factor != 0.0:
        if kind == OREN_NAYAR:
            single, multiple = oren_nayar_f_cos(closures, lane, i, n, wo, wi, cos_i)
            for c in range(len(closures.channels)):
                f_cos = single + multiple * param[lane, i, OREN_MULTIPLE + c]
                out[row, c] += param[lane, i, CLOSURE_WEIGHT + c] * f_cos * factor
        else:
            for c in range(len(closures.channels)):
                out[row, c] += param[lane, i, CLOSURE_WEIGHT + c] * pdf * factor
    return pdf


@kernel
def eval_lobes(closures, tables, lane, wo, wi, visibility, sampled, out, row):
    """Write f cos of all non-delta lobes into out[row] and return the mixture's pdf.

    `sampled` is the index of the lobe that proposed `wi`, -1 if none did.
    """
    param = closures.param
    for c in range(len(closures.channels)):
        out[row, c] = 0.0
    weighted_pdf = 0.0
    weight_sum = 0.0
    for i in range(closures.count[lane]):
        kind = closures.kind[lane, i]
        sample_weight = param[lane, i, CLOSURE_SAMPLE_WEIGHT]
        weight_sum += sample_weight
        n = closure_normal(closures, lane, i)
        is_diffuse = kind <= LAST_DIFFUSE
        factor = 1.0
        if param[lane, i, IS_BUMPED] != 0.0:
            factor = bump_shadowing(closures, lane, n, wi, is_diffuse, i == sampled)
        if is_diffuse:
            if not visibility & RAY_DIFFUSE:
                factor = 0.0
            pdf = eval_diffuse_kind(closures, lane, i, kind, n, wo, wi, factor, out, row)
            weighted_pdf += sample_weight * pdf
    return weighted_pdf / weight_sum if weight_sum > 0.0 else 0.0


@kernel
def eval_bsdf(closures, tables, lane, wo, wi, ng, visibility, out, row):
    """Value and density of direction `wi`.

    Parameters
    ----------
    wo, wi, ng : tuple of 3 float32
        Unit, world space; geometric normal on the side of `wo` (not looked at, as in Cycles: smooth terminators).
    visibility : int
        RAY_DIFFUSE, RAY_GLOSSY, RAY_TRANSMIT bits: lobes of another kind count into the pdf only.
    out : float32 (R, C)
        Row `row` receives f |cos| summed over non-delta lobes [sr^-1].

    Returns
    -------
    pdf : float32 [sr^-1]
        Of `sample_bsdf` choosing `wi`, delta lobes keeping their share.
    """
    return eval_lobes(closures, tables, lane, wo, wi, visibility, -1, out, row)


@kernel
def sample_bsdf(closures, tables, lane, wo, ng, u0, u1, u2, out, row):
    """Sample a direction.

    Parameters
    ----------
    u0, u1, u2 : float32 in [0, 1)
        `u0` picks the lobe, then reflection or refraction.

    Returns
    -------
    pdf : float32 [sr^-1], of the mixture; of a delta lobe its probability; 0 = no sample
    wi : tuple of 3 float32
    label : int, RAY_* bits
    roughness : float32, alpha of the lobe (geometric mean), 1 for diffuse lobes, 0 for transparent ones
    eta : float32, refractive index crossed (1 if none)

    out[row] receives f |cos| of the mixture, of a delta lobe what makes out / pdf the throughput.
    """
    param = closures.param
    invalid = (0.0, (0.0, 0.0, 0.0), 0, 0.0, 1.0)
    count = closures.count[lane]
    weight_sum = 0.0
    for i in range(count):
        weight_sum += param[lane, i, CLOSURE_SAMPLE_WEIGHT]
    if not weight_sum > 0.0:
        return invalid
    chosen = 0
    remaining = u0 * weight_sum
    while chosen < count - 1 and remaining >= param[lane, chosen, CLOSURE_SAMPLE_WEIGHT]:
        remaining -= param[lane, chosen, CLOSURE_SAMPLE_WEIGHT]
        chosen += 1
    sample_weight = param[lane, chosen, CLOSURE_SAMPLE_WEIGHT]
    if not sample_weight > 0.0:
        return invalid
    u0 = min(remaining / sample_weight, 0.99999994)
    kind = closures.kind[lane, chosen]
    n = closure_normal(closures, lane, chosen)
    if kind == TRANSPARENT:
        for c in range(len(closures.channels)):
            out[row, c] = param[lane, chosen, CLOSURE_WEIGHT + c]
        return sample_weight / weight_sum, negate(wo), RAY_TRANSPARENT | RAY_TRANSMIT, 0.0, 1.0
    label = RAY_DIFFUSE | RAY_REFLECT
    roughness = 1.0
    eta = 1.0
    if kind == TRANSLUCENT:
        label = RAY_DIFFUSE | RAY_TRANSMIT
        n = negate(n)
    wi, cos_i = sample_cosine_hemisphere(n, u1, u2)
    if (dot(ng, wi) > 0.0) != (label & RAY_REFLECT != 0) or cos_i <= 0.0:
        return invalid
    if count == 1 and kind == DIFFUSE and param[lane, 0, IS_BUMPED] == 0.0:
        pdf = cos_i * INV_PI
        for c in range(len(closures.channels)):
            out[row, c] = param[lane, 0, CLOSURE_WEIGHT + c] * pdf
        return pdf, wi, label, roughness, eta
    every_kind = -1
    pdf = eval_lobes(closures, tables, lane, wo, wi, every_kind, chosen, out, row)
    return pdf, wi, label, roughness, eta


@kernel
def albedo(closures, tables, lane, wo, out, row):
    """Write the estimated directional albedo of all lobes into out[row] (Albedo pass)."""
    for c in range(len(closures.channels)):
        out[row, c] = 0.0
    for i in range(closures.count[lane]):
        for c in range(len(closures.channels)):
            out[row, c] += closures.param[lane, i, CLOSURE_WEIGHT + c]
