# SPDX-License-Identifier: GPL-3.0-or-later
"""Stages: what media leave of light samples. They run only in scenes that have media.

They go along the shadow rays from boundary to boundary, whatever stands between; surfaces in their way come after.
Where media vary in space this takes turns, as in `engine.wavefront.track_media`.
"""

from engine.accel.masks import CATCHER_MASK_SHIFT, MASK_MEDIUM, MASK_SHADOW_OPAQUE
from engine.accel.passing import prepare_filters, read_boundary, trace_boundaries
from engine.accel.ray_words import MOST_BOUNDARIES
from engine.accel.rays import read_hit, trace_closest_from, trace_occluded_from
from engine.kernels.constants import DISTANT, FAR
from engine.kernels.exponential import decay
from engine.kernels.lights import casts_shadow, links_shadows
from engine.kernels.media import add_depth, attenuate, copy_media, cross_boundary, leave_objects
from engine.kernels.path import ends_on_light, real_3
from engine.kernels.prefetch import ask_for_media, ask_for_point
from engine.kernels.rng import SET_SHADOW_MEDIUM, track_4
from engine.kernels.surface import gap_before, offset_origin, program_of, surface_point
from engine.kernels.tracking import MOST_STEPS, next_collision, place_in_medium, read_medium, survives
from engine.kernels.vector import add, dot, load, scale, store
from engine.runtime.jit import kernel
from engine.scene.description import VISIBLE_SHADOW
from engine.state.geometry import INSTANCE_VISIBILITY
from engine.state.lanes import (
    LIGHT_CASTS_SHADOW,
    LIGHT_IS_LAMP,
    POINT_FLAG_BACKFACING,
    POINT_FLAGS,
    POINT_INSTANCE,
    POINT_NG,
    POINT_PROGRAM,
    RAY_CATCHER_HIT,
    RAY_SHADOW,
)
from engine.state.media import CHANNEL_WEIGHT, EXTINCTION, MOST_CROSSINGS
from engine.state.shaders import PROGRAM_FLAGS, PROGRAM_IS_BOUNDARY
from engine.wavefront.columns import (
    MAJORANTS_EXCEEDED,
    MEDIA_DROPPED,
    MEDIUM_REJECTS,
    SCENE_HANDLE,
    SCENE_HAS_BOUNDARIES,
    SCENE_HAS_DENSE_MEDIA,
    SCENE_HAS_TRANSPARENT_SHADOWS,
    SCENE_MASK_HANDLE,
    SHADOW_ROWS,
    TRACKING_ENDED,
    TRANSPARENT_SHADOW_RAYS,
    UNIT_FOLLOWS,
)
from engine.wavefront.ray_ends import name_ends

_ROWS_AHEAD = 4
#: Searches for the boundaries on one shadow ray; one is enough unless there are more than MOST_BOUNDARIES.
_MOST_SEARCHES = 64


@kernel
def _leave_point(scene, work, lane, row, direction):
    """Make row `row` what the shadow ray of a lane starts in."""
    points, media = work.points, work.media
    copy_media(media, lane, row)
    program = points.integer[lane, POINT_PROGRAM]
    if program < 0 or dot(direction, real_3(points, lane, POINT_NG)) >= 0.0:
        return
    medium = scene.media.of_program[program]
    is_back = points.integer[lane, POINT_FLAGS] & POINT_FLAG_BACKFACING != 0
    if medium >= 0 and not cross_boundary(media, row, points.integer[lane, POINT_INSTANCE], medium, is_back):
        work.counts[MEDIA_DROPPED] += 1


@kernel
def _stops_light(scene, instance, triangle):
    """Whether what a shadow ray has met is opaque, in a scene where what casts shadows is either that or a boundary."""
    casts = scene.geometry.instance_table[instance, INSTANCE_VISIBILITY] & VISIBLE_SHADOW != 0
    flags = scene.shaders.programs[program_of(scene.geometry, instance, triangle), PROGRAM_FLAGS]
    return casts and flags & PROGRAM_IS_BOUNDARY == 0


@kernel
def _next_boundary(scene, work, lane, origin, direction, rest, time):
    """Find the next boundary of media on a shadow ray: whether there is one, and what `read_hit` says of it."""
    work.counts[TRANSPARENT_SHADOW_RAYS] += 1
    name_ends(scene, work, lane)
    hit = trace_closest_from(
        scene.header[SCENE_HANDLE], work.ray, work.ray_bits, work.ray_address[0], origin, direction, 0.0, rest, time,
        MASK_MEDIUM,
    )
    if not hit:
        return False, -1, -1, rest, 0.0, 0.0
    instance, triangle, distance, u, v = read_hit(work.ray, work.ray_bits, scene.geometry)
    return True, int(instance), int(triangle), distance, u, v


