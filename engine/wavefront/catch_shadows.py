# SPDX-License-Identifier: GPL-3.0-or-later
"""Stages of shadow catchers. They run only in scenes that have some.

What a catcher shows is how much darker the scene makes it than it would be alone. So its pixels are sampled twice, as
in Cycles: by paths that see everything, and by followers that see catchers and lamps only, once a ray of the camera has
met a catcher. Followers are the same paths up to there, of the same random numbers, in a unit of their own
(UNIT_FOLLOWS). `engine.render.shadow_catchers` makes pictures of both.
"""

import numpy as np

from engine.kernels.spectrum import to_rgb
from engine.runtime.jit import kernel
from engine.state.film import CAUGHT_BACKGROUND, CAUGHT_COUNT
from engine.state.geometry import INSTANCE_FLAG_CATCHER, INSTANCE_FLAGS
from engine.state.lanes import RAY_CAMERA, RAY_CATCHER_HIT, RAY_TRANSPARENT_BACKGROUND, RGB
from engine.wavefront.columns import SCENE_WORLD_VISIBILITY, UNIT_FOLLOWS, UNIT_SPLITS_LIGHT


@kernel
def meet_catchers(scene, unit, work, queue):
    """Mark paths whose camera ray has met a catcher; end followers that were scattered by anything else.

    Parameters
    ----------
    queue : LaneQueue
        `work.traced`, from which those that end are taken. `work.pending` is filled with the followers that have met a
        catcher, for the background behind it.
    """
    geometry, paths, catcher, film = scene.geometry, work.paths, work.catcher, unit.film
    follows, splits_light = unit.header[UNIT_FOLLOWS] != 0, unit.header[UNIT_SPLITS_LIGHT] != 0
    lanes, lane_count = queue.lanes, queue.count[0]
    met, met_count = work.pending.lanes, 0
    kept = 0
    for k in range(lane_count):
        lane = lanes[k]
        flags = paths.flags[lane]
        if not flags & RAY_CATCHER_HIT:
            instance = paths.hit_instance[lane]
            if not flags & RAY_TRANSPARENT_BACKGROUND:
                if follows:
                    paths.alive[lane] = 0
                    continue
            elif instance >= 0 and geometry.instance_table[instance, INSTANCE_FLAGS] & INSTANCE_FLAG_CATCHER:
                paths.flags[lane] = flags | RAY_CATCHER_HIT
                average = 0.0
                for c in range(len(paths.channels)):
                    average += paths.throughput[lane, c] / np.float32(len(paths.channels))
                    catcher.base[lane, c] = paths.radiance[lane, c]
                catcher.alpha[lane] = paths.alpha[lane] - average
                if follows:
                    met[met_count] = lane
                    met_count += 1
                else:
                    film.caught[paths.pixel[lane], CAUGHT_COUNT] += 1.0
                    if splits_light:
                        work.passes.is_open[lane] = 0
        lanes[kept] = lane
        kept += 1
    queue.count[0] = kept
    work.pending.count[0] = met_count


@kernel
def show_background(scene, unit, work, queue):
    """Add the background behind catchers, or beside them, to the film.

    Parameters
    ----------
    queue : LaneQueue
        Lanes for which `work.closures.emission` is the background's radiance along their ray.
    """
    paths, emission, scratch, film = work.paths, work.closures.emission, work.f_cos, unit.film
    lanes, lane_count = queue.lanes, queue.count[0]
    if not scene.header[SCENE_WORLD_VISIBILITY] & RAY_CAMERA or scene.options.film_transparent != 0:
        return
    for k in range(lane_count):
        lane = lanes[k]
        if not paths.flags[lane] & RAY_TRANSPARENT_BACKGROUND:
            continue
        for c in range(len(paths.channels)):
            scratch[lane, c] = emission[lane, c] * paths.throughput[lane, c]
        color = to_rgb(scene.spectrum, paths, lane, scratch, lane)
        for c in range(RGB):
            film.caught[paths.pixel[lane], CAUGHT_BACKGROUND + c] += color[c]
