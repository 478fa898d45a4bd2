# SPDX-License-Identifier: GPL-3.0-or-later
"""Stages of next-event estimation: choose a point on a light, then weigh it and queue its shadow ray.

Between the two, `evaluate_shaders` runs the programs of lights whose emission is not constant. What the surface cannot
scatter, such as light from below it, is dropped before.
"""

import numpy as np

from engine.kernels.bsdf import HAS_EVAL, HAS_TRANSMISSION, eval_bsdf, summarize
from engine.kernels.clamping import clamps, weighted_inverse
from engine.kernels.light_sample import keep_light_sample
from engine.kernels.lights import (
    Choice,
    Receiver,
    ask_for_cell,
    choose_emitter,
    cluster_choice,
    column_of_map,
    drawn_triangle,
    finds_all,
    group_of_few,
    is_of_map,
    pick_among_few,
    put_triangle,
    row_of_map,
    sample_emitter,
    sample_triangles,
    tree_of_receiver,
    tree_within,
    triangle_of,
)
from engine.kernels.path import ends_on_light, mark_shadow, real_3
from engine.kernels.prefetch import ask_for_closures, ask_for_ray, ask_for_throughput, lane_ahead, prefetch
from engine.kernels.radiance import power_heuristic
from engine.kernels.rng import SET_LIGHT
from engine.kernels.rng_eight import put_path, sample_eight
from engine.kernels.terminator import shadow_ray
from engine.kernels.vector import store
from engine.runtime.jit import kernel
from engine.state.geometry import INSTANCE_FLAG_CATCHER, INSTANCE_FLAGS
from engine.state.lanes import (
    DRAW_COLUMN,
    DRAW_EMITTER,
    DRAW_LANE,
    DRAW_LEAVES_DIM,
    DRAW_N,
    DRAW_P,
    DRAW_PATCH,
    DRAW_PMF,
    DRAW_ROULETTE,
    DRAW_ROW,
    DRAW_TRANSMITS,
    DRAW_U0,
    DRAW_U1,
    DRAW_U_PICK,
    DRAW_WIDTH,
    LIGHT_CASTS_SHADOW,
    LIGHT_ENDS_IN_PLACE,
    LIGHT_HAS_PROGRAM,
    LIGHT_IS_OF_SEGMENT,
    LIGHT_USES_MIS,
    POINT_FLAG_IN_PLACE,
    POINT_FLAGS,
    POINT_NG,
    POINT_NS,
    POINT_P,
    POINT_WO,
    RAY_DIFFUSE,
    RAY_GLOSSY,
    RAY_TRANSMIT,
    RAY_VOLUME,
)
from engine.state.lights import HEADER_BACKGROUND_EMITTER
from engine.wavefront.columns import (
    SCENE_WORLD_GROUP,
    SHADOW_ROWS,
    UNIT_FOLLOWS,
    UNIT_LEARNS_LIGHTS,
    UNIT_SPLITS_LIGHT,
)

_SCATTERED = RAY_DIFFUSE | RAY_GLOSSY | RAY_TRANSMIT | RAY_VOLUME


@kernel(forceinline=True)
def _take_receivers(scene, work, lanes, first, lane_count, learns_lights):
    """Put the next lanes of a queue that may get light into `work.draws`, in their order; returns how many."""
    paths, points, closures, samples, draws = work.paths, work.points, work.closures, work.samples, work.draws
    real, numbers = draws.real, draws.integer
    count = 0
    for k in range(first, min(first + DRAW_WIDTH, lane_count)):
        lane = lanes[k]
        # For the next time: they are all read within a moment.
        ahead = lanes[min(k + DRAW_WIDTH, lane_count - 1)]
        ask_for_ray(paths, ahead)
        ask_for_throughput(paths, ahead)
        ask_for_closures(closures, ahead)
        prefetch(points.real, ahead)
        prefetch(samples.direction, ahead)
        if learns_lights and work.log.is_recording[lane] != 0:
            samples.cluster[lane] = -1
        if paths.alive[lane] == 0 or samples.weight[lane] == 0.0:
            continue
        bits = summarize(closures, lane)
        if not bits & HAS_EVAL:
            continue
        put_path(draws, count, paths, lane, SET_LIGHT)
        for c in range(3):
            real[0, DRAW_P + c, count] = points.real[lane, POINT_P + c]
            real[0, DRAW_N + c, count] = points.real[lane, POINT_NS + c]
        real[0, DRAW_TRANSMITS, count] = 1.0 if bits & HAS_TRANSMISSION != 0 else 0.0
        numbers[DRAW_LANE, count] = lane
        leaves_dim = finds_all(scene.lights, closures, lane, real_3(points, lane, POINT_NG))
        numbers[DRAW_LEAVES_DIM, count] = 1 if leaves_dim else 0
        count += 1
    sample_eight(draws)
    return count