@kernel
def _meet(scene, direction, instance, triangle, u, v, time):
    """A boundary that a shadow ray has met: point, normal, error, and how far before it the media end (`find_gaps`)."""
    p, ng, _ns, error = surface_point(scene.geometry, instance, triangle, u, v, time)
    gap = 0.0
    if scene.header[SCENE_HAS_DENSE_MEDIA] != 0:
        gap = gap_before(scene.geometry, instance, ng, direction, error)
    return p, ng, error, gap


@kernel
def _length_beyond(scene, work, lane):
    """How far media go on behind the end of a shadow ray [m], which ends before its light by a rounding error.

    Before a surface that glows they end where they end for rays that are scattered there (`find_gaps`). Lamps are no
    surfaces, and in dense media their light is dimmed on that last bit too. What ends in place leaves none.
    """
    flags, lamp = work.samples.flags[lane], LIGHT_IS_LAMP | LIGHT_CASTS_SHADOW
    if scene.header[SCENE_HAS_DENSE_MEDIA] == 0 or flags & lamp != lamp or ends_on_light(work.paths, lane, flags):
        return 0.0 * work.samples.offset[lane]
    return work.samples.offset[lane]


@kernel
def _cross(scene, work, lane, row, instance, triangle, is_back):
    """Take row `row` of the media, those of a lane's shadow ray, through a boundary.

    What casts no shadow in the light is not entered, as in Cycles.
    """
    geometry = scene.geometry
    if not is_back and not casts_shadow(scene.lights, work.samples.emitter[lane], instance):
        return
    medium = scene.media.of_program[program_of(geometry, instance, triangle)]
    if medium >= 0 and geometry.instance_table[instance, INSTANCE_VISIBILITY] & VISIBLE_SHADOW:
        if not cross_boundary(work.media, row, instance, medium, is_back):
            work.counts[MEDIA_DROPPED] += 1


@kernel
def _end_ray(work, row, is_blocked):
    """Spare `intersect_shadow` a shadow ray of which it is known whether something opaque hides its light."""
    work.shadows.distance[row] = 0.0
    if is_blocked:
        for c in range(len(work.paths.channels)):
            work.shadows.radiance[row, c] = 0.0


