# SPDX-License-Identifier: GPL-3.0-or-later
"""Stages: light of lamps that scattered rays would meet, were it not for objects that cast no shadows in it.

A lamp with a collection of blockers shines through everything else, and so it does for rays that go towards it by
chance: each looks for such lamps along its whole way, and sends a shadow ray to one of those that it finds.
"""

import numpy as np

from engine.kernels.constants import INFINITY
from engine.kernels.lights import (
    is_seen_by,
    lamp_emitter,
    lamp_shines,
    tree_of_ray,
)
from engine.kernels.path import mark_shadow
from engine.kernels.prefetch import ask_for_history, ask_for_ray, ask_for_throughput, lane_ahead
from engine.kernels.vector import load, store
from engine.runtime.jit import kernel
from engine.state.lanes import (
    LIGHT_CASTS_SHADOW,
    LIGHT_IS_LAMP,
    RAY_CAMERA,
    RAY_STARTS_ON,
    RAY_SUBSURFACE,
    RAY_TRANSPARENT,
)
from engine.state.lights import (
    LAMP_FLAG_MIS,
    LAMP_FLAG_SHADOW,
    LAMP_FLAGS,
    LAMP_LIGHT_GROUP,
    LAMP_PROGRAM,
    LAMP_VISIBILITY,
)
from engine.wavefront.columns import SHADOW_ROWS, UNIT_SPLITS_LIGHT
from engine.wavefront.found_lamps import distance_to_lamp, takes_next, weigh_lamp, write_lamp_radiance

#: What ends a shadow ray before its lamp, by rounding.
_BEFORE = np.float32(1.0 - 1e-5)


@kernel
def _find(lights, paths, lane, origin, wi, u):
    """One of the hidden lamps that a ray meets: row (-1 = none), distance, and how many there are."""
    flags = paths.flags[lane]
    chosen, at, count = np.int64(-1), np.float32(-1.0), 0
    for k in range(lights.links.hidden.shape[0]):
        row = np.int64(lights.links.hidden[k])
        if not lights.lamp_table[row, LAMP_FLAGS] & LAMP_FLAG_MIS or not lamp_shines(lights, flags, row):
            continue
        if lights.lamp_table[row, LAMP_PROGRAM] >= 0:
            continue
        if not is_seen_by(flags, lights.lamp_table[row, LAMP_VISIBILITY]):
            continue
        distance = distance_to_lamp(lights, row, origin, wi, 0.0, INFINITY, True)
        if distance < 0.0:
            continue
        count += 1
        is_taken, u = takes_next(count, u)
        if is_taken:
            chosen, at = row, distance
    return chosen, at, count


@kernel
def meet_hidden_lamps(scene, unit, work, queue):
    """Queue a shadow ray towards a lamp with blockers for every scattered ray that goes to one.

    What it brings was found by the path's last scattering: `depth` counts that no more until `leave_hidden_lamps`.

    Parameters
    ----------
    queue : LaneQueue
        `work.traced`, before its rays have been traced.
    """
    lights, paths, shadows, samples = scene.lights, work.paths, work.shadows, work.samples
    splits_light = unit.header[UNIT_SPLITS_LIGHT] != 0
    lanes, lane_count = queue.lanes, queue.count[0]
    shadow_count = 0
    for k in range(lane_count):
        lane = lanes[k]
        ahead = lane_ahead(lanes, k, lane_count)
        ask_for_ray(paths, ahead)
        ask_for_throughput(paths, ahead)
        ask_for_history(paths, ahead)
        flags = paths.flags[lane]
        if flags & (RAY_CAMERA | RAY_TRANSPARENT | RAY_SUBSURFACE):
            # Transparent surfaces are on the way of the ray that has left the last other one.
            continue
        origin, wi = load(paths.mis_origin, lane), load(paths.direction, lane)
        row, distance, count = _find(lights, paths, lane, origin, wi, paths.random[lane, 2])
        if row < 0:
            continue
        factor, unguided = weigh_lamp(scene, work, lane, row, origin, wi, distance)
        if not factor > 0.0:
            continue
        whole = factor * np.float32(count)
        write_lamp_radiance(scene, paths, lane, row, whole, shadows.radiance, shadow_count)
        store(shadows.origin, shadow_count, load(paths.origin, lane))
        store(shadows.direction, shadow_count, wi)
        casts_shadow = lights.lamp_table[row, LAMP_FLAGS] & LAMP_FLAG_SHADOW
        shadows.distance[shadow_count] = distance * _BEFORE if casts_shadow else -1.0
        shadows.lane[shadow_count] = lane
        shadows.weight[shadow_count] = 1.0
        shadows.own[shadow_count] = unguided.own
        shadows.other[shadow_count] = unguided.other
        shadows.share[shadow_count] = unguided.share
        samples.emitter[lane] = lamp_emitter(lights, tree_of_ray(lights, flags), row)
        samples.flags[lane] = LIGHT_IS_LAMP | (LIGHT_CASTS_SHADOW if casts_shadow else 0)
        samples.offset[lane] = 0.0
        if splits_light:
            work.passes.group[lane] = lights.lamp_table[row, LAMP_LIGHT_GROUP]
        mark_shadow(paths, lane, flags & RAY_STARTS_ON != 0)
        paths.depth[lane] -= 1
        shadow_count += 1
    work.counts[SHADOW_ROWS] = shadow_count


@kernel
def leave_hidden_lamps(scene, unit, work, queue):
    """Count the paths' last scattering again.

    Parameters
    ----------
    queue : LaneQueue
        Not looked at: rows of `work.shadows` tell the lanes.
    """
    for row in range(work.counts[SHADOW_ROWS]):
        work.paths.depth[work.shadows.lane[row]] += 1
