# SPDX-License-Identifier: GPL-3.0-or-later
"""Clamping that does not see how a path was sampled.

Cycles clamps what a path contributes: a contribution c is multiplied by s(c) = min(1, limit / |c|). That depends on the
densities that the path was sampled with. Whoever samples bright light more often has smaller contributions, of which
the clamp takes less, and so another picture. Here the clamp looks at what the path *would* have contributed by plain
sampling, with nothing learned, whatever it was sampled by.

Let f be a path's light, p1 and p2 the densities with which plain sampling finds its last vertex by scattering and by
light sampling, w1 and w2 the weights of these two (`power_heuristic`). The clamped picture of plain sampling is the sum
over all paths of

    f (w1 s(f w1 / p1) + w2 s(f w2 / p2)).

The bracket is a number that the path has by itself. So any sampling that finds f without bias may multiply what it
finds by it: `Unguided` holds what is needed, and both techniques use the same bracket, so that their weights sum to one
as before. docs/decisions/clamping.md says which terms are exact.
"""

from typing import NamedTuple

import numpy as np

from engine.runtime.jit import kernel


class Unguided(NamedTuple):
    """Factors that make of a contribution what plain sampling would have contributed for the same path.

    Attributes
    ----------
    own : float32
        If the technique that has found it had.
    other : float32
        If the other of scattering and light sampling had.
    share : float32 in [0, 1]
        MIS weight of the technique that has found it, in plain sampling.
    """

    own: float
    other: float
    share: float


@kernel
def found_alone(unguided):
    """`Unguided` of light that one technique alone finds: float32, the path's factor."""
    return Unguided(unguided, np.float32(0.0), np.float32(1.0))


@kernel
def clamps(options):
    """Whether anything is clamped."""
    return options.clamp_direct > 0.0 or options.clamp_indirect > 0.0


@kernel
def _left_of(total, limit):
    """Share that clamping leaves of a contribution whose channels sum to `total`; NaN leaves all."""
    return limit / total if total > limit else np.float32(1.0)


@kernel
def clamped_share(options, channels, contribution, row, depth, unguided):
    """Share of row `row` of `contribution` that the clamp of direct or indirect light leaves: float32.

    The limits are on the sum of channels, as many times the user's setting as there are.

    Parameters
    ----------
    contribution : float32 (N, C)
    depth : int
        Scatterings before the light's last one: 0 is direct light, -1 what the camera sees.
    unguided : Unguided
    """
    limit = (options.clamp_indirect if depth > 0 else options.clamp_direct) * np.float32(len(channels))
    if not limit > 0.0:
        return np.float32(1.0)
    total = np.float32(0.0)
    for c in range(len(channels)):
        total += abs(contribution[row, c])
    own = _left_of(total * unguided.own, limit)
    if unguided.share >= 1.0:
        return own
    return unguided.share * own + (np.float32(1.0) - unguided.share) * _left_of(total * unguided.other, limit)


@kernel
def weighted_inverse(pdf, other_pdf):
    """A technique's MIS weight over its density: w / p of `pdf` against `other_pdf` [sr]; 0 for a density of 0.

    References: Veach 1997, Eq. (9.13), beta = 2. Written so that squares do not overflow.
    """
    if not pdf > 0.0:
        return 0.0 * pdf
    if other_pdf <= pdf:
        ratio = other_pdf / pdf
        return 1.0 / (pdf * (1.0 + ratio * ratio))
    ratio = pdf / other_pdf
    return ratio / (other_pdf * (1.0 + ratio * ratio))


@kernel
def settle_roulette(paths, lane):
    """Divide a path's throughput by the probability with which roulette has let it go on.

    By plain sampling it would have been divided by another.
    """
    survival = paths.survival[lane]
    plain = paths.unguided_survival[lane]
    if survival < 1.0:
        scale = 1.0 / survival
        for c in range(len(paths.channels)):
            paths.throughput[lane, c] *= scale
    if survival != plain and plain > 0.0:
        paths.unguided[lane] *= survival / plain
