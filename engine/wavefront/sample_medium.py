# SPDX-License-Identifier: GPL-3.0-or-later
"""Stage: what media on a path's way do to it: emission, absorption, and whether it collides before it meets a surface.

Runs only in scenes that have media, and behind `shade_lights`, which sees lamps through them.
"""

import math

import numpy as np

from engine.accel.rays import trace_closest
from engine.kernels.clamping import found_alone, settle_roulette
from engine.kernels.constants import DISTANT, INFINITY
from engine.kernels.hit_prefetch import TRIANGLES_AHEAD, VERTICES_AHEAD, ask_for_triangle, ask_for_vertices
from engine.kernels.lights import lamp_hit, medium_shines
from engine.kernels.media import (
    cross_boundary,
    emitted_length,
    last_medium,
    leave_objects,
    length_in_media,
    sum_coefficients,
    transmittance,
    weigh_channels,
)
from engine.kernels.path import go_on, real_3
from engine.kernels.prefetch import ask_for_history, ask_for_media, ask_for_ray, ask_for_throughput, lane_ahead
from engine.kernels.radiance import add_emission, add_seen
from engine.kernels.rng import SET_MEDIUM, SETS_PER_VERTEX, sample_4d
from engine.kernels.surface import offset_origin, prepare_point, program_of, surface_point
from engine.kernels.vector import load
from engine.runtime.jit import kernel
from engine.state.film import FEATURE_EMISSION
from engine.state.geometry import INSTANCE_LIGHT_GROUP
from engine.state.lanes import (
    POINT_FLAG_BACKFACING,
    POINT_FLAGS,
    POINT_NG,
    POINT_P,
    RAY_CATCHER_HIT,
    RAY_ENDS,
    RAY_TERMINATE_ON_NEXT_SURFACE,
)
from engine.state.lights import HEADER_FIRST_DISTANT, HEADER_HITTABLE, HEADER_LAST_DISTANT
from engine.state.media import CHANNEL_WEIGHT, EMISSION, EXTINCTION, MOST_CROSSINGS, SCATTERING
from engine.state.shaders import PROGRAM_FLAGS, PROGRAM_IS_BOUNDARY, VALUE_EMISSION
from engine.wavefront.columns import (
    MEDIA_DROPPED,
    SCENE_HANDLE,
    SCENE_HAS_BOUNDARIES,
    SCENE_HAS_VARYING_MEDIA,
    SCENE_WORLD_GROUP,
    SCENE_WORLD_IS_CONSTANT,
    SCENE_WORLD_PROGRAM,
    UNIT_CATCHES,
    UNIT_FOLLOWS,
    UNIT_USE_DENOISING,
    UNIT_USE_FEATURES,
)

#: Mask of rays that meet whatever any path may see.
_SEEN_BY_ANY = 31
#: Lamps that are looked at one by one.
_MOST_LAMPS = 8


@kernel
def _add_medium_emission(scene, unit, work, lane, distance):
    """Add what the media on the ray emit before `distance`, seen through what lies before it."""
    paths, media, emission = work.paths, work.media, work.f_cos
    sums = media.coefficients
    largest = 0.0
    for c in range(len(paths.channels)):
        emission[lane, c] = 0.0
        if sums[EMISSION, c] > 0.0:
            emission[lane, c] = sums[EMISSION, c] * emitted_length(sums[EXTINCTION, c], min(distance, DISTANT))
        largest = max(largest, emission[lane, c])
    if largest > 0.0:
        _add_emission(scene, unit, work, lane)


@kernel
def _add_emission(scene, unit, work, lane):
    """Add row `lane` of `work.f_cos`, emitted by media, to the path."""
    paths, emission = work.paths, work.f_cos
    # As in Cycles, all of it is light of the medium that the path has entered last.
    instance = last_medium(work.media, lane)
    if not medium_shines(scene.lights, paths.flags[lane], instance):
        return
    group = scene.header[SCENE_WORLD_GROUP]
    if instance >= 0:
        group = scene.geometry.instance_table[instance, INSTANCE_LIGHT_GROUP]
    share = add_emission(
        scene.options, scene.spectrum, paths, work.passes, lane, emission, np.float32(1.0),
        found_alone(paths.unguided[lane]), group, unit.film, FEATURE_EMISSION, unit.header[UNIT_USE_FEATURES] != 0,
    )
    if unit.header[UNIT_USE_DENOISING] != 0:
        add_seen(scene.spectrum, paths, work.features, lane, emission, share, unit.film)


