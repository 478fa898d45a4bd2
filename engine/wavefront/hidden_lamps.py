# SPDX-License-Identifier: GPL-3.0-or-later
"""Stages: light of lamps that scattered rays would meet, were it not for objects that cast no shadows in it.

A lamp with a collection of blockers shines through everything else, and so it does for rays that go towards it by
chance: each looks for such lamps along its whole way, and sends a shadow ray to one of those that it finds.
"""

import numpy as np

from engine.kernels.clamping import found_alone
from engine.kernels.constants import DISTANT, INFINITY
from engine.kernels.lights import (
    Receiver,
    distant_lamp_is_hit,
    distant_lamp_leaving,
    distant_lamp_pdf,
    is_seen_by,
    lamp_emitter,
    lamp_hit,
    lamp_leaving,
    lamp_pdf,
    lamp_shines,
    tree_of_ray,
)
from engine.kernels.path import mark_shadow
from engine.kernels.prefetch import ask_for_history, ask_for_ray, ask_for_throughput, lane_ahead
from engine.kernels.radiance import weigh_found
from engine.kernels.spectrum import upsample_light
from engine.kernels.vector import load, store
from engine.runtime.jit import kernel
from engine.state.lanes import (
    LIGHT_CASTS_SHADOW,
    LIGHT_IS_LAMP,
    RAY_CAMERA,
    RAY_MIS_HAD_TRANSMISSION,
    RAY_MIS_SKIP,
    RAY_STARTS_ON,
    RAY_SUBSURFACE,
    RAY_TRANSPARENT,
    RGB,
)
from engine.state.lights import (
    HEADER_HITTABLE,
    LAMP_ESTIMATE,
    LAMP_FLAG_MIS,
    LAMP_FLAG_SHADOW,
    LAMP_FLAGS,
    LAMP_LIGHT_GROUP,
    LAMP_PROGRAM,
    LAMP_RADIANCE,
    LAMP_TEMPERATURE,
    LAMP_VISIBILITY,
)
from engine.wavefront.columns import SHADOW_ROWS, UNIT_SPLITS_LIGHT

#: What ends a shadow ray before its lamp, by rounding.
_BEFORE = np.float32(1.0 - 1e-5)


@kernel
def _distance(lights, row, origin, wi):
    """How far away a ray meets a lamp, -1 = not; DISTANT of one that is infinitely far away."""
    if row < lights.header[HEADER_HITTABLE]:
        return lamp_hit(lights, row, origin, wi, 0.0, INFINITY)
    return DISTANT if distant_lamp_is_hit(lights, row, origin, wi, 0.0) else np.float32(-1.0)


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
        distance = _distance(lights, row, origin, wi)
        if distance < 0.0:
            continue
        count += 1
        # Each with the same probability, by one number: what is left of it is uniform again.
        u *= np.float32(count)
        if u < 1.0:
            chosen, at = row, distance
        else:
            u = (u - 1.0) / np.float32(count - 1)
    return chosen, at, count


@kernel
def _weigh(scene, paths, lane, row, origin, wi, distance):
    """What is seen of a lamp's radiance, MIS weight included, and how clamping sees it."""
    lights, flags = scene.lights, paths.flags[lane]
    is_distant = row >= lights.header[HEADER_HITTABLE]
    factor = distant_lamp_leaving(lights, row, origin, wi) if is_distant else lamp_leaving(lights, row, origin, wi)
    unguided = found_alone(paths.unguided[lane])
    if factor > 0.0 and not flags & RAY_MIS_SKIP:
        tree = tree_of_ray(lights, flags)
        had_transmission = (flags & RAY_MIS_HAD_TRANSMISSION) != 0
        receiver = Receiver(origin, load(paths.mis_normal, lane), had_transmission, False, tree)
        if is_distant:
            pdf = distant_lamp_pdf(lights, row, receiver, wi)
        else:
            pdf = lamp_pdf(lights, row, receiver, wi, distance)
        weight, unguided = weigh_found(
            scene.options, lights, paths, lane, lamp_emitter(lights, tree, row), False, pdf
        )
        factor *= weight
    return factor, unguided


@kernel
def _write_radiance(scene, paths, shadows, shadow, lane, row, factor):
    """Write a lamp's light, `factor` times, into row `shadow` of the shadow rays."""
    lamps = scene.lights.lamps
    for c in range(RGB):
        shadows.radiance[shadow, c] = lamps[row, LAMP_RADIANCE + c] * lamps[row, LAMP_ESTIMATE + c]
    if len(paths.channels) > RGB:
        upsample_light(
            scene.spectrum, paths, lane, shadows.radiance[shadow, 0], shadows.radiance[shadow, 1],
            shadows.radiance[shadow, 2], lamps[row, LAMP_TEMPERATURE], shadows.radiance, shadow,
        )
    for c in range(len(paths.channels)):
        shadows.radiance[shadow, c] *= factor * paths.throughput[lane, c]


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
        factor, unguided = _weigh(scene, paths, lane, row, origin, wi, distance)
        if not factor > 0.0:
            continue
        _write_radiance(scene, paths, shadows, shadow_count, lane, row, factor * np.float32(count))
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
