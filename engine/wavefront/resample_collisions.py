# SPDX-License-Identifier: GPL-3.0-or-later
"""Stages: propose several directions at collisions with media, and pick one; `predict_radiance` comes between them.

`draw_candidates` and `guide_resample` do the same for surfaces.
"""

from engine.guiding.sampling.collisions import PhaseCandidate, propose_at_collision, send_on_from_collision
from engine.guiding.sampling.guide import ask_for_guide
from engine.guiding.sampling.picking import pick_candidate
from engine.kernels.path import real_3
from engine.kernels.prefetch import (
    ask_for_closures,
    ask_for_history,
    ask_for_point,
    ask_for_ray,
    ask_for_throughput,
    lane_ahead,
)
from engine.kernels.rng import sample_4d
from engine.kernels.vector import load, store
from engine.ris.spread import SET_CANDIDATES, rotated
from engine.runtime.jit import kernel
from engine.state.lanes import POINT_P, RGB
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
        candidates.lane[vertex] = lane
        candidates.first[vertex] = row
        store(candidates.position, vertex, real_3(work.points, lane, POINT_P))
        candidates.time[vertex] = paths.time[lane]
        if len(paths.channels) > RGB:
            candidates.hero[vertex] = paths.hero[lane]
        u1, u2, u0, u3 = sample_4d(paths.rng[lane], paths.sample[lane], paths.dimension[lane] + SET_CANDIDATES)
        for j in range(guided.candidate_count[lane]):
            v0, v1, v2, _ = rotated(u0, u1, u2, u3, j)
            candidate = propose_at_collision(work, guide, lane, v0, v1, v2, candidates.f_cos, row)
            candidates.vertex[row] = vertex
            store(candidates.direction, row, candidate.wi)
            candidates.source_pdf[row] = candidate.source_pdf
            candidates.bsdf_pdf[row] = candidate.phase_pdf
            candidates.guide_pdf[row] = candidate.guide_pdf
            candidates.is_valid[row] = 1 if candidate.source_pdf > 0.0 and candidate.phase_pdf > 0.0 else 0
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
        lane = candidates.lane[vertex]
        ahead = lane_ahead(candidates.lane, vertex, vertex_count)
        ask_for_ray(paths, ahead)
        ask_for_throughput(paths, ahead)
        ask_for_history(paths, ahead)
        ask_for_point(work.points, ahead)
        first = candidates.first[vertex]
        last = candidates.first[vertex + 1] if vertex + 1 < vertex_count else row_count
        row, weight, benefit = pick_candidate(guidance.options, paths, candidates, lane, first, last - first)
        if row < 0:
            paths.alive[lane] = 0
            continue
        for c in range(len(paths.channels)):
            f_cos[lane, c] = candidates.f_cos[row, c]
        candidate = PhaseCandidate(
            load(candidates.direction, row), candidates.source_pdf[row], candidates.bsdf_pdf[row],
            candidates.guide_pdf[row],
        )  # fmt: skip
        send_on_from_collision(scene, unit, guidance.guide, work, lane, candidate, weight, benefit)
