# SPDX-License-Identifier: GPL-3.0-or-later
"""All stages by name, and what the main loop passes to each."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from engine.state.shaders import MODE_CLOSURES
from engine.wavefront.accumulate import accumulate
from engine.wavefront.attenuate_shadows import (
    attenuate_shadows,
    begin_shadows,
    dim_shadows,
    find_shadow_collisions,
)
from engine.wavefront.catch_shadows import meet_catchers, show_background
from engine.wavefront.collect_records import collect_records
from engine.wavefront.collect_taught import collect_taught
from engine.wavefront.columns import (
    SCENE_HAS_DENSE_MEDIA,
    SCENE_HAS_EMITTERS,
    SCENE_HAS_HITTABLE_LIGHTS,
    SCENE_HAS_MEDIA,
    SCENE_HAS_MOVING_MEDIA,
    SCENE_HAS_TRANSPARENT_SHADOWS,
    SCENE_HAS_VARYING_MEDIA,
    SCENE_IS_SPECTRAL,
    SCENE_WORLD_IS_CONSTANT,
    UNIT_CATCHES,
    UNIT_SPLITS_LIGHT,
    UNIT_USE_DENOISING,
    UNIT_USE_FEATURES,
    UNIT_USE_OCCLUSION,
)
from engine.wavefront.draw_candidates import draw_candidates
from engine.wavefront.end_in_cache import end_in_cache, follow_footprints
from engine.wavefront.evaluate_shaders import evaluate_shaders
from engine.wavefront.guide_collisions import guide_collisions, prepare_collision_guides
from engine.wavefront.guide_lights import guide_lights
from engine.wavefront.guide_resample import guide_resample
from engine.wavefront.init_from_camera import init_from_camera
from engine.wavefront.intersect_closest import intersect_closest
from engine.wavefront.intersect_shadow import intersect_shadow, pass_transparent
from engine.wavefront.light_segments import leave_segments, light_segments
from engine.wavefront.media_stacks import cross_boundaries, find_gaps, start_media
from engine.wavefront.move_media import move_media
from engine.wavefront.occlusion import aim_occlusion, keep_occlusion
from engine.wavefront.play_adjoint_roulette import play_adjoint_roulette
from engine.wavefront.play_roulette import play_roulette
from engine.wavefront.predict_radiance import blend_with_mixture, predict_radiance
from engine.wavefront.prepare_guides import prepare_guides
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
from engine.wavefront.split_light import split_sampled, split_scattered, write_colors
from engine.wavefront.track_media import begin_tracking, find_collisions, meet_media
from engine.wavefront.upsample import upsample_closures, upsample_emission, upsample_lights
from engine.wavefront.work import GuidanceView, RadianceView, SceneView, UnitView, Work
from engine.wavefront.write_data import write_aovs, write_background_vectors, write_data
from engine.wavefront.write_denoising import write_denoising
from engine.wavefront.write_features import write_features
from engine.wavefront.write_guiding import write_guiding

_Stages = dict[str, Callable[..., Any]]


def _by_name(*stages: Callable[..., Any]) -> _Stages:
    return {stage.__name__: stage for stage in stages}


#: Take scene, unit, work and a queue.
_PLAIN = _by_name(
    init_from_camera, play_roulette, intersect_closest, prepare_surface, shade_background, shade_emission, scatter,
    accumulate,
)
#: The same, where the scene or what is asked for needs them.
_HITTABLE_LIGHTS = _by_name(shade_lights)
_CONSTANT_WORLD, _OTHER_WORLD = _by_name(fill_background), _by_name(prepare_background)
_FEATURES, _DENOISING = _by_name(write_features), _by_name(write_denoising)
_LIGHT_PASSES, _SAMPLED_PASSES = _by_name(write_colors, split_scattered), _by_name(split_sampled)
_DATA, _AOVS = _by_name(write_data, write_background_vectors), _by_name(write_aovs)
_CATCHERS = _by_name(meet_catchers, show_background)
_MEDIA = _by_name(start_media, sample_medium, prepare_collisions, scatter_collisions, cross_boundaries)
_DENSE_MEDIA = _by_name(find_gaps)
_MEDIA_LIGHTS, _MEDIA_SHADOWS = _by_name(light_segments, leave_segments), _by_name(attenuate_shadows)
_TRACKING = _by_name(begin_tracking, find_collisions, meet_media)
_MOVING_MEDIA = _by_name(move_media)
_TRACKED_SHADOWS = _by_name(begin_shadows, find_shadow_collisions, dim_shadows)
_OCCLUSION = _by_name(aim_occlusion, keep_occlusion)
_EMITTERS, _SHADOWS = _by_name(choose_lights, connect_lights), _by_name(intersect_shadow)
_TRANSPARENT_SHADOWS = _by_name(pass_transparent)
_WAVELENGTHS = _by_name(upsample_lights, upsample_closures)
_RECORDS = _by_name(collect_records)
#: Take scene, unit, guidance, work and a queue.
_GUIDED = _by_name(prepare_guides, guide_lights, draw_candidates, guide_resample, sample_source)
_GUIDED_FEATURES = _by_name(write_guiding)
_GUIDED_MEDIA = _by_name(
    prepare_collision_guides, guide_collisions, draw_collision_candidates, resample_collisions
)
#: Take what they need.
_SHADERS = _by_name(evaluate_shaders)
_EMISSION_WAVELENGTHS = _by_name(upsample_emission)
_CACHE, _TAUGHT = _by_name(end_in_cache), _by_name(follow_footprints, collect_taught)
_ADJOINT = _by_name(play_adjoint_roulette)
_PREDICTION, _BLENDING = _by_name(predict_radiance), _by_name(blend_with_mixture)

#: Every stage.
STAGES: _Stages = {
    **_PLAIN, **_HITTABLE_LIGHTS, **_CONSTANT_WORLD, **_OTHER_WORLD, **_FEATURES, **_DENOISING, **_EMITTERS,
    **_TRANSPARENT_SHADOWS, **_WAVELENGTHS, **_RECORDS, **_GUIDED, **_GUIDED_FEATURES, **_GUIDED_MEDIA, **_SHADERS,
    **_EMISSION_WAVELENGTHS, **_PREDICTION, **_BLENDING, **_CACHE, **_TAUGHT, **_ADJOINT,
    **_LIGHT_PASSES, **_SAMPLED_PASSES, **_OCCLUSION, **_SHADOWS, **_CATCHERS, **_DATA, **_AOVS,
    **_MEDIA, **_DENSE_MEDIA, **_MEDIA_LIGHTS, **_MEDIA_SHADOWS, **_TRACKING, **_TRACKED_SHADOWS,
    **_MOVING_MEDIA,
}


def stage_arguments(
    scene: SceneView, unit: UnitView, guidance: GuidanceView, radiance: RadianceView, work: Work, *, is_guided: bool,
    records: bool, uses_cache: bool, predicts: bool,
) -> dict[str, tuple[Any, ...]]:
    """What `StageTable.link` is to know of every stage that `trace_rounds` may call for these bundles.

    Returns
    -------
    dict
        By the stage's name, arguments of the types that the loop passes.
    """
    header, use_features = scene.header, unit.header[UNIT_USE_FEATURES]
    splits_light, use_occlusion = unit.header[UNIT_SPLITS_LIGHT], unit.header[UNIT_USE_OCCLUSION]
    plain, guided = (scene, unit, work, work.active), (scene, unit, guidance, work, work.active)
    arguments: dict[str, tuple[Any, ...]] = {}

    def add(stages: _Stages, taken: tuple[Any, ...], when: Any = True) -> None:
        if when:
            arguments.update(dict.fromkeys(stages, taken))

    add(_PLAIN, plain)
    add(_HITTABLE_LIGHTS, plain, header[SCENE_HAS_HITTABLE_LIGHTS])
    add(_CONSTANT_WORLD if header[SCENE_WORLD_IS_CONSTANT] else _OTHER_WORLD, plain)
    add(_FEATURES, plain, use_features)
    add(_DATA, plain, scene.data.options.is_used)
    add(_AOVS, plain, scene.data.options.aov_width)
    add(_DENOISING, plain, unit.header[UNIT_USE_DENOISING])
    add(_LIGHT_PASSES, plain, splits_light)
    add(_EMITTERS, plain, header[SCENE_HAS_EMITTERS])
    add(_SAMPLED_PASSES, plain, header[SCENE_HAS_EMITTERS] and splits_light)
    add(_CATCHERS, plain, unit.header[UNIT_CATCHES])
    add(_OCCLUSION, plain, use_occlusion)
    add(_MEDIA, plain, header[SCENE_HAS_MEDIA])
    add(_DENSE_MEDIA, plain, header[SCENE_HAS_DENSE_MEDIA])
    has_shadows = header[SCENE_HAS_EMITTERS] or use_occlusion
    varies = header[SCENE_HAS_VARYING_MEDIA]
    add(_TRACKING, plain, varies)
    add(_MOVING_MEDIA, plain, header[SCENE_HAS_MOVING_MEDIA])
    add(_MEDIA_LIGHTS, plain, header[SCENE_HAS_MEDIA] and header[SCENE_HAS_EMITTERS])
    add(_MEDIA_SHADOWS, plain, header[SCENE_HAS_MEDIA] and has_shadows and not varies)
    add(_TRACKED_SHADOWS, plain, varies and has_shadows)
    add(_SHADOWS, plain, has_shadows)
    add(_TRANSPARENT_SHADOWS, plain, has_shadows and header[SCENE_HAS_TRANSPARENT_SHADOWS])
    add(_WAVELENGTHS, plain, header[SCENE_IS_SPECTRAL])
    add(_RECORDS, plain, records)
    add(_GUIDED, guided, is_guided)
    add(_GUIDED_FEATURES, guided, is_guided and use_features)
    add(_GUIDED_MEDIA, guided, is_guided and header[SCENE_HAS_MEDIA])
    shading = (scene.shaders, scene.geometry, scene.tables, work.points, work.shaded, work.active.lanes)
    add(_SHADERS, (*shading, 0, work.registers, MODE_CLOSURES))
    add(_EMISSION_WAVELENGTHS, (scene, work, work.points, work.closures, work.active), header[SCENE_IS_SPECTRAL])
    add(_PREDICTION, (radiance, guidance, work), is_guided)
    add(_BLENDING, (guidance, work), is_guided)
    add(_CACHE, (scene, unit, radiance, work, work.active), uses_cache)
    add(_TAUGHT, plain, uses_cache)
    add(_ADJOINT, (scene, unit, radiance, work, work.active), predicts)
    return arguments
