# SPDX-License-Identifier: GPL-3.0-or-later
"""Stages around light sampling within homogeneous media: on every segment of a path that may be scattered there.

Thin media make few paths collide, and seldom where a lamp is near. So light is sampled on each segment, at a distance
that is drawn for the light (`engine.kernels.distances`), whether or not the path then collides. A lane stands at that
point until its light has been added, and then goes on as if nothing had been; should it collide, no light is sampled
there again.

Both techniques' MIS weights use the densities of directions at the point. That of scattering is multiplied by the
probability of a collision on the segment, that of light sampling has the light tree's choice at the point in place of
the segment's: whoever meets a light later knows no more.
"""

import numpy as np

from engine.kernels.bsdf.phase import eval_phases
from engine.kernels.clamping import settle_roulette
from engine.kernels.collision import place_collision, set_lobes
from engine.kernels.constants import INFINITY
from engine.kernels.distances import choose_distance
from engine.kernels.light_sample import keep_light_sample
from engine.kernels.lights import (
    Choice,
    Receiver,
    background_pdf,
    draw_cell,
    draw_triangle,
    sample_emitter,
    tree_within,
)
from engine.kernels.lights.segments import LONGEST, pick_for_segment
from engine.kernels.lights.tree import emitter_pmf, selection_row
from engine.kernels.media import (
    any_varies,
    leave_objects,
    length_in_media,
    sum_coefficients,
    transmittance,
    weigh_channels,
)
from engine.kernels.path import real_3
from engine.kernels.prefetch import (
    ask_for_closures,
    ask_for_history,
    ask_for_media,
    ask_for_point,
    ask_for_ray,
    ask_for_throughput,
    lane_ahead,
)
from engine.kernels.rng import SET_SEGMENT, SET_SEGMENT_LIGHT, sample_4d
from engine.kernels.vector import load
from engine.runtime.jit import kernel
from engine.state.geometry import INSTANCE_FLAG_CATCHER, INSTANCE_FLAGS
from engine.state.lanes import (
    LIGHT_IS_OF_SEGMENT,
    POINT_NS,
    POINT_P,
    POINT_WO,
    RAY_CATCHER_HIT,
    RAY_ENDS,
    RAY_SUBSURFACE,
    RAY_VOLUME,
)
from engine.state.lights import EMITTER_NODE, LIGHT_BACKGROUND
from engine.state.media import EXTINCTION, SCATTERING, WORLD
from engine.wavefront.columns import SCENE_HAS_VARYING_MEDIA, SCENE_WORLD_GROUP, UNIT_FOLLOWS, UNIT_SPLITS_LIGHT

#: Mean free paths behind which a segment is too dim for its lights to be chosen by it.
_DEPTHS = np.float32(4.0)


@kernel
def _largest(channels, rows, row):
    largest = 0.0
    for c in range(len(channels)):
        largest = max(largest, rows[row, c])
    return largest


@kernel
def _reach(channels, coefficients, length):
    """How far along the segment lights are looked for, by what is left of the channel that goes farthest."""
    least = coefficients[EXTINCTION, 0]
    for c in range(len(channels)):
        if coefficients[SCATTERING, c] > 0.0:
            least = min(least, coefficients[EXTINCTION, c])
    return min(length, _DEPTHS / least) if least > 0.0 else length


@kernel
def _stand(scene, work, lane, distance, weight):
    """Move a lane to a point of its segment, with the throughput that it has there for light samples."""
    paths, media = work.paths, work.media
    media.next_instance[lane] = paths.hit_instance[lane]
    paths.hit_instance[lane] = -1
    media.kept_unguided[lane] = paths.unguided[lane]
    for c in range(len(paths.channels)):
        media.kept_throughput[lane, c] = paths.throughput[lane, c]
    settle_roulette(paths, lane)
    for c in range(len(paths.channels)):
        scattered = media.coefficients[SCATTERING, c] * transmittance(media.coefficients[EXTINCTION, c], distance)
        paths.throughput[lane, c] *= scattered * weight


@kernel
def _share_of_scattering(lights, tree, collision_share, sample, p, normal):
    """Factor on the density of the phase functions in the MIS weight of a light sample; see the module.

    0 where nothing but light sampling finds the light, -1 where it is left to scattering.
    """
    if not sample.use_mis:
        return 0.0 * sample.pmf
    row = selection_row(lights, tree, p)
    if sample.kind == LIGHT_BACKGROUND and row >= 0:
        known = background_pdf(lights, tree, p, normal, True, False, sample.wi)
    else:
        known = sample.pdf / sample.pmf * emitter_pmf(lights, row, sample.emitter, p, normal, True)
    return collision_share * sample.pdf / known if known > 0.0 else -1.0 + 0.0 * known


@kernel
def _is_catcher(geometry, instance):
    return geometry.instance_table[instance, INSTANCE_FLAGS] & INSTANCE_FLAG_CATCHER != 0


