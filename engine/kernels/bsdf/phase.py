# SPDX-License-Identifier: GPL-3.0-or-later
"""Phase functions: how a medium scatters, all around and without a cosine.

Draine's function has those of Henyey and Greenstein (alpha 0) and of Rayleigh (g 0, alpha 1) in it. Directions are
drawn by Henyey and Greenstein's of the same g, and `evaluate` returns that density. Fournier and Forand's function is
its own density (`engine.kernels.bsdf.fournier_forand`).

References
----------
Henyey and Greenstein 1941, "Diffuse Radiation in the Galaxy", Eq. (2).
Draine 2003, "Scattering by Interstellar Dust Grains. I", Eq. (5).
"""

import math

import numpy as np

from engine.kernels.bsdf.fournier_forand import eval_fournier_forand, half_sine_squared, sample_fournier_forand
from engine.kernels.bsdf.kinds import BUMP, PHASE
from engine.kernels.bsdf.lobe import Lobe
from engine.kernels.constants import INV_FOUR_PI, TWO_PI
from engine.kernels.vector import add, dot, negate, normalize, orthonormal_basis, scale
from engine.runtime.jit import kernel
from engine.state.lanes import CLOSURE_KIND_PARAMS, CLOSURE_N, CLOSURE_SAMPLE_WEIGHT, CLOSURE_WEIGHT, MAX_CLOSURES

# Columns of Closures.param. Of Fournier and Forand's function they are mean cosine, exponent and delta; delta is 0 of
# Draine's.
PHASE_G = CLOSURE_KIND_PARAMS + 1
PHASE_ALPHA = CLOSURE_KIND_PARAMS + 2
PHASE_DELTA = CLOSURE_KIND_PARAMS + 3
#: Mean cosines below which the inverse would divide by next to nothing.
_ISOTROPIC = np.float32(1e-3)


@kernel
def add_phase(closures, lane, weight, g, alpha, delta):
    """Append a phase function; `weight`, one number for all channels, is replaced by the caller where channels differ.

    Returns its index, -1 if there is no room.
    """
    i = closures.count[lane]
    if i >= MAX_CLOSURES:
        return -1
    closures.count[lane] = i + 1
    closures.kind[lane, i] = PHASE
    param = closures.param
    for c in range(len(closures.channels)):
        param[lane, i, CLOSURE_WEIGHT + c] = weight
    for c in range(3):
        param[lane, i, CLOSURE_N + c] = 0.0
    param[lane, i, CLOSURE_SAMPLE_WEIGHT] = weight
    param[lane, i, BUMP] = 0.0
    param[lane, i, PHASE_G] = g
    param[lane, i, PHASE_ALPHA] = alpha
    param[lane, i, PHASE_DELTA] = delta
    return i


@kernel
def henyey_greenstein(cosine, g):
    """Density [sr^-1] of scattering by an angle of this cosine, 1 = straight on."""
    denominator = max(1.0 + g * g - 2.0 * g * cosine, 1e-12)
    return INV_FOUR_PI * (1.0 - g * g) / (denominator * math.sqrt(denominator))


@kernel
def eval_phase(param, channels, lane, i, n, wo, wi, factor, out, row):
    """See `Lobe.evaluate`; of Draine's function."""
    cosine = -dot(wo, wi)
    g = param[lane, i, PHASE_G]
    alpha = param[lane, i, PHASE_ALPHA]
    pdf = henyey_greenstein(cosine, g)
    value = factor * pdf * (1.0 + alpha * cosine * cosine) / (1.0 + alpha * (1.0 + 2.0 * g * g) * (1.0 / 3.0))
    for c in range(len(channels)):
        out[row, c] += param[lane, i, CLOSURE_WEIGHT + c] * value
    return pdf


@kernel
def _eval_water(param, channels, lane, i, wo, wi, factor, out, row):
    """See `Lobe.evaluate`; of Fournier and Forand's function."""
    pdf = eval_fournier_forand(half_sine_squared(wo, wi), param[lane, i, PHASE_ALPHA], param[lane, i, PHASE_DELTA])
    for c in range(len(channels)):
        out[row, c] += param[lane, i, CLOSURE_WEIGHT + c] * (factor * pdf)
    return pdf


@kernel
def eval_phase_lobe(param, channels, lane, i, n, wo, wi, factor, out, row):
    """See `Lobe.evaluate`."""
    if param[lane, i, PHASE_DELTA] > 0.0:
        return _eval_water(param, channels, lane, i, wo, wi, factor, out, row)
    return eval_phase(param, channels, lane, i, n, wo, wi, factor, out, row)


@kernel
def _has_water(closures, lane):
    """Whether some phase function of a lane is Fournier and Forand's."""
    for i in range(closures.count[lane]):
        if closures.param[lane, i, PHASE_DELTA] > 0.0:
            return True
    return False