@kernel(forceinline=True)
def _tree_of(lights, work, lane):
    """The light tree of what a lane's path has met: a surface, or the media that it is in."""
    instance = np.int64(work.paths.hit_instance[lane])
    if instance < 0:
        return tree_within(lights, work.media, lane)
    return tree_of_receiver(lights, instance)


@kernel(forceinline=True)
def _choose_emitters(scene, work, draws, count, few):
    """Choose emitters for the first receivers in `draws`, and draw points of those that are triangles.

    Parameters
    ----------
    few : int, as `group_of_few` says
    """
    lights, geometry, paths = scene.lights, scene.geometry, work.paths
    real, numbers = draws.real, draws.integer
    if few >= 0:
        pick_among_few(lights, few, draws)
    has_triangles = False
    for k in range(count):
        p = (real[0, DRAW_P, k], real[0, DRAW_P + 1, k], real[0, DRAW_P + 2, k])
        if few < 0:
            n = (real[0, DRAW_N, k], real[0, DRAW_N + 1, k], real[0, DRAW_N + 2, k])
            tree = _tree_of(lights, work, numbers[DRAW_LANE, k])
            emitter, pmf, patch = choose_emitter(
                lights, tree, p, n, real[0, DRAW_TRANSMITS, k] > 0.0, real[0, DRAW_U_PICK, k]
            )
            numbers[DRAW_EMITTER, k] = emitter if pmf > 0.0 else -1
            numbers[DRAW_PATCH, k] = patch
            real[0, DRAW_PMF, k] = pmf
        time = paths.time[numbers[DRAW_LANE, k]]
        is_triangle, (v0, edge1, edge2) = triangle_of(lights, geometry, numbers[DRAW_EMITTER, k], time)
        if is_triangle:
            put_triangle(draws, k, v0, edge1, edge2, p)
            has_triangles = True
    if has_triangles:
        sample_triangles(draws)
    if lights.header[HEADER_BACKGROUND_EMITTER] >= 0:
        _find_cells(lights, draws, count)


@kernel(forceinline=True)
def _find_cells(lights, draws, count):
    """Draw cells of the background's map for the first receivers in `draws` that have chosen it.

    The map fits into no cache: each step asks for what the next one reads.
    """
    real, numbers = draws.real, draws.integer
    for k in range(count):
        row = np.int64(-1)
        if is_of_map(lights, numbers[DRAW_EMITTER, k], numbers[DRAW_PATCH, k]):
            row = row_of_map(lights, numbers[DRAW_LEAVES_DIM, k] != 0, real[0, DRAW_U0, k], real[0, DRAW_U1, k])
        numbers[DRAW_ROW, k] = row
    for k in range(count):
        if numbers[DRAW_ROW, k] >= 0:
            ask_for_cell(lights, numbers[DRAW_LEAVES_DIM, k] != 0, numbers[DRAW_ROW, k], real[0, DRAW_U0, k])
    for k in range(count):
        if numbers[DRAW_ROW, k] >= 0:
            numbers[DRAW_COLUMN, k] = column_of_map(
                lights, numbers[DRAW_LEAVES_DIM, k] != 0, numbers[DRAW_ROW, k], real[0, DRAW_U0, k]
            )


@kernel
def _choice_of(draws, k):
    """What place `k` of `draws` has chosen: Choice, of the same types as in other stages, so that it compiles once."""
    numbers = draws.integer
    return Choice(np.int64(numbers[DRAW_EMITTER, k]), draws.real[0, DRAW_PMF, k], np.int64(numbers[DRAW_PATCH, k]))