@kernel
def _take_tracked(scene, unit, work, lane):
    """Add what media that vary emit before the path's end or collision, and update its throughput by what is left.

    Returns
    -------
    float32 [m]
        Where the path collides, -1: it passes.
    """
    paths, tracking, emission = work.paths, work.tracking, work.f_cos
    largest = 0.0
    for c in range(len(paths.channels)):
        emission[lane, c] = tracking.emitted[lane, c]
        largest = max(largest, abs(emission[lane, c]))
    if largest > 0.0:
        _add_emission(scene, unit, work, lane)
    for c in range(len(paths.channels)):
        paths.throughput[lane, c] *= tracking.weight[lane, c]
    return tracking.collision[lane]


@kernel
def _collide_for_sure(paths, media, lane, distance, u_channel, u):
    """Draw where the path collides before `distance`, by the part of each channel that does; as `_collide`."""
    sums, channels = media.coefficients, paths.channels
    total = 0.0
    for c in range(len(channels)):
        weight = abs(paths.throughput[lane, c]) * sums[SCATTERING, c] * emitted_length(sums[EXTINCTION, c], distance)
        sums[CHANNEL_WEIGHT, c] = weight
        total += weight
    if not total > 0.0:
        for c in range(len(channels)):
            paths.throughput[lane, c] = 0.0
        return -1.0
    rest = u_channel * total
    extinction = sums[EXTINCTION, 0]
    for c in range(len(channels)):
        if sums[CHANNEL_WEIGHT, c] > 0.0:
            extinction = sums[EXTINCTION, c]
            if rest < sums[CHANNEL_WEIGHT, c]:
                break
            rest -= sums[CHANNEL_WEIGHT, c]
    t = min(-math.log1p(-u * extinction * emitted_length(extinction, distance)) / extinction, distance)
    pdf = 0.0
    for c in range(len(channels)):
        if sums[CHANNEL_WEIGHT, c] > 0.0:
            seen = transmittance(sums[EXTINCTION, c], t)
            pdf += sums[CHANNEL_WEIGHT, c] * seen / emitted_length(sums[EXTINCTION, c], distance)
    factor = total / pdf if pdf > 0.0 else 0.0
    for c in range(len(channels)):
        paths.throughput[lane, c] *= sums[SCATTERING, c] * transmittance(sums[EXTINCTION, c], t) * factor
    return t


@kernel
def _is_world_black(scene):
    """Whether nothing comes from where rays leave the scene, as far as that is the same everywhere; suns aside."""
    program = scene.header[SCENE_WORLD_PROGRAM]
    if program < 0:
        return True
    values = scene.shaders.program_values
    largest = max(values[program, VALUE_EMISSION], values[program, VALUE_EMISSION + 1])
    largest = max(largest, values[program, VALUE_EMISSION + 2])
    return scene.header[SCENE_WORLD_IS_CONSTANT] != 0 and not largest > 0.0


@kernel
def _may_see_nothing(scene, unit):
    """Whether camera rays that leave a medium may find nothing that a picture shows, in a scene of few lamps."""
    header = scene.lights.header
    is_bounded = scene.header[SCENE_HAS_BOUNDARIES] != 0 and scene.media.world[0] < 0
    is_seen = scene.options.film_transparent != 0 or unit.header[UNIT_CATCHES] != 0
    has_few = header[HEADER_HITTABLE] <= _MOST_LAMPS and header[HEADER_FIRST_DISTANT] == header[HEADER_LAST_DISTANT]
    return is_bounded and has_few and not is_seen and _is_world_black(scene)


