# SPDX-License-Identifier: GPL-3.0-or-later
"""Stage: light samples meet what stands in their way.

Opaque blockers end a shadow ray at once. Transparent ones dim it: where their transparency is constant within the
kernel, else the ray waits in `pending` until `evaluate_shaders` has run the program at the blocker.
"""

import numpy as np

from engine.accel import MASK_SHADOW_OPAQUE, MASK_SHADOW_TRANSPARENT, trace_closest, trace_occluded
from engine.jit import kernel
from engine.kernels.prefetch import ask_for_ray, ask_for_throughput
from engine.kernels.radiance import add_radiance
from engine.kernels.spectrum import filter_by
from engine.kernels.surface import offset_origin, prepare_point, program_of
from engine.kernels.vector import load, store
from engine.scene.arrays import INSTANCE_MESH, MESH_FIRST_TRIANGLE
from engine.shaders.arrays import PROGRAM_FLAGS, PROGRAM_TRANSPARENCY_CONSTANT, VALUE_TRANSPARENCY
from engine.state import (
    POINT_DEPTH,
    POINT_DIFFUSE_DEPTH,
    POINT_GLOSSY_DEPTH,
    POINT_NG,
    POINT_P,
    POINT_PROGRAM,
    POINT_RADIUS,
    POINT_RANDOM,
    POINT_RAY_FLAGS,
    POINT_RAY_LENGTH,
    POINT_TRANSMISSION_DEPTH,
    POINT_TRANSPARENT_DEPTH,
    RAY_SHADOW,
)

_NO_INSTANCE = np.uint32(0xFFFFFFFF)
_ROWS_AHEAD = 2


@kernel
def intersect_shadow(scene, ray, bits, address, options, paths, shadows, shadow_count, has_transparent, pending):
    """Trace all shadow rays and add the light of those that pass.

    Rays that meet transparent blockers only are listed in `pending` (rows of `shadows`) instead.

    Returns
    -------
    pending_count : int
    """
    pending_count = 0
    # Most rays meet nothing at all, and this way need no second look.
    mask = MASK_SHADOW_OPAQUE | (MASK_SHADOW_TRANSPARENT if has_transparent else 0)
    for row in range(shadow_count):
        lane = shadows.lane[row]
        ahead = shadows.lane[min(row + _ROWS_AHEAD, shadow_count - 1)]
        ask_for_ray(paths, ahead)
        ask_for_throughput(paths, ahead)
        if not shadows.distance[row] > 0.0:
            # A light that casts no shadow, or one touching the surface.
            add_radiance(
                paths, lane, shadows.radiance, row, paths.depth[lane], options.clamp_direct, options.clamp_indirect,
                shadows.weight[row],
            )
            continue
        origin = load(shadows.origin, row)
        direction = load(shadows.direction, row)
        far = shadows.distance[row]
        blocked = trace_occluded(scene, ray, bits, address, origin, direction, 0.0, far, paths.time[lane], mask)
        if not blocked:
            add_radiance(
                paths, lane, shadows.radiance, row, paths.depth[lane], options.clamp_direct, options.clamp_indirect,
                shadows.weight[row],
            )
        elif has_transparent and not trace_occluded(
            scene, ray, bits, address, origin, direction, 0.0, far, paths.time[lane], MASK_SHADOW_OPAQUE
        ):
            shadows.transparent_depth[row] = paths.transparent_depth[lane]
            pending[pending_count] = row
            pending_count += 1
    return pending_count


@kernel
def pass_transparent(
    scene, ray, bits, address, options, spectrum, geometry, programs, program_values, paths, shadows, points, closures,
    pending, pending_count, is_evaluated,
):
    """Take every pending shadow ray to its next transparent blocker that needs its program run.

    Parameters
    ----------
    spectrum : SpectralTables
    points, closures : ShadePoints, Closures (as shaders see them)
        By row of `shadows`: where to evaluate, and on the next call what came of it (`is_evaluated`).

    Returns
    -------
    pending_count : int
        Rays still waiting; the others have been blocked or have delivered their light.
    """
    kept = 0
    for k in range(pending_count):
        row = pending[k]
        lane = shadows.lane[row]
        direction = load(shadows.direction, row)
        if is_evaluated:
            holdout = closures.holdout[row]
            largest = filter_by(
                spectrum, paths, lane, shadows.radiance, row, closures.transparency[row, 0] + holdout,
                closures.transparency[row, 1] + holdout, closures.transparency[row, 2] + holdout,
            )
            if not largest > 0.0:
                continue
        while True:
            hit = trace_closest(
                scene, ray, bits, address, load(shadows.origin, row), direction, 0.0, shadows.distance[row],
                paths.time[lane], MASK_SHADOW_TRANSPARENT,
            )
            if not hit:
                add_radiance(
                    paths, lane, shadows.radiance, row, paths.depth[lane], options.clamp_direct,
                    options.clamp_indirect, shadows.weight[row],
                )
                break
            shadows.transparent_depth[row] += 1
            if shadows.transparent_depth[row] > options.max_transparent_depth:
                break
            distance = ray[8]
            u = ray[15]
            v = ray[16]
            top = bits[19]
            if top == _NO_INSTANCE:
                top = bits[18]
            instance = np.int32(top)
            mesh = geometry.instance_table[instance, INSTANCE_MESH]
            triangle = geometry.mesh_table[mesh, MESH_FIRST_TRIANGLE] + np.int32(bits[17])
            error = prepare_point(geometry, points, row, instance, triangle, u, v, direction, paths.time[lane])
            real = points.real
            p = (real[row, POINT_P], real[row, POINT_P + 1], real[row, POINT_P + 2])
            ng = (real[row, POINT_NG], real[row, POINT_NG + 1], real[row, POINT_NG + 2])
            store(shadows.origin, row, offset_origin(p, ng, direction, error))
            shadows.distance[row] -= distance
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
            integer[row, POINT_DEPTH] = paths.depth[lane]
            integer[row, POINT_DIFFUSE_DEPTH] = paths.diffuse_depth[lane]
            integer[row, POINT_GLOSSY_DEPTH] = paths.glossy_depth[lane]
            integer[row, POINT_TRANSMISSION_DEPTH] = paths.transmission_depth[lane]
            integer[row, POINT_TRANSPARENT_DEPTH] = shadows.transparent_depth[row]
            real[row, POINT_RAY_LENGTH] = distance
            real[row, POINT_RADIUS] = 0.0
            real[row, POINT_RANDOM] = paths.random[lane, 2]
            pending[kept] = row
            kept += 1
            break
    return kept
