# SPDX-License-Identifier: GPL-3.0-or-later
"""Stage: decide which lanes are guided, ready what they sample by, and allot candidates."""

import numpy as np

from engine.guiding.fields.vmm.query import find_region
from engine.guiding.sampling.allotment import TRIAL_BITS, allot, look_up_bits
from engine.guiding.sampling.guide import query_guides, ready_guide
from engine.kernels.binary_tree import locate_leaf
from engine.kernels.bsdf import rough_share
from engine.kernels.path import real_3
from engine.kernels.prefetch import ask_for_closures, ask_for_point, ask_for_ray, ask_for_throughput, lane_ahead
from engine.kernels.rng import hash_combine, unit_float
from engine.runtime.jit import kernel
from engine.state.lanes import POINT_P


@kernel
def prepare_guides(scene, unit, guidance, work, queue):
    """Fill `guided`, `guide` and `samples.weight`; lanes outside the learned field keep BSDF and light sampling.

    Lanes where the region's guiding probability is 0 are left to the BSDF, but for a few of recorded paths, by which it
    can be learned anew.
    """
    guiding, field, allocation = guidance.options, guidance.field, guidance.allocation
    probability, light_share, guide = guidance.probability, guidance.light_share, guidance.guide
    paths, points, closures, guided = work.paths, work.points, work.closures, work.guided
    samples, log, pixel_weight = work.samples, work.log, unit.pixel_weight
    lanes, lane_count = queue.lanes, queue.count[0]
    for k in range(lane_count):
        lane = lanes[k]
        ahead = lane_ahead(lanes, k, lane_count)
        ask_for_ray(paths, ahead)
        ask_for_throughput(paths, ahead)
        ask_for_point(points, ahead)
        ask_for_closures(closures, ahead)
        guided.rough_share[lane] = 0.0
        samples.weight[lane] = 1.0
        if paths.alive[lane] == 0:
            continue
        is_recorded = log.is_recording[lane] != 0
        p = real_3(points, lane, POINT_P)
        leaf = locate_leaf(field, p)
        if leaf < 0:
            continue
        bits = look_up_bits(paths, lane)
        if light_share[leaf] < 1.0:
            taken = unit_float(hash_combine(bits, np.uint32(3))) < light_share[leaf]
            samples.weight[lane] = 1.0 / light_share[leaf] if taken else np.float32(0.0)
        is_tried = is_recorded and bits < TRIAL_BITS
        if probability[leaf] == 0.0 and not is_tried:
            continue
        share, is_diffuse = rough_share(closures, lane, guiding.min_alpha)
        if not share > 0.0:
            continue
        bits = hash_combine(bits, np.uint32(1))
        region = find_region(field, leaf, p, bits)
        look_up = hash_combine(bits, np.uint32(4))
        if not ready_guide(guide, lane, field, region, points, closures, is_diffuse, look_up):
            continue
        guided.rough_share[lane] = share
        guided.region[lane] = region if region >= 0 else leaf
        guided.leaf[lane] = leaf
        guided.probability[lane] = probability[leaf]
        guided.candidate_count[lane] = allot(guiding, allocation, leaf, paths, lane, pixel_weight, is_recorded, bits)
    query_guides(guide, guided, paths, points, lanes, lane_count)
