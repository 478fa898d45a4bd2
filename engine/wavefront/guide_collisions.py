# SPDX-License-Identifier: GPL-3.0-or-later
"""Stages: decide which collisions with media are guided, ready what they sample by, and send on those that have one
candidate.

They come on both sides of light sampling: where a collision samples lights, their weights need to know the guide.
"""

import numpy as np

from engine.guiding.fields.vmm.query import find_region
from engine.guiding.sampling.allotment import TRIAL_BITS, allot, look_up_bits
from engine.guiding.sampling.collisions import propose_at_collision, send_on_from_collision
from engine.guiding.sampling.guide import ask_for_guide, query_guides, ready_collision
from engine.kernels.binary_tree import locate_leaf
from engine.kernels.collision import all_around
from engine.kernels.constants import NAN
from engine.kernels.path import real_3
from engine.kernels.prefetch import (
    ask_for_closures,
    ask_for_history,
    ask_for_point,
    ask_for_ray,
    ask_for_throughput,
    lane_ahead,
)
from engine.kernels.rng import hash_combine
from engine.kernels.vector import load
from engine.runtime.jit import kernel
from engine.state.lanes import POINT_NS, POINT_P, POINT_TIME
from engine.wavefront.columns import CANDIDATES, GUIDED_VERTICES


@kernel
def _set_normal(points, lane, n):
    """Give a point this for its normal."""
    for axis in range(3):
        points.real[lane, POINT_NS + axis] = n[axis]


@kernel
def prepare_collision_guides(scene, unit, guidance, work, queue):
    """Fill `guided` and `guide` of collisions; those that are not to be guided have a `rough_share` of 0.

    Sources see where the path was going as the normal, as records have it.

    Parameters
    ----------
    queue : LaneQueue
        `work.collided`.
    """
    guiding, field, allocation = guidance.options, guidance.field, guidance.allocation
    probability, guide = guidance.probability, guidance.guide
    paths, points, closures, guided, log = work.paths, work.points, work.closures, work.guided, work.log
    lanes, lane_count = queue.lanes, queue.count[0]
    # Media have rows of their own behind those of surfaces.
    first_row = probability.shape[0] - field.is_ready.shape[0]
    for k in range(lane_count):
        lane = lanes[k]
        ahead = lane_ahead(lanes, k, lane_count)
        ask_for_ray(paths, ahead)
        ask_for_throughput(paths, ahead)
        ask_for_point(points, ahead)
        ask_for_closures(closures, ahead)
        p = real_3(points, lane, POINT_P)
        leaf = locate_leaf(field, p)
        if leaf < 0:
            continue
        bits = look_up_bits(paths, lane)
        is_recorded = log.is_recording[lane] != 0
        row = first_row + leaf
        if probability[row] == 0.0 and not (is_recorded and bits < TRIAL_BITS):
            continue
        bits = hash_combine(bits, np.uint32(1))
        region = find_region(field, leaf, p, bits)
        _set_normal(points, lane, load(paths.direction, lane))
        points.real[lane, POINT_TIME] = paths.time[lane]
        if not ready_collision(guide, lane, field, region, points, closures, hash_combine(bits, np.uint32(4))):
            continue
        guided.rough_share[lane] = 1.0
        guided.region[lane] = region if region >= 0 else leaf
        guided.leaf[lane] = leaf
        guided.probability[lane] = probability[row]
        guided.candidate_count[lane] = allot(
            guiding, allocation, row, paths, lane, unit.pixel_weight, is_recorded, bits
        )
    query_guides(guide, guided, paths, points, lanes, lane_count)
    for k in range(lane_count):
        lane = lanes[k]
        _set_normal(points, lane, all_around(load(paths.direction, lane)))


@kernel
def guide_collisions(scene, unit, guidance, work, queue):
    """Send on the paths whose collision has one candidate; those with several go to `work.several`, and those that are
    not guided stay in the queue.

    Parameters
    ----------
    queue : LaneQueue
        `work.collided`. Lanes that leave it are taken from the end of `work.surface` too.
    """
    guide, guided, paths, f_cos = guidance.guide, work.guided, work.paths, work.f_cos
    several, several_count = work.several.lanes, 0
    lanes, lane_count = queue.lanes, queue.count[0]
    kept = 0
    for k in range(lane_count):
        lane = lanes[k]
        ahead = lane_ahead(lanes, k, lane_count)
        ask_for_ray(paths, ahead)
        ask_for_throughput(paths, ahead)
        ask_for_history(paths, ahead)
        ask_for_point(work.points, ahead)
        ask_for_closures(work.closures, ahead)
        ask_for_guide(guide, ahead)
        if not guided.rough_share[lane] > 0.0:
            lanes[kept] = lane
            kept += 1
            continue
        if guided.candidate_count[lane] > 1:
            several[several_count] = lane
            several_count += 1
            continue
        candidate = propose_at_collision(
            work, guide, lane, paths.random[lane, 0], paths.random[lane, 1], paths.random[lane, 2], f_cos, lane
        )
        if candidate.source_pdf > 0.0:
            send_on_from_collision(scene, unit, guide, work, lane, candidate, 1.0 / candidate.source_pdf, NAN)
        else:
            paths.alive[lane] = 0
    single_count = lane_count - kept - several_count
    work.counts[GUIDED_VERTICES] += single_count
    work.counts[CANDIDATES] += single_count
    work.several.count[0] = several_count
    work.surface.count[0] -= lane_count - kept
    queue.count[0] = kept
