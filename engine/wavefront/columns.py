# SPDX-License-Identifier: GPL-3.0-or-later
"""Columns of the headers, the counters and the clock of `engine.wavefront.work`.

Apart from the bundles, so that stages import little: a kernel is compiled anew when a module it reaches changes.
"""

from typing import NamedTuple

# SceneView.header
SCENE_HANDLE = 0  # Embree's, an address
SCENE_WORLD_PROGRAM = 1
SCENE_WORLD_VISIBILITY = 2
SCENE_WORLD_IS_CONSTANT = 3
SCENE_HAS_EMITTERS = 4
SCENE_HAS_HITTABLE_LIGHTS = 5
SCENE_HAS_TRANSPARENT_SHADOWS = 6
SCENE_IS_SPECTRAL = 7  # paths have wavelengths
SCENE_WORLD_GROUP = 8  # light group, -1 = none
SCENE_HAS_MEDIA = 9  # paths can be in media
SCENE_HAS_BOUNDARIES = 10  # and can enter and leave them
SCENE_HAS_VARYING_MEDIA = 11  # some of them vary in space
SCENE_TRANSPARENT_HANDLE = 12  # Embree's, of what shadow rays can pass; SCENE_HANDLE if that is not apart
SCENE_HAS_DENSE_MEDIA = 13  # so dense that what a ray skips at a surface matters
SCENE_HAS_MOVING_MEDIA = 14  # some that vary move by their own velocity while the shutter is open
SCENE_MASK_HANDLE = 15  # address of the instances' masks
SCENE_HAS_ROUNDS = 16  # curves or spheres
SCENE_HAS_SUBSURFACE = 17  # light that goes in below surfaces
SCENE_HAS_HIDDEN_LAMPS = 18  # scattered rays find lamps through what casts no shadow in their light
SCENE_HAS_VARYING_LAMPS = 19  # programs tell what lamps emit that rays may meet
SCENE_HAS_PORTALS = 20  # surfaces behind which rays go on elsewhere
SCENE_SHIFTS_SHADING = 21  # objects with a Shadow Terminator Shading Offset
SCENE_SHORTENS = 22  # later bounces look at what is near alone (`FastGi.bounces`)
SCENE_ADDS_LIGHT = 23  # surfaces receive light for what does not hide the sky (`FastGi.added`)
SCENE_BAKES = 24  # rays look at places of a bake, not from the camera
SCENE_HAS_PHOTONS = 25  # lamps' light through smooth surfaces is found by photons
SCENE_HAS_PHOTONS_WITHIN = 26  # and within media, where nothing moves and paths have no wavelengths
SCENE_HEADER_WIDTH = 27

# UnitView.header
UNIT_SEED = 0
UNIT_SAMPLE_FIRST = 1
UNIT_PATH_COUNT = 2  # pixels x samples
UNIT_RECORD_THRESHOLD = 3
UNIT_IS_GUIDED = 4
UNIT_SHADER_MODE = 5
UNIT_USE_FEATURES = 6
UNIT_STRATUM = 7  # part of the shutter that times lie in; or ALL_STRATA: a path's time says which row of its pixel
UNIT_STRATA = 8
UNIT_DIVIDES_WAVELENGTHS = 9  # strata divide what a path's wavelengths have in common, their offset from a quarter
UNIT_USES_CACHE = 10  # paths end where the cache knows the rest
UNIT_MEASURE_THRESHOLD = 11  # but for those whose hash is below this: they go on and measure what the cache lacks
UNIT_USE_DENOISING = 12  # the film has what helps denoisers
UNIT_SPLITS_LIGHT = 13  # light passes are asked for
UNIT_USE_OCCLUSION = 14  # so is Ambient Occlusion
UNIT_CATCHES = 15  # the scene has shadow catchers
UNIT_FOLLOWS = 16  # paths see catchers only, from the first one that the camera's ray meets
UNIT_SHOWS_BACKGROUND = 17  # the Environment pass is asked for: it has what a transparent film leaves out
UNIT_PREDICTS = 18  # roulette goes by what surfaces were found to send back
UNIT_LEARNS_LIGHTS = 19  # recorded paths say which lights they have sampled
UNIT_GUIDES_MEDIA = 20  # recorded paths make records of collisions with media, and guided ones are guided there
UNIT_ASKS_MODEL = 21  # what weighs candidates is a model (`RadianceView.model`)
UNIT_HEADER_WIDTH = 22

# Work.counts: where a unit stands, then, from REJECTS on, what has been counted in it.
NEXT_PATH = 0
RECORDS = 1
SHADOW_ROWS = 2  # of `Work.shadows`, in use
NEXT_LANE = 3  # of those to be resampled
VERTICES = 4  # and rows of `Work.candidates`, in use
ROWS = 5
REJECTS = 6
RECORD_REJECTS = 7
RECORDS_DROPPED = 8  # for want of room
CLOSEST_RAYS = 9
SHADOW_RAYS = 10
TRANSPARENT_SHADOW_RAYS = 11
GUIDED_VERTICES = 12
RESAMPLED_VERTICES = 13
CANDIDATES = 14
RESAMPLED_CANDIDATES = 15
CACHE_RECORDS = 16  # records for the cache
CACHED_PATHS = 17  # that ended, or could have ended, in the cache: after one scattering, after two, later
CACHED_DEPTHS = 3
MEDIA_DROPPED = CACHED_PATHS + CACHED_DEPTHS  # entries into more media at once than there is room for
MAJORANTS_EXCEEDED = MEDIA_DROPPED + 1  # points where a medium is denser than its bound
MEDIUM_REJECTS = MEDIA_DROPPED + 2  # and where it is no number
TRACKING_ENDED = MEDIA_DROPPED + 3  # rays that have been followed for too long
PHOTONS = MEDIA_DROPPED + 4  # rows of `PhotonLanes.found` in use
COUNT_WIDTH = MEDIA_DROPPED + 5


class ClockEntries(NamedTuple):
    """Entries of `Work.clock`, whose last element is the last mark."""

    init_from_camera: int
    play_roulette: int
    hidden_lamps: int
    intersect_closest: int
    track_media: int
    shade_lights: int
    light_segments: int
    sample_medium: int
    prepare_surface: int
    play_adjoint_roulette: int
    shade_background: int
    evaluate_shaders: int
    upsample: int
    shade_emission: int
    write_features: int
    write_denoising: int
    split_light: int
    catch_shadows: int
    prepare_guides: int
    write_guiding: int
    choose_lights: int
    evaluate_light_shaders: int
    guide_lights: int
    connect_lights: int
    attenuate_shadows: int
    intersect_shadow: int
    fast_gi: int
    occlusion: int
    scatter: int
    walk_subsurface: int
    sample_source: int
    draw_candidates: int
    predict_radiance: int
    guide_resample: int
    end_in_cache: int
    collect_records: int
    accumulate: int
    gather_photons: int


CLOCK = ClockEntries(*range(len(ClockEntries._fields)))
