# SPDX-License-Identifier: GPL-3.0-or-later
"""Stage: draw the next vertex's numbers, play Russian roulette, and leave out rays that cannot matter.

The survival probability is the square root of the largest channel of the throughput that plain sampling would have
given the path, as in Cycles, or what guiding asks for if that is more (`engine.guiding.sampling.scattering`); the
throughput is divided by it in `shade_emission`, behind the emission that is found either way. Nothing of it depends on
what the ray will hit, so it comes before the tracing: a path that ends at the next surface can only find emission
there, and needs no ray where there is none along its line.
"""

import math

import numpy as np

from engine.kernels.constants import ONE_MINUS_EPSILON
from engine.kernels.prefetch import ask_for_ray, ask_for_throughput, lane_ahead
from engine.kernels.rng import SET_BSDF, sample_4d
from engine.kernels.vector import dot, load
from engine.runtime.jit import kernel
from engine.state.lanes import (
    RAY_ENDS,
    RAY_SUBSURFACE,
    RAY_TERMINATE_ON_NEXT_SURFACE,
    RAY_TRANSPARENT,
    RAY_TRANSPARENT_BACKGROUND,
)
from engine.state.lights import HEADER_SOURCES
from engine.wavefront.columns import UNIT_PREDICTS


@kernel
def _meets_source(sources, source_count, origin, direction):
    """Whether a ray passes through one of the spheres that hold all emission."""
    for row in range(source_count):
        offset = (sources[row, 0] - origin[0], sources[row, 1] - origin[1], sources[row, 2] - origin[2])
        along = dot(offset, direction)
        squared = dot(offset, offset)
        # Room for rounding; behind the origin only where the sphere holds it.
        reach = sources[row, 3] + 1e-5 * squared
        if squared - along * along <= reach and (along >= 0.0 or squared <= reach):
            return True
    return False


@kernel
def play_roulette(scene, unit, work, queue):
    """Decide which paths end at the next surface, and which rays are worth tracing.

    `work.traced` is filled with the lanes to be traced. The others have ended. Rays of recorded paths are all traced:
    how far they get is part of a record.
    """
    lights, options, paths, log = scene.lights, scene.options, work.paths, work.log
    active, active_count, traced = queue.lanes, queue.count[0], work.traced.lanes
    traced_count = 0
    predicts = unit.header[UNIT_PREDICTS] != 0
    source_count = lights.header[HEADER_SOURCES]
    for k in range(active_count):
        lane = active[k]
        ahead = lane_ahead(active, k, active_count)
        ask_for_ray(paths, ahead)
        ask_for_throughput(paths, ahead)
        if paths.alive[lane] == 0:
            # A new one, of what a panorama does not see.
            continue
        u1, u2, u0, u3 = sample_4d(paths.rng[lane], paths.sample[lane], paths.dimension[lane] + SET_BSDF)
        paths.random[lane, 0] = u0
        paths.random[lane, 1] = u1
        paths.random[lane, 2] = u2
        paths.random[lane, 3] = u3

        flags = paths.flags[lane]
        survival = np.float32(1.0)
        plain = np.float32(1.0)
        if options.use_roulette != 0:
            if flags & RAY_SUBSURFACE:
                # It was played where the path went in.
                sure = True
            elif flags & RAY_TRANSPARENT:
                sure = paths.transparent_depth[lane] <= options.min_transparent_depth
            else:
                sure = paths.depth[lane] <= options.min_depth
            if not sure:
                largest = np.float32(0.0)
                for c in range(len(paths.channels)):
                    largest = max(largest, abs(paths.throughput[lane, c]))
                plain = min(np.float32(math.sqrt(largest * paths.unguided[lane])), np.float32(1.0))
                survival = max(paths.survival[lane], plain)
                if predicts and not flags & RAY_TRANSPARENT:
                    # What the ray hits has a say.
                    pass
                elif u3 >= survival:
                    flags |= RAY_TERMINATE_ON_NEXT_SURFACE
                    paths.flags[lane] = flags
                else:
                    # Uniform again, for what is to come.
                    paths.random[lane, 3] = min(u3 / survival, ONE_MINUS_EPSILON)
        paths.survival[lane] = survival
        paths.unguided_survival[lane] = plain

        # Behind transparent surfaces a path goes on along the same line. What it would take from alpha is settled once
        # it has scattered.
        ends = flags & RAY_ENDS
        if (
            ends
            and source_count >= 0
            and not flags & RAY_TRANSPARENT_BACKGROUND
            and log.is_recording[lane] == 0
            and not _meets_source(lights.sources, source_count, load(paths.origin, lane), load(paths.direction, lane))
        ):
            paths.alive[lane] = 0
            continue
        traced[traced_count] = lane
        traced_count += 1
    work.traced.count[0] = traced_count
