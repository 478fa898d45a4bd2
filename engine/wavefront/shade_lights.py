# SPDX-License-Identifier: GPL-3.0-or-later
"""Stage: light of lamps that a ray crosses before its closest surface, and of suns where it leaves the scene.

Lamps do not stop rays: each one crossed adds its light. As in Cycles, camera rays see the lamps that are visible to the
camera, other rays only those with multiple importance sampling; suns without it are never seen. Those whose emission
a program tells have stages of their own, around `evaluate_shaders`.
"""

import numpy as np

from engine.kernels.clamping import Unguided, found_alone
from engine.kernels.constants import DISTANT, FAR
from engine.kernels.lights import (
    Receiver,
    distant_lamp_is_hit,
    distant_lamp_leaving,
    distant_lamp_pdf,
    is_seen_by,
    lamp_emitter,
    lamp_hit,
    lamp_is_hidden,
    lamp_leaving,
    lamp_pdf,
    lamp_place,
    lamp_shines,
    tree_of_ray,
)
from engine.kernels.media import attenuate
from engine.kernels.path_depths import store_depths
from engine.kernels.prefetch import ask_for_history, ask_for_ray, ask_for_throughput, lane_ahead
from engine.kernels.radiance import add_found, add_seen, weigh_found
from engine.kernels.spectrum import upsample_light
from engine.kernels.vector import load
from engine.runtime.jit import kernel
from engine.state.film import FEATURE_EMISSION
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
    RAY_MIS_HAD_TRANSMISSION,
    RAY_MIS_SKIP,
    RGB,
)
from engine.state.lights import (
    HEADER_FIRST_DISTANT,
    HEADER_HITTABLE,
    HEADER_LAST_DISTANT,
    LAMP_ESTIMATE,
    LAMP_FLAG_MIS,
    LAMP_FLAGS,
    LAMP_LIGHT_GROUP,
    LAMP_PROGRAM,
    LAMP_RADIANCE,
    LAMP_TEMPERATURE,
    LAMP_VISIBILITY,
)
from engine.wavefront.columns import SCENE_HAS_MEDIA, SCENE_HAS_VARYING_MEDIA, UNIT_USE_DENOISING, UNIT_USE_FEATURES


@kernel
def _see_through(work, lane, row, distance):
    """Multiply a lamp's light in `work.f_cos` by what the ray that was tracked to it has left there.

    One lamp on the way was picked, and stands for all; a sun is behind everything, where the ray has not collided.
    """
    tracking, scratch = work.tracking, work.f_cos
    for c in range(len(work.paths.channels)):
        factor = 0.0
        if distance >= FAR:
            factor = tracking.weight[lane, c] if tracking.collision[lane] < 0.0 else 0.0
        elif tracking.lamp[lane] == row:
            factor = tracking.lamp_weight[lane, c] * np.float32(tracking.lamp_count[lane])
        scratch[lane, c] *= factor


@kernel
def _add(scene, unit, work, lane, row, distance, unguided):
    """Add row `lane` of `work.f_cos`, what is seen of a lamp, clamped like all light found, and show it in passes.

    `distance` is that from the ray's origin, which media may lie on.
    """
    spectrum, paths, scratch = scene.spectrum, work.paths, work.f_cos
    if scene.header[SCENE_HAS_VARYING_MEDIA] != 0 and work.tracking.is_tracked[lane] != 0:
        _see_through(work, lane, row, distance)
    elif scene.header[SCENE_HAS_MEDIA] != 0:
        attenuate(scene, paths, work.media, lane, lane, distance, scratch, lane)
    share = add_found(
        scene.options, spectrum, paths, work.passes, lane, scratch, unguided,
        scene.lights.lamp_table[row, LAMP_LIGHT_GROUP], unit.film, FEATURE_EMISSION,
        unit.header[UNIT_USE_FEATURES] != 0,
    )
    if unit.header[UNIT_USE_DENOISING] != 0:
        add_seen(spectrum, paths, work.features, lane, scratch, share, unit.film)


