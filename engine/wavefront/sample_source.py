# SPDX-License-Identifier: GPL-3.0-or-later
"""Stage: draw the only candidate of a vertex and send the path on."""

from engine.guiding.sampling.guide import ask_for_guide
from engine.guiding.sampling.scattering import propose, send_on
from engine.kernels.constants import NAN, ONE_MINUS_EPSILON
from engine.kernels.prefetch import (
    ask_for_closures,
    ask_for_history,
    ask_for_point,
    ask_for_ray,
    ask_for_throughput,
    lane_ahead,
)
from engine.runtime.jit import kernel
from engine.wavefront.columns import CANDIDATES, GUIDED_VERTICES


@kernel
def sample_source(scene, unit, guidance, work, queue):
    """Draw the only candidate of each lane and send the path on: nothing needs to be predicted or kept."""
    paths, points, closures, guided, guide = work.paths, work.points, work.closures, work.guided, guidance.guide
    lanes, lane_count = queue.lanes, queue.count[0]
    work.counts[GUIDED_VERTICES] += lane_count
    work.counts[CANDIDATES] += lane_count
    for k in range(lane_count):
        lane = lanes[k]
        ahead = lane_ahead(lanes, k, lane_count)
        ask_for_ray(paths, ahead)
        ask_for_throughput(paths, ahead)
        ask_for_history(paths, ahead)
        ask_for_point(points, ahead)
        ask_for_closures(closures, ahead)
        ask_for_guide(guide, ahead)
        # What `scatter` has left of the number that chose against the delta lobes.
        share = guided.rough_share[lane]
        u0 = min(max((paths.random[lane, 0] - (1.0 - share)) / share, 0.0), ONE_MINUS_EPSILON)
        u = (u0, paths.random[lane, 1], paths.random[lane, 2], paths.random[lane, 3])
        candidate, is_valid = propose(work, guide, lane, u, 0)
        if not is_valid:
            paths.alive[lane] = 0
            continue
        send_on(scene, unit, guide, work, lane, candidate, 1.0 / candidate.source_pdf, NAN)
