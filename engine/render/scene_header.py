# SPDX-License-Identifier: GPL-3.0-or-later
"""What kernels are told of a scene in numbers, and which of its lights' tables they read."""

from __future__ import annotations

import numpy as np

from engine.array_types import Int64Array
from engine.builder.environment import sampled_whole
from engine.builder.scene import Scene
from engine.settings import RenderSettings
from engine.state.geometry import VALUE_SHADING_OFFSET
from engine.state.lanes import RGB
from engine.state.lights import (
    HEADER_EMITTERS,
    HEADER_FIRST_DISTANT,
    HEADER_HITTABLE,
    HEADER_LAST_DISTANT,
    LightArrays,
)
from engine.state.shaders import PROGRAM_EMISSION_CONSTANT, PROGRAM_FLAGS, PROGRAM_HAS_AOVS
from engine.wavefront.columns import (
    SCENE_ADDS_LIGHT,
    SCENE_BAKES,
    SCENE_HANDLE,
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
    SCENE_HEADER_WIDTH,
    SCENE_IS_SPECTRAL,
    SCENE_MASK_HANDLE,
    SCENE_SHIFTS_SHADING,
    SCENE_SHORTENS,
    SCENE_TRANSPARENT_HANDLE,
    SCENE_WORLD_GROUP,
    SCENE_WORLD_IS_CONSTANT,
    SCENE_WORLD_PROGRAM,
    SCENE_WORLD_VISIBILITY,
)


def _world_is_constant(scene: Scene) -> bool:
    """Whether no program has to run for the background."""
    facts = scene.shaders.programs[scene.world_program, PROGRAM_FLAGS]
    return scene.world_program < 0 or bool(facts & PROGRAM_EMISSION_CONSTANT and not facts & PROGRAM_HAS_AOVS)


def has_photons(scene: Scene, settings: RenderSettings) -> bool:
    """Whether photons are asked for, and there is something that they begin at, and somebody who sends them."""
    is_lit = settings.use_nee and int(scene.lights.header[HEADER_EMITTERS]) > 0
    return settings.traces_photons and is_lit and len(scene.casters.area) > 0


def scene_header(scene: Scene, settings: RenderSettings) -> Int64Array:
    """`SceneView.header`: int64 (SCENE_HEADER_WIDTH,)."""
    lights, media, world = scene.lights.header, scene.media, scene.description.world
    has_suns = lights[HEADER_LAST_DISTANT] > lights[HEADER_FIRST_DISTANT]
    numbers = np.zeros(SCENE_HEADER_WIDTH, np.int64)
    numbers[SCENE_HANDLE], numbers[SCENE_MASK_HANDLE] = scene.accelerator.handle, scene.accelerator.mask_handle
    numbers[SCENE_TRANSPARENT_HANDLE] = scene.accelerator.transparent_handle
    numbers[SCENE_WORLD_PROGRAM] = scene.world_program
    numbers[SCENE_WORLD_VISIBILITY] = world.visibility if world else 0
    numbers[SCENE_WORLD_GROUP] = world.light_group if world else -1
    numbers[SCENE_WORLD_IS_CONSTANT] = _world_is_constant(scene)
    numbers[SCENE_HAS_EMITTERS] = bool(settings.use_nee) and int(lights[HEADER_EMITTERS]) > 0
    numbers[SCENE_HAS_HITTABLE_LIGHTS] = bool(lights[HEADER_HITTABLE] > 0 or has_suns)
    numbers[SCENE_HAS_TRANSPARENT_SHADOWS] = scene.has_transparent_shadows
    numbers[SCENE_IS_SPECTRAL] = settings.channel_count > RGB
    numbers[SCENE_HAS_HIDDEN_LAMPS] = bool(numbers[SCENE_HAS_EMITTERS]) and len(scene.lights.links.hidden) > 0
    numbers[SCENE_HAS_VARYING_LAMPS] = len(scene.lights.varying) > 0
    numbers[SCENE_HAS_SUBSURFACE], numbers[SCENE_HAS_PORTALS] = scene.has_subsurface, scene.has_portals
    numbers[SCENE_HAS_MEDIA] = media.is_used
    numbers[SCENE_HAS_DENSE_MEDIA], numbers[SCENE_HAS_VARYING_MEDIA] = media.is_dense, media.varies
    numbers[SCENE_HAS_MOVING_MEDIA] = media.varies and (scene.geometry.grids.velocity >= 0).any()
    numbers[SCENE_HAS_ROUNDS] = len(scene.geometry.radii) > 0
    numbers[SCENE_HAS_BOUNDARIES] = media.has_inside.any()
    numbers[SCENE_SHIFTS_SHADING] = (scene.geometry.instance_values[:, VALUE_SHADING_OFFSET] > 0.0).any()
    numbers[SCENE_SHORTENS] = scene.description.fast_gi.bounces > 0
    numbers[SCENE_ADDS_LIGHT] = scene.description.fast_gi.added != 0.0
    numbers[SCENE_HAS_PHOTONS] = has_photons(scene, settings)
    stands = not scene.casters.motion.any() and settings.channel_count == RGB
    numbers[SCENE_HAS_PHOTONS_WITHIN] = bool(numbers[SCENE_HAS_PHOTONS]) and media.is_used and stands
    numbers[SCENE_BAKES] = scene.description.bake is not None
    return numbers


def lights_of(scene: Scene) -> LightArrays:
    """The scene's lights as kernels read them.

    Short rays do not find all of the background that light sampling would: then light samples go to all of it.
    """
    if scene.description.fast_gi.bounces == 0:
        return scene.lights
    return sampled_whole(scene.lights)