@kernel
def _sees_nothing_behind(scene, work, lane):
    """Whether there is neither a surface, nor a medium, nor light behind the boundary that a camera ray has met."""
    geometry, lights, paths = scene.geometry, scene.lights, work.paths
    instance, triangle = paths.hit_instance[lane], paths.hit_triangle[lane]
    if instance < 0 or paths.depth[lane] > 0 or work.log.is_recording[lane] != 0:
        return False
    if scene.shaders.programs[program_of(geometry, instance, triangle), PROGRAM_FLAGS] & PROGRAM_IS_BOUNDARY == 0:
        return False
    origin, direction, time = load(paths.origin, lane), load(paths.direction, lane), paths.time[lane]
    for lamp in range(lights.header[HEADER_HITTABLE]):
        if lamp_hit(lights, lamp, origin, direction, 0.0, INFINITY) >= 0.0:
            return False
    p, ng, _ns, error = surface_point(geometry, instance, triangle, paths.hit_u[lane], paths.hit_v[lane], time)
    # From where the path would go on.
    return not trace_closest(
        scene.header[SCENE_HANDLE], work.ray, work.ray_bits, work.ray_address[0],
        offset_origin(p, ng, direction, error), direction, 0.0, INFINITY, time, _SEEN_BY_ANY,
    )


@kernel
def _collide(paths, media, lane, distance, is_dark):
    """Draw where the path collides, before `distance` or not at all, and update its throughput.

    One channel draws: the density is the mean over all, by what each has to expect of scattering and of passing, which
    is the balance heuristic. Every channel's throughput is divided by it.

    Parameters
    ----------
    is_dark : bool
        There is no light behind `distance`: the path collides for sure.

    Returns
    -------
    float32 [m]
        -1: it passes.

    References
    ----------
    Fong et al. 2017, "Production Volume Rendering" (SIGGRAPH course), section 4.3, spectral multiple importance
    sampling.
    """
    sums = media.coefficients
    u_channel, u, _, _ = sample_4d(paths.rng[lane], paths.sample[lane], paths.dimension[lane] + SET_MEDIUM)
    if is_dark:
        return _collide_for_sure(paths, media, lane, distance, u_channel, u)
    total, _ = weigh_channels(paths, media, lane, distance)
    if not total > 0.0:
        for c in range(len(paths.channels)):
            paths.throughput[lane, c] = 0.0
        return -1.0
    rest = u_channel * total
    extinction = sums[EXTINCTION, 0]
    for c in range(len(paths.channels)):
        # Rounding may leave a little behind the last one: it stays.
        if sums[CHANNEL_WEIGHT, c] > 0.0:
            extinction = sums[EXTINCTION, c]
            if rest < sums[CHANNEL_WEIGHT, c]:
                break
            rest -= sums[CHANNEL_WEIGHT, c]
    t = INFINITY
    if extinction > 0.0:
        t = -math.log(1.0 - u) / extinction
    collides = t < distance
    pdf = 0.0
    end = t if collides else distance
    for c in range(len(paths.channels)):
        passed = transmittance(sums[EXTINCTION, c], end)
        pdf += sums[CHANNEL_WEIGHT, c] * passed * (sums[EXTINCTION, c] if collides else 1.0)
        # The weight has done its duty: what is left of the channel takes its place.
        sums[CHANNEL_WEIGHT, c] = passed * (sums[SCATTERING, c] if collides else 1.0)
    factor = total / pdf if pdf > 0.0 else 0.0
    for c in range(len(paths.channels)):
        paths.throughput[lane, c] *= sums[CHANNEL_WEIGHT, c] * factor
    return t if collides else -1.0


@kernel
def _cross(scene, work, lane, instance, triangle, program):
    """Take a path through a surface that is nothing but a boundary, along the same line; False: it ends there.

    Roulette is settled here as behind any surface.
    """
    geometry, paths, points, media = scene.geometry, work.paths, work.points, work.media
    media.crossings[lane] += 1
    if paths.flags[lane] & RAY_TERMINATE_ON_NEXT_SURFACE or media.crossings[lane] > MOST_CROSSINGS:
        return False
    direction = load(paths.direction, lane)
    error = prepare_point(
        geometry, points, lane, instance, triangle, paths.hit_u[lane], paths.hit_v[lane], direction, paths.time[lane]
    )
    medium = scene.media.of_program[program]
    is_back = points.integer[lane, POINT_FLAGS] & POINT_FLAG_BACKFACING != 0
    if medium >= 0 and not cross_boundary(media, lane, instance, medium, is_back):
        work.counts[MEDIA_DROPPED] += 1
    go_on(paths, lane, offset_origin(real_3(points, lane, POINT_P), real_3(points, lane, POINT_NG), direction, error))
    paths.dimension[lane] += SETS_PER_VERTEX
    settle_roulette(paths, lane)
    paths.survival[lane] = -1.0
    return True


