# SPDX-License-Identifier: GPL-3.0-or-later
"""All stages, a record each: what the main loop passes to it, when it runs, and which clocks its time goes to.

`engine.wavefront.trace_rounds` is the list that one reads; this one says the rest. Whether kernels that were linked for
one render serve another follows from it (`Tracer.is_linked`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

from engine.state.shaders import MODE_CLOSURES
from engine.wavefront.accumulate import accumulate
from engine.wavefront.added_light import aim_added_light, leave_added_light
from engine.wavefront.attenuate_shadows import (
    attenuate_shadows,
    begin_shadows,
    dim_shadows,
    find_shadow_collisions,
)
from engine.wavefront.baked_rays import aim_at_baked, meet_baked
from engine.wavefront.catch_shadows import meet_catchers, show_background
from engine.wavefront.collect_cache_records import collect_cache_records
from engine.wavefront.collect_records import collect_records
from engine.wavefront.columns import (
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
    SCENE_HAS_TRANSPARENT_SHADOWS,
    SCENE_HAS_VARYING_LAMPS,
    SCENE_HAS_VARYING_MEDIA,
    SCENE_IS_SPECTRAL,
    SCENE_SHIFTS_SHADING,
    SCENE_SHORTENS,
    SCENE_WORLD_IS_CONSTANT,
    UNIT_CATCHES,
    UNIT_SPLITS_LIGHT,
    UNIT_USE_DENOISING,
    UNIT_USE_FEATURES,
    UNIT_USE_OCCLUSION,
)
from engine.wavefront.cross_below import cross_below
from engine.wavefront.draw_candidates import draw_candidates
from engine.wavefront.emit_photons import follow_photons, launch_photons, place_photons
from engine.wavefront.end_in_cache import end_in_cache, follow_collisions, follow_footprints
from engine.wavefront.enter_portals import enter_portals
from engine.wavefront.evaluate_shaders import evaluate_shaders
from engine.wavefront.follow_reflections import follow_reflections, write_reflected_motion
from engine.wavefront.gather_at_collisions import gather_at_collisions, mark_collisions
from engine.wavefront.gather_photons import gather_photons, mark_caustics
from engine.wavefront.guide_collisions import guide_collisions, prepare_collision_guides
from engine.wavefront.guide_lights import guide_lights
from engine.wavefront.guide_resample import guide_resample
from engine.wavefront.hidden_lamps import leave_hidden_lamps, meet_hidden_lamps
from engine.wavefront.init_from_camera import init_from_camera
from engine.wavefront.intersect_closest import intersect_closest
from engine.wavefront.intersect_shadow import intersect_shadow, pass_transparent
from engine.wavefront.keep_at_collisions import keep_at_collisions
from engine.wavefront.keep_photons import keep_photons
from engine.wavefront.leave_to_photons import leave_to_photons
from engine.wavefront.light_segments import leave_segments, light_segments
from engine.wavefront.media_stacks import cross_boundaries, find_gaps, start_media
from engine.wavefront.move_media import move_media
from engine.wavefront.occlusion import aim_occlusion, keep_occlusion
from engine.wavefront.play_adjoint_roulette import play_adjoint_roulette
from engine.wavefront.play_roulette import play_roulette
from engine.wavefront.predict_radiance import ask_model, blend_with_mixture, predict_radiance
from engine.wavefront.prepare_guides import prepare_guides
from engine.wavefront.prepare_rounds import prepare_passed_rounds, prepare_rounds
from engine.wavefront.prepare_surface import prepare_surface
from engine.wavefront.resample_collisions import draw_collision_candidates, resample_collisions
from engine.wavefront.sample_light import choose_lights, connect_lights
from engine.wavefront.sample_medium import sample_medium
from engine.wavefront.sample_source import sample_source
from engine.wavefront.scatter import scatter
from engine.wavefront.scatter_collisions import prepare_collisions, scatter_collisions
from engine.wavefront.shade_background import fill_background, prepare_background, shade_background
from engine.wavefront.shade_emission import shade_emission
from engine.wavefront.shade_lights import shade_lights
from engine.wavefront.shift_terminator import shift_terminator
from engine.wavefront.short_rays import dim_background, lengthen_rays, shorten_rays
from engine.wavefront.split_light import split_sampled, split_scattered, write_colors
from engine.wavefront.track_media import begin_tracking, find_collisions, meet_media
from engine.wavefront.upsample import upsample_closures, upsample_emission, upsample_lights
from engine.wavefront.varying_lamps import add_varying_lamps, keep_varying_lamps, meet_varying_lamps
from engine.wavefront.walk_subsurface import leave_subsurface, walk_subsurface
from engine.wavefront.work import GuidanceView, RadianceView, SceneView, UnitView, Work
from engine.wavefront.write_data import write_aovs, write_background_vectors, write_data
from engine.wavefront.write_denoising import write_denoising
from engine.wavefront.write_features import write_features
from engine.wavefront.write_guiding import write_guiding


class Loop(NamedTuple):
    """What the main loop works on, and what threads have room for.

    scene : SceneView; unit : UnitView; guidance : GuidanceView; radiance : RadianceView; work : Work
    is_guided : bool, whether paths may be guided
    records : bool, whether they may be recorded
    uses_cache : bool, whether they may end in the radiance cache
    predicts : bool, whether roulette may go by learned light
    """

    scene: SceneView
    unit: UnitView
    guidance: GuidanceView
    radiance: RadianceView
    work: Work
    is_guided: bool
    records: bool
    uses_cache: bool
    predicts: bool


#: Something that follows from what the loop works on.
_Of = Callable[[Loop], Any]


def _plain(loop: Loop) -> tuple[Any, ...]:
    return loop.scene, loop.unit, loop.work, loop.work.active


def _guided(loop: Loop) -> tuple[Any, ...]:
    return loop.scene, loop.unit, loop.guidance, loop.work, loop.work.active


def _radiance(loop: Loop) -> tuple[Any, ...]:
    return loop.scene, loop.unit, loop.radiance, loop.work, loop.work.active


def _shading(loop: Loop) -> tuple[Any, ...]:
    scene, work = loop.scene, loop.work
    return (
        scene.shaders, scene.geometry, scene.tables, work.points, work.shaded, work.active.lanes, 0, work.registers,
        MODE_CLOSURES,
    )


def _always(_loop: Loop) -> bool:
    return True


def _scene(flag: int) -> _Of:
    return lambda loop: loop.scene.header[flag]


def _unit(flag: int) -> _Of:
    return lambda loop: loop.unit.header[flag]


def _not(condition: _Of) -> _Of:
    return lambda loop: not condition(loop)


def _all(*conditions: _Of) -> _Of:
    return lambda loop: all(condition(loop) for condition in conditions)


def _any(*conditions: _Of) -> _Of:
    return lambda loop: any(condition(loop) for condition in conditions)


@dataclass(frozen=True)
class Stage:
    """One stage.

    Attributes
    ----------
    run : kernel
        Its name is the stage's.
    clocks : str
        Entries of `engine.wavefront.columns.CLOCK` that its time goes to, separated by spaces.
    when : callable
        Whether the loop may call it, of a `Loop`.
    takes : callable
        Arguments of the types that the loop passes, of a `Loop`.
    """

    run: Callable[..., Any]
    clocks: str
    when: _Of = _always
    takes: _Of = _plain

    @property
    def name(self) -> str:
        """As the loop calls it."""
        return self.run.__name__


_CONSTANT_WORLD, _SPECTRAL = _scene(SCENE_WORLD_IS_CONSTANT), _scene(SCENE_IS_SPECTRAL)
_EMITTERS, _LAMPS = _scene(SCENE_HAS_EMITTERS), _scene(SCENE_HAS_HITTABLE_LIGHTS)
_MEDIA, _DENSE_MEDIA = _scene(SCENE_HAS_MEDIA), _scene(SCENE_HAS_DENSE_MEDIA)
_VARYING_MEDIA, _MOVING_MEDIA = _scene(SCENE_HAS_VARYING_MEDIA), _scene(SCENE_HAS_MOVING_MEDIA)
_TRANSPARENT_SHADOWS, _ROUNDS = _scene(SCENE_HAS_TRANSPARENT_SHADOWS), _scene(SCENE_HAS_ROUNDS)
_SUBSURFACE, _PHOTONS = _scene(SCENE_HAS_SUBSURFACE), _scene(SCENE_HAS_PHOTONS)
_PHOTONS_WITHIN = _scene(SCENE_HAS_PHOTONS_WITHIN)
_HIDDEN_LAMPS, _VARYING_LAMPS = _scene(SCENE_HAS_HIDDEN_LAMPS), _scene(SCENE_HAS_VARYING_LAMPS)
_FEATURES, _DENOISING = _unit(UNIT_USE_FEATURES), _unit(UNIT_USE_DENOISING)
_SPLITS_LIGHT, _OCCLUSION, _CATCHES = _unit(UNIT_SPLITS_LIGHT), _unit(UNIT_USE_OCCLUSION), _unit(UNIT_CATCHES)
_SHORTENS, _ADDS_LIGHT = _scene(SCENE_SHORTENS), _scene(SCENE_ADDS_LIGHT)
_SHADOWS = _any(_EMITTERS, _OCCLUSION, _ADDS_LIGHT)


def _data(loop: Loop) -> Any:
    return loop.scene.data.options.is_used


def _aovs(loop: Loop) -> Any:
    return loop.scene.data.options.aov_width


def _mirrors(loop: Loop) -> Any:
    return loop.scene.data.options.asks_for_mirrors


def _reflects_motion(loop: Loop) -> Any:
    return loop.scene.data.options.specular_motion >= 0


def _is_guided(loop: Loop) -> bool:
    return loop.is_guided


def _records(loop: Loop) -> bool:
    return loop.records


def _uses_cache(loop: Loop) -> bool:
    return loop.uses_cache


#: All stages, about in the order of `trace_rounds`.
_STAGES = (
    Stage(init_from_camera, "init_from_camera"),
    Stage(aim_at_baked, "init_from_camera", _scene(SCENE_BAKES)),
    Stage(start_media, "init_from_camera", _MEDIA),
    Stage(play_roulette, "play_roulette"),
    Stage(meet_hidden_lamps, "hidden_lamps", _HIDDEN_LAMPS),
    Stage(leave_hidden_lamps, "hidden_lamps", _HIDDEN_LAMPS),
    Stage(shorten_rays, "fast_gi", _SHORTENS),
    Stage(intersect_closest, "intersect_closest"),
    Stage(meet_baked, "intersect_closest", _scene(SCENE_BAKES)),
    Stage(lengthen_rays, "fast_gi", _all(_SHORTENS, _MEDIA)),
    Stage(find_gaps, "sample_medium", _DENSE_MEDIA),
    Stage(light_segments, "light_segments", _all(_MEDIA, _EMITTERS)),
    Stage(leave_segments, "light_segments", _all(_MEDIA, _EMITTERS)),
    Stage(gather_at_collisions, "gather_photons", _PHOTONS_WITHIN),
    Stage(begin_tracking, "track_media", _VARYING_MEDIA),
    Stage(find_collisions, "track_media", _VARYING_MEDIA),
    Stage(move_media, "track_media attenuate_shadows", _MOVING_MEDIA),
    Stage(meet_media, "track_media", _VARYING_MEDIA),
    Stage(shade_lights, "shade_lights", _LAMPS),
    Stage(meet_varying_lamps, "shade_lights", _VARYING_LAMPS),
    Stage(keep_varying_lamps, "shade_lights", _VARYING_LAMPS),
    Stage(add_varying_lamps, "shade_lights", _VARYING_LAMPS),
    Stage(sample_medium, "sample_medium", _MEDIA),
    Stage(meet_catchers, "catch_shadows", _CATCHES),
    Stage(show_background, "catch_shadows shade_background", _CATCHES),
    Stage(prepare_surface, "prepare_surface"),
    Stage(prepare_rounds, "prepare_surface", _ROUNDS),
    Stage(play_adjoint_roulette, "play_adjoint_roulette", lambda loop: loop.predicts, _radiance),
    Stage(write_reflected_motion, "write_features", _reflects_motion),
    Stage(end_in_cache, "end_in_cache", _uses_cache, _radiance),
    Stage(fill_background, "catch_shadows shade_background", _CONSTANT_WORLD),
    Stage(prepare_background, "catch_shadows shade_background", _not(_CONSTANT_WORLD)),
    Stage(write_background_vectors, "shade_background", _data),
    Stage(dim_background, "shade_background", _SHORTENS),
    Stage(shade_background, "shade_background"),
    Stage(
        evaluate_shaders,
        "evaluate_shaders evaluate_light_shaders shade_lights catch_shadows shade_background track_media "
        "attenuate_shadows intersect_shadow",
        takes=_shading,
    ),
    Stage(leave_subsurface, "evaluate_shaders", _SUBSURFACE),
    Stage(shift_terminator, "evaluate_shaders", _scene(SCENE_SHIFTS_SHADING)),
    Stage(
        upsample_emission, "upsample shade_lights catch_shadows shade_background", _SPECTRAL,
        lambda loop: (loop.scene, loop.work, loop.work.points, loop.work.closures, loop.work.active),
    ),
    Stage(shade_emission, "shade_emission"),
    Stage(write_aovs, "write_features shade_background", _aovs),
    Stage(write_data, "write_features", _data),
    Stage(follow_reflections, "write_features", _mirrors),
    Stage(write_features, "write_features", _FEATURES),
    Stage(write_denoising, "write_denoising", _DENOISING),
    Stage(write_colors, "split_light", _SPLITS_LIGHT),
    Stage(upsample_closures, "upsample", _SPECTRAL),
    Stage(prepare_guides, "prepare_guides", _is_guided, _guided),
    Stage(write_guiding, "write_guiding", _all(_is_guided, _FEATURES), _guided),
    Stage(gather_photons, "gather_photons", _PHOTONS),
    Stage(prepare_collisions, "sample_medium", _MEDIA),
    Stage(prepare_collision_guides, "prepare_guides", _all(_is_guided, _MEDIA), _guided),
    Stage(choose_lights, "choose_lights", _EMITTERS),
    Stage(leave_to_photons, "gather_photons", _all(_EMITTERS, _PHOTONS)),
    Stage(upsample_lights, "upsample", _SPECTRAL),
    Stage(guide_lights, "guide_lights", _is_guided, _guided),
    Stage(connect_lights, "connect_lights", _EMITTERS),
    Stage(split_sampled, "split_light", _all(_EMITTERS, _SPLITS_LIGHT)),
    Stage(attenuate_shadows, "attenuate_shadows", _all(_MEDIA, _SHADOWS, _not(_VARYING_MEDIA))),
    Stage(begin_shadows, "attenuate_shadows", _all(_VARYING_MEDIA, _SHADOWS)),
    Stage(find_shadow_collisions, "attenuate_shadows", _all(_VARYING_MEDIA, _SHADOWS)),
    Stage(dim_shadows, "attenuate_shadows", _all(_VARYING_MEDIA, _SHADOWS)),
    Stage(intersect_shadow, "intersect_shadow", _SHADOWS),
    Stage(pass_transparent, "intersect_shadow", _all(_SHADOWS, _TRANSPARENT_SHADOWS)),
    Stage(prepare_passed_rounds, "intersect_shadow", _all(_SHADOWS, _TRANSPARENT_SHADOWS, _ROUNDS)),
    Stage(guide_collisions, "sample_source", _all(_is_guided, _MEDIA), _guided),
    Stage(draw_collision_candidates, "draw_candidates", _all(_is_guided, _MEDIA), _guided),
    Stage(resample_collisions, "guide_resample", _all(_is_guided, _MEDIA), _guided),
    Stage(scatter_collisions, "sample_medium", _MEDIA),
    Stage(aim_added_light, "fast_gi", _ADDS_LIGHT),
    Stage(leave_added_light, "fast_gi", _all(_ADDS_LIGHT, _SPLITS_LIGHT)),
    Stage(aim_occlusion, "occlusion", _OCCLUSION),
    Stage(keep_occlusion, "occlusion", _OCCLUSION),
    Stage(scatter, "scatter"),
    Stage(enter_portals, "scatter", _scene(SCENE_HAS_PORTALS)),
    Stage(walk_subsurface, "walk_subsurface", _SUBSURFACE),
    Stage(cross_below, "walk_subsurface", _all(_SUBSURFACE, _scene(SCENE_HAS_BOUNDARIES))),
    Stage(sample_source, "sample_source", _is_guided, _guided),
    Stage(draw_candidates, "draw_candidates", _is_guided, _guided),
    Stage(predict_radiance, "predict_radiance", _is_guided, lambda loop: (loop.radiance, loop.guidance, loop.work)),
    # Linked by who knows the model (`Tracer`).
    Stage(ask_model, "predict_radiance", lambda loop: False),
    Stage(blend_with_mixture, "predict_radiance", _is_guided, lambda loop: (loop.guidance, loop.work)),
    Stage(guide_resample, "guide_resample", _is_guided, _guided),
    Stage(cross_boundaries, "sample_medium", _MEDIA),
    Stage(split_scattered, "split_light", _SPLITS_LIGHT),
    Stage(mark_caustics, "gather_photons", _PHOTONS),
    Stage(mark_collisions, "gather_photons", _PHOTONS_WITHIN),
    Stage(follow_collisions, "end_in_cache", _all(_uses_cache, _MEDIA)),
    Stage(follow_footprints, "end_in_cache", _uses_cache),
    Stage(collect_records, "collect_records", _records),
    Stage(collect_cache_records, "collect_records", _uses_cache),
    Stage(accumulate, "accumulate"),
    # Of `trace_photons`.
    Stage(place_photons, "", _PHOTONS),
    Stage(launch_photons, "", _PHOTONS),
    Stage(follow_photons, "", _PHOTONS),
    Stage(keep_photons, "", _PHOTONS),
    Stage(keep_at_collisions, "", _PHOTONS_WITHIN),
)

#: Kernels of all stages by name.
STAGES: dict[str, Callable[..., Any]] = {stage.name: stage.run for stage in _STAGES}
#: Which clocks their time goes to.
CLOCKS: dict[str, frozenset[str]] = {stage.name: frozenset(stage.clocks.split()) for stage in _STAGES}


def stage_arguments(loop: Loop) -> dict[str, tuple[Any, ...]]:
    """What `StageTable.link` is to know of every stage that `trace_rounds` may call.

    Returns
    -------
    dict
        By the stage's name, arguments of the types that the loop passes.
    """
    return {stage.name: stage.takes(loop) for stage in _STAGES if stage.when(loop)}
