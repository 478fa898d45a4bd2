# SPDX-License-Identifier: GPL-3.0-or-later
"""Stages: follow rays through media that vary in space, to where they collide or to the next surface.

They run only in scenes that have such media, in turns: `find_collisions` takes every ray to where it may collide,
`evaluate_shaders` says what the medium is there, and `meet_media` decides. `sample_medium` takes what came of it.
"""

import numpy as np

from engine.kernels.constants import DISTANT
from engine.kernels.lights import lamp_hit
from engine.kernels.media import any_varies, leave_objects, length_in_media, sum_coefficients
from engine.kernels.rng import SET_MEDIUM, track_4
from engine.kernels.tracking import (
    COLLIDES,
    GOES_ON,
    MOST_STEPS,
    meet_medium,
    next_collision,
    place_in_medium,
    read_medium,
    read_uniform,
)
from engine.kernels.vector import add, load, scale
from engine.runtime.jit import kernel
from engine.state.lanes import (
    POINT_INSTANCE,
    RAY_CATCHER_HIT,
    RAY_ENDS,
)
from engine.state.lights import HEADER_HITTABLE
from engine.state.media import EMISSION, EXTINCTION
from engine.wavefront.columns import (
    MAJORANTS_EXCEEDED,
    MEDIUM_REJECTS,
    SCENE_HAS_HITTABLE_LIGHTS,
    TRACKING_ENDED,
    UNIT_FOLLOWS,
)


@kernel
def _pick_lamp(scene, work, lane):
    """Pick one of the lamps on the ray, whose light is seen through what the ray has passed by then."""
    lights, paths, tracking = scene.lights, work.paths, work.tracking
    origin, direction = load(paths.mis_origin, lane), load(paths.direction, lane)
    before = paths.mis_distance[lane]
    count = 0
    u = np.float32(0.0)
    for lamp in range(lights.header[HEADER_HITTABLE]):
        distance = lamp_hit(lights, lamp, origin, direction, before, before + paths.hit_distance[lane])
        if distance < 0.0:
            continue
        count += 1
        if count == 2:
            # The first one takes no number.
            _, _, _, u = track_4(paths.rng[lane], paths.sample[lane], paths.dimension[lane] + SET_MEDIUM, 0)
        # The newest of n is taken with a probability of 1 / n.
        u *= np.float32(count)
        if u < 1.0:
            tracking.lamp[lane] = lamp
            tracking.lamp_distance[lane] = distance - before
        else:
            u = (u - 1.0) / np.float32(count - 1)
    tracking.lamp_count[lane] = count


@kernel
def begin_tracking(scene, unit, work, queue):
    """Put those lanes into `work.tracked` that media which vary lie before.

    Parameters
    ----------
    queue : LaneQueue
        `work.traced`.
    """
    paths, media, tracking = work.paths, work.media, work.tracking
    follows, has_lamps = unit.header[UNIT_FOLLOWS] != 0, scene.header[SCENE_HAS_HITTABLE_LIGHTS] != 0
    tracked, count = work.tracked.lanes, 0
    for k in range(queue.count[0]):
        lane = queue.lanes[k]
        tracking.is_tracked[lane] = 0
        if follows and paths.flags[lane] & RAY_CATCHER_HIT:
            continue
        is_endless = paths.hit_instance[lane] < 0
        if is_endless:
            leave_objects(media, lane)
        if not any_varies(scene.media, media, lane):
            continue
        tracking.is_tracked[lane] = 1
        tracking.position[lane] = 0.0
        tracking.end[lane] = DISTANT if is_endless else length_in_media(paths, media, lane)
        tracking.collision[lane] = -1.0
        tracking.step[lane] = 0
        tracking.lamp[lane] = -1
        for c in range(len(paths.channels)):
            tracking.weight[lane, c] = 1.0
            tracking.emitted[lane, c] = 0.0
            tracking.lamp_weight[lane, c] = 0.0
        if has_lamps:
            _pick_lamp(scene, work, lane)
        tracked[count] = lane
        count += 1
    work.tracked.count[0] = count


