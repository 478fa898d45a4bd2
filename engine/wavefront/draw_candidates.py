# SPDX-License-Identifier: GPL-3.0-or-later
"""Stage: propose directions by the guide and by the BSDF."""

from engine.guiding.sampling.candidate_rows import keep_candidate, open_vertex
from engine.guiding.sampling.guide import ask_for_guide
from engine.guiding.sampling.scattering import propose
from engine.kernels.prefetch import ask_for_closures, ask_for_point, ask_for_throughput, lane_ahead
from engine.ris.rotation import rotated
from engine.runtime.jit import kernel
from engine.wavefront.columns import (
    CANDIDATES,
    GUIDED_VERTICES,
    NEXT_LANE,
    RESAMPLED_CANDIDATES,
    RESAMPLED_VERTICES,
    ROWS,
    VERTICES,
)


@kernel
def draw_candidates(scene, unit, guidance, work, queue):
    """Fill `work.candidates` for the lanes of the queue that are not done, as many as fit (see
    `engine.guiding.sampling.scattering.propose`).

    `work.counts` holds the first lane that is not done (NEXT_LANE), and then how many vertices and rows are in use
    (VERTICES, ROWS).

    The candidates of a vertex are one point of a set, stratified over the samples of its pixel, moved on around the
    unit cube (Cranley and Patterson 1976) by steps that spread them evenly; each alone is uniform, which is all that
    resampling asks of them.

    Parameters
    ----------
    queue : LaneQueue
        Lanes to resample, with at least one candidate each.
    """
    paths, points, closures, guided, guide = work.paths, work.points, work.closures, work.guided, guidance.guide
    candidates, counts = work.candidates, work.counts
    lanes, lane_count = queue.lanes, queue.count[0]
    row = 0
    vertex = 0
    k = counts[NEXT_LANE]
    capacity = candidates.label.shape[0]
    while k < lane_count and row + guided.candidate_count[lanes[k]] <= capacity:
        lane = lanes[k]
        ahead = lane_ahead(lanes, k, lane_count)
        ask_for_throughput(paths, ahead)
        ask_for_point(points, ahead)
        ask_for_closures(closures, ahead)
        ask_for_guide(guide, ahead)
        k += 1
        u0, u1, u2, u3 = open_vertex(paths, points, candidates, lane, vertex, row)
        for j in range(guided.candidate_count[lane]):
            candidate, is_valid = propose(work, guide, lane, rotated(u0, u1, u2, u3, j), row)
            keep_candidate(
                candidates, row, vertex, candidate.wi, candidate.source_pdf, candidate.bsdf_pdf, candidate.guide_pdf,
                is_valid,
            )  # fmt: skip
            candidates.label[row] = candidate.label
            candidates.roughness[row] = candidate.roughness
            candidates.eta[row] = candidate.eta
            row += 1
        vertex += 1
    counts[NEXT_LANE] = k
    counts[VERTICES] = vertex
    counts[ROWS] = row
    counts[GUIDED_VERTICES] += vertex
    counts[CANDIDATES] += row
    counts[RESAMPLED_VERTICES] += vertex
    counts[RESAMPLED_CANDIDATES] += row
