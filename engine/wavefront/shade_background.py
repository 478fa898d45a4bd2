# SPDX-License-Identifier: GPL-3.0-or-later
"""Stages around the background: set up its points, and add its light to paths that left the scene.

Between the two, `evaluate_shaders` runs the world's program where it is not constant.
"""

import numpy as np

from engine.film import FEATURE_ENVIRONMENT, NO_DEPTH, POINT_DEPTH
from engine.jit import kernel
from engine.kernels.lights import background_pdf
from engine.kernels.radiance import add_radiance, power_heuristic
from engine.kernels.spectrum import to_rgb
from engine.kernels.vector import load
from engine.shaders.arrays import VALUE_EMISSION
from engine.state import POINT_DEPTH as POINT_PATH_DEPTH
from engine.state import (
    POINT_DIFFUSE_DEPTH,
    POINT_FLAGS,
    POINT_GLOSSY_DEPTH,
    POINT_INSTANCE,
    POINT_LIGHT,
    POINT_NG,
    POINT_NS,
    POINT_P,
    POINT_PROGRAM,
    POINT_RADIUS,
    POINT_RANDOM,
    POINT_RAY_FLAGS,
    POINT_RAY_LENGTH,
    POINT_TIME,
    POINT_TRANSMISSION_DEPTH,
    POINT_TRANSPARENT_DEPTH,
    POINT_TRIANGLE,
    POINT_U,
    POINT_V,
    POINT_WO,
    RAY_EMISSION,
    RAY_MIS_HAD_TRANSMISSION,
    RAY_MIS_SKIP,
    RAY_PASSES_DONE,
    RAY_TRANSPARENT_BACKGROUND,
    RAY_VISIBILITY,
    RGB,
)


@kernel
def fill_background(program_values, world_program, closures, missed, missed_count):
    """Emission of a world whose program is constant; black without a world (`world_program` -1)."""
    for k in range(missed_count):
        for c in range(len(closures.channels)):
            value = 0.0
            if world_program >= 0:
                value = program_values[world_program, VALUE_EMISSION + c]
            closures.emission[missed[k], c] = value


@kernel
def prepare_background(world_program, paths, points, missed, missed_count):
    """Set up points for the world's program: its position *is* the direction, as in Cycles."""
    for k in range(missed_count):
        lane = missed[k]
        real = points.real
        for c in range(3):
            direction = paths.direction[lane, c]
            real[lane, POINT_P + c] = direction
            real[lane, POINT_WO + c] = -direction
            real[lane, POINT_NG + c] = -direction
            real[lane, POINT_NS + c] = -direction
        real[lane, POINT_U] = 0.0
        real[lane, POINT_V] = 0.0
        real[lane, POINT_RAY_LENGTH] = 1e30
        real[lane, POINT_RADIUS] = paths.spread[lane]
        real[lane, POINT_RANDOM] = paths.random[lane, 2]
        real[lane, POINT_TIME] = paths.time[lane]
        integer = points.integer
        integer[lane, POINT_INSTANCE] = -1
        integer[lane, POINT_TRIANGLE] = -1
        integer[lane, POINT_PROGRAM] = world_program
        integer[lane, POINT_RAY_FLAGS] = paths.flags[lane] | RAY_EMISSION
        integer[lane, POINT_FLAGS] = 0
        integer[lane, POINT_PATH_DEPTH] = paths.depth[lane]
        integer[lane, POINT_DIFFUSE_DEPTH] = paths.diffuse_depth[lane]
        integer[lane, POINT_GLOSSY_DEPTH] = paths.glossy_depth[lane]
        integer[lane, POINT_TRANSMISSION_DEPTH] = paths.transmission_depth[lane]
        integer[lane, POINT_TRANSPARENT_DEPTH] = paths.transparent_depth[lane]
        integer[lane, POINT_LIGHT] = -1


@kernel
def shade_background(
    lights, spectrum, options, visibility, paths, closures, missed, missed_count, film, write_features
):
    """Add the background seen by paths that left the scene, MIS-weighted, and end them.

    Parameters
    ----------
    spectrum : SpectralTables
    visibility : int
        VISIBLE_* bits of the world.
    closures : Closures
        `emission` holds the background's radiance by lane.
    film : FilmTile
        Receives the Environment pass and the depth of nothing, if `write_features`.
    """
    for k in range(missed_count):
        lane = missed[k]
        paths.alive[lane] = 0
        flags = paths.flags[lane]
        seen = True
        if options.film_transparent != 0 and flags & RAY_TRANSPARENT_BACKGROUND:
            average = 0.0
            for c in range(len(paths.channels)):
                average += paths.throughput[lane, c]
            paths.alpha[lane] -= average / np.float32(len(paths.channels))
            seen = False
        if seen and (flags & RAY_VISIBILITY & visibility):
            weight = 1.0
            if options.use_nee != 0 and not flags & RAY_MIS_SKIP:
                pdf = background_pdf(
                    lights,
                    load(paths.mis_origin, lane),
                    load(paths.mis_normal, lane),
                    (flags & RAY_MIS_HAD_TRANSMISSION) != 0,
                    load(paths.direction, lane),
                )
                weight = power_heuristic(paths.mis_pdf[lane], pdf)
            for c in range(len(paths.channels)):
                closures.emission[lane, c] *= paths.throughput[lane, c] * weight
            add_radiance(
                paths, lane, closures.emission, lane, paths.depth[lane] - 1, options.clamp_direct,
                options.clamp_indirect, 1.0,
            )
            if write_features and flags & RAY_TRANSPARENT_BACKGROUND:
                color = to_rgb(spectrum, paths, lane, closures.emission, lane)
                for c in range(RGB):
                    film.features[paths.pixel[lane], FEATURE_ENVIRONMENT + c] += color[c]
        if write_features and not flags & RAY_PASSES_DONE and film.count[paths.pixel[lane]] == 0:
            film.points[paths.pixel[lane], POINT_DEPTH] = NO_DEPTH
