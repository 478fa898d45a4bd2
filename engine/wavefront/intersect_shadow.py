# SPDX-License-Identifier: GPL-3.0-or-later
"""Stage: light samples meet what stands in their way.

Opaque blockers end a shadow ray at once; the same search keeps the transparent ones before its light. These dim it, the
closest first: where their transparency is constant within the kernel, else the ray waits in `pending` until
`evaluate_shaders` has run the program at the blocker. Those for which there was no room are looked for again, one by
one. Where transparent blockers are few they have a hierarchy of their own, which is looked through sooner than all
casters are.
"""

import numpy as np

from engine.accel.masks import CATCHER_MASK_SHIFT, MASK_SHADOW_OPAQUE, MASK_SHADOW_TRANSPARENT
from engine.accel.passing import limit_passing, prepare_filters, read_kept, trace_passing
from engine.accel.ray_words import MOST_PASSED
from engine.accel.rays import read_hit, trace_closest, trace_closest_from, trace_occluded, trace_occluded_from
from engine.kernels.lights import shadow_mask
from engine.kernels.path import real_3
from engine.kernels.path_depths import store_depths
from engine.kernels.prefetch import ask_for_ray, ask_for_throughput
from engine.kernels.radiance import add_sampled
from engine.kernels.spectrum import filter_by
from engine.kernels.surface import offset_origin, prepare_point, program_of
from engine.kernels.vector import add, dot, length, load, scale, store, subtract
from engine.runtime.jit import kernel
from engine.state.geometry import INSTANCE_MESH, MESH_SHAPE, SHAPE_TRIANGLES
from engine.state.lanes import (
    POINT_FLAG_IN_PLACE,
    POINT_FLAGS,
    POINT_INSTANCE,
    POINT_NG,
    POINT_P,
    POINT_PROGRAM,
    POINT_RADIUS,
    POINT_RANDOM,
    POINT_RAY_FLAGS,
    POINT_RAY_LENGTH,
    POINT_TRIANGLE,
    RAY_SHADOW,
    RAY_SHADOW_IN_PLACE,
)
from engine.state.shaders import PROGRAM_FLAGS, PROGRAM_TRANSPARENCY_CONSTANT, VALUE_TRANSPARENCY
from engine.wavefront.columns import (
    SCENE_HANDLE,
    SCENE_HAS_TRANSPARENT_SHADOWS,
    SCENE_MASK_HANDLE,
    SCENE_TRANSPARENT_HANDLE,
    SHADOW_RAYS,
    SHADOW_ROWS,
    TRANSPARENT_SHADOW_RAYS,
    UNIT_FOLLOWS,
)
from engine.wavefront.ray_ends import name_ends, name_passed

_ROWS_AHEAD = 2


@kernel
def _keep_hits(scene, work, row, count, used):
    """Put the `count` hits of a row behind the `used` others in `work.passed`, if there is room; how many are there."""
    passed = work.passed
    kept = min(count, MOST_PASSED, passed.distance.shape[0] - used)
    passed.next[row] = used
    passed.end[row] = used + kept
    passed.gone[row] = 0.0
    for k in range(kept):
        instance, triangle, distance, u, v = read_kept(work.ray, work.ray_bits, scene.geometry, k)
        passed.distance[used + k], passed.u[used + k], passed.v[used + k] = distance, u, v
        passed.instance[used + k], passed.triangle[used + k] = instance, triangle
    return used + kept


