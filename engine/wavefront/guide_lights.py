# SPDX-License-Identifier: GPL-3.0-or-later
"""Stage: the guide's part in the source density of every light sample, for its MIS weight."""

from engine.guiding.sampling.guide import ask_for_guide, eval_guide
from engine.kernels.prefetch import lane_ahead, prefetch
from engine.kernels.vector import load
from engine.runtime.jit import kernel


@kernel
def guide_lights(scene, unit, guidance, work, queue):
    """Fill `guide_pdf` and `bsdf_share` of the light samples.

    The density of what resampling returns is unknown: both techniques' weights use the source density, Eq. (7), so that
    they sum to one.

    Parameters
    ----------
    queue : LaneQueue
        Lanes that have a light sample.
    """
    guided, guide, samples = work.guided, guidance.guide, work.samples
    lit, lit_count = queue.lanes, queue.count[0]
    for k in range(lit_count):
        lane = lit[k]
        ahead = lane_ahead(lit, k, lit_count)
        prefetch(samples.direction, ahead)
        ask_for_guide(guide, ahead)
        share = guided.rough_share[lane]
        if share > 0.0:
            pdf = eval_guide(guide, lane, load(samples.direction, lane))
            samples.guide_pdf[lane] = share * guided.probability[lane] * pdf
            samples.bsdf_share[lane] = 1.0 - guided.probability[lane]
        else:
            samples.guide_pdf[lane] = 0.0
            samples.bsdf_share[lane] = 1.0
