# SPDX-License-Identifier: GPL-3.0-or-later
"""The main loop: every stage in turn on all lanes, until a unit's paths have ended.

Compiled as one kernel, so that a thread holds Python's lock once a unit instead of once a stage. It calls the stages
through `engine.runtime.stage_table.StageTable`, and runs in Python as well (`engine.runtime.jit.in_python`).
"""

from engine.kernels.clock import mark
from engine.runtime.jit import kernel
from engine.state.shaders import MODE_EMISSION, MODE_MEDIUM, MODE_TRANSPARENCY
from engine.wavefront.columns import (
    CLOCK,
    NEXT_LANE,
    ROWS,
    SCENE_ADDS_LIGHT,
    SCENE_BAKES,
    SCENE_HAS_BOUNDARIES,
    SCENE_HAS_DENSE_MEDIA,
    SCENE_HAS_EMITTERS,
    SCENE_HAS_HIDDEN_LAMPS,
    SCENE_HAS_HITTABLE_LIGHTS,
    SCENE_HAS_MEDIA,
    SCENE_HAS_MOVING_MEDIA,
    SCENE_HAS_PHOTONS,
    SCENE_HAS_PHOTONS_WITHIN,
    SCENE_HAS_PORTALS,
    SCENE_HAS_ROUNDS,
    SCENE_HAS_SUBSURFACE,
    SCENE_HAS_VARYING_LAMPS,
    SCENE_HAS_VARYING_MEDIA,
    SCENE_IS_SPECTRAL,
    SCENE_SHIFTS_SHADING,
    SCENE_SHORTENS,
    SCENE_WORLD_IS_CONSTANT,
    UNIT_ASKS_MODEL,
    UNIT_CATCHES,
    UNIT_FOLLOWS,
    UNIT_GUIDES_MEDIA,
    UNIT_IS_GUIDED,
    UNIT_PREDICTS,
    UNIT_RECORD_THRESHOLD,
    UNIT_SHADER_MODE,
    UNIT_SPLITS_LIGHT,
    UNIT_USE_DENOISING,
    UNIT_USE_FEATURES,
    UNIT_USE_OCCLUSION,
    UNIT_USES_CACHE,
    VERTICES,
)


@kernel
def evaluate(stages, scene, work, points, closures, queue, mode):
    """Run the shader programs at points; `closures` are in RGB."""
    stages.evaluate_shaders(
        scene.shaders, scene.geometry, scene.tables, points, closures, queue.lanes, queue.count[0], work.registers, mode
    )


@kernel
def _evaluate_background(stages, scene, unit, work, queue):
    """Radiance of the world along the rays of a queue's lanes."""
    if scene.header[SCENE_WORLD_IS_CONSTANT] != 0:
        stages.fill_background(scene, unit, work, queue)
    else:
        stages.prepare_background(scene, unit, work, queue)
        evaluate(stages, scene, work, work.points, work.shaded, queue, MODE_EMISSION)
    if scene.header[SCENE_IS_SPECTRAL] != 0:
        stages.upsample_emission(scene, work, work.points, work.closures, queue)


@kernel
def _catch_shadows(stages, scene, unit, work):
    """Mark paths that have met a shadow catcher; followers see the background behind it."""
    stages.meet_catchers(scene, unit, work, work.traced)
    if work.pending.count[0] > 0:
        _evaluate_background(stages, scene, unit, work, work.pending)
        stages.show_background(scene, unit, work, work.pending)
    mark(work.clock, CLOCK.catch_shadows)


@kernel
def _shade_background(stages, scene, unit, work):
    """Light of the world along the rays that met nothing."""
    _evaluate_background(stages, scene, unit, work, work.missed)
    if unit.header[UNIT_CATCHES] != 0 and unit.header[UNIT_FOLLOWS] == 0:
        stages.show_background(scene, unit, work, work.missed)
    if scene.data.options.aov_width > 0 and unit.header[UNIT_USE_FEATURES] != 0:
        stages.write_aovs(scene, unit, work, work.missed)
    moves = scene.data.options.background_moves != 0 and scene.data.options.vector >= 0
    if unit.header[UNIT_USE_FEATURES] != 0 and (moves or scene.data.options.backward_motion >= 0):
        stages.write_background_vectors(scene, unit, work, work.missed)
    if scene.header[SCENE_SHORTENS] != 0:
        stages.dim_background(scene, unit, work, work.missed)
    stages.shade_background(scene, unit, work, work.missed)
    mark(work.clock, CLOCK.shade_background)


