# SPDX-License-Identifier: GPL-3.0-or-later
"""Stage: sort paths by what they hit and set up the point to shade; paths that end here only where it emits."""

from engine.kernels.hit_prefetch import (
    HITS_AHEAD,
    TRIANGLES_AHEAD,
    VERTICES_AHEAD,
    ask_for_triangle,
    ask_for_vertices,
)
from engine.kernels.path_depths import store_depths
from engine.kernels.prefetch import (
    ask_for_history,
    ask_for_point,
    ask_for_ray,
    ask_for_throughput,
    lane_ahead,
)
from engine.kernels.surface import prepare_point, program_of
from engine.kernels.vector import load
from engine.runtime.jit import kernel
from engine.state.geometry import (
    INSTANCE_FLAG_HOLDOUT,
    INSTANCE_FLAGS,
)
from engine.state.lanes import (
    POINT_PROGRAM,
    POINT_RADIUS,
    POINT_RANDOM,
    POINT_RAY_FLAGS,
    POINT_RAY_LENGTH,
    RAY_ENDS,
    RAY_TERMINATE_ON_NEXT_SURFACE,
)
from engine.state.shaders import PROGRAM_FLAGS, PROGRAM_HAS_EMISSION, PROGRAM_MAY_BE_TRANSPARENT


@kernel
def prepare_surface(scene, unit, work, queue):
    """Sort lanes into `work.surface`, to be shaded, and `work.missed`, which left the scene; the others have ended."""
    geometry, programs, paths, points = scene.geometry, scene.shaders.programs, work.paths, work.points
    active, active_count = queue.lanes, queue.count[0]
    surface, missed = work.surface.lanes, work.missed.lanes
    surface_count = 0
    missed_count = 0
    for k in range(active_count):
        lane = active[k]
        ask_for_ray(paths, active[min(k + HITS_AHEAD, active_count - 1)])
        ahead = lane_ahead(active, k, active_count)
        ask_for_throughput(paths, ahead)
        ask_for_history(paths, ahead)
        ask_for_point(points, ahead)
        if k + TRIANGLES_AHEAD < active_count:
            ask_for_triangle(geometry, paths, active[k + TRIANGLES_AHEAD])
        if k + VERTICES_AHEAD < active_count:
            ask_for_vertices(geometry, paths, active[k + VERTICES_AHEAD])
        instance = paths.hit_instance[lane]
        if instance < 0:
            missed[missed_count] = lane
            missed_count += 1
            continue
        triangle = paths.hit_triangle[lane]
        program = program_of(geometry, instance, triangle)
        program_flags = programs[program, PROGRAM_FLAGS]
        holdout = geometry.instance_table[instance, INSTANCE_FLAGS] & INSTANCE_FLAG_HOLDOUT
        flags = paths.flags[lane]

        ends = flags & RAY_ENDS
        if ends:
            wanted = PROGRAM_HAS_EMISSION
            if not flags & RAY_TERMINATE_ON_NEXT_SURFACE:
                wanted |= PROGRAM_MAY_BE_TRANSPARENT
            if not program_flags & wanted and not holdout:
                paths.alive[lane] = 0
                continue

        direction = load(paths.direction, lane)
        paths.room[lane] = prepare_point(
            geometry, points, lane, instance, triangle, paths.hit_u[lane], paths.hit_v[lane], direction,
            paths.time[lane],
        )
        distance = paths.hit_distance[lane]
        real = points.real
        real[lane, POINT_RAY_LENGTH] = distance
        real[lane, POINT_RADIUS] = paths.radius[lane] + distance * paths.spread[lane]
        real[lane, POINT_RANDOM] = paths.random[lane, 3]
        integer = points.integer
        integer[lane, POINT_PROGRAM] = program
        integer[lane, POINT_RAY_FLAGS] = flags
        store_depths(paths, lane, paths.transparent_depth[lane], points, lane)
        surface[surface_count] = lane
        surface_count += 1
    work.surface.count[0] = surface_count
    work.missed.count[0] = missed_count
