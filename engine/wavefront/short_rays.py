# SPDX-License-Identifier: GPL-3.0-or-later
"""Stages of rays that Fast GI makes short: behind some bounces they look at what is near, and see the world beyond.

Where a short ray arrives its path ends as at the limit of bounces: it finds what glows there, and goes on through what
is transparent. Light samples look as far as ever, and their weights know nothing of it, as in Cycles.
"""

from engine.kernels.constants import INFINITY
from engine.kernels.media import first_medium
from engine.runtime.jit import kernel
from engine.state.geometry import VALUE_OCCLUSION
from engine.state.lanes import RAY_SUBSURFACE, RAY_TERMINATE_AFTER_TRANSPARENT, RAY_VOLUME


@kernel
def _is_short(options, paths, lane):
    """Whether a lane's ray is short: by its bounces, transmissions and one glossy reflection left out."""
    counted = paths.depth[lane] - paths.transmission_depth[lane]
    if paths.glossy_depth[lane] > 0:
        counted -= 1
    return counted >= options.short_bounces


@kernel
def shorten_rays(scene, unit, work, queue):
    """Have short rays end at what they meet, and look as far as what they leave says.

    The distance counts from the last scattering; of what has been passed since, it is the last that says it.

    Parameters
    ----------
    queue : LaneQueue
        `work.traced`.
    """
    options, geometry, paths = scene.options, scene.geometry, work.paths
    lanes, lane_count = queue.lanes, queue.count[0]
    for k in range(lane_count):
        lane = lanes[k]
        # Where a path comes out from below a surface nothing is traced.
        if paths.flags[lane] & RAY_SUBSURFACE or not _is_short(options, paths, lane):
            continue
        left = paths.hit_instance[lane]
        if paths.flags[lane] & RAY_VOLUME and paths.mis_distance[lane] == 0.0:
            left = first_medium(work.media, lane)
        reach = options.occlusion_distance
        if left >= 0 and geometry.instance_values[left, VALUE_OCCLUSION] != 0.0:
            reach = geometry.instance_values[left, VALUE_OCCLUSION]
        paths.reach[lane] = reach
        paths.hit_distance[lane] = max(reach - paths.mis_distance[lane], 0.0)
        paths.flags[lane] |= RAY_TERMINATE_AFTER_TRANSPARENT


@kernel
def lengthen_rays(scene, unit, work, queue):
    """Have media go on where short rays have met nothing. `PathState.reach` says still how far lamps may be."""
    options, paths = scene.options, work.paths
    lanes, lane_count = queue.lanes, queue.count[0]
    for k in range(lane_count):
        lane = lanes[k]
        if paths.hit_instance[lane] < 0 and _is_short(options, paths, lane):
            paths.hit_distance[lane] = INFINITY


@kernel
def dim_background(scene, unit, work, queue):
    """Have short rays see their share of the background.

    Parameters
    ----------
    queue : LaneQueue
        `work.missed`, whose `work.closures.emission` holds the background's radiance.
    """
    options, paths, closures = scene.options, work.paths, work.closures
    lanes, lane_count = queue.lanes, queue.count[0]
    for k in range(lane_count):
        lane = lanes[k]
        if _is_short(options, paths, lane):
            for c in range(len(paths.channels)):
                closures.emission[lane, c] *= options.short_background