@kernel
def _look_up_media(stages, scene, unit, work):
    """Say what media are at the places where rays may collide with them."""
    if scene.header[SCENE_HAS_MOVING_MEDIA] != 0:
        stages.move_media(scene, unit, work, work.tracked)
    evaluate(stages, scene, work, work.light_points, work.light_shaded, work.tracked, MODE_MEDIUM)


@kernel
def _track_media(stages, scene, unit, work):
    """Follow rays through media that vary in space, one possible collision a turn."""
    stages.begin_tracking(scene, unit, work, work.traced)
    while work.tracked.count[0] > 0:
        stages.find_collisions(scene, unit, work, work.tracked)
        if work.tracked.count[0] > 0:
            _look_up_media(stages, scene, unit, work)
            stages.meet_media(scene, unit, work, work.tracked)
    mark(work.clock, CLOCK.track_media)


@kernel
def _attenuate_shadows(stages, scene, unit, work):
    """Dim light samples by the media on their way."""
    if scene.header[SCENE_HAS_VARYING_MEDIA] == 0:
        stages.attenuate_shadows(scene, unit, work, work.lit)
    else:
        stages.begin_shadows(scene, unit, work, work.tracked)
        while work.tracked.count[0] > 0:
            stages.find_shadow_collisions(scene, unit, work, work.tracked)
            if work.tracked.count[0] > 0:
                _look_up_media(stages, scene, unit, work)
                stages.dim_shadows(scene, unit, work, work.tracked)
    mark(work.clock, CLOCK.attenuate_shadows)


@kernel
def _trace_shadows(stages, scene, unit, work):
    """Add the light samples that nothing hides, dimmed by media; what may let light through is evaluated, one surface a
    turn.
    """
    if scene.header[SCENE_HAS_MEDIA] != 0:
        _attenuate_shadows(stages, scene, unit, work)
    stages.intersect_shadow(scene, unit, work, work.pending)
    while work.pending.count[0] > 0:
        stages.pass_transparent(scene, unit, work, work.pending)
        if work.pending.count[0] > 0:
            if scene.header[SCENE_HAS_ROUNDS] != 0:
                stages.prepare_passed_rounds(scene, unit, work, work.pending)
            evaluate(stages, scene, work, work.light_points, work.light_shaded, work.pending, MODE_TRANSPARENCY)
    mark(work.clock, CLOCK.intersect_shadow)


@kernel
def _meet_hidden_lamps(stages, scene, unit, work):
    """Light of lamps that rays go towards through what casts no shadow in it."""
    stages.meet_hidden_lamps(scene, unit, work, work.traced)
    mark(work.clock, CLOCK.hidden_lamps)
    _trace_shadows(stages, scene, unit, work)
    stages.leave_hidden_lamps(scene, unit, work, work.traced)
    mark(work.clock, CLOCK.hidden_lamps)


@kernel
def _connect_lights(stages, scene, unit, guidance, work, is_guided):
    """What follows once lights are chosen: evaluate, connect, trace."""
    clock = work.clock
    if work.programs.count[0] > 0:
        evaluate(stages, scene, work, work.light_points, work.light_shaded, work.programs, MODE_EMISSION)
        mark(clock, CLOCK.evaluate_light_shaders)
    if scene.header[SCENE_IS_SPECTRAL] != 0:
        stages.upsample_lights(scene, unit, work, work.lit)
        stages.upsample_emission(scene, work, work.light_points, work.light_closures, work.programs)
        mark(clock, CLOCK.upsample)
    if is_guided:
        stages.guide_lights(scene, unit, guidance, work, work.lit)
        mark(clock, CLOCK.guide_lights)
    stages.connect_lights(scene, unit, work, work.lit)
    mark(clock, CLOCK.connect_lights)
    if unit.header[UNIT_SPLITS_LIGHT] != 0:
        stages.split_sampled(scene, unit, work, work.lit)
        mark(clock, CLOCK.split_light)
    _trace_shadows(stages, scene, unit, work)