@kernel
def _pass_uniform(scene, unit, work, lane, distance, may_see_nothing):
    """Take a path through media that are the same everywhere, before `distance`; see `_take_tracked`."""
    paths, media = work.paths, work.media
    sum_coefficients(scene, paths, media, lane, lane, paths.hit_instance[lane] < 0)
    _add_medium_emission(scene, unit, work, lane, distance)
    scattering = 0.0
    for c in range(len(paths.channels)):
        scattering = max(scattering, media.coefficients[SCATTERING, c])
    if scattering > 0.0 and not paths.flags[lane] & RAY_ENDS:
        return _collide(paths, media, lane, distance, may_see_nothing and _sees_nothing_behind(scene, work, lane))
    for c in range(len(paths.channels)):
        paths.throughput[lane, c] *= transmittance(media.coefficients[EXTINCTION, c], distance)
    return -1.0


@kernel
def sample_medium(scene, unit, work, queue):
    """Sort traced lanes: those that collide go to `work.collided`, with the distance in `hit_distance`; those that meet
    nothing but a boundary cross it, and wait for the next round; the others stay.

    Paths that end at the next surface, or have reached a limit, are not scattered: they only fade.

    Parameters
    ----------
    queue : LaneQueue
        `work.traced`.
    """
    geometry, programs, paths, media = scene.geometry, scene.shaders.programs, work.paths, work.media
    follows, varies = unit.header[UNIT_FOLLOWS] != 0, scene.header[SCENE_HAS_VARYING_MEDIA] != 0
    has_boundaries, may_see_nothing = scene.header[SCENE_HAS_BOUNDARIES] != 0, _may_see_nothing(scene, unit)
    lanes, lane_count, collided = queue.lanes, queue.count[0], work.collided.lanes
    kept = 0
    collided_count = 0
    for k in range(lane_count):
        lane = lanes[k]
        ahead = lane_ahead(lanes, k, lane_count)
        ask_for_ray(paths, ahead)
        ask_for_throughput(paths, ahead)
        ask_for_history(paths, ahead)
        ask_for_media(media, ahead)
        if has_boundaries:
            if k + TRIANGLES_AHEAD < lane_count:
                ask_for_triangle(geometry, paths, lanes[k + TRIANGLES_AHEAD])
            if k + VERTICES_AHEAD < lane_count:
                ask_for_vertices(geometry, paths, lanes[k + VERTICES_AHEAD])
        flags = paths.flags[lane]
        instance = paths.hit_instance[lane]
        distance = length_in_media(paths, media, lane)
        if instance < 0:
            distance = INFINITY
            leave_objects(media, lane)
        if follows and flags & RAY_CATCHER_HIT:
            # Catchers alone, in the open.
            media.count[lane] = 0
        if media.count[lane] > 0:
            collision = -1.0
            if varies and work.tracking.is_tracked[lane] != 0:
                collision = _take_tracked(scene, unit, work, lane)
            else:
                collision = _pass_uniform(scene, unit, work, lane, distance, may_see_nothing)
            largest = 0.0
            for c in range(len(paths.channels)):
                largest = max(largest, abs(paths.throughput[lane, c]))
            if not largest > 0.0:
                paths.alive[lane] = 0
                continue
            if collision >= 0.0:
                paths.hit_distance[lane] = collision
                paths.hit_instance[lane] = -1
                collided[collided_count] = lane
                collided_count += 1
                continue
        if instance >= 0:
            triangle = paths.hit_triangle[lane]
            program = program_of(geometry, instance, triangle)
            if programs[program, PROGRAM_FLAGS] & PROGRAM_IS_BOUNDARY:
                if not _cross(scene, work, lane, instance, triangle, program):
                    paths.alive[lane] = 0
                continue
        lanes[kept] = lane
        kept += 1
    queue.count[0] = kept
    work.collided.count[0] = collided_count
