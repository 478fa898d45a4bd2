# SPDX-License-Identifier: GPL-3.0-or-later
"""Stages around the background: set up its points, and add its light to paths that left the scene.

Between the two, `evaluate_shaders` runs the world's program where it is not constant.
"""

import numpy as np

from engine.kernels.caustics import caster_receiver, share_of_path
from engine.kernels.clamping import found_alone
from engine.kernels.constants import DISTANT
from engine.kernels.lights import background_pdf, emitter_towards, tree_of_ray
from engine.kernels.path_depths import store_depths
from engine.kernels.radiance import add_emission, add_seen, show_left_out, weigh_found
from engine.kernels.vector import load
from engine.runtime.jit import kernel
from engine.state.film import FEATURE_ENVIRONMENT, FIRST_WIDTH
from engine.state.lanes import (
    POINT_FLAGS,
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
    POINT_TANGENT,
    POINT_TIME,
    POINT_TRIANGLE,
    POINT_U,
    POINT_V,
    POINT_WO,
    RAY_CAUSTIC,
    RAY_EMISSION,
    RAY_MIS_FINDS_ALL,
    RAY_MIS_HAD_TRANSMISSION,
    RAY_MIS_SKIP,
    RAY_PASSES_DONE,
    RAY_TRANSPARENT_BACKGROUND,
    RAY_VISIBILITY,
    RGB,
)
from engine.state.shaders import VALUE_EMISSION
from engine.wavefront.columns import (
    SCENE_WORLD_GROUP,
    SCENE_WORLD_PROGRAM,
    SCENE_WORLD_VISIBILITY,
    UNIT_SHOWS_BACKGROUND,
    UNIT_USE_DENOISING,
    UNIT_USE_FEATURES,
)


@kernel
def fill_background(scene, unit, work, queue):
    """Emission of a world whose program is constant; black without a world (program -1)."""
    program_values, world_program = scene.shaders.program_values, scene.header[SCENE_WORLD_PROGRAM]
    closures, points = work.shaded, work.points
    missed, missed_count = queue.lanes, queue.count[0]
    for k in range(missed_count):
        if len(work.paths.channels) > RGB:
            # `upsample_emission` asks which program it was.
            points.integer[missed[k], POINT_PROGRAM] = world_program
        for c in range(len(closures.channels)):
            value = 0.0
            if world_program >= 0:
                value = program_values[world_program, VALUE_EMISSION + c]
            closures.emission[missed[k], c] = value


@kernel
def prepare_background(scene, unit, work, queue):
    """Set up points for the world's program: its position *is* the direction, as in Cycles."""
    world_program, paths, points = scene.header[SCENE_WORLD_PROGRAM], work.paths, work.points
    missed, missed_count = queue.lanes, queue.count[0]
    for k in range(missed_count):
        lane = missed[k]
        real = points.real
        for c in range(3):
            direction = paths.direction[lane, c]
            real[lane, POINT_P + c] = direction
            real[lane, POINT_WO + c] = -direction
            real[lane, POINT_NG + c] = -direction
            real[lane, POINT_NS + c] = -direction
            real[lane, POINT_TANGENT + c] = paths.origin[lane, c]
        real[lane, POINT_U] = 0.0
        real[lane, POINT_V] = 0.0
        real[lane, POINT_RAY_LENGTH] = DISTANT
        real[lane, POINT_RADIUS] = paths.spread[lane]
        real[lane, POINT_RANDOM] = paths.random[lane, 2]
        real[lane, POINT_TIME] = paths.time[lane]
        integer = points.integer
        integer[lane, POINT_INSTANCE] = -1
        integer[lane, POINT_TRIANGLE] = -1
        integer[lane, POINT_PROGRAM] = world_program
        integer[lane, POINT_RAY_FLAGS] = paths.flags[lane] | RAY_EMISSION
        integer[lane, POINT_FLAGS] = 0
        store_depths(paths, lane, paths.transparent_depth[lane], points, lane)
        integer[lane, POINT_LIGHT] = -1


@kernel
def shade_background(scene, unit, work, queue):
    """Add the background seen by paths that left the scene, MIS-weighted, and end them.

    `work.closures.emission` holds the background's radiance. The film gets the Environment pass, and the first sample's
    depth and position of nothing, if features are asked for. A transparent film leaves the background out of the
    picture, but not out of that pass.
    """
    lights, spectrum, options = scene.lights, scene.spectrum, scene.options
    visibility = scene.header[SCENE_WORLD_VISIBILITY]
    paths, closures, film = work.paths, work.closures, unit.film
    use_features = unit.header[UNIT_USE_FEATURES] != 0
    use_denoising = unit.header[UNIT_USE_DENOISING] != 0
    group, shows_all = scene.header[SCENE_WORLD_GROUP], unit.header[UNIT_SHOWS_BACKGROUND] != 0
    missed, missed_count = queue.lanes, queue.count[0]
    for k in range(missed_count):
        lane = missed[k]
        paths.alive[lane] = 0
        flags = paths.flags[lane]
        is_seen = flags & RAY_VISIBILITY & visibility != 0
        is_left_out = False
        if options.film_transparent != 0 and flags & RAY_TRANSPARENT_BACKGROUND:
            average = 0.0
            for c in range(len(paths.channels)):
                average += paths.throughput[lane, c]
            paths.alpha[lane] -= average / np.float32(len(paths.channels))
            is_left_out = True
        share = np.float32(-1.0)
        if is_seen and is_left_out and shows_all:
            share = show_left_out(
                options, spectrum, paths, work.passes, lane, closures.emission, group, film, FEATURE_ENVIRONMENT
            )
        if is_seen and not is_left_out:
            weight, caustic = np.float32(1.0), np.float32(1.0)
            unguided = found_alone(paths.unguided[lane])
            if flags & RAY_CAUSTIC:
                asking, cosine = caster_receiver(paths, lane, scene.casters.lights)
                pdf = background_pdf(
                    scene.casters.lights, asking.tree, asking.p, asking.n, False, False, load(paths.direction, lane)
                )
                caustic = share_of_path(scene, work, lane, pdf, cosine)
            if options.use_nee != 0 and not flags & RAY_MIS_SKIP:
                leaves_dim = (flags & RAY_MIS_FINDS_ALL) != 0
                tree, direction = tree_of_ray(lights, flags), load(paths.direction, lane)
                pdf = background_pdf(
                    lights,
                    tree,
                    load(paths.mis_origin, lane),
                    load(paths.mis_normal, lane),
                    (flags & RAY_MIS_HAD_TRANSMISSION) != 0,
                    leaves_dim,
                    direction,
                )
                weight, unguided = weigh_found(
                    options, lights, paths, lane, emitter_towards(lights, tree, direction), leaves_dim, pdf
                )
            share = add_emission(
                options, spectrum, paths, work.passes, lane, closures.emission, caustic * weight, unguided, group,
                film, FEATURE_ENVIRONMENT, use_features,
            )
        if use_denoising and share >= 0.0:
            add_seen(spectrum, paths, work.features, lane, closures.emission, share, film)
        if use_features and flags & RAY_TRANSPARENT_BACKGROUND and not flags & RAY_PASSES_DONE:
            if paths.sample[lane] == 0:
                # Nothing is behind what was not opaque enough.
                for column in range(FIRST_WIDTH):
                    film.points[paths.pixel[lane], column] = 0.0
