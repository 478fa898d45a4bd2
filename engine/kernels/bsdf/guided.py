# SPDX-License-Identifier: GPL-3.0-or-later
"""The BSDF as resampling needs it: delta lobes apart, and directions that no lobe proposed.

A direction proposed by a guide is credited to the lobe that would most likely have proposed it: one is drawn with the
lobes' shares of the density. So the ray's kind, the depth limits it counts against and the check against the geometric
normal are distributed as they are under BSDF sampling, given the direction, and the expected image is the same.
"""

import math

import numpy as np

from engine.kernels.bsdf.closures import read3
from engine.kernels.bsdf.evaluate import BY_GUIDE, EVERY_KIND, eval_channels, hair_label, is_delta_lobe
from engine.kernels.bsdf.kinds import (
    ALPHA_X,
    ALPHA_Y,
    BUMP,
    ETA,
    FIRST_HAIR,
    FIRST_TRANSLUCENT,
    LAST_DIFFUSE,
    REFRACTION,
)
from engine.kernels.bsdf.linked import is_linked, linked_label
from engine.kernels.bsdf.lobes import hair_roughness
from engine.kernels.bsdf.microfacet import MIN_ETA_STEP
from engine.kernels.vector import dot
from engine.runtime.jit import kernel
from engine.state.lanes import CLOSURE_N, CLOSURE_SAMPLE_WEIGHT, RAY_DIFFUSE, RAY_GLOSSY, RAY_REFLECT, RAY_TRANSMIT

#: Share of a surface's samples that diffuse lobes have at least where the cosine stands for its BSDF: a coat of gloss,
#: as most materials have it, takes less (docs/decisions/mixture-field.md).
_LEAST_DIFFUSE = np.float32(0.5)


@kernel
def rough_share(closures, lane, min_alpha):
    """Probability that BSDF sampling picks a lobe that is not delta; 0 if the lane is not worth or fit for guiding.

    Parameters
    ----------
    min_alpha : float32
        Lanes whose lobes are all narrower are left to BSDF sampling.

    Returns
    -------
    share : float32
    is_diffuse : bool
        Rough lobes only reflect, and most samples of theirs are of diffuse ones, so that the cosine is most of the
        product: a guide multiplies it in, and the BSDF's samples find what a coat of gloss adds.
    """
    rough = 0.0
    diffuse = 0.0
    total = 0.0
    is_broad = False
    reflects = True
    for i in range(closures.count[lane]):
        kind = closures.kind[lane, i]
        weight = closures.param[lane, i, CLOSURE_SAMPLE_WEIGHT]
        total += weight
        if is_delta_lobe(closures.kind, closures.param, lane, i):
            continue
        rough += weight
        if kind > LAST_DIFFUSE:
            reflects = reflects and kind < REFRACTION
            alpha_squared = closures.param[lane, i, ALPHA_X] * closures.param[lane, i, ALPHA_Y]
            is_broad = is_broad or alpha_squared >= min_alpha * min_alpha
            # Refraction is a delta lobe here and reflection is not: one lobe cannot be in both sets.
            if kind >= REFRACTION and abs(closures.param[lane, i, ETA] - 1.0) < 2.0 * MIN_ETA_STEP:
                return 0.0, False
        else:
            is_broad = True
            reflects = reflects and kind < FIRST_TRANSLUCENT
            diffuse += weight
    if not is_broad or not rough > 0.0:
        return 0.0, False
    return rough / total, reflects and diffuse >= _LEAST_DIFFUSE * rough


@kernel
def mean_roughness(closures, lane):
    """Roughness of a surface as networks see it: the mean of its rough lobes, diffuse ones being 1: float32 in [0, 1].

    That of a lobe is its alpha, as `sample_bsdf` returns it.
    """
    rough = 0.0
    total = 0.0
    for i in range(closures.count[lane]):
        if is_delta_lobe(closures.kind, closures.param, lane, i):
            continue
        weight = closures.param[lane, i, CLOSURE_SAMPLE_WEIGHT]
        total += weight
        if closures.kind[lane, i] <= LAST_DIFFUSE:
            rough += weight
        else:
            alpha_squared = closures.param[lane, i, ALPHA_X] * closures.param[lane, i, ALPHA_Y]
            rough += weight * min(math.sqrt(alpha_squared), 1.0)
    return rough / total if total > 0.0 else np.float32(1.0)


@kernel
def eval_guided(closures, lane, wo, wi, ng, u, out, row):
    """Value, density and kind of a direction that a guide proposed.

    Parameters
    ----------
    u : float32 in [0, 1)
        Picks the lobe that is credited.
    out : float32 (R, C)
        Row `row` receives f |cos| [sr^-1]; black where the credited lobe's own sample would have been rejected.

    Returns
    -------
    pdf : float32 [sr^-1]
        Density with which `sample_bsdf` chooses `wi`; delta lobes keep their share of the choice.
    label : int
        RAY_* bits; 0 if no lobe can send light that way.
    roughness, eta : float32
        As `sample_bsdf`.
    """
    kinds = closures.kind
    param = closures.param
    channels = closures.channels
    pdf, picked = eval_channels(closures, lane, wo, wi, EVERY_KIND, BY_GUIDE, u, out, row)
    if picked < 0:
        for c in range(len(channels)):
            out[row, c] = 0.0
        return 0.0, 0, 1.0, 1.0
    kind = kinds[lane, picked]
    if FIRST_HAIR <= kind <= LAST_DIFFUSE:
        return pdf, hair_label(kind), hair_roughness(kind, param, lane, picked), 1.0
    is_refracted = dot(read3(param, lane, picked, CLOSURE_N), wi) < 0.0
    if (dot(ng, wi) < 0.0) != is_refracted:
        for c in range(len(channels)):
            out[row, c] = 0.0
        return pdf, 0, 1.0, 1.0
    label = RAY_TRANSMIT if is_refracted else RAY_REFLECT
    if param[lane, picked, BUMP] != 0.0 and (kind > LAST_DIFFUSE or is_refracted):
        # A specular or translucent lobe's own sample passes where other directions are rejected (`bump_shadowing`).
        pdf, _ = eval_channels(closures, lane, wo, wi, EVERY_KIND, picked, -1.0, out, row)
    if kind <= LAST_DIFFUSE:
        return pdf, label | RAY_DIFFUSE, 1.0, 1.0
    roughness = math.sqrt(param[lane, picked, ALPHA_X] * param[lane, picked, ALPHA_Y])
    label |= linked_label(param, lane, picked, kind) if is_linked(kind) else RAY_GLOSSY
    return pdf, label, roughness, param[lane, picked, ETA] if is_refracted else 1.0