@kernel
def choose_lights(scene, unit, work, queue):
    """Draw one light sample for every lane that has a lobe to receive it, unless its weight is 0.

    `work.lit` is filled with the lanes that got a sample from which the surface scatters light, `work.programs` with
    those of them whose light has a program to run at `work.light_points`. `work.f_cos` and `samples.bsdf_pdf` hold what
    the BSDF says of it.
    """
    lights, geometry = scene.lights, scene.geometry
    paths, points, closures, samples, draws = work.paths, work.points, work.closures, work.samples, work.draws
    lit, programs = work.lit.lanes, work.programs.lanes
    tables, f_cos, log = scene.tables, work.f_cos, work.log
    splits_light, follows = unit.header[UNIT_SPLITS_LIGHT] != 0, unit.header[UNIT_FOLLOWS] != 0
    learns_lights = unit.header[UNIT_LEARNS_LIGHTS] != 0
    is_learned = clamps(scene.options) and lights.selection.cumulative.shape[0] > 0
    lanes, lane_count = queue.lanes, queue.count[0]
    real, numbers = draws.real, draws.integer
    lit_count = 0
    program_count = 0
    few = group_of_few(lights)
    if few >= 0:
        for k in range(DRAW_WIDTH):
            numbers[DRAW_PATCH, k] = -1
    for first in range(0, lane_count, DRAW_WIDTH):
        count = _take_receivers(scene, work, lanes, first, lane_count, learns_lights)
        _choose_emitters(scene, work, draws, count, few)
        for k in range(count):
            if numbers[DRAW_EMITTER, k] < 0:
                continue
            lane = numbers[DRAW_LANE, k]
            has_transmission = real[0, DRAW_TRANSMITS, k] > 0.0
            leaves_dim = numbers[DRAW_LEAVES_DIM, k] != 0
            p, n = real_3(points, lane, POINT_P), real_3(points, lane, POINT_NS)
            sample = sample_emitter(
                lights, geometry, _choice_of(draws, k), drawn_triangle(draws, k),
                (np.int64(numbers[DRAW_ROW, k]), np.int64(numbers[DRAW_COLUMN, k])),
                Receiver(p, n, has_transmission, leaves_dim, _tree_of(lights, work, lane)), paths.time[lane],
                real[0, DRAW_U0, k], real[0, DRAW_U1, k],
            )
            wi, instance = sample.wi, sample.instance
            if sample.pdf > 0.0 and (is_learned or (learns_lights and log.is_recording[lane] != 0)):
                cluster, cluster_pmf, tree_pmf = cluster_choice(
                    lights, sample.emitter, sample.pmf, p, n, has_transmission, leaves_dim, wi
                )
                samples.cluster[lane] = cluster
                samples.cluster_pmf[lane] = cluster_pmf
                samples.tree_pmf[lane] = tree_pmf
            if not sample.pdf > 0.0 or paths.depth[lane] > sample.max_bounces:
                continue
            if instance >= 0 and instance == paths.hit_instance[lane]:
                if sample.triangle == paths.hit_triangle[lane]:
                    continue
            if follows and instance >= 0:
                # Nothing but catchers is there for them.
                if not geometry.instance_table[instance, INSTANCE_FLAGS] & INSTANCE_FLAG_CATCHER:
                    continue
            wo = real_3(points, lane, POINT_WO)
            ng = real_3(points, lane, POINT_NG)
            bsdf_pdf = eval_bsdf(closures, tables, lane, wo, wi, ng, sample.visibility & _SCATTERED, f_cos, lane)
            largest = 0.0
            for c in range(len(paths.channels)):
                largest = max(largest, abs(f_cos[lane, c]))
            if not largest > 0.0:
                continue
            if keep_light_sample(
                scene, work, lane, sample, bsdf_pdf, real[0, DRAW_ROULETTE, k], scene.header[SCENE_WORLD_GROUP],
                splits_light,
            ):
                programs[program_count] = lane
                program_count += 1
            lit[lit_count] = lane
            lit_count += 1
    work.lit.count[0] = lit_count
    work.programs.count[0] = program_count


@kernel
def _leave_to_clamp(options, paths, samples, shadows, lane, row, tree, largest, weight):
    """Note what the lane's light sample would be by plain sampling, in row `row` of the shadow rays.

    Parameters
    ----------
    tree : float32
        Factor that makes of the sample's density that by the light tree alone.
    largest : float32 [sr^-1]
        Largest channel of BSDF, cosine and emission.
    weight : float32 [sr]
        MIS weight over density, and over the probability of having been kept for so little.
    """
    own_pdf, other_pdf = samples.pdf[lane] * tree, np.float32(0.0)
    if samples.flags[lane] & LIGHT_IS_OF_SEGMENT:
        other_pdf = samples.bsdf_share[lane] * samples.bsdf_pdf[lane]
    elif samples.flags[lane] & LIGHT_USES_MIS:
        other_pdf = samples.bsdf_pdf[lane]
    own = weighted_inverse(own_pdf, other_pdf)
    kept = min(largest * own * options.inverse_light_threshold, np.float32(1.0))
    factor = paths.unguided[lane] / weight
    shadows.own[row] = factor * (own / kept if options.inverse_light_threshold > 0.0 and kept > 0.0 else own)
    shadows.other[row] = factor * weighted_inverse(other_pdf, own_pdf)
    # Scattering finds light of a segment from elsewhere: each is clamped by itself.
    alone = samples.flags[lane] & LIGHT_IS_OF_SEGMENT
    shadows.share[row] = np.float32(1.0) if alone else own * own_pdf


