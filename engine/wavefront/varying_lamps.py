# SPDX-License-Identifier: GPL-3.0-or-later
"""Stages: light of lamps whose emission a program tells, where rays meet them: found, looked up, added."""

import numpy as np

from engine.kernels.clamping import Unguided
from engine.kernels.constants import DISTANT, FAR
from engine.kernels.lights import (
    is_seen_by,
    lamp_is_hidden,
    lamp_place,
    lamp_shines,
)
from engine.kernels.path_depths import store_depths
from engine.kernels.prefetch import ask_for_history, ask_for_ray, ask_for_throughput, lane_ahead
from engine.kernels.vector import load
from engine.runtime.jit import kernel
from engine.state.lanes import (
    POINT_FLAGS,
    POINT_INSTANCE,
    POINT_LIGHT,
    POINT_NG,
    POINT_NS,
    POINT_P,
    POINT_PROGRAM,
    POINT_RADIUS,
    POINT_RANDOM,
    POINT_RAY_FLAGS,
    POINT_RAY_LENGTH,
    POINT_TIME,
    POINT_TRIANGLE,
    POINT_U,
    POINT_V,
    POINT_WO,
    RAY_CAMERA,
    RAY_EMISSION,
)
from engine.state.lights import (
    HEADER_HITTABLE,
    LAMP_FLAG_MIS,
    LAMP_FLAGS,
    LAMP_PROGRAM,
    LAMP_VISIBILITY,
)
from engine.wavefront.found_lamps import add_lamp, distance_to_lamp, takes_next, weigh_lamp, write_lamp_radiance


@kernel
def _find(lights, options, paths, lane, origin, wi):
    """One of the lamps with programs that a lane's ray crosses: row (-1 = none), distance, and how many there are."""
    flags, t_min = paths.flags[lane], paths.mis_distance[lane]
    t_max, is_camera = min(t_min + paths.hit_distance[lane], paths.reach[lane]), flags & RAY_CAMERA
    chosen, at, count, u = np.int64(-1), np.float32(-1.0), 0, paths.random[lane, 2]
    for k in range(lights.varying.shape[0]):
        row = np.int64(lights.varying[k])
        is_local = row < lights.header[HEADER_HITTABLE]
        is_seen = lights.lamp_table[row, LAMP_FLAGS] & LAMP_FLAG_MIS or options.use_nee == 0
        if not (is_seen or (is_camera and is_local)):
            continue
        if not is_seen_by(flags, lights.lamp_table[row, LAMP_VISIBILITY]) or not lamp_shines(lights, flags, row):
            continue
        if options.use_nee != 0 and lamp_is_hidden(lights, row) and not (is_camera and is_local):
            continue
        distance = distance_to_lamp(lights, row, origin, wi, t_min, t_max, paths.hit_instance[lane] < 0)
        if distance < 0.0:
            continue
        count += 1
        is_taken, u = takes_next(count, u)
        if is_taken:
            chosen, at = row, distance
    return chosen, at, count


@kernel
def _place(lights, paths, points, lane, row, origin, wi, distance):
    """Set up the point of a lamp that a ray has met, for its program."""
    ng, u, v = lamp_place(lights, row, origin, wi, distance)
    real, integer = points.real, points.integer
    for c in range(3):
        # A sun's place is the direction that its light goes in, as in Cycles.
        real[lane, POINT_P + c] = origin[c] + distance * wi[c] if distance < FAR else -wi[c]
        real[lane, POINT_WO + c] = -wi[c]
        real[lane, POINT_NG + c] = ng[c]
        real[lane, POINT_NS + c] = ng[c]
    real[lane, POINT_U], real[lane, POINT_V] = u, v
    real[lane, POINT_RAY_LENGTH] = distance
    real[lane, POINT_RADIUS] = 0.0
    real[lane, POINT_RANDOM] = paths.random[lane, 2]
    real[lane, POINT_TIME] = paths.time[lane]
    integer[lane, POINT_INSTANCE] = integer[lane, POINT_TRIANGLE] = -1
    integer[lane, POINT_PROGRAM] = lights.lamp_table[row, LAMP_PROGRAM]
    integer[lane, POINT_RAY_FLAGS] = paths.flags[lane] | RAY_EMISSION
    integer[lane, POINT_FLAGS] = 0
    store_depths(paths, lane, paths.transparent_depth[lane], points, lane)
    integer[lane, POINT_LIGHT] = 0


@kernel
def meet_varying_lamps(scene, unit, work, queue):
    """Find lamps on rays whose emission a program tells, one of them each, and fill `work.programs` with their lanes.

    `work.light_points` are where they are met, and rows of `work.shadows` by lane what `add_varying_lamps` reads.

    Parameters
    ----------
    queue : LaneQueue
        `work.traced`.
    """
    lights, paths, shadows, programs = scene.lights, work.paths, work.shadows, work.programs
    lanes, lane_count = queue.lanes, queue.count[0]
    count = 0
    for k in range(lane_count):
        lane = lanes[k]
        ahead = lane_ahead(lanes, k, lane_count)
        ask_for_ray(paths, ahead)
        ask_for_throughput(paths, ahead)
        ask_for_history(paths, ahead)
        origin, wi = load(paths.mis_origin, lane), load(paths.direction, lane)
        row, distance, found = _find(lights, scene.options, paths, lane, origin, wi)
        if row < 0:
            continue
        factor, unguided = weigh_lamp(scene, work, lane, row, origin, wi, distance)
        if not factor > 0.0:
            continue
        write_lamp_radiance(scene, paths, lane, row, factor * np.float32(found), shadows.radiance, lane)
        shadows.own[lane], shadows.other[lane], shadows.share[lane] = unguided.own, unguided.other, unguided.share
        shadows.distance[lane] = distance - paths.mis_distance[lane] if distance < FAR else DISTANT
        shadows.lane[lane] = row
        _place(lights, paths, work.light_points, lane, row, origin, wi, distance)
        programs.lanes[count] = lane
        count += 1
    programs.count[0] = count


@kernel
def keep_varying_lamps(scene, unit, work, queue):
    """Take over what the lamps' programs have said: where media vary, tracking needs the place.

    Parameters
    ----------
    queue : LaneQueue
        `work.programs`.
    """
    shadows, emission = work.shadows, work.light_closures.emission
    for k in range(queue.count[0]):
        lane = queue.lanes[k]
        for c in range(len(work.paths.channels)):
            shadows.radiance[lane, c] *= emission[lane, c]


@kernel
def add_varying_lamps(scene, unit, work, queue):
    """Add what lamps emit that `meet_varying_lamps` has found.

    Parameters
    ----------
    queue : LaneQueue
        `work.programs`.
    """
    shadows, scratch = work.shadows, work.f_cos
    for k in range(queue.count[0]):
        lane = queue.lanes[k]
        for c in range(len(work.paths.channels)):
            scratch[lane, c] = shadows.radiance[lane, c]
        unguided = Unguided(shadows.own[lane], shadows.other[lane], shadows.share[lane])
        add_lamp(scene, unit, work, lane, np.int64(shadows.lane[lane]), shadows.distance[lane], unguided)