@kernel
def _write_radiance(scene, paths, lane, row, factor, out):
    """Write a lamp's radiance times `factor` and throughput into row `lane` of `out`, without what its program says."""
    lamps = scene.lights.lamps
    for c in range(RGB):
        out[lane, c] = lamps[row, LAMP_RADIANCE + c]
        if scene.lights.lamp_table[row, LAMP_PROGRAM] < 0:
            out[lane, c] *= lamps[row, LAMP_ESTIMATE + c]
    if len(paths.channels) > RGB:
        upsample_light(
            scene.spectrum, paths, lane, out[lane, 0], out[lane, 1], out[lane, 2], lamps[row, LAMP_TEMPERATURE], out,
            lane,
        )
    for c in range(len(paths.channels)):
        out[lane, c] *= factor * paths.throughput[lane, c]


@kernel
def shade_lights(scene, unit, work, queue):
    """Add the light of lamps and suns to rays that `intersect_closest` has traced, MIS-weighted.

    The hit and its density are found from `mis_origin`, where the light sample they are weighed against was drawn;
    transparent surfaces since then only move the range of distances (`mis_distance`, `hit_distance`). Without
    light sampling (`use_nee` 0) every lamp counts whole, those without multiple importance sampling included.
    """
    lights, options, paths = scene.lights, scene.options, work.paths
    lanes, lane_count = queue.lanes, queue.count[0]
    hittable_count = lights.header[HEADER_HITTABLE]
    first_distant = lights.header[HEADER_FIRST_DISTANT]
    last_distant = lights.header[HEADER_LAST_DISTANT]
    if hittable_count == 0 and first_distant == last_distant:
        return
    for k in range(lane_count):
        lane = lanes[k]
        ahead = lane_ahead(lanes, k, lane_count)
        ask_for_ray(paths, ahead)
        ask_for_throughput(paths, ahead)
        ask_for_history(paths, ahead)
        flags = paths.flags[lane]
        is_camera = flags & RAY_CAMERA
        counts_whole = options.use_nee == 0 or (flags & RAY_MIS_SKIP) != 0
        had_transmission = (flags & RAY_MIS_HAD_TRANSMISSION) != 0
        origin = load(paths.mis_origin, lane)
        tree = tree_of_ray(lights, flags)
        receiver = Receiver(origin, load(paths.mis_normal, lane), had_transmission, False, tree)
        wi = load(paths.direction, lane)
        t_min = paths.mis_distance[lane]
        t_max = t_min + paths.hit_distance[lane]
        for row in range(hittable_count):
            if not (lights.lamp_table[row, LAMP_FLAGS] & LAMP_FLAG_MIS or is_camera or options.use_nee == 0):
                continue
            if lights.lamp_table[row, LAMP_PROGRAM] >= 0:
                # `meet_varying_lamps` does that.
                continue
            if not is_seen_by(flags, lights.lamp_table[row, LAMP_VISIBILITY]) or not lamp_shines(lights, flags, row):
                continue
            if options.use_nee != 0 and not is_camera and lamp_is_hidden(lights, row):
                continue
            distance = lamp_hit(lights, row, origin, wi, t_min, t_max)
            if distance < 0.0:
                continue
            factor = lamp_leaving(lights, row, origin, wi)
            if not factor > 0.0:
                continue
            unguided = found_alone(paths.unguided[lane])
            if not counts_whole:
                pdf = lamp_pdf(lights, row, receiver, wi, distance)
                emitter = lamp_emitter(lights, tree, row)
                weight, unguided = weigh_found(options, lights, paths, lane, emitter, False, pdf)
                factor *= weight
            _write_radiance(scene, paths, lane, row, factor, work.f_cos)
            _add(scene, unit, work, lane, row, distance - t_min, unguided)
        if first_distant == last_distant or paths.hit_instance[lane] >= 0:
            continue
        for row in range(first_distant, last_distant):
            if not (lights.lamp_table[row, LAMP_FLAGS] & LAMP_FLAG_MIS or options.use_nee == 0):
                continue
            if lights.lamp_table[row, LAMP_PROGRAM] >= 0:
                continue
            if not is_seen_by(flags, lights.lamp_table[row, LAMP_VISIBILITY]) or not lamp_shines(lights, flags, row):
                continue
            if options.use_nee != 0 and lamp_is_hidden(lights, row):
                # As in Cycles, not even the camera sees it.
                continue
            if not distant_lamp_is_hit(lights, row, origin, wi, t_min):
                continue
            factor = distant_lamp_leaving(lights, row, origin, wi)
            unguided = found_alone(paths.unguided[lane])
            if not counts_whole:
                pdf = distant_lamp_pdf(lights, row, receiver, wi)
                emitter = lamp_emitter(lights, tree, row)
                weight, unguided = weigh_found(options, lights, paths, lane, emitter, False, pdf)
                factor *= weight
            _write_radiance(scene, paths, lane, row, factor, work.f_cos)
            _add(scene, unit, work, lane, row, DISTANT, unguided)


