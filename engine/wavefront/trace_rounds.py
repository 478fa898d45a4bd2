# SPDX-License-Identifier: GPL-3.0-or-later
"""The main loop: every stage in turn on all lanes, until a unit's paths have ended.

Compiled as one kernel, so that a thread holds Python's lock once a unit instead of once a stage. It calls the stages
through `engine.stage_table.StageTable`, and runs in Python as well (`engine.jit.in_python`).
"""

import numpy as np

from engine.jit import kernel
from engine.kernels.clock import mark
from engine.shaders.arrays import MODE_EMISSION, MODE_TRANSPARENCY
from engine.work import (
    ACTIVE,
    CANDIDATES,
    CLOCK_ENTRIES,
    CLOSEST_RAYS,
    FREE,
    GUIDED_VERTICES,
    NEXT_PATH,
    RECORDS,
    REJECTS,
    RESAMPLED_CANDIDATES,
    RESAMPLED_VERTICES,
    SCENE_HANDLE,
    SCENE_HAS_EMITTERS,
    SCENE_HAS_HITTABLE_LIGHTS,
    SCENE_HAS_TRANSPARENT_SHADOWS,
    SCENE_IS_SPECTRAL,
    SCENE_WIDTH,
    SCENE_WORLD_IS_CONSTANT,
    SCENE_WORLD_PROGRAM,
    SCENE_WORLD_VISIBILITY,
    SHADOW_RAYS,
    TRANSPARENT_SHADOW_RAYS,
    UNIT_DIVIDES_WAVELENGTHS,
    UNIT_IS_GUIDED,
    UNIT_PATH_COUNT,
    UNIT_RECORD_THRESHOLD,
    UNIT_SAMPLE_FIRST,
    UNIT_SEED,
    UNIT_SHADER_MODE,
    UNIT_STRATA,
    UNIT_STRATUM,
    UNIT_USE_FEATURES,
)

_INIT_FROM_CAMERA = CLOCK_ENTRIES.index("init_from_camera")
_PLAY_ROULETTE = CLOCK_ENTRIES.index("play_roulette")
_INTERSECT_CLOSEST = CLOCK_ENTRIES.index("intersect_closest")
_SHADE_LIGHTS = CLOCK_ENTRIES.index("shade_lights")
_PREPARE_SURFACE = CLOCK_ENTRIES.index("prepare_surface")
_SHADE_BACKGROUND = CLOCK_ENTRIES.index("shade_background")
_EVALUATE_SHADERS = CLOCK_ENTRIES.index("evaluate_shaders")
_UPSAMPLE = CLOCK_ENTRIES.index("upsample")
_SHADE_EMISSION = CLOCK_ENTRIES.index("shade_emission")
_WRITE_FEATURES = CLOCK_ENTRIES.index("write_features")
_PREPARE_GUIDES = CLOCK_ENTRIES.index("prepare_guides")
_WRITE_GUIDING = CLOCK_ENTRIES.index("write_guiding")
_CHOOSE_LIGHTS = CLOCK_ENTRIES.index("choose_lights")
_EVALUATE_LIGHT_SHADERS = CLOCK_ENTRIES.index("evaluate_light_shaders")
_GUIDE_LIGHTS = CLOCK_ENTRIES.index("guide_lights")
_CONNECT_LIGHTS = CLOCK_ENTRIES.index("connect_lights")
_INTERSECT_SHADOW = CLOCK_ENTRIES.index("intersect_shadow")
_SCATTER = CLOCK_ENTRIES.index("scatter")
_SAMPLE_SOURCE = CLOCK_ENTRIES.index("sample_source")
_DRAW_CANDIDATES = CLOCK_ENTRIES.index("draw_candidates")
_PREDICT_RADIANCE = CLOCK_ENTRIES.index("predict_radiance")
_GUIDE_RESAMPLE = CLOCK_ENTRIES.index("guide_resample")
_COLLECT_RECORDS = CLOCK_ENTRIES.index("collect_records")
_ACCUMULATE = CLOCK_ENTRIES.index("accumulate")

