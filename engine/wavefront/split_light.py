# SPDX-License-Identifier: GPL-3.0-or-later
"""Stages of the light passes: by which lobes light comes at the first surface that is not transparent. They run only if
such a pass was asked for.

What a path finds is added to its parts where it is added to its radiance (`engine.kernels.radiance`). Shares are those
of the lobes' values in the direction that was taken, whatever it was drawn by, so that the passes' sum is the picture.
"""

from engine.kernels.bsdf import DIFFUSE_LOBES, GLOSSY_LOBES, TRANSMISSIVE_LOBES, albedo_parts, share_lobes
from engine.kernels.bsdf.evaluate import EVERY_KIND
from engine.kernels.path import real_3
from engine.kernels.spectrum import to_rgb
from engine.kernels.vector import load
from engine.runtime.jit import kernel
from engine.state.film import LIGHT_DIFFUSE_COLOR
from engine.state.lanes import (
    POINT_WO,
    RAY_DIFFUSE,
    RAY_REFLECT,
    RAY_SINGULAR,
    RAY_SUBSURFACE,
    RAY_TRANSPARENT,
    RAY_TRANSPARENT_BACKGROUND,
    RGB,
)
from engine.wavefront.columns import SCENE_HAS_MEDIA, SHADOW_ROWS


@kernel
def write_colors(scene, unit, work, queue):
    """Add what lobes of each kind reflect or let through to the film, of surfaces that the camera sees."""
    paths, points, closures, film = work.paths, work.points, work.shaded, unit.film
    color, looks_up = work.passes.color, scene.data.options.looks_up_transmission
    is_clear = len(paths.channels) > RGB and scene.header[SCENE_HAS_MEDIA] == 0
    lanes, lane_count = queue.lanes, queue.count[0]
    for k in range(lane_count):
        lane = lanes[k]
        if paths.alive[lane] == 0 or not paths.flags[lane] & RAY_TRANSPARENT_BACKGROUND:
            continue
        albedo_parts(closures, scene.tables, lane, real_3(points, lane, POINT_WO), looks_up, color)
        pixel = paths.pixel[lane]
        tint = to_rgb(scene.spectrum, paths, lane, paths.throughput, lane)
        if is_clear and paths.transparent_depth[lane] == 0:
            # With wavelengths one is one on average only.
            tint = (1.0, 1.0, 1.0)
        for row in range(3):
            for c in range(RGB):
                film.light[pixel, LIGHT_DIFFUSE_COLOR + RGB * row + c] += tint[c] * color[row, c]


@kernel
def split_sampled(scene, unit, work, queue):
    """Share out the light samples of surfaces that the camera sees.

    Parameters
    ----------
    queue : LaneQueue
        Not looked at: rows of `work.shadows` tell the lanes.
    """
    paths, points, closures, samples, passes = work.paths, work.points, work.closures, work.samples, work.passes
    for row in range(work.counts[SHADOW_ROWS]):
        lane = work.shadows.lane[row]
        if paths.depth[lane] == 0:
            share_lobes(
                closures, lane, real_3(points, lane, POINT_WO), load(samples.direction, lane),
                samples.visibility[lane] & EVERY_KIND, DIFFUSE_LOBES, passes.value, passes.share,
            )


@kernel
def split_scattered(scene, unit, work, queue):
    """Share out what paths carry that have just been scattered for the first time."""
    paths, points, closures, passes = work.paths, work.points, work.closures, work.passes
    lanes, lane_count = queue.lanes, queue.count[0]
    for k in range(lane_count):
        lane = lanes[k]
        flags = paths.flags[lane]
        if paths.alive[lane] == 0 or paths.depth[lane] != 1 or flags & (RAY_TRANSPARENT | RAY_SUBSURFACE):
            continue
        found = TRANSMISSIVE_LOBES
        if flags & RAY_DIFFUSE:
            found = DIFFUSE_LOBES
        elif flags & RAY_REFLECT:
            found = GLOSSY_LOBES
        # No lobe is visible to delta lobes' light.
        visibility = 0 if flags & RAY_SINGULAR else EVERY_KIND
        share_lobes(
            closures, lane, real_3(points, lane, POINT_WO), load(paths.direction, lane), visibility, found,
            passes.value, passes.share,
        )
