# SPDX-License-Identifier: GPL-3.0-or-later
"""The loop that sends photons off, compiled as that of paths is (`trace_rounds.py`)."""

from engine.runtime.jit import kernel
from engine.wavefront.columns import (
    SCENE_HAS_DENSE_MEDIA,
    SCENE_HAS_MEDIA,
    SCENE_HAS_PHOTONS_WITHIN,
    SCENE_IS_SPECTRAL,
    UNIT_SHADER_MODE,
)
from engine.wavefront.trace_rounds import evaluate, prepare_surfaces, sample_lights


@kernel
def trace_photons(stages, scene, unit, guidance, work, stop):
    """Send a unit's photons off, and follow them; those that have arrived are in `work.photons.found`.

    Parameters
    ----------
    stages, scene, guidance, work, stop
        As `trace_rounds` takes them.
    unit : UnitView
        Its samples are the photons.

    Returns
    -------
    int
        1 if all have ended.
    """
    has_media = scene.header[SCENE_HAS_MEDIA] != 0
    while stop[0] == 0:
        stages.place_photons(scene, unit, work, work.active)
        if work.active.count[0] == 0:
            return 1
        if has_media:
            stages.start_media(scene, unit, work, work.active)
        sample_lights(stages, scene, unit, guidance, work)
        stages.launch_photons(scene, unit, work, work.active)
        is_under_way = work.traced.count[0] > 0
        while is_under_way:
            prepare_surfaces(stages, scene, unit, work)
            evaluate(stages, scene, work, work.points, work.shaded, work.surface, unit.header[UNIT_SHADER_MODE])
            if scene.header[SCENE_IS_SPECTRAL] != 0:
                stages.upsample_closures(scene, unit, work, work.surface)
            stages.keep_photons(scene, unit, work, work.surface)
            if has_media:
                stages.cross_boundaries(scene, unit, work, work.surface)
            # Those that have crossed nothing but a boundary are not among the traced.
            stages.follow_photons(scene, unit, work, work.active)
            is_under_way = work.traced.count[0] > 0
            if is_under_way:
                stages.intersect_closest(scene, unit, work, work.traced)
                if scene.header[SCENE_HAS_DENSE_MEDIA] != 0:
                    stages.find_gaps(scene, unit, work, work.traced)
                if scene.header[SCENE_HAS_PHOTONS_WITHIN] != 0:
                    stages.keep_at_collisions(scene, unit, work, work.traced)
                if has_media:
                    stages.sample_medium(scene, unit, work, work.traced)
    return 0