@kernel
def _pass_boundaries(scene, work, lane, row, own, rest, beyond, mask):
    """Dim the light of a shadow ray by the media on its way, and find out whether it meets anything else.

    Parameters
    ----------
    own : int
        Row of the media that it starts in.
    rest, beyond : float32 [m]
        To the end of the ray, and further to the light.
    mask : int
        MASK_MEDIUM, and MASK_SHADOW_OPAQUE besides to find what is opaque too.

    Returns
    -------
    bool
        False: it meets something opaque.
    """
    paths, media, shadows, geometry = work.paths, work.media, work.shadows, scene.geometry
    ray, bits, depths = work.ray, work.ray_bits, work.media.coefficients
    origin, direction, time = load(shadows.origin, row), load(shadows.direction, row), paths.time[lane]
    is_dense, sees_opaque = scene.header[SCENE_HAS_DENSE_MEDIA] != 0, mask != MASK_MEDIUM
    name_ends(scene, work, lane)
    for c in range(len(paths.channels)):
        depths[CHANNEL_WEIGHT, c] = 0.0
    near, far, passed = 0.0, rest, 0.0
    for search in range(_MOST_SEARCHES):
        work.counts[TRANSPARENT_SHADOW_RAYS] += 1
        count = trace_boundaries(
            scene.header[SCENE_HANDLE], ray, bits, work.ray_address[0], origin, direction, near, far, time, mask
        )
        if count < 0:
            return False
        if count > MOST_BOUNDARIES and search < _MOST_SEARCHES // 2:
            # Those that were kept may be any: look again on a part of the way.
            _, _, middle, _, _, _ = read_boundary(ray, bits, geometry, MOST_BOUNDARIES // 2)
            if near < middle < far:
                far = middle
                continue
        for k in range(min(count, MOST_BOUNDARIES)):
            instance, triangle, distance, u, v, is_back = read_boundary(ray, bits, geometry, k)
            if sees_opaque and _stops_light(scene, instance, triangle):
                return False
            gap = 0.0
            if is_dense:
                _, _, _, gap = _meet(scene, direction, instance, triangle, u, v, time)
            add_depth(scene, paths, media, lane, own, max(distance - gap - passed, 0.0))
            passed = distance + gap
            _cross(scene, work, lane, own, instance, triangle, is_back)
        if not far < rest:
            break
        near, far = far, rest
    add_depth(scene, paths, media, lane, own, max(rest + beyond - passed, 0.0) if rest < FAR else DISTANT)
    for c in range(len(paths.channels)):
        shadows.radiance[row, c] *= decay(depths[CHANNEL_WEIGHT, c])
    return True


@kernel
def attenuate_shadows(scene, unit, work, queue):
    """Multiply the light of all shadow rays by the transmittance on their way.

    Lights without shadows are not dimmed, as in Cycles. Where nothing is transparent a ray looks for boundaries and for
    what is opaque at once, as paths do, and `intersect_shadow` need not look again.

    Parameters
    ----------
    queue : LaneQueue
        Not looked at: rows of `work.shadows` are in use.
    """
    paths, shadows, media = work.paths, work.shadows, work.media
    has_boundaries, follows = scene.header[SCENE_HAS_BOUNDARIES] != 0, unit.header[UNIT_FOLLOWS] != 0
    own = media.count.shape[0] - 1
    settles = has_boundaries and not follows and scene.header[SCENE_HAS_TRANSPARENT_SHADOWS] == 0
    settles = settles and not links_shadows(scene.lights)
    row_count = work.counts[SHADOW_ROWS]
    prepare_filters(work.ray_bits, scene.header[SCENE_MASK_HANDLE], scene.geometry.instance_table.shape[0])
    for row in range(row_count):
        lane = shadows.lane[row]
        ahead = shadows.lane[min(row + _ROWS_AHEAD, row_count - 1)]
        ask_for_media(media, ahead)
        ask_for_point(work.points, ahead)
        rest, beyond = shadows.distance[row], _length_beyond(scene, work, lane)
        if not rest + beyond > 0.0 or (follows and paths.flags[lane] & RAY_CATCHER_HIT):
            continue
        _leave_point(scene, work, lane, own, load(shadows.direction, row))
        if not has_boundaries or not rest > 0.0:
            attenuate(scene, paths, media, lane, own, rest + beyond, shadows.radiance, row)
            continue
        mask = MASK_MEDIUM | MASK_SHADOW_OPAQUE if settles else MASK_MEDIUM
        passes = _pass_boundaries(scene, work, lane, row, own, rest, beyond, mask)
        if settles or not passes:
            _end_ray(work, row, not passes)


@kernel
def _set_leg(tracking, own, instance, triangle, distance, u, v):
    """Note the next boundary of a shadow ray, instance -1: there is none before `distance`."""
    tracking.instance[own] = instance
    tracking.position[own] = distance
    tracking.triangle[own] = triangle
    tracking.u[own] = u
    tracking.v[own] = v


@kernel
def _look_for_leg(scene, work, row, own):
    """Find the next boundary on a shadow ray, if there may be any."""
    paths, shadows, tracking = work.paths, work.shadows, work.tracking
    rest = tracking.rest[own]
    hit, instance, triangle, distance, u, v = False, -1, -1, rest, 0.0, 0.0
    if tracking.chosen[own] > 0 and rest > 0.0:
        hit, instance, triangle, distance, u, v = _next_boundary(
            scene, work, shadows.lane[row], load(tracking.origin, own), load(shadows.direction, row), rest,
            paths.time[shadows.lane[row]],
        )
        tracking.chosen[own] -= 1
    _set_leg(tracking, own, instance, triangle, distance, u, v)


@kernel
def _look_along(scene, work, row, own, mask):
    """Find the first boundary on a shadow ray and how many there are; False: it meets something opaque.

    Parameters
    ----------
    mask : int
        As of `_pass_boundaries`.
    """
    paths, shadows, tracking = work.paths, work.shadows, work.tracking
    rest, time = tracking.rest[own], paths.time[shadows.lane[row]]
    origin, direction = load(tracking.origin, own), load(shadows.direction, row)
    _set_leg(tracking, own, -1, -1, rest, 0.0, 0.0)
    tracking.chosen[own] = 0
    if scene.header[SCENE_HAS_BOUNDARIES] == 0 or not rest > 0.0:
        return True
    work.counts[TRANSPARENT_SHADOW_RAYS] += 1
    name_ends(scene, work, shadows.lane[row])
    count = trace_boundaries(
        scene.header[SCENE_HANDLE], work.ray, work.ray_bits, work.ray_address[0], origin, direction, 0.0, rest, time,
        mask,
    )
    kept = min(count, MOST_BOUNDARIES)
    if mask != MASK_MEDIUM:
        if count < 0:
            return False
        for k in range(kept):
            instance, triangle, _, _, _, _ = read_boundary(work.ray, work.ray_bits, scene.geometry, k)
            if _stops_light(scene, instance, triangle):
                return False
    if kept > 0:
        instance, triangle, distance, u, v, _ = read_boundary(work.ray, work.ray_bits, scene.geometry, 0)
        tracking.chosen[own] = count - 1
        _set_leg(tracking, own, instance, triangle, distance, u, v)
    if count > kept:
        # Those that were kept may be any.
        if mask != MASK_MEDIUM and trace_occluded_from(
            scene.header[SCENE_HANDLE], work.ray, work.ray_bits, work.ray_address[0], origin, direction, 0.0, rest,
            time, mask & ~MASK_MEDIUM,
        ):
            return False
        tracking.chosen[own] = count
        _look_for_leg(scene, work, row, own)
    return True


@kernel
def _start_leg(scene, work, row, own):
    """Dim a shadow ray's light by the media before what `_look_for_leg` has found that are the same everywhere."""
    paths, shadows, tracking = work.paths, work.shadows, work.tracking
    lane, instance, distance = shadows.lane[row], tracking.instance[own], tracking.position[own]
    if instance >= 0:
        _p, _ng, _error, gap = _meet(
            scene, load(shadows.direction, row), instance, tracking.triangle[own], tracking.u[own], tracking.v[own],
            paths.time[lane],
        )
        distance = max(distance - gap, 0.0)
    else:
        distance += _length_beyond(scene, work, lane)
    tracking.position[own] = 0.0
    tracking.end[own] = distance
    attenuate(scene, paths, work.media, lane, own, distance, shadows.radiance, row)
    if distance >= FAR:
        leave_objects(work.media, own)


@kernel
def begin_shadows(scene, unit, work, queue):
    """Put the shadow rays into the queue that have light and nothing opaque in their way.

    Runs in place of `attenuate_shadows` where media vary.

    Parameters
    ----------
    queue : LaneQueue
        `work.tracked`: rows of `work.shadows`, whose media and tracked lanes lie behind those of all paths.
    """
    paths, shadows, tracking = work.paths, work.shadows, work.tracking
    follows, first = unit.header[UNIT_FOLLOWS] != 0, tracking.rest.shape[0] // 2
    opaque = MASK_SHADOW_OPAQUE << (CATCHER_MASK_SHIFT if follows else 0)
    settles = scene.header[SCENE_HAS_TRANSPARENT_SHADOWS] == 0 and not links_shadows(scene.lights)
    # Then one look is enough, for what is opaque and for boundaries.
    looks_once = settles and not follows and scene.header[SCENE_HAS_BOUNDARIES] != 0
    mask = MASK_MEDIUM | opaque if looks_once else MASK_MEDIUM
    prepare_filters(work.ray_bits, scene.header[SCENE_MASK_HANDLE], scene.geometry.instance_table.shape[0])
    kept = 0
    for row in range(work.counts[SHADOW_ROWS]):
        lane = shadows.lane[row]
        rest = shadows.distance[row]
        if not rest + _length_beyond(scene, work, lane) > 0.0 or (follows and paths.flags[lane] & RAY_CATCHER_HIT):
            continue
        own = first + row
        direction = load(shadows.direction, row)
        store(tracking.origin, own, load(shadows.origin, row))
        tracking.rest[own] = rest
        # Following a ray costs far more than finding out that something hides the light.
        name_ends(scene, work, lane)
        is_hidden = not looks_once and rest > 0.0 and trace_occluded_from(
            scene.header[SCENE_HANDLE], work.ray, work.ray_bits, work.ray_address[0], load(shadows.origin, row),
            direction, 0.0, rest, paths.time[lane], opaque,
        )
        if is_hidden or not _look_along(scene, work, row, own, mask):
            _end_ray(work, row, True)
            continue
        _leave_point(scene, work, lane, own, direction)
        tracking.step[own] = 0
        work.media.crossings[own] = 0
        for c in range(len(paths.channels)):
            tracking.weight[own, c] = 1.0
        _start_leg(scene, work, row, own)
        if settles:
            _end_ray(work, row, False)
        queue.lanes[kept] = row
        kept += 1
    queue.count[0] = kept


@kernel
def _end_shadow(work, row, own):
    """Give a shadow ray's light what is left of it."""
    for c in range(len(work.paths.channels)):
        work.shadows.radiance[row, c] *= work.tracking.weight[own, c]


@kernel
def find_shadow_collisions(scene, unit, work, queue):
    """Take every shadow ray to where a medium that varies may collide with it, through all boundaries on the way.

    Parameters
    ----------
    queue : LaneQueue
        As `begin_shadows` has left it; rays that have arrived leave it. `work.light_points` are points to look up.
    """
    paths, shadows, media, tracking = work.paths, work.shadows, work.media, work.tracking
    lanes, kept, first = queue.lanes, 0, tracking.rest.shape[0] // 2
    for k in range(queue.count[0]):
        row = lanes[k]
        own, lane = first + row, shadows.lane[row]
        direction, time = load(shadows.direction, row), paths.time[lane]
        u_choice, u_distance, u_roulette, _ = track_4(
            paths.rng[lane], paths.sample[lane], paths.dimension[lane] + SET_SHADOW_MEDIUM, tracking.step[own]
        )
        waits = False
        while True:
            origin = load(tracking.origin, own)
            t, entry, majorant = next_collision(
                scene, paths, media, own, origin, direction, time, tracking.position[own], tracking.end[own],
                u_distance, u_choice, False,
            )
            if entry >= 0:
                tracking.position[own] = t
                tracking.majorant[own] = majorant
                tracking.u_roulette[own] = u_roulette
                waits = tracking.step[own] < MOST_STEPS
                instance = media.instance[own, entry]
                place_in_medium(
                    paths, lane, work.light_points, row, instance, scene.media.program[media.medium[own, entry]],
                    add(origin, scale(direction, t)), direction, t, RAY_SHADOW,
                    # Shadow rays count boundaries of media too, as in Cycles. Surfaces within them are not known here.
                    paths.transparent_depth[lane] + media.crossings[own],
                )
                if not waits:
                    work.counts[TRACKING_ENDED] += 1
                    for c in range(len(paths.channels)):
                        tracking.weight[own, c] = 0.0
                break
            instance = tracking.instance[own]
            media.crossings[own] += 1
            if instance < 0 or media.crossings[own] > MOST_CROSSINGS:
                break
            rest = tracking.rest[own]
            triangle = tracking.triangle[own]
            p, ng, error, gap = _meet(
                scene, direction, instance, triangle, tracking.u[own], tracking.v[own], time
            )
            tracking.rest[own] = rest - (tracking.end[own] + gap) if rest < FAR else DISTANT
            _cross(scene, work, lane, own, instance, triangle, dot(ng, direction) > 0.0)
            store(tracking.origin, own, offset_origin(p, ng, direction, error))
            _look_for_leg(scene, work, row, own)
            _start_leg(scene, work, row, own)
            # A new leg, new numbers.
            tracking.step[own] += 1
            u_choice, u_distance, u_roulette, _ = track_4(
                paths.rng[lane], paths.sample[lane], paths.dimension[lane] + SET_SHADOW_MEDIUM, tracking.step[own]
            )
        if waits:
            lanes[kept] = row
            kept += 1
        else:
            _end_shadow(work, row, own)
    queue.count[0] = kept


@kernel
def dim_shadows(scene, unit, work, queue):
    """Dim shadow rays by what `evaluate_shaders` has left in `work.light_shaded` (ratio tracking).

    Parameters
    ----------
    queue : LaneQueue
        Those that `find_shadow_collisions` has left; rays without light leave it.
    """
    paths, shadows, tracking, sums = work.paths, work.shadows, work.tracking, work.media.coefficients
    lanes, kept, first = queue.lanes, 0, tracking.rest.shape[0] // 2
    for k in range(queue.count[0]):
        row = lanes[k]
        own, lane = first + row, shadows.lane[row]
        instance = work.light_points.integer[row, POINT_INSTANCE]
        if not read_medium(scene, paths, lane, work.light_shaded, row, instance, sums):
            work.counts[MEDIUM_REJECTS] += 1
        majorant = tracking.majorant[own]
        is_denser = False
        left, whole = 0.0, 0.0
        for c in range(len(paths.channels)):
            tracking.weight[own, c] *= 1.0 - sums[EXTINCTION, c] / majorant
            is_denser = is_denser or sums[EXTINCTION, c] > majorant
            left += abs(shadows.radiance[row, c] * tracking.weight[own, c])
            whole += abs(shadows.radiance[row, c])
        if is_denser:
            work.counts[MAJORANTS_EXCEEDED] += 1
        tracking.step[own] += 1
        is_left = left > 0.0 and survives(
            tracking.weight, own, len(paths.channels), left, whole, tracking.u_roulette[own]
        )
        if is_left:
            lanes[kept] = row
            kept += 1
            continue
        for c in range(len(paths.channels)):
            tracking.weight[own, c] = 0.0
        _end_shadow(work, row, own)
    queue.count[0] = kept
