# SPDX-License-Identifier: GPL-3.0-or-later
"""Stages: propose several directions at collisions with media, and pick one; `predict_radiance` comes between them.

`draw_candidates` and `guide_resample` do the same for surfaces.
"""

from engine.guiding.sampling.candidate_rows import keep_candidate, open_vertex, pick_of_vertex
from engine.guiding.sampling.collisions import PhaseCandidate, propose_at_collision, send_on_from_collision
from engine.guiding.sampling.guide import ask_for_guide
from engine.kernels.prefetch import ask_for_closures, ask_for_point, ask_for_throughput, lane_ahead
from engine.kernels.vector import load
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
def draw_collision_candidates(scene, unit, guidance, work, queue):
    """Fill `work.candidates` for the lanes of the queue that are not done, as many as fit, as `draw_candidates` does.

    Parameters
    ----------
    queue : LaneQueue
        Lanes at collisions that have several candidates each.
    """
    paths, guided, guide, candidates, counts = work.paths, work.guided, guidance.guide, work.candidates, work.counts
    lanes, lane_count = queue.lanes, queue.count[0]
    row = 0
    vertex = 0
    k = counts[NEXT_LANE]
    capacity = candidates.label.shape[0]
    while k < lane_count and row + guided.candidate_count[lanes[k]] <= capacity:
        lane = lanes[k]
        ahead = lane_ahead(lanes, k, lane_count)
        ask_for_throughput(paths, ahead)
        ask_for_point(work.points, ahead)
        ask_for_closures(work.closures, ahead)
        ask_for_guide(guide, ahead)
        k += 1
        u0, u1, u2, u3 = open_vertex(paths, work.points, candidates, lane, vertex, row)
        for j in range(guided.candidate_count[lane]):
            v0, v1, v2, _ = rotated(u0, u1, u2, u3, j)
            candidate = propose_at_collision(work, guide, lane, v0, v1, v2, candidates.f_cos, row)
            keep_candidate(
                candidates, row, vertex, candidate.wi, candidate.source_pdf, candidate.phase_pdf, candidate.guide_pdf,
                candidate.source_pdf > 0.0 and candidate.phase_pdf > 0.0,
            )  # fmt: skip
            row += 1
        vertex += 1
    counts[NEXT_LANE] = k
    counts[VERTICES] = vertex
    counts[ROWS] = row
    counts[GUIDED_VERTICES] += vertex
    counts[CANDIDATES] += row
    counts[RESAMPLED_VERTICES] += vertex
    counts[RESAMPLED_CANDIDATES] += row


@kernel
def resample_collisions(scene, unit, guidance, work, queue):
    """Resample (see `engine.ris.resample`) and send the paths on.

    Parameters
    ----------
    queue : LaneQueue
        The lanes that `draw_collision_candidates` was given.
    """
    paths, candidates, f_cos = work.paths, work.candidates, work.f_cos
    vertex_count, row_count = work.counts[VERTICES], work.counts[ROWS]
    for vertex in range(vertex_count):
        lane, row, weight, benefit = pick_of_vertex(guidance.options, work, vertex, vertex_count, row_count)
        if row < 0:
            continue
        for c in range(len(paths.channels)):
            f_cos[lane, c] = candidates.f_cos[row, c]
        candidate = PhaseCandidate(
            load(candidates.direction, row), candidates.source_pdf[row], candidates.bsdf_pdf[row],
            candidates.guide_pdf[row],
        )  # fmt: skip
        send_on_from_collision(scene, unit, guidance.guide, work, lane, candidate, weight, benefit)