@kernel
def _distance(lights, row, origin, wi, t_min, t_max, is_endless):
    """How far away a ray meets a lamp, -1 = not; DISTANT of one that is infinitely far away."""
    if row < lights.header[HEADER_HITTABLE]:
        return lamp_hit(lights, row, origin, wi, t_min, t_max)
    if is_endless and distant_lamp_is_hit(lights, row, origin, wi, t_min):
        return DISTANT
    return np.float32(-1.0)


@kernel
def _find(lights, options, paths, lane, origin, wi):
    """One of the lamps with programs that a lane's ray crosses: row (-1 = none), distance, and how many there are."""
    flags, t_min = paths.flags[lane], paths.mis_distance[lane]
    t_max, is_camera = t_min + paths.hit_distance[lane], flags & RAY_CAMERA
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
        distance = _distance(lights, row, origin, wi, t_min, t_max, paths.hit_instance[lane] < 0)
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
    """What leaves a lamp towards a ray, MIS weight included, and how clamping sees it."""
    lights, options, flags = scene.lights, scene.options, paths.flags[lane]
    is_local = row < lights.header[HEADER_HITTABLE]
    factor = lamp_leaving(lights, row, origin, wi) if is_local else distant_lamp_leaving(lights, row, origin, wi)
    unguided = found_alone(paths.unguided[lane])
    if factor > 0.0 and options.use_nee != 0 and not flags & RAY_MIS_SKIP:
        tree = tree_of_ray(lights, flags)
        had_transmission = (flags & RAY_MIS_HAD_TRANSMISSION) != 0
        receiver = Receiver(origin, load(paths.mis_normal, lane), had_transmission, False, tree)
        if is_local:
            pdf = lamp_pdf(lights, row, receiver, wi, distance)
        else:
            pdf = distant_lamp_pdf(lights, row, receiver, wi)
        weight, unguided = weigh_found(options, lights, paths, lane, lamp_emitter(lights, tree, row), False, pdf)
        factor *= weight
    return factor, unguided


@kernel
def _place(lights, paths, points, lane, row, origin, wi, distance):
    """Set up the point of a lamp that a ray has met, for its program."""
    ng, u, v = lamp_place(lights, row, origin, wi, distance)
    real, integer = points.real, points.integer
    for c in range(3):
        real[lane, POINT_P + c] = origin[c] + distance * wi[c] if distance < FAR else wi[c]
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
        factor, unguided = _weigh(scene, paths, lane, row, origin, wi, distance)
        if not factor > 0.0:
            continue
        _write_radiance(scene, paths, lane, row, factor * np.float32(found), shadows.radiance)
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
        _add(scene, unit, work, lane, np.int64(shadows.lane[lane]), shadows.distance[lane], unguided)
