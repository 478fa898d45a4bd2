# SPDX-License-Identifier: GPL-3.0-or-later
"""Stage: pick one of each vertex's candidates and send the path on."""

from engine.guiding.sampling.candidate_rows import pick_of_vertex
from engine.guiding.sampling.scattering import Candidate, send_on
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
    guiding, guide, candidates = guidance.options, guidance.guide, work.candidates
    vertex_count, row_count = work.counts[VERTICES], work.counts[ROWS]
    for vertex in range(vertex_count):
        lane, row, weight, benefit = pick_of_vertex(guiding, work, vertex, vertex_count, row_count)
        if row < 0:
            continue
        source_pdf = candidates.source_pdf[row]
        candidate = Candidate(
            load(candidates.direction, row), source_pdf, candidates.bsdf_pdf[row], candidates.guide_pdf[row],
            candidates.label[row], candidates.roughness[row], candidates.eta[row], row,
        )  # fmt: skip
        send_on(scene, unit, guide, work, lane, candidate, weight, benefit)