@kernel
def sample_lights(stages, scene, unit, guidance, work):
    """Next-event estimation for all shaded lanes: choose, evaluate, connect, trace."""
    stages.choose_lights(scene, unit, work, work.surface)
    mark(work.clock, CLOCK.choose_lights)
    if scene.header[SCENE_HAS_PHOTONS] != 0:
        stages.leave_to_photons(scene, unit, work, work.lit)
        mark(work.clock, CLOCK.gather_photons)
    _connect_lights(stages, scene, unit, guidance, work, unit.header[UNIT_IS_GUIDED] != 0)


@kernel
def _look_around(stages, scene, unit, work):
    """What the hemisphere over surfaces brings: light that Fast GI adds, but not to followers, and occlusion."""
    if scene.header[SCENE_ADDS_LIGHT] != 0 and unit.header[UNIT_FOLLOWS] == 0:
        stages.aim_added_light(scene, unit, work, work.surface)
        mark(work.clock, CLOCK.fast_gi)
        _trace_shadows(stages, scene, unit, work)
        if unit.header[UNIT_SPLITS_LIGHT] != 0:
            stages.leave_added_light(scene, unit, work, work.surface)
            mark(work.clock, CLOCK.fast_gi)
    if unit.header[UNIT_USE_OCCLUSION] != 0:
        stages.aim_occlusion(scene, unit, work, work.surface)
        mark(work.clock, CLOCK.occlusion)
        _trace_shadows(stages, scene, unit, work)
        stages.keep_occlusion(scene, unit, work, work.surface)
        mark(work.clock, CLOCK.occlusion)


@kernel
def _light_segments(stages, scene, unit, guidance, work):
    """Next-event estimation on the segments that lie within media."""
    stages.light_segments(scene, unit, work, work.traced)
    mark(work.clock, CLOCK.light_segments)
    if work.lit.count[0] > 0:
        _connect_lights(stages, scene, unit, guidance, work, False)
    stages.leave_segments(scene, unit, work, work.lit)
    mark(work.clock, CLOCK.light_segments)


@kernel
def _predict(stages, unit, guidance, radiance, work):
    """Say what arrives along candidates."""
    if unit.header[UNIT_ASKS_MODEL] != 0:
        counts = work.counts
        stages.ask_model(radiance.model, work.candidates, counts[VERTICES], counts[ROWS])
    else:
        stages.predict_radiance(radiance, guidance, work)
    if guidance.options.blends_mixture != 0:
        stages.blend_with_mixture(guidance, work)
    mark(work.clock, CLOCK.predict_radiance)


@kernel
def _resample(stages, scene, unit, guidance, radiance, work):
    """Draw candidates for the lanes that have several, predict what arrives along them, and pick one each."""
    clock, counts = work.clock, work.counts
    counts[NEXT_LANE] = 0
    while counts[NEXT_LANE] < work.several.count[0]:
        stages.draw_candidates(scene, unit, guidance, work, work.several)
        mark(clock, CLOCK.draw_candidates)
        _predict(stages, unit, guidance, radiance, work)
        stages.guide_resample(scene, unit, guidance, work, work.several)
        mark(clock, CLOCK.guide_resample)


@kernel
def _guide_collisions(stages, scene, unit, guidance, radiance, work):
    """Send paths on from guided collisions."""
    clock, counts = work.clock, work.counts
    stages.guide_collisions(scene, unit, guidance, work, work.collided)
    mark(clock, CLOCK.sample_source)
    counts[NEXT_LANE] = 0
    while counts[NEXT_LANE] < work.several.count[0]:
        stages.draw_collision_candidates(scene, unit, guidance, work, work.several)
        mark(clock, CLOCK.draw_candidates)
        _predict(stages, unit, guidance, radiance, work)
        stages.resample_collisions(scene, unit, guidance, work, work.several)
        mark(clock, CLOCK.guide_resample)