#: Distance of light from outside the scene [m].
FAR = np.float32(1e30)


@kernel
def _shade_background(stages, scene, options, unit, b, missed_count):
    """Radiance of the world along the rays that met nothing."""
    header, shaders = scene.header, scene.shaders
    world = header[SCENE_WORLD_PROGRAM]
    if header[SCENE_WORLD_IS_CONSTANT] != 0:
        stages.fill_background(shaders.program_values, world, b.shaded, b.missed, missed_count)
    else:
        stages.prepare_background(world, b.paths, b.points, b.missed, missed_count)
        stages.evaluate_shaders(
            shaders, scene.geometry, scene.tables, b.points, b.shaded, b.missed, missed_count, b.registers,
            MODE_EMISSION,
        )
    if header[SCENE_IS_SPECTRAL] != 0:
        stages.upsample_emission(
            scene.spectrum, shaders.program_temperature, world, b.paths, b.points, b.closures, b.missed, missed_count
        )
    stages.shade_background(
        scene.lights, scene.spectrum, options, header[SCENE_WORLD_VISIBILITY], b.paths, b.closures, b.missed,
        missed_count, unit.film, unit.header[UNIT_USE_FEATURES] != 0,
    )


@kernel
def _trace_shadows(stages, scene, options, b, shadow_count):
    """Add the light samples that nothing hides; what may let light through is evaluated, one surface a turn."""
    handle, address, shaders = scene.header[SCENE_HANDLE], b.ray_address[0], scene.shaders
    pending_count = stages.intersect_shadow(
        handle, b.ray, b.ray_bits, address, options, b.paths, b.shadows, shadow_count,
        scene.header[SCENE_HAS_TRANSPARENT_SHADOWS] != 0, b.pending,
    )
    b.counts[SHADOW_RAYS] += shadow_count
    is_evaluated = False
    while pending_count > 0:
        b.counts[TRANSPARENT_SHADOW_RAYS] += pending_count
        pending_count = stages.pass_transparent(
            handle, b.ray, b.ray_bits, address, options, scene.spectrum, scene.geometry, shaders.programs,
            shaders.program_values, b.paths, b.shadows, b.light_points, b.light_shaded, b.pending, pending_count,
            is_evaluated,
        )
        if pending_count > 0:
            stages.evaluate_shaders(
                shaders, scene.geometry, scene.tables, b.light_points, b.light_shaded, b.pending, pending_count,
                b.registers, MODE_TRANSPARENCY,
            )
        is_evaluated = True


@kernel
def _sample_lights(stages, scene, options, unit, b, surface_count):
    """Next-event estimation for all shaded lanes: choose, evaluate, connect, trace."""
    lit_count, program_count = stages.choose_lights(
        scene.lights, scene.geometry, scene.shaders.program_temperature, b.paths, b.points, b.closures, b.samples,
        b.light_points, b.surface, surface_count, b.lit, b.programs,
    )
    mark(b.clock, _CHOOSE_LIGHTS)
    if program_count > 0:
        stages.evaluate_shaders(
            scene.shaders, scene.geometry, scene.tables, b.light_points, b.light_shaded, b.programs, program_count,
            b.registers, MODE_EMISSION,
        )
        mark(b.clock, _EVALUATE_LIGHT_SHADERS)
    if scene.header[SCENE_IS_SPECTRAL] != 0:
        stages.upsample_lights(scene.spectrum, b.paths, b.samples, b.lit, lit_count)
        stages.upsample_emission(
            scene.spectrum, scene.shaders.program_temperature, -1, b.paths, b.light_points, b.light_closures,
            b.programs, program_count,
        )
        mark(b.clock, _UPSAMPLE)
    if unit.header[UNIT_IS_GUIDED] != 0:
        stages.guide_lights(b.guided, b.guide, b.samples, b.lit, lit_count)
        mark(b.clock, _GUIDE_LIGHTS)
    shadow_count = stages.connect_lights(
        options, scene.tables, scene.geometry, b.paths, b.points, b.closures, b.samples, b.light_closures, b.f_cos,
        b.lit, lit_count, b.shadows,
    )
    mark(b.clock, _CONNECT_LIGHTS)
    _trace_shadows(stages, scene, options, b, shadow_count)
    mark(b.clock, _INTERSECT_SHADOW)