@kernel
def intersect_shadow(scene, unit, work, queue):
    """Trace all shadow rays and add the light of those that pass.

    Parameters
    ----------
    queue : LaneQueue
        Filled with the rows of `work.shadows` whose rays meet transparent blockers only.
    """
    handle, options, paths, shadows = scene.header[SCENE_HANDLE], scene.options, work.paths, work.shadows
    passes, lights, samples = work.passes, scene.lights, work.samples
    ray, bits, address = work.ray, work.ray_bits, work.ray_address[0]
    has_transparent, shadow_count = scene.header[SCENE_HAS_TRANSPARENT_SHADOWS] != 0, work.counts[SHADOW_ROWS]
    work.counts[SHADOW_RAYS] += shadow_count
    pending = queue.lanes
    pending_count, hit_count = 0, 0
    shift = CATCHER_MASK_SHIFT if unit.header[UNIT_FOLLOWS] != 0 else 0
    every = MASK_SHADOW_OPAQUE << shift
    if has_transparent:
        every |= MASK_SHADOW_TRANSPARENT << shift
        prepare_filters(bits, scene.header[SCENE_MASK_HANDLE], scene.geometry.instance_table.shape[0])
    for row in range(shadow_count):
        lane = shadows.lane[row]
        ahead = shadows.lane[min(row + _ROWS_AHEAD, shadow_count - 1)]
        ask_for_ray(paths, ahead)
        ask_for_throughput(paths, ahead)
        if not shadows.distance[row] > 0.0:
            # A light that casts no shadow, or one touching the surface.
            add_sampled(options, paths, passes, lane, shadows, row)
            continue
        origin = load(shadows.origin, row)
        direction = load(shadows.direction, row)
        far = shadows.distance[row]
        mask = shadow_mask(lights, samples.emitter[lane], every, shift)
        time = paths.time[lane]
        passed = 0
        is_in_place = paths.flags[lane] & RAY_SHADOW_IN_PLACE != 0
        if has_transparent or is_in_place:
            name_ends(scene, work, lane)
        if has_transparent:
            limit_passing(bits, options.max_transparent_depth - paths.transparent_depth[lane])
            passed = trace_passing(handle, ray, bits, address, origin, direction, 0.0, far, time, mask)
        elif is_in_place:
            if trace_occluded_from(handle, ray, bits, address, origin, direction, 0.0, far, time, mask):
                continue
        elif trace_occluded(handle, ray, bits, address, origin, direction, 0.0, far, time, mask):
            continue
        if passed > 0:
            hit_count = _keep_hits(scene, work, row, passed, hit_count)
            shadows.transparent_depth[row] = paths.transparent_depth[lane]
            shadows.transparent_left[row] = passed
            pending[pending_count] = row
            pending_count += 1
        elif passed == 0:
            add_sampled(options, paths, passes, lane, shadows, row)
    queue.count[0] = pending_count


@kernel
def _look_ahead(scene, work, row, lane, direction, mask):
    """Look for the next transparent blocker of a shadow ray: whether there is one, and what `read_hit` says of it."""
    paths, shadows, points = work.paths, work.shadows, work.light_points
    handle, ray, bits, address = scene.header[SCENE_TRANSPARENT_HANDLE], work.ray, work.ray_bits, work.ray_address[0]
    work.counts[TRANSPARENT_SHADOW_RAYS] += 1
    if shadows.transparent_depth[row] > paths.transparent_depth[lane]:
        skips = name_passed(
            scene, work, lane, points.integer[row, POINT_INSTANCE], points.integer[row, POINT_TRIANGLE]
        )
    else:
        skips = name_ends(scene, work, lane)
    origin, far, time = load(shadows.origin, row), shadows.distance[row], paths.time[lane]
    if skips:
        is_met = trace_closest_from(handle, ray, bits, address, origin, direction, 0.0, far, time, mask)
    else:
        is_met = trace_closest(handle, ray, bits, address, origin, direction, 0.0, far, time, mask)
    if not is_met:
        return False, np.int64(-1), np.int64(-1), far, np.float32(0.0), np.float32(0.0)
    instance, triangle, distance, u, v = read_hit(ray, bits, scene.geometry)
    return True, np.int64(instance), np.int64(triangle), distance, u, v


@kernel
def _next_hit(scene, work, row, lane, direction, mask):
    """The next transparent blocker of a shadow ray: whether there is one, and what `read_hit` says of it."""
    passed, left = work.passed, work.shadows.transparent_left
    while left[row] > 0:
        k = passed.next[row]
        if k == passed.end[row]:
            return _look_ahead(scene, work, row, lane, direction, mask)
        passed.next[row] = k + 1
        distance = passed.distance[k] - passed.gone[row]
        # Two triangles that share an edge have both been found where the ray meets one.
        if distance >= 0.0:
            return (
                True, np.int64(passed.instance[k]), np.int64(passed.triangle[k]), distance, passed.u[k], passed.v[k]
            )
        left[row] -= 1
    return False, np.int64(-1), np.int64(-1), np.float32(0.0), np.float32(0.0), np.float32(0.0)