@kernel
def _pass_leg(scene, work, lane, start, end):
    """Note what a ray's lamp is seen through, and add what media that are the same everywhere emit, on a leg of it.

    Where the ray may collide next is drawn by chance, so the length of the leg stands for the integral.
    """
    paths, media, tracking = work.paths, work.media, work.tracking
    if tracking.lamp[lane] >= 0 and start <= tracking.lamp_distance[lane] < end:
        for c in range(len(paths.channels)):
            tracking.lamp_weight[lane, c] = tracking.weight[lane, c]
    if media.count[lane] > 1:
        sum_coefficients(scene, paths, media, lane, lane, False)
        for c in range(len(paths.channels)):
            emission = media.coefficients[EMISSION, c]
            if emission > 0.0:
                tracking.emitted[lane, c] += tracking.weight[lane, c] * emission * (end - start)


@kernel
def find_collisions(scene, unit, work, queue):
    """Take every ray to where a medium may collide with it; where that one varies, `work.light_points` is the point.

    Parameters
    ----------
    queue : LaneQueue
        `work.tracked`: rays that have reached their end leave it.
    """
    paths, media, tracking, points = work.paths, work.media, work.tracking, work.light_points
    lanes, kept = queue.lanes, 0
    for k in range(queue.count[0]):
        lane = lanes[k]
        origin, direction, time = load(paths.origin, lane), load(paths.direction, lane), paths.time[lane]
        may_scatter = paths.flags[lane] & RAY_ENDS == 0
        while True:
            step = tracking.step[lane]
            start = tracking.position[lane]
            u_choice, u_distance, u_event, u_roulette = track_4(
                paths.rng[lane], paths.sample[lane], paths.dimension[lane] + SET_MEDIUM, step
            )
            t, entry, majorant = next_collision(
                scene, paths, media, lane, origin, direction, time, start, tracking.end[lane], u_distance, u_choice,
                True,
            )
            _pass_leg(scene, work, lane, start, t)
            if entry < 0:
                break
            tracking.position[lane] = t
            tracking.step[lane] = step + 1
            tracking.chosen[lane] = entry
            tracking.majorant[lane] = majorant
            if step >= MOST_STEPS:
                work.counts[TRACKING_ENDED] += 1
                for c in range(len(paths.channels)):
                    tracking.weight[lane, c] = 0.0
                break
            program = scene.media.program[media.medium[lane, entry]]
            if program >= 0:
                tracking.u_event[lane] = u_event
                tracking.u_roulette[lane] = u_roulette
                p = add(origin, scale(direction, t))
                place_in_medium(
                    paths, lane, points, lane, media.instance[lane, entry], program, p, direction, t,
                    paths.flags[lane], paths.transparent_depth[lane],
                )
                lanes[kept] = lane
                kept += 1
                break
            read_uniform(scene, paths, lane, media.medium[lane, entry], media.coefficients)
            event = meet_medium(
                paths, lane, tracking, lane, majorant, media.coefficients, may_scatter, u_event, u_roulette
            )
            if event == COLLIDES:
                tracking.collision[lane] = t
            if event != GOES_ON:
                break
    queue.count[0] = kept


@kernel
def meet_media(scene, unit, work, queue):
    """Let rays collide, or go on, by what `evaluate_shaders` has left in `work.light_shaded`.

    Phase functions of a collision stay there until `prepare_collisions` takes them.

    Parameters
    ----------
    queue : LaneQueue
        `work.tracked`: rays that have collided, or have no light left, leave it.
    """
    paths, tracking, sums = work.paths, work.tracking, work.media.coefficients
    lanes, kept = queue.lanes, 0
    for k in range(queue.count[0]):
        lane = lanes[k]
        instance = work.light_points.integer[lane, POINT_INSTANCE]
        if not read_medium(scene, paths, lane, work.light_shaded, lane, instance, sums):
            work.counts[MEDIUM_REJECTS] += 1
        majorant = tracking.majorant[lane]
        is_denser = False
        for c in range(len(paths.channels)):
            tracking.emitted[lane, c] += tracking.weight[lane, c] * sums[EMISSION, c] / majorant
            is_denser = is_denser or sums[EXTINCTION, c] > majorant
        if is_denser:
            work.counts[MAJORANTS_EXCEEDED] += 1
        may_scatter = paths.flags[lane] & RAY_ENDS == 0
        event = meet_medium(
            paths, lane, tracking, lane, majorant, sums, may_scatter, tracking.u_event[lane], tracking.u_roulette[lane]
        )
        if event == COLLIDES:
            tracking.collision[lane] = tracking.position[lane]
        if event == GOES_ON:
            lanes[kept] = lane
            kept += 1
    queue.count[0] = kept