@kernel
def _resample(stages, options, guiding_options, guidance, pixel_weight, b, lanes, lane_count):
    """Draw candidates for the lanes, predict what arrives along them, and pick one each."""
    counts, candidates = b.counts, b.candidates
    first = 0
    while first < lane_count:
        first, vertex_count, row_count = stages.draw_candidates(
            b.paths, b.points, b.closures, b.guided, b.guide, candidates, lanes, first, lane_count
        )
        mark(b.clock, _DRAW_CANDIDATES)
        counts[GUIDED_VERTICES] += vertex_count
        counts[CANDIDATES] += row_count
        counts[RESAMPLED_VERTICES] += vertex_count
        counts[RESAMPLED_CANDIDATES] += row_count
        stages.predict_radiance(
            guidance.table, guidance.network, b.latent, b.hidden, b.guide, b.guided, candidates, row_count
        )
        if guiding_options.blends_mixture != 0:
            stages.blend_with_mixture(b.guide, candidates, row_count)
        mark(b.clock, _PREDICT_RADIANCE)
        stages.guide_resample(
            guiding_options, options, b.paths, b.points, b.closures, b.guided, b.guide, b.samples, b.log, pixel_weight,
            candidates, vertex_count, row_count, b.f_cos,
        )
        mark(b.clock, _GUIDE_RESAMPLE)