@kernel
def _go_to_hit(scene, work, row, lane, direction, instance, triangle, distance, u, v):
    """Let a shadow ray go on from what it has met, which is set up as a point to shade; returned: where."""
    geometry, points, shadows = scene.geometry, work.light_points, work.shadows
    error = prepare_point(geometry, points, row, instance, triangle, u, v, direction, work.paths.time[lane])
    p, ng = real_3(points, row, POINT_P), real_3(points, row, POINT_NG)
    if geometry.mesh_table[geometry.instance_table[instance, INSTANCE_MESH], MESH_SHAPE] != SHAPE_TRIANGLES:
        # `prepare_passed_rounds` does the rest.
        p = add(load(shadows.origin, row), scale(direction, distance))
    in_place = points.integer[row, POINT_FLAGS] & POINT_FLAG_IN_PLACE != 0
    behind = p if in_place else offset_origin(p, ng, direction, error)
    store(shadows.origin, row, behind)
    shadows.distance[row] -= distance
    work.passed.gone[row] += distance + dot(subtract(behind, p), direction)
    return p


@kernel
def pass_transparent(scene, unit, work, queue):
    """Take every pending shadow ray to its next transparent blocker that needs its program run.

    By row of `work.shadows`, `work.light_points` are where to evaluate, and `work.light_shaded` is what came of it.

    Parameters
    ----------
    queue : LaneQueue
        Rows of `work.shadows`. Those that still wait stay; the others have been blocked or have delivered their light.
    """
    geometry, options, spectrum = scene.geometry, scene.options, scene.spectrum
    programs, program_values = scene.shaders.programs, scene.shaders.program_values
    paths, shadows, points, closures = work.paths, work.shadows, work.light_points, work.light_shaded
    passes = work.passes
    pending, pending_count = queue.lanes, queue.count[0]
    shift = CATCHER_MASK_SHIFT if unit.header[UNIT_FOLLOWS] != 0 else 0
    every = MASK_SHADOW_TRANSPARENT << shift
    kept = 0
    for k in range(pending_count):
        row = pending[k]
        lane = shadows.lane[row]
        direction = load(shadows.direction, row)
        mask = shadow_mask(scene.lights, work.samples.emitter[lane], every, shift)
        # A ray that has passed something since `intersect_shadow` waited for its program.
        if shadows.transparent_depth[row] > paths.transparent_depth[lane]:
            # A holdout lets no light through: it is a hole in the picture alone.
            largest = filter_by(
                spectrum, paths, lane, shadows.radiance, row, closures.transparency[row, 0],
                closures.transparency[row, 1], closures.transparency[row, 2],
            )
            if not largest > 0.0:
                continue
        while True:
            # Behind the last of those that were counted there is nothing.
            is_met, instance, triangle, distance, u, v = _next_hit(scene, work, row, lane, direction, mask)
            if not is_met:
                add_sampled(options, paths, passes, lane, shadows, row)
                break
            shadows.transparent_left[row] -= 1
            shadows.transparent_depth[row] += 1
            if shadows.transparent_depth[row] > options.max_transparent_depth:
                break
            p = _go_to_hit(scene, work, row, lane, direction, instance, triangle, distance, u, v)
            real = points.real
            program = program_of(geometry, instance, triangle)
            if programs[program, PROGRAM_FLAGS] & PROGRAM_TRANSPARENCY_CONSTANT:
                largest = filter_by(
                    spectrum, paths, lane, shadows.radiance, row, program_values[program, VALUE_TRANSPARENCY],
                    program_values[program, VALUE_TRANSPARENCY + 1], program_values[program, VALUE_TRANSPARENCY + 2],
                )
                if not largest > 0.0:
                    break
                continue
            integer = points.integer
            integer[row, POINT_PROGRAM] = program
            integer[row, POINT_RAY_FLAGS] = RAY_SHADOW
            # As in Cycles, a surface does not count itself, and the length is that from where the light is looked for.
            store_depths(paths, lane, shadows.transparent_depth[row] - 1, points, row)
            real[row, POINT_RAY_LENGTH] = length(subtract(p, real_3(work.points, lane, POINT_P)))
            real[row, POINT_RADIUS] = 0.0
            real[row, POINT_RANDOM] = paths.random[lane, 2]
            pending[kept] = row
            kept += 1
            break
    queue.count[0] = kept
