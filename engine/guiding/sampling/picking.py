# SPDX-License-Identifier: GPL-3.0-or-later
"""Picking one of a vertex's candidates by what they are expected to bring."""

from engine.ris.resample import product_target, resample
from engine.runtime.jit import kernel


@kernel
def pick_candidate(guiding, paths, candidates, lane, first, count):
    """Pick one of the candidates `first` to `first + count` of a lane's vertex, at least two.

    Parameters
    ----------
    guiding : GuidingOptions
    candidates : Candidates
        With what is expected to arrive along them; `target` is written.

    Returns
    -------
    row : int
        -1 if no candidate is valid.
    weight : float32 [sr], contribution weight
    benefit : float32
        Eq. (19), but for the squared radiance that the path has yet to find.
    """
    for row in range(first, first + count):
        candidates.target[row] = product_target(
            paths.throughput, lane, candidates.f_cos, candidates.radiance, row, paths.channels,
            guiding.use_scalar_target,
        )
    row, weight = resample(
        candidates.target, candidates.source_pdf, candidates.is_valid, first, count, guiding.defensive_alpha,
        paths.random[lane, 1],
    )
    benefit = 0.0
    if row >= 0:
        benefit = count / (count - 1.0) * (1.0 / (candidates.source_pdf[row] * weight) - 1.0)
    return row, weight, benefit
