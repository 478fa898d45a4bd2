# SPDX-License-Identifier: GPL-3.0-or-later
"""Rows of candidates, whether surfaces or media scatter: a vertex is opened, its candidates are kept, one is picked."""

from engine.guiding.sampling.picking import pick_candidate
from engine.kernels.path import real_3
from engine.kernels.prefetch import ask_for_history, ask_for_point, ask_for_ray, ask_for_throughput, lane_ahead
from engine.kernels.rng import sample_4d
from engine.kernels.vector import store
from engine.ris.rotation import SET_CANDIDATES
from engine.runtime.jit import kernel
from engine.state.lanes import POINT_P, RGB


@kernel
def open_vertex(paths, points, candidates, lane, vertex, row):
    """Write what all candidates of a lane's vertex share, and draw the numbers that they come from.

    Returns
    -------
    u0, u1, u2, u3 : float32 in [0, 1)
        To be `rotated` by the number of the candidate.
    """
    candidates.lane[vertex] = lane
    candidates.first[vertex] = row
    store(candidates.position, vertex, real_3(points, lane, POINT_P))
    candidates.time[vertex] = paths.time[lane]
    if len(paths.channels) > RGB:
        candidates.hero[vertex] = paths.hero[lane]
    u1, u2, u0, u3 = sample_4d(paths.rng[lane], paths.sample[lane], paths.dimension[lane] + SET_CANDIDATES)
    return u0, u1, u2, u3


@kernel
def keep_candidate(candidates, row, vertex, wi, source_pdf, scatter_pdf, guide_pdf, is_valid):
    """Write a candidate into its row; its value is there already.

    Parameters
    ----------
    wi : 3-tuple of float32
    source_pdf, scatter_pdf, guide_pdf : float32 [sr^-1]
        What it was drawn by, what the BSDF or the phase functions would draw it by, and the guide alone.
    is_valid : bool
    """
    candidates.vertex[row] = vertex
    store(candidates.direction, row, wi)
    candidates.source_pdf[row] = source_pdf
    candidates.bsdf_pdf[row] = scatter_pdf
    candidates.guide_pdf[row] = guide_pdf
    candidates.is_valid[row] = 1 if is_valid else 0


@kernel
def pick_of_vertex(guiding, work, vertex, vertex_count, row_count):
    """Pick one of a vertex's candidates, and ask for the lanes ahead; see `pick_candidate`.

    Returns
    -------
    lane : int32
    row : int
        -1 if no candidate is valid: the path has ended then.
    weight : float32 [sr]
    benefit : float32
    """
    paths, candidates = work.paths, work.candidates
    lane = candidates.lane[vertex]
    ahead = lane_ahead(candidates.lane, vertex, vertex_count)
    ask_for_ray(paths, ahead)
    ask_for_throughput(paths, ahead)
    ask_for_history(paths, ahead)
    ask_for_point(work.points, ahead)
    first = candidates.first[vertex]
    last = candidates.first[vertex + 1] if vertex + 1 < vertex_count else row_count
    row, weight, benefit = pick_candidate(guiding, paths, candidates, lane, first, last - first)
    if row < 0:
        paths.alive[lane] = 0
    return lane, row, weight, benefit
