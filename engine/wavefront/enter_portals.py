# SPDX-License-Identifier: GPL-3.0-or-later
"""Stage: paths that have taken the lobe of a Ray Portal BSDF go on where it says. Runs only in scenes that have one."""

import numpy as np

from engine.kernels.bsdf.closures import read3
from engine.kernels.bsdf.portal import PORTAL_DIRECTION, PORTAL_POSITION, is_portal
from engine.kernels.constants import INFINITY
from engine.kernels.media import cross_boundary
from engine.kernels.path import real_3
from engine.kernels.path_depths import count_transparent
from engine.kernels.surface import offset_origin
from engine.kernels.vector import dot, store, subtract
from engine.runtime.jit import kernel
from engine.state.lanes import (
    POINT_FLAG_BACKFACING,
    POINT_FLAGS,
    POINT_INSTANCE,
    POINT_NG,
    POINT_NS,
    POINT_P,
    POINT_PROGRAM,
    POINT_RADIUS,
    RAY_MIS_SKIP,
    RAY_STARTS_ON,
    RAY_TERMINATE_ON_NEXT_SURFACE,
    RAY_TRANSPARENT,
)
from engine.wavefront.columns import MEDIA_DROPPED, SCENE_HAS_MEDIA

#: Squared distance up to which a portal leaves the ray where it is [m^2] (Cycles' threshold).
_SAME_PLACE = np.float32(1e-9)


@kernel
def _cross(scene, work, lane, direction):
    """Enter or leave the medium inside the portal's surface, whichever side the ray goes on at, as in Cycles."""
    points = work.points
    medium = scene.media.of_program[points.integer[lane, POINT_PROGRAM]]
    if medium < 0 or dot(direction, real_3(points, lane, POINT_NG)) < 0.0:
        # `cross_boundaries` sees to those that go on behind it.
        return
    is_back = points.integer[lane, POINT_FLAGS] & POINT_FLAG_BACKFACING != 0
    if not cross_boundary(work.media, lane, points.integer[lane, POINT_INSTANCE], medium, is_back):
        work.counts[MEDIA_DROPPED] += 1


@kernel
def _go_through(options, paths, points, lane, origin, direction):
    """Send a path on behind a portal.

    It stays the same kind of ray, and counts as having passed something transparent. Light samples meet portals as
    something opaque, so what it finds counts in full.
    """
    p = real_3(points, lane, POINT_P)
    way = subtract(origin, p)
    flags = paths.flags[lane] & ~RAY_STARTS_ON | RAY_TRANSPARENT | RAY_MIS_SKIP
    if count_transparent(options, paths, lane):
        flags |= RAY_TERMINATE_ON_NEXT_SURFACE
    if not dot(way, way) > _SAME_PLACE:
        origin = offset_origin(origin, real_3(points, lane, POINT_NG), direction, paths.offset[lane])
    paths.flags[lane] = flags
    store(paths.origin, lane, origin)
    store(paths.direction, lane, direction)
    store(paths.mis_origin, lane, origin)
    store(paths.mis_normal, lane, real_3(points, lane, POINT_NS))
    paths.mis_distance[lane] = 0.0
    paths.hit_distance[lane] = paths.reach[lane] = INFINITY
    paths.radius[lane] = points.real[lane, POINT_RADIUS]


@kernel
def enter_portals(scene, unit, work, queue):
    """Let paths go on from where the portals that they have entered lead; they leave the queue.

    Parameters
    ----------
    queue : LaneQueue
        `work.walking`, whose closures are still those of the surface that was hit.
    """
    paths, closures = work.paths, work.closures
    lanes, kept = queue.lanes, 0
    for k in range(queue.count[0]):
        lane = lanes[k]
        i = work.walks.lobe[lane]
        if not is_portal(closures, lane, i):
            lanes[kept] = lane
            kept += 1
            continue
        origin = read3(closures.param, lane, i, PORTAL_POSITION)
        direction = read3(closures.param, lane, i, PORTAL_DIRECTION)
        if scene.header[SCENE_HAS_MEDIA] != 0:
            _cross(scene, work, lane, direction)
        _go_through(scene.options, paths, work.points, lane, origin, direction)
    queue.count[0] = kept