@kernel
def prepare_surfaces(stages, scene, unit, work):
    """Set up the points that rays have met."""
    stages.prepare_surface(scene, unit, work, work.traced)
    if scene.header[SCENE_HAS_ROUNDS] != 0:
        stages.prepare_rounds(scene, unit, work, work.surface)
    mark(work.clock, CLOCK.prepare_surface)


@kernel
def _shade_surfaces(stages, scene, unit, guidance, work):
    """Run the programs of what was hit, add what it emits, and ready the lanes for guiding."""
    clock, is_spectral = work.clock, scene.header[SCENE_IS_SPECTRAL] != 0
    is_guided, use_features = unit.header[UNIT_IS_GUIDED] != 0, unit.header[UNIT_USE_FEATURES] != 0
    evaluate(stages, scene, work, work.points, work.shaded, work.surface, unit.header[UNIT_SHADER_MODE])
    if scene.header[SCENE_HAS_SUBSURFACE] != 0:
        stages.leave_subsurface(scene, unit, work, work.surface)
    if scene.header[SCENE_SHIFTS_SHADING] != 0:
        stages.shift_terminator(scene, unit, work, work.surface)
    mark(clock, CLOCK.evaluate_shaders)
    if is_spectral:
        stages.upsample_emission(scene, work, work.points, work.closures, work.surface)
        mark(clock, CLOCK.upsample)
    stages.shade_emission(scene, unit, work, work.surface)
    mark(clock, CLOCK.shade_emission)
    if use_features:
        if scene.data.options.aov_width > 0:
            stages.write_aovs(scene, unit, work, work.surface)
        if scene.data.options.is_used != 0:
            stages.write_data(scene, unit, work, work.surface)
        if scene.data.options.asks_for_mirrors != 0:
            stages.follow_reflections(scene, unit, work, work.surface)
        stages.write_features(scene, unit, work, work.surface)
        mark(clock, CLOCK.write_features)
    if unit.header[UNIT_USE_DENOISING] != 0:
        stages.write_denoising(scene, unit, work, work.surface)
        mark(clock, CLOCK.write_denoising)
    if unit.header[UNIT_SPLITS_LIGHT] != 0:
        stages.write_colors(scene, unit, work, work.surface)
        mark(clock, CLOCK.split_light)
    if is_spectral:
        stages.upsample_closures(scene, unit, work, work.surface)
        mark(clock, CLOCK.upsample)
    if is_guided:
        stages.prepare_guides(scene, unit, guidance, work, work.surface)
        mark(clock, CLOCK.prepare_guides)
    if is_guided and use_features:
        stages.write_guiding(scene, unit, guidance, work, work.surface)
        mark(clock, CLOCK.write_guiding)
    if scene.header[SCENE_HAS_PHOTONS] != 0:
        stages.gather_photons(scene, unit, work, work.surface)
        mark(clock, CLOCK.gather_photons)


@kernel
def _scatter(stages, scene, unit, work):
    """Send paths on by the BSDF, and those that enter portals or go in below a surface to where they come out."""
    stages.scatter(scene, unit, work, work.surface)
    if scene.header[SCENE_HAS_PORTALS] != 0:
        stages.enter_portals(scene, unit, work, work.walking)
    mark(work.clock, CLOCK.scatter)
    if work.walking.count[0] > 0:
        stages.walk_subsurface(scene, unit, work, work.walking)
        if scene.header[SCENE_HAS_BOUNDARIES] != 0:
            stages.cross_below(scene, unit, work, work.walking)
        mark(work.clock, CLOCK.walk_subsurface)