@kernel
def light_segments(scene, unit, work, queue):
    """Choose a light for every segment within media, where it is scattered, and a point on it.

    `work.lit` and `work.programs` are filled as by `choose_lights`.

    Parameters
    ----------
    queue : LaneQueue
        `work.traced`.
    """
    lights, geometry = scene.lights, scene.geometry
    paths, points, closures, samples, media = work.paths, work.points, work.closures, work.samples, work.media
    f_cos, lit, programs = work.f_cos, work.lit.lanes, work.programs.lanes
    splits_light, follows = unit.header[UNIT_SPLITS_LIGHT] != 0, unit.header[UNIT_FOLLOWS] != 0
    varies = scene.header[SCENE_HAS_VARYING_MEDIA] != 0
    lanes, lane_count = queue.lanes, queue.count[0]
    lit_count = 0
    program_count = 0
    for k in range(lane_count):
        lane = lanes[k]
        ahead = lane_ahead(lanes, k, lane_count)
        ask_for_ray(paths, ahead)
        ask_for_throughput(paths, ahead)
        ask_for_history(paths, ahead)
        ask_for_media(media, ahead)
        ask_for_closures(closures, ahead)
        ask_for_point(points, ahead)
        media.is_lit[lane] = 0
        media.collision_share[lane] = 1.0
        flags = paths.flags[lane]
        is_endless = paths.hit_instance[lane] < 0
        if is_endless:
            leave_objects(media, lane)
        if media.count[lane] == 0 or flags & (RAY_ENDS | RAY_SUBSURFACE) or (follows and flags & RAY_CATCHER_HIT):
            continue
        if varies and any_varies(scene.media, media, lane):
            # There a path samples lights where it collides.
            continue
        sum_coefficients(scene, paths, media, lane, lane, is_endless)
        if not _largest(paths.channels, media.coefficients, SCATTERING) > 0.0:
            continue
        distance = INFINITY if is_endless else length_in_media(paths, media, lane)
        _, share = weigh_channels(paths, media, lane, distance)
        media.is_lit[lane] = 1
        media.collision_share[lane] = share
        length = min(distance, LONGEST)
        reach = _reach(paths.channels, media.coefficients, length)
        u_light, u_distance, u_candidate, u_roulette = sample_4d(
            paths.rng[lane], paths.sample[lane], paths.dimension[lane] + SET_SEGMENT
        )
        origin, direction = load(paths.origin, lane), load(paths.direction, lane)
        tree = tree_within(lights, media, lane)
        emitter, pmf = pick_for_segment(lights, tree, origin, direction, length, reach, u_light)
        if emitter < 0 or not pmf > 0.0:
            continue
        set_lobes(scene, closures, media, lane)
        fills_all = media.count[lane] == 1 and media.instance[lane, 0] == WORLD
        at, weight = choose_distance(
            lights, closures, media.coefficients, paths.throughput, lane, lights.emitters[emitter, EMITTER_NODE],
            origin, direction, length, fills_all, u_distance, u_candidate,
        )
        if not weight > 0.0:
            continue
        place_collision(paths, points, lane, at)
        p, normal, wo = real_3(points, lane, POINT_P), real_3(points, lane, POINT_NS), real_3(points, lane, POINT_WO)
        u0, u1, _, _ = sample_4d(
            paths.rng[lane], paths.sample[lane], paths.dimension[lane] + SET_SEGMENT_LIGHT
        )
        drawn = draw_triangle(lights, geometry, emitter, p, paths.time[lane], u0, u1)
        cell = draw_cell(lights, emitter, -1, False, u0, u1)
        sample = sample_emitter(
            lights, geometry, Choice(emitter, pmf, np.int64(-1)), drawn, cell,
            Receiver(p, normal, True, False, tree), paths.time[lane], u0, u1,
        )
        if not sample.pdf > 0.0 or paths.depth[lane] > sample.max_bounces or not sample.visibility & RAY_VOLUME:
            continue
        if follows and sample.instance >= 0 and not _is_catcher(geometry, sample.instance):
            continue
        scattering_share = _share_of_scattering(lights, tree, share, sample, p, normal)
        if scattering_share < 0.0:
            continue
        phase_pdf = eval_phases(closures, lane, wo, sample.wi, f_cos, lane)
        if not _largest(paths.channels, f_cos, lane) > 0.0:
            continue
        samples.weight[lane] = 1.0
        samples.guide_pdf[lane] = 0.0
        samples.bsdf_share[lane] = scattering_share
        _stand(scene, work, lane, at, weight)
        if splits_light and paths.depth[lane] == 0:
            work.passes.is_volume[lane] = 1
        if keep_light_sample(
            scene, work, lane, sample, phase_pdf, u_roulette, scene.header[SCENE_WORLD_GROUP], splits_light
        ):
            programs[program_count] = lane
            program_count += 1
        samples.flags[lane] |= LIGHT_IS_OF_SEGMENT
        lit[lit_count] = lane
        lit_count += 1
    work.lit.count[0] = lit_count
    work.programs.count[0] = program_count


@kernel
def leave_segments(scene, unit, work, queue):
    """Put lanes back to where their segments begin.

    Parameters
    ----------
    queue : LaneQueue
        `work.lit`, as `light_segments` has left it.
    """
    paths, media = work.paths, work.media
    splits_light = unit.header[UNIT_SPLITS_LIGHT] != 0
    lanes, lane_count = queue.lanes, queue.count[0]
    for k in range(lane_count):
        lane = lanes[k]
        # Where nothing is guided, surfaces take it for what it is.
        work.samples.bsdf_share[lane] = 1.0
        paths.hit_instance[lane] = media.next_instance[lane]
        paths.unguided[lane] = media.kept_unguided[lane]
        for c in range(len(paths.channels)):
            paths.throughput[lane, c] = media.kept_throughput[lane, c]
        if splits_light and paths.depth[lane] == 0:
            work.passes.is_volume[lane] = 0