@kernel
def connect_lights(scene, unit, work, queue):
    """Weigh light samples by BSDF and MIS, thin out the negligible, and queue shadow rays in `work.shadows`.

    Both techniques' weights use the densities of choosing the direction (pmf of the light included), so they sum to
    one. Samples that would add little survive with a probability proportional to it (Cycles' light threshold). Where
    surfaces are smooth, shadow rays start off them (`kernels.terminator`).
    """
    options, geometry, paths = scene.options, scene.geometry, work.paths
    is_clamped, is_learned = clamps(options), scene.lights.selection.cumulative.shape[0] > 0
    points, samples, light_closures = work.points, work.samples, work.light_closures
    f_cos, shadows = work.f_cos, work.shadows
    lit, lit_count = queue.lanes, queue.count[0]
    shadow_count = 0
    for k in range(lit_count):
        lane = lit[k]
        ahead = lane_ahead(lit, k, lit_count)
        ask_for_ray(paths, ahead)
        ask_for_throughput(paths, ahead)
        prefetch(points.real, ahead)
        prefetch(samples.direction, ahead)
        prefetch(f_cos, ahead)
        pdf = samples.pdf[lane]
        flags = samples.flags[lane]
        weight = 1.0 / pdf
        if flags & LIGHT_USES_MIS:
            source_pdf = samples.guide_pdf[lane] + samples.bsdf_share[lane] * samples.bsdf_pdf[lane]
            weight *= power_heuristic(pdf, source_pdf)
        largest = 0.0
        for c in range(len(paths.channels)):
            value = f_cos[lane, c] * samples.radiance[lane, c] * weight
            if flags & LIGHT_HAS_PROGRAM:
                value *= light_closures.emission[lane, c]
            f_cos[lane, c] = value
            largest = max(largest, abs(value))
        if not largest > 0.0:
            continue
        scale = np.float32(1.0)
        if options.inverse_light_threshold > 0.0:
            survival = largest * options.inverse_light_threshold
            if survival < 1.0:
                if samples.terminate[lane] >= survival:
                    continue
                scale /= survival
        row = shadow_count
        shadow_count += 1
        if is_clamped:
            tree = np.float32(1.0)
            if is_learned and not flags & LIGHT_IS_OF_SEGMENT and samples.cluster_pmf[lane] > 0.0:
                tree = samples.tree_pmf[lane] / samples.cluster_pmf[lane]
            _leave_to_clamp(options, paths, samples, shadows, lane, row, tree, largest / weight, weight * scale)
        shadows.lane[row] = lane
        shadows.weight[row] = samples.weight[lane]
        for c in range(len(paths.channels)):
            shadows.radiance[row, c] = paths.throughput[lane, c] * f_cos[lane, c] * scale
        real = points.real
        p = (real[lane, POINT_P], real[lane, POINT_P + 1], real[lane, POINT_P + 2])
        ng = (real[lane, POINT_NG], real[lane, POINT_NG + 1], real[lane, POINT_NG + 2])
        ns = (real[lane, POINT_NS], real[lane, POINT_NS + 1], real[lane, POINT_NS + 2])
        wi = (samples.direction[lane, 0], samples.direction[lane, 1], samples.direction[lane, 2])
        instance = paths.hit_instance[lane]
        in_place = flags & LIGHT_ENDS_IN_PLACE != 0
        in_place |= instance >= 0 and points.integer[lane, POINT_FLAGS] & POINT_FLAG_IN_PLACE != 0
        origin, wi, distance, in_place = shadow_ray(
            geometry, instance, paths.hit_triangle[lane], paths.hit_u[lane], paths.hit_v[lane], p, ng, ns, wi,
            samples.distance[lane], paths.offset[lane], in_place, paths.time[lane],
        )
        store(shadows.origin, row, origin)
        store(shadows.direction, row, wi)
        mark_shadow(paths, lane, in_place)
        if not ends_on_light(paths, lane, flags):
            distance -= samples.offset[lane]
        shadows.distance[row] = distance if flags & LIGHT_CASTS_SHADOW else -1.0
    work.counts[SHADOW_ROWS] = shadow_count