@kernel
def _shade_lights(stages, scene, unit, work):
    """Light of lamps that rays have crossed."""
    stages.shade_lights(scene, unit, work, work.traced)
    if scene.header[SCENE_HAS_VARYING_LAMPS] != 0:
        stages.add_varying_lamps(scene, unit, work, work.programs)
    mark(work.clock, CLOCK.shade_lights)


@kernel
def _follow_rays(stages, scene, unit, work):
    """Look at the way to what rays have met: for lamps whose emission a program tells, and in media that vary."""
    if scene.header[SCENE_HAS_VARYING_LAMPS] != 0:
        stages.meet_varying_lamps(scene, unit, work, work.traced)
        if work.programs.count[0] > 0:
            evaluate(stages, scene, work, work.light_points, work.light_shaded, work.programs, MODE_EMISSION)
            if scene.header[SCENE_IS_SPECTRAL] != 0:
                stages.upsample_emission(scene, work, work.light_points, work.light_closures, work.programs)
            stages.keep_varying_lamps(scene, unit, work, work.programs)
        mark(work.clock, CLOCK.shade_lights)
    if scene.header[SCENE_HAS_VARYING_MEDIA] != 0:
        _track_media(stages, scene, unit, work)


@kernel
def _follow_footprints(stages, scene, unit, work):
    """Say how far paths have spread that were sent on."""
    if scene.header[SCENE_HAS_MEDIA] != 0:
        stages.follow_collisions(scene, unit, work, work.active)
    stages.follow_footprints(scene, unit, work, work.surface)
    mark(work.clock, CLOCK.end_in_cache)


@kernel
def _note_scattering(stages, scene, unit, work):
    """Say of paths that were sent on what they carry, and who else may find what they meet next."""
    if scene.header[SCENE_HAS_PHOTONS] != 0:
        stages.mark_caustics(scene, unit, work, work.surface)
        if scene.header[SCENE_HAS_PHOTONS_WITHIN] != 0:
            stages.mark_collisions(scene, unit, work, work.active)
        mark(work.clock, CLOCK.gather_photons)
    if unit.header[UNIT_SPLITS_LIGHT] != 0:
        stages.split_scattered(scene, unit, work, work.surface)
        mark(work.clock, CLOCK.split_light)
    if unit.header[UNIT_USES_CACHE] != 0:
        _follow_footprints(stages, scene, unit, work)


@kernel
def _trace_paths(stages, scene, unit, work):
    """Find what rays of paths meet."""
    if scene.header[SCENE_HAS_HIDDEN_LAMPS] != 0:
        _meet_hidden_lamps(stages, scene, unit, work)
    if scene.header[SCENE_SHORTENS] != 0:
        stages.shorten_rays(scene, unit, work, work.traced)
        mark(work.clock, CLOCK.fast_gi)
    stages.intersect_closest(scene, unit, work, work.traced)
    if scene.header[SCENE_BAKES] != 0:
        stages.meet_baked(scene, unit, work, work.traced)
    mark(work.clock, CLOCK.intersect_closest)
    if scene.header[SCENE_SHORTENS] != 0 and scene.header[SCENE_HAS_MEDIA] != 0:
        stages.lengthen_rays(scene, unit, work, work.traced)
        mark(work.clock, CLOCK.fast_gi)
    if scene.header[SCENE_HAS_DENSE_MEDIA] != 0:
        stages.find_gaps(scene, unit, work, work.traced)
        mark(work.clock, CLOCK.sample_medium)


@kernel
def _end_early(stages, scene, unit, radiance, work):
    """End paths at what they have met, before it is shaded: by roulette that looks there, and by the radiance cache.

    What mirrors show counts all the same.
    """
    if unit.header[UNIT_PREDICTS] != 0:
        stages.play_adjoint_roulette(scene, unit, radiance, work, work.surface)
        mark(work.clock, CLOCK.play_adjoint_roulette)
    if scene.data.options.specular_motion >= 0 and unit.header[UNIT_USE_FEATURES] != 0:
        stages.write_reflected_motion(scene, unit, work, work.surface)
        mark(work.clock, CLOCK.write_features)
    if unit.header[UNIT_USES_CACHE] != 0:
        stages.end_in_cache(scene, unit, radiance, work, work.surface)
        mark(work.clock, CLOCK.end_in_cache)