@kernel
def trace_rounds(stages, scene, options, guiding_options, guidance, unit, b, stop):
    """Trace all paths of a unit.

    Parameters
    ----------
    stages : StageTable
    scene : SceneView; options : IntegratorOptions
    guiding_options : GuidingOptions; guidance : GuidanceView
    unit : UnitView; b : Work
    stop : int32 (1,); not zero: end after this round, with paths unfinished

    Returns
    -------
    int
        1 if all paths have ended.
    """
    header, counts = unit.header, b.counts
    handle, address = scene.header[SCENE_HANDLE], b.ray_address[0]
    is_guided, records_paths = header[UNIT_IS_GUIDED] != 0, header[UNIT_RECORD_THRESHOLD] != 0
    is_spectral = scene.header[SCENE_IS_SPECTRAL] != 0
    while stop[0] == 0:
        counts[NEXT_PATH], active_count, counts[FREE] = stages.init_from_camera(
            scene.camera, scene.camera_motion, scene.shutter, scene.spectrum, scene.pixel_filter, header[UNIT_SEED],
            unit.pixels, scene.header[SCENE_WIDTH], header[UNIT_STRATUM], header[UNIT_STRATA],
            header[UNIT_DIVIDES_WAVELENGTHS], header[UNIT_SAMPLE_FIRST], header[UNIT_PATH_COUNT], counts[NEXT_PATH],
            b.paths, b.log, header[UNIT_RECORD_THRESHOLD], b.active, counts[ACTIVE], b.free, counts[FREE],
        )
        mark(b.clock, _INIT_FROM_CAMERA)
        if active_count == 0:
            return 1

        traced_count = stages.play_roulette(scene.lights, options, b.paths, b.log, b.active, active_count, b.traced)
        mark(b.clock, _PLAY_ROULETTE)

        stages.intersect_closest(
            handle, b.ray, b.ray_bits, address, scene.geometry, b.paths, b.traced, traced_count
        )
        counts[CLOSEST_RAYS] += traced_count
        mark(b.clock, _INTERSECT_CLOSEST)

        if scene.header[SCENE_HAS_HITTABLE_LIGHTS] != 0:
            stages.shade_lights(scene.lights, scene.spectrum, options, b.paths, b.traced, traced_count, b.f_cos)
            mark(b.clock, _SHADE_LIGHTS)

        surface_count, missed_count = stages.prepare_surface(
            scene.geometry, scene.shaders.programs, b.paths, b.points, b.traced, traced_count, b.surface, b.missed
        )
        mark(b.clock, _PREPARE_SURFACE)
        if missed_count > 0:
            _shade_background(stages, scene, options, unit, b, missed_count)
            mark(b.clock, _SHADE_BACKGROUND)

        stages.evaluate_shaders(
            scene.shaders, scene.geometry, scene.tables, b.points, b.shaded, b.surface, surface_count, b.registers,
            header[UNIT_SHADER_MODE],
        )
        mark(b.clock, _EVALUATE_SHADERS)
        if is_spectral:
            stages.upsample_emission(
                scene.spectrum, scene.shaders.program_temperature, -1, b.paths, b.points, b.closures, b.surface,
                surface_count,
            )
            mark(b.clock, _UPSAMPLE)
        stages.shade_emission(
            scene.lights, scene.geometry, scene.spectrum, options, b.paths, b.points, b.closures, b.surface,
            surface_count, unit.film, header[UNIT_USE_FEATURES] != 0,
        )
        mark(b.clock, _SHADE_EMISSION)
        if header[UNIT_USE_FEATURES] != 0:
            stages.write_features(
                scene.camera, scene.geometry, scene.tables, scene.shaders.program_pass_index, b.paths, b.points,
                b.shaded, b.f_cos, b.surface, surface_count, unit.film,
            )
            mark(b.clock, _WRITE_FEATURES)
        if is_spectral:
            stages.upsample_closures(
                scene.spectrum, scene.shaders.program_dispersion, b.paths, b.points, b.closures, b.surface,
                surface_count,
            )
            mark(b.clock, _UPSAMPLE)

        if is_guided:
            stages.prepare_guides(
                guiding_options, guidance.field, guidance.allocation, guidance.probability, guidance.light_share,
                b.paths, b.points, b.closures, b.guided, b.guide, b.samples, b.log, unit.pixel_weight, b.surface,
                surface_count,
            )
            mark(b.clock, _PREPARE_GUIDES)
            if header[UNIT_USE_FEATURES] != 0:
                stages.write_guiding(guidance.benefit, b.paths, b.guided, b.surface, surface_count, unit.film)
                mark(b.clock, _WRITE_GUIDING)
        if scene.header[SCENE_HAS_EMITTERS] != 0:
            _sample_lights(stages, scene, options, unit, b, surface_count)

        single_count, several_count = stages.scatter(
            options, b.paths, b.points, b.closures, b.guided, b.samples, b.log, b.f_cos, b.surface, surface_count,
            b.single, b.several,
        )
        mark(b.clock, _SCATTER)
        if single_count > 0:
            stages.sample_source(
                options, b.paths, b.points, b.closures, b.guided, b.guide, b.samples, b.log, unit.pixel_weight,
                b.candidates, b.single, single_count, b.f_cos,
            )
            counts[GUIDED_VERTICES] += single_count
            counts[CANDIDATES] += single_count
            mark(b.clock, _SAMPLE_SOURCE)
        if several_count > 0:
            _resample(stages, options, guiding_options, guidance, unit.pixel_weight, b, b.several, several_count)

        if records_paths:
            counts[RECORDS], _ = stages.collect_records(
                b.log, b.paths, unit.pixel_weight, b.active, active_count, FAR, b.records, counts[RECORDS]
            )
            mark(b.clock, _COLLECT_RECORDS)
        counts[ACTIVE], counts[FREE], reject_count = stages.accumulate(
            scene.spectrum, b.paths, b.active, active_count, b.free, counts[FREE], unit.film
        )
        counts[REJECTS] += reject_count
        mark(b.clock, _ACCUMULATE)
    return 0
