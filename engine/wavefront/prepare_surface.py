# SPDX-License-Identifier: GPL-3.0-or-later
"""Stage: sort paths by what they hit, play Russian roulette, and set up the point to shade.

Roulette comes before shading, so that paths that end never run a shader unless the surface emits. Its survival
probability is the square root of the largest channel of the throughput that BSDF sampling would have given the path, as
in Cycles; the throughput is divided by it in `shade_emission`, behind the emission that was found either way.
"""

import math

import numpy as np

from engine.jit import kernel
from engine.kernels.prefetch import prefetch
from engine.kernels.rng import SET_BSDF, sample_4d
from engine.kernels.surface import prepare_point, program_of
from engine.kernels.vector import load
from engine.scene.arrays import (
    INSTANCE_FLAG_HOLDOUT,
    INSTANCE_FLAGS,
    INSTANCE_MESH,
    MESH_FIRST_NORMAL,
    MESH_FIRST_TRIANGLE,
)
from engine.shaders.arrays import PROGRAM_FLAGS, PROGRAM_HAS_EMISSION, PROGRAM_MAY_BE_TRANSPARENT
from engine.state import (
    POINT_DEPTH,
    POINT_DIFFUSE_DEPTH,
    POINT_GLOSSY_DEPTH,
    POINT_PROGRAM,
    POINT_RADIUS,
    POINT_RANDOM,
    POINT_RAY_FLAGS,
    POINT_RAY_LENGTH,
    POINT_TIME,
    POINT_TRANSMISSION_DEPTH,
    POINT_TRANSPARENT_DEPTH,
    RAY_TERMINATE_AFTER_TRANSPARENT,
    RAY_TERMINATE_ON_NEXT_SURFACE,
    RAY_TRANSPARENT,
)

#: How many hits ahead triangles are asked for, and then their vertices: memory is that much slower than the stage.
_TRIANGLES_AHEAD = 8
_VERTICES_AHEAD = 4


@kernel
def _ask_for_triangle(geometry, paths, lane):
    """Prefetch what `prepare_point` will read of a hit, but for the vertices."""
    instance = paths.hit_instance[lane]
    if instance >= 0:
        triangle = np.int64(paths.hit_triangle[lane])
        prefetch(geometry.triangles, triangle)
        prefetch(geometry.material_slots, triangle)
        mesh = geometry.instance_table[instance, INSTANCE_MESH]
        first_normal = geometry.mesh_table[mesh, MESH_FIRST_NORMAL]
        if first_normal >= 0:
            prefetch(geometry.corner_normals, first_normal + triangle - geometry.mesh_table[mesh, MESH_FIRST_TRIANGLE])


@kernel
def _ask_for_vertices(geometry, paths, lane):
    """Prefetch the vertices of a hit."""
    if paths.hit_instance[lane] >= 0:
        triangle = paths.hit_triangle[lane]
        for corner in range(3):
            prefetch(geometry.vertices, np.int64(geometry.triangles[triangle, corner]))


@kernel
def prepare_surface(geometry, programs, options, paths, points, active, active_count, surface, missed):
    """Sort the active lanes.

    Parameters
    ----------
    surface, missed : int32 (L,)
        Filled with lanes to be shaded, and with lanes that left the scene. Lanes in neither have ended.

    Returns
    -------
    surface_count, missed_count : int
    """
    surface_count = 0
    missed_count = 0
    for k in range(active_count):
        lane = active[k]
        if k + _TRIANGLES_AHEAD < active_count:
            _ask_for_triangle(geometry, paths, active[k + _TRIANGLES_AHEAD])
        if k + _VERTICES_AHEAD < active_count:
            _ask_for_vertices(geometry, paths, active[k + _VERTICES_AHEAD])
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
        depth = paths.depth[lane]

        u0, u1, u2, u3 = sample_4d(paths.rng[lane], paths.sample[lane], paths.dimension[lane] + SET_BSDF)
        paths.random[lane, 0] = u0
        paths.random[lane, 1] = u1
        paths.random[lane, 2] = u2

        survival = 1.0
        if options.use_roulette != 0:
            if flags & RAY_TRANSPARENT:
                sure = paths.transparent_depth[lane] <= options.min_transparent_depth
            else:
                sure = depth <= options.min_depth
            if not sure:
                largest = 0.0
                for c in range(len(paths.channels)):
                    largest = max(largest, abs(paths.throughput[lane, c]))
                survival = min(math.sqrt(largest * paths.unguided[lane]), 1.0)
                if u3 >= survival:
                    flags |= RAY_TERMINATE_ON_NEXT_SURFACE
                    paths.flags[lane] = flags
        # The survival probability waits here for shade_emission.
        paths.random[lane, 3] = survival

        ends = flags & (RAY_TERMINATE_ON_NEXT_SURFACE | RAY_TERMINATE_AFTER_TRANSPARENT)
        if ends:
            wanted = PROGRAM_HAS_EMISSION
            if not flags & RAY_TERMINATE_ON_NEXT_SURFACE:
                wanted |= PROGRAM_MAY_BE_TRANSPARENT
            if not program_flags & wanted and not holdout:
                paths.alive[lane] = 0
                continue

        direction = load(paths.direction, lane)
        error = prepare_point(
            geometry, points, lane, instance, triangle, paths.hit_u[lane], paths.hit_v[lane], direction
        )
        distance = paths.hit_distance[lane]
        paths.offset[lane] = error
        real = points.real
        real[lane, POINT_RAY_LENGTH] = distance
        real[lane, POINT_RADIUS] = paths.radius[lane] + distance * paths.spread[lane]
        real[lane, POINT_RANDOM] = u3
        real[lane, POINT_TIME] = paths.time[lane]
        integer = points.integer
        integer[lane, POINT_PROGRAM] = program
        integer[lane, POINT_RAY_FLAGS] = flags
        integer[lane, POINT_DEPTH] = depth
        integer[lane, POINT_DIFFUSE_DEPTH] = paths.diffuse_depth[lane]
        integer[lane, POINT_GLOSSY_DEPTH] = paths.glossy_depth[lane]
        integer[lane, POINT_TRANSMISSION_DEPTH] = paths.transmission_depth[lane]
        integer[lane, POINT_TRANSPARENT_DEPTH] = paths.transparent_depth[lane]
        surface[surface_count] = lane
        surface_count += 1
    return surface_count, missed_count