@kernel
def trace_rounds(stages, scene, unit, guidance, radiance, work, stop):
    """Trace all paths of a unit.

    Parameters
    ----------
    stages : StageTable
    scene : SceneView; unit : UnitView; guidance : GuidanceView; radiance : RadianceView; work : Work
    stop : int32 (1,); not zero: end after this round, with paths unfinished

    Returns
    -------
    int
        1 if all paths have ended.
    """
    clock, has_media = work.clock, scene.header[SCENE_HAS_MEDIA] != 0
    guides_media = has_media and unit.header[UNIT_GUIDES_MEDIA] != 0 and unit.header[UNIT_IS_GUIDED] != 0
    while stop[0] == 0:
        stages.init_from_camera(scene, unit, work, work.free)
        if scene.header[SCENE_BAKES] != 0:
            stages.aim_at_baked(scene, unit, work, work.active)
        if has_media:
            stages.start_media(scene, unit, work, work.active)
        mark(clock, CLOCK.init_from_camera)
        if work.active.count[0] == 0:
            return 1
        stages.play_roulette(scene, unit, work, work.active)
        mark(clock, CLOCK.play_roulette)
        _trace_paths(stages, scene, unit, work)
        if has_media and scene.header[SCENE_HAS_EMITTERS] != 0:
            # Before tracking, which leaves closures where shadow rays have theirs.
            _light_segments(stages, scene, unit, guidance, work)
        if scene.header[SCENE_HAS_PHOTONS_WITHIN] != 0:
            stages.gather_at_collisions(scene, unit, work, work.traced)
            mark(clock, CLOCK.gather_photons)
        _follow_rays(stages, scene, unit, work)
        if scene.header[SCENE_HAS_HITTABLE_LIGHTS] != 0:
            _shade_lights(stages, scene, unit, work)
        if has_media:
            stages.sample_medium(scene, unit, work, work.traced)
            mark(clock, CLOCK.sample_medium)
        if unit.header[UNIT_CATCHES] != 0:
            _catch_shadows(stages, scene, unit, work)
        prepare_surfaces(stages, scene, unit, work)
        _end_early(stages, scene, unit, radiance, work)
        if work.missed.count[0] > 0:
            _shade_background(stages, scene, unit, work)
        _shade_surfaces(stages, scene, unit, guidance, work)
        if has_media:
            stages.prepare_collisions(scene, unit, work, work.collided)
            mark(clock, CLOCK.sample_medium)
            if guides_media:
                stages.prepare_collision_guides(scene, unit, guidance, work, work.collided)
                mark(clock, CLOCK.prepare_guides)
        if scene.header[SCENE_HAS_EMITTERS] != 0:
            sample_lights(stages, scene, unit, guidance, work)
        if has_media:
            if guides_media:
                _guide_collisions(stages, scene, unit, guidance, radiance, work)
            stages.scatter_collisions(scene, unit, work, work.collided)
            mark(clock, CLOCK.sample_medium)
        _look_around(stages, scene, unit, work)
        _scatter(stages, scene, unit, work)
        if work.single.count[0] > 0:
            stages.sample_source(scene, unit, guidance, work, work.single)
            mark(clock, CLOCK.sample_source)
        if work.several.count[0] > 0:
            _resample(stages, scene, unit, guidance, radiance, work)
        if has_media:
            stages.cross_boundaries(scene, unit, work, work.surface)
            mark(clock, CLOCK.sample_medium)
        _note_scattering(stages, scene, unit, work)
        if unit.header[UNIT_RECORD_THRESHOLD] != 0:
            stages.collect_records(scene, unit, work, work.active)
            if unit.header[UNIT_USES_CACHE] != 0:
                stages.collect_cache_records(scene, unit, work, work.active)
            mark(clock, CLOCK.collect_records)
        stages.accumulate(scene, unit, work, work.active)
        mark(clock, CLOCK.accumulate)
    return 0
