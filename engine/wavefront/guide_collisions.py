# SPDX-License-Identifier: GPL-3.0-or-later
"""Stage: send paths on from collisions with media by what the mixture field has learned.

One direction is drawn, by the region's mixture times the phase function, or by the phase function itself (one-sample
MIS). Light that such a direction meets is weighed by the phase function's density, whatever drew it: so are the light
samples of the segment, which do not know where on it the path collides.
"""

import numpy as np

from engine.guiding.fields.vmm.query import find_region, prepare_phase
from engine.guiding.records.vertices import Scattering, log_collision
from engine.guiding.sampling.guide import eval_guide, sample_guide
from engine.guiding.sampling.scattering import LEAST_UNGUIDED, MOST_UNGUIDED
from engine.kernels.binary_tree import locate_leaf
from engine.kernels.bsdf.phase import eval_phases, mean_cosine, sample_phases
from engine.kernels.collision import scatter_throughput
from engine.kernels.constants import NAN, ONE_MINUS_EPSILON
from engine.kernels.path import leave_collision, real_3
from engine.kernels.rng import SETS_PER_VERTEX, hash_combine
from engine.runtime.jit import kernel
from engine.state.lanes import POINT_P, POINT_WO
from engine.wavefront.columns import CANDIDATES, GUIDED_VERTICES

#: Offset of the numbers for look-ups among a path's dimensions, far from those of its vertices.
_SET_LOOKUP = 1 << 17
#: Share (of 2^32) of recorded lanes for which the guide is asked, though not used, where its probability is 0.
_TRIAL_BITS = np.uint32(1 << 28)


@kernel
def _ready(guidance, work, lane):
    """Write what to sample by into the lane's guide; returns the probability of it, -1: the lane is not guided."""
    field, probability, guide = guidance.field, guidance.probability, guidance.guide
    paths, points, log = work.paths, work.points, work.log
    p = real_3(points, lane, POINT_P)
    leaf = locate_leaf(field, p)
    # Elsewhere lights are sampled at the collision, and know the phase function alone.
    if leaf < 0 or work.media.is_lit[lane] == 0:
        return np.float32(-1.0)
    bits = hash_combine(
        hash_combine(paths.rng[lane], paths.sample[lane]), np.uint32(paths.dimension[lane] + _SET_LOOKUP)
    )
    if probability[leaf] == 0.0 and not (log.is_recording[lane] != 0 and bits < _TRIAL_BITS):
        return np.float32(-1.0)
    region = find_region(field, leaf, p, hash_combine(bits, np.uint32(1)))
    if region < 0:
        return np.float32(-1.0)
    wo = real_3(points, lane, POINT_WO)
    prepare_phase(
        field, region, p, (-wo[0], -wo[1], -wo[2]), mean_cosine(work.closures, lane), guide, lane
    )
    return probability[leaf]


@kernel
def guide_collisions(scene, unit, guidance, work, queue):
    """Send on the paths that have a region; the others stay in the queue.

    Parameters
    ----------
    queue : LaneQueue
        `work.collided`. Lanes that leave it are taken from the end of `work.surface` too.
    """
    options, guide = scene.options, guidance.guide
    paths, points, closures, media, log, f_cos = (
        work.paths, work.points, work.closures, work.media, work.log, work.f_cos,
    )  # fmt: skip
    lanes, lane_count = queue.lanes, queue.count[0]
    kept = 0
    for k in range(lane_count):
        lane = lanes[k]
        probability = _ready(guidance, work, lane)
        if probability < 0.0:
            lanes[kept] = lane
            kept += 1
            continue
        work.samples.weight[lane] = 1.0
        wo = real_3(points, lane, POINT_WO)
        u0, u1, u2 = paths.random[lane, 0], paths.random[lane, 1], paths.random[lane, 2]
        if u0 < probability:
            wi = sample_guide(guide, lane, u0 / probability, u1, u2)
        else:
            u0 = min((u0 - probability) / (1.0 - probability), ONE_MINUS_EPSILON)
            wi = sample_phases(closures, lane, wo, u0, u1, u2)
        phase_pdf = eval_phases(closures, lane, wo, wi, f_cos, lane)
        guide_pdf = eval_guide(guide, lane, wi)
        pdf = probability * guide_pdf + (1.0 - probability) * phase_pdf
        if not pdf > 0.0 or not scatter_throughput(paths, lane, f_cos, 1.0 / pdf) > 0.0:
            paths.alive[lane] = 0
            continue
        if phase_pdf > 0.0:
            unguided = paths.unguided[lane] * pdf / phase_pdf
            paths.unguided[lane] = min(max(unguided, LEAST_UNGUIDED), MOST_UNGUIDED)
        paths.survival[lane] = -1.0
        paths.dimension[lane] += SETS_PER_VERTEX
        if log.is_recording[lane] != 0:
            roughness = 1.0 - abs(mean_cosine(closures, lane))
            scattering = Scattering(wi, pdf, roughness, 1.0, NAN, phase_pdf, guide_pdf)
            log_collision(log, paths, points, closures, work.samples, lane, scattering, f_cos)
        leave_collision(options, paths, points, media, lane, wi, phase_pdf)
    work.counts[GUIDED_VERTICES] += lane_count - kept
    work.counts[CANDIDATES] += lane_count - kept
    work.surface.count[0] -= lane_count - kept
    queue.count[0] = kept
