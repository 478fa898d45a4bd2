# SPDX-License-Identifier: GPL-3.0-or-later
"""Stages that keep account of which media paths are in. They run only in scenes that have some."""

import numpy as np

from engine.accel.masks import MASK_MEDIUM
from engine.accel.rays import read_hit, trace_closest
from engine.kernels.constants import INFINITY
from engine.kernels.media import copy_media, cross_boundary, enter_medium
from engine.kernels.path import real_3
from engine.kernels.rng import SETS_BEFORE_VERTICES
from engine.kernels.surface import gap_before, offset_origin, program_of, surface_point
from engine.kernels.vector import dot, load, subtract
from engine.runtime.jit import kernel
from engine.scene.description import VISIBLE_CAMERA
from engine.state.camera import CAMERA_CLEAR
from engine.state.geometry import INSTANCE_VISIBILITY
from engine.state.lanes import (
    POINT_FLAG_BACKFACING,
    POINT_FLAGS,
    POINT_INSTANCE,
    POINT_NG,
    POINT_PROGRAM,
    RAY_SUBSURFACE,
)
from engine.state.media import MAX_MEDIA, WORLD
from engine.wavefront.columns import MEDIA_DROPPED, SCENE_HANDLE, SCENE_HAS_BOUNDARIES, UNIT_SPLITS_LIGHT

#: Where the ray that looks for media around the camera goes; any direction would do, this is Cycles'.
_UP = (np.float32(0.0), np.float32(0.0), np.float32(1.0))


@kernel
def _find_media(scene, work, lane):
    """Add the media of the objects that a path starts in: those that a ray leaves which it has not entered.

    The row behind the lanes' holds what has been entered on the way.
    """
    geometry, of_program, media, paths = scene.geometry, scene.media.of_program, work.media, work.paths
    entered = media.count.shape[0] - 1
    media.count[entered] = 0
    origin = load(paths.origin, lane)
    time = paths.time[lane]
    for _ in range(2 * MAX_MEDIA):
        hit = trace_closest(
            scene.header[SCENE_HANDLE], work.ray, work.ray_bits, work.ray_address[0], origin, _UP, 0.0, INFINITY, time,
            MASK_MEDIUM,
        )
        if not hit:
            return
        instance, triangle, _distance, u, v = read_hit(work.ray, work.ray_bits, geometry)
        p, ng, _ns, error = surface_point(geometry, instance, triangle, u, v, time)
        origin = offset_origin(p, ng, _UP, error)
        medium = of_program[program_of(geometry, instance, triangle)]
        if medium < 0 or not geometry.instance_table[instance, INSTANCE_VISIBILITY] & VISIBLE_CAMERA:
            continue
        if dot(ng, _UP) < 0.0:
            enter_medium(media, entered, instance, medium)
            continue
        is_new = True
        for k in range(media.count[entered]):
            is_new = is_new and media.instance[entered, k] != instance
        for k in range(media.count[lane]):
            is_new = is_new and media.instance[lane, k] != instance
        if is_new and not enter_medium(media, lane, instance, medium):
            work.counts[MEDIA_DROPPED] += 1


@kernel
def start_media(scene, unit, work, queue):
    """Find what new paths start in: the world's medium, and those of objects around the camera.

    Where no medium begins or ends near the camera, one of its paths is looked at, and the others start in the same.

    Parameters
    ----------
    queue : LaneQueue
        `work.active`, of which new paths are those that have used no random numbers but the camera's.
    """
    paths, media, world = work.paths, work.media, scene.media.world[0]
    has_boundaries, splits_light = scene.header[SCENE_HAS_BOUNDARIES] != 0, unit.header[UNIT_SPLITS_LIGHT] != 0
    clear = scene.camera[CAMERA_CLEAR]
    motion = scene.camera_motion
    center = (motion[0, 3], motion[0, 7], motion[0, 11])
    known = -1
    lanes, lane_count = queue.lanes, queue.count[0]
    for k in range(lane_count):
        lane = lanes[k]
        if paths.dimension[lane] != SETS_BEFORE_VERTICES or paths.alive[lane] == 0:
            continue
        media.count[lane] = 0
        media.depth[lane] = 0
        media.crossings[lane] = 0
        if splits_light:
            work.passes.is_volume[lane] = 0
        if world >= 0:
            enter_medium(media, lane, WORLD, world)
        if has_boundaries:
            away = subtract(load(paths.origin, lane), center)
            is_near = dot(away, away) < clear * clear
            if is_near and known >= 0:
                copy_media(media, known, lane)
                continue
            _find_media(scene, work, lane)
            if is_near:
                known = lane


@kernel
def find_gaps(scene, unit, work, queue):
    """Find how far before the surfaces that rays have met their media end. Runs only where media are dense.

    A ray that leaves a surface starts beyond the rounding error of the point there. On the distance that it skips it
    meets no medium. Where the mean free path is as short, light would be lost, since paths come in deeper than they go
    out. So media end as far before a surface as rays start behind it: what is left empty on either side, a few
    millionths of the coordinates, neither dims light nor scatters it.

    Parameters
    ----------
    queue : LaneQueue
        `work.traced`.
    """
    paths, media, geometry = work.paths, work.media, scene.geometry
    lanes, lane_count = queue.lanes, queue.count[0]
    for k in range(lane_count):
        lane = lanes[k]
        instance = paths.hit_instance[lane]
        gap = 0.0
        if instance >= 0 and media.count[lane] > 0:
            _p, ng, _ns, error = surface_point(
                geometry, instance, paths.hit_triangle[lane], paths.hit_u[lane], paths.hit_v[lane], paths.time[lane]
            )
            gap = gap_before(geometry, instance, ng, load(paths.direction, lane), error)
        media.gap[lane] = gap


@kernel
def cross_boundaries(scene, unit, work, queue):
    """Let paths that go on behind a surface enter or leave the medium inside.

    Parameters
    ----------
    queue : LaneQueue
        `work.surface`, once all lanes have their next direction.
    """
    paths, points, of_program = work.paths, work.points, scene.media.of_program
    lanes, lane_count = queue.lanes, queue.count[0]
    for k in range(lane_count):
        lane = lanes[k]
        if paths.alive[lane] == 0 or paths.flags[lane] & RAY_SUBSURFACE:
            continue
        medium = of_program[points.integer[lane, POINT_PROGRAM]]
        # Normals of points face where the path came from.
        if medium < 0 or dot(load(paths.direction, lane), real_3(points, lane, POINT_NG)) >= 0.0:
            continue
        is_back = points.integer[lane, POINT_FLAGS] & POINT_FLAG_BACKFACING != 0
        if not cross_boundary(work.media, lane, points.integer[lane, POINT_INSTANCE], medium, is_back):
            work.counts[MEDIA_DROPPED] += 1
