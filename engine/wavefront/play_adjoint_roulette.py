# SPDX-License-Identifier: GPL-3.0-or-later
"""Stage: Russian roulette by what a path is expected to bring to its pixel from the surface that it has hit.

A path goes on with its throughput times the importance of the surface's cell (`engine.guiding.fields.roulette`), over
the pixel's value, times a factor for the whole image: what is expected over what it costs to find, beside the same of
the image. So paths end where they have little to bring, and go on where they have much, however dark the way was. Where
no cell is known they go on as the throughput alone says.

It is played before the surface is shaded. What the surface emits is found either way.

References: Vorba and Krivanek 2016, "Adjoint-Driven Russian Roulette and Splitting in Light Transport Simulation"; Rath
et al. 2022, "EARS: Efficiency-Aware Russian Roulette and Splitting" (the factor for roulette, without splitting).
"""

import math

import numpy as np

from engine.guiding.fields.roulette.field import NUMBER_LEAST, NUMBER_SCALE, find_importance
from engine.kernels.constants import ONE_MINUS_EPSILON
from engine.kernels.path import real_3
from engine.kernels.prefetch import ask_for_point, ask_for_ray, ask_for_throughput, lane_ahead
from engine.runtime.jit import kernel
from engine.state.geometry import INSTANCE_FLAG_HOLDOUT, INSTANCE_FLAGS
from engine.state.lanes import (
    POINT_INSTANCE,
    POINT_NS,
    POINT_P,
    POINT_PROGRAM,
    POINT_RANDOM,
    RAY_DIFFUSE_ANCESTOR,
    RAY_SUBSURFACE,
    RAY_TERMINATE_AFTER_TRANSPARENT,
    RAY_TERMINATE_ON_NEXT_SURFACE,
    RAY_TRANSPARENT,
)
from engine.state.shaders import PROGRAM_FLAGS, PROGRAM_HAS_EMISSION, PROGRAM_MAY_BE_TRANSPARENT

#: Rays whose roulette has been played, or is not needed.
_SETTLED = RAY_TERMINATE_AFTER_TRANSPARENT | RAY_TERMINATE_ON_NEXT_SURFACE | RAY_TRANSPARENT | RAY_SUBSURFACE
_SHOWS_MORE = PROGRAM_HAS_EMISSION | PROGRAM_MAY_BE_TRANSPARENT


@kernel
def play_adjoint_roulette(scene, unit, radiance, work, queue):
    """Decide which paths end at the surfaces that they have hit, and take those that find nothing there out.

    `paths.survival` holds the probability by the throughput before, and the one that was played with behind.

    Parameters
    ----------
    radiance : RadianceView
        With the field.
    queue : LaneQueue
        `work.surface`.
    """
    field, pixel_weight, min_depth = radiance.roulette_field, unit.pixel_weight, scene.options.min_depth
    programs, instances = scene.shaders.programs, scene.geometry.instance_table
    paths, points = work.paths, work.points
    scale, least = field.numbers[NUMBER_SCALE], field.numbers[NUMBER_LEAST]
    lanes, lane_count = queue.lanes, queue.count[0]
    kept = 0
    for k in range(lane_count):
        lane = lanes[k]
        ahead = lane_ahead(lanes, k, lane_count)
        ask_for_ray(paths, ahead)
        ask_for_throughput(paths, ahead)
        ask_for_point(points, ahead)
        # Those that end are overwritten.
        lanes[kept] = lane
        kept += 1
        flags = paths.flags[lane]
        depth = paths.depth[lane]
        if flags & _SETTLED or depth < min_depth:
            continue
        survival = paths.survival[lane]
        program = points.integer[lane, POINT_PROGRAM]
        finds_more = programs[program, PROGRAM_FLAGS] & _SHOWS_MORE != 0
        # What the camera sees in mirrors has passes to fill.
        if not finds_more and (flags & RAY_DIFFUSE_ANCESTOR or depth > min_depth):
            importance = find_importance(
                field, real_3(points, lane, POINT_P), real_3(points, lane, POINT_NS), program
            )
            total = np.float32(0.0)
            for c in range(len(paths.channels)):
                total += abs(paths.throughput[lane, c])
            total *= math.sqrt(pixel_weight[paths.pixel[lane]]) / np.float32(len(paths.channels))
            wanted = scale * importance * total
            # Written so that NaN fails.
            if wanted >= np.float32(0.0):
                survival = min(max(wanted, least), np.float32(1.0))
        paths.survival[lane] = survival
        u = paths.random[lane, 3]
        if u < survival:
            # Uniform again, for what is to come.
            u = min(u / survival, ONE_MINUS_EPSILON)
            paths.random[lane, 3] = u
            points.real[lane, POINT_RANDOM] = u
        elif finds_more or instances[points.integer[lane, POINT_INSTANCE], INSTANCE_FLAGS] & INSTANCE_FLAG_HOLDOUT:
            paths.flags[lane] = flags | RAY_TERMINATE_ON_NEXT_SURFACE
        else:
            paths.alive[lane] = 0
            kept -= 1
    queue.count[0] = kept