@kernel
def _eval_with_water(closures, lane, wo, wi, out, row):
    """Add the values of all phase functions of a lane to out[row]; see `eval_phases`."""
    pdf = 0.0
    total = 0.0
    for i in range(closures.count[lane]):
        weight = closures.param[lane, i, CLOSURE_SAMPLE_WEIGHT]
        total += weight
        pdf += weight * eval_phase_lobe(closures.param, closures.channels, lane, i, wi, wo, wi, 1.0, out, row)
    return pdf / total if total > 0.0 else 0.0 * pdf


@kernel
def eval_phases(closures, lane, wo, wi, out, row):
    """Write the values of all phase functions of a lane, which has no other lobes, into out[row]; return their density.

    `eval_lobes` for points within media.
    """
    for c in range(len(closures.channels)):
        out[row, c] = 0.0
    # Apart, so that the compiler makes of the others what it always does, to the last bit.
    if _has_water(closures, lane):
        return _eval_with_water(closures, lane, wo, wi, out, row)
    pdf = 0.0
    total = 0.0
    for i in range(closures.count[lane]):
        weight = closures.param[lane, i, CLOSURE_SAMPLE_WEIGHT]
        total += weight
        pdf += weight * eval_phase(closures.param, closures.channels, lane, i, wi, wo, wi, 1.0, out, row)
    return pdf / total if total > 0.0 else 0.0 * pdf


@kernel
def mean_cosine(closures, lane):
    """Mean cosine of the angle by which a lane's phase functions scatter, all together."""
    total = 0.0
    mean = 0.0
    for i in range(closures.count[lane]):
        weight = closures.param[lane, i, CLOSURE_SAMPLE_WEIGHT]
        total += weight
        mean += weight * closures.param[lane, i, PHASE_G]
    return mean / total if total > 0.0 else 0.0 * mean


@kernel
def phase_roughness(closures, lane):
    """What stands for the roughness of a surface: 1 where a medium scatters evenly, 0 where straight on or back."""
    return 1.0 - abs(mean_cosine(closures, lane))


@kernel
def sample_phases(closures, lane, wo, u0, u1, u2):
    """Direction, unit, by one of a lane's phase functions; see `eval_phases`."""
    total = 0.0
    for i in range(closures.count[lane]):
        total += closures.param[lane, i, CLOSURE_SAMPLE_WEIGHT]
    rest = u0 * total
    chosen = 0
    for i in range(closures.count[lane]):
        chosen = i
        weight = closures.param[lane, i, CLOSURE_SAMPLE_WEIGHT]
        if rest < weight:
            break
        rest -= weight
    if closures.param[lane, chosen, PHASE_DELTA] > 0.0:
        return normalize(_sample_water(closures.param, lane, chosen, wo, u1, u2))
    return normalize(sample_phase(closures.param, lane, chosen, wo, wo, u1, u2))


@kernel
def _sample_water(param, lane, i, wo, u1, u2):
    """See `Lobe.sample`; of Fournier and Forand's function."""
    square = sample_fournier_forand(u1, param[lane, i, PHASE_ALPHA], param[lane, i, PHASE_DELTA])
    ahead = negate(wo)
    x, y = orthonormal_basis(ahead)
    across = add(scale(x, math.cos(TWO_PI * u2)), scale(y, math.sin(TWO_PI * u2)))
    return add(scale(across, 2.0 * math.sqrt(square * (1.0 - square))), scale(ahead, 1.0 - 2.0 * square))


@kernel
def sample_phase(param, lane, i, n, wo, u1, u2):
    """See `Lobe.sample`; of Henyey and Greenstein's function."""
    g = param[lane, i, PHASE_G]
    cosine = 1.0 - 2.0 * u1
    if abs(g) > _ISOTROPIC:
        part = (1.0 - g * g) / (1.0 + g - 2.0 * g * u1)
        cosine = min(max((1.0 + g * g - part * part) / (2.0 * g), -1.0), 1.0)
    sine = math.sqrt(max(0.0, 1.0 - cosine * cosine))
    ahead = negate(wo)
    x, y = orthonormal_basis(ahead)
    across = add(scale(x, math.cos(TWO_PI * u2)), scale(y, math.sin(TWO_PI * u2)))
    return add(scale(across, sine), scale(ahead, cosine))


@kernel
def sample_phase_lobe(param, lane, i, n, wo, u1, u2):
    """See `Lobe.sample`."""
    if param[lane, i, PHASE_DELTA] > 0.0:
        return _sample_water(param, lane, i, wo, u1, u2)
    return sample_phase(param, lane, i, n, wo, u1, u2)


LOBE = Lobe(PHASE, eval_phase_lobe, sample_phase_lobe)
