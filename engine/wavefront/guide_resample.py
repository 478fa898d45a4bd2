# SPDX-License-Identifier: GPL-3.0-or-later
"""Stage: pick one of each vertex's candidates and send the path on."""

from engine.guiding.sampling.picking import pick_candidate
from engine.guiding.sampling.scattering import Candidate, send_on
from engine.kernels.prefetch import ask_for_history, ask_for_point, ask_for_ray, ask_for_throughput, lane_ahead
from engine.kernels.vector import load
from engine.runtime.jit import kernel
from engine.wavefront.columns import ROWS, VERTICES


@kernel
def guide_resample(scene, unit, guidance, work, queue):
    """Resample (see `engine.ris.resample`) and send the paths on.

    Parameters
    ----------
    queue : LaneQueue
        The lanes that `draw_candidates` was given: what it has drawn, and `predict_radiance` has predicted, is used.
    """
    guiding, guide = guidance.options, guidance.guide
    paths, points, candidates = work.paths, work.points, work.candidates
    vertex_count, row_count = work.counts[VERTICES], work.counts[ROWS]
    for vertex in range(vertex_count):
        lane = candidates.lane[vertex]
        ahead = lane_ahead(candidates.lane, vertex, vertex_count)
        ask_for_ray(paths, ahead)
        ask_for_throughput(paths, ahead)
        ask_for_history(paths, ahead)
        ask_for_point(points, ahead)
        first = candidates.first[vertex]
        last = candidates.first[vertex + 1] if vertex + 1 < vertex_count else row_count
        row, weight, benefit = pick_candidate(guiding, paths, candidates, lane, first, last - first)
        if row < 0:
            paths.alive[lane] = 0
            continue
        source_pdf = candidates.source_pdf[row]
        candidate = Candidate(
            load(candidates.direction, row), source_pdf, candidates.bsdf_pdf[row], candidates.guide_pdf[row],
            candidates.label[row], candidates.roughness[row], candidates.eta[row], row,
        )  # fmt: skip
        send_on(scene, unit, guide, work, lane, candidate, weight, benefit)
