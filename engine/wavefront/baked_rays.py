# SPDX-License-Identifier: GPL-3.0-or-later
"""Stages of a bake: paths begin at places on a mesh instead of at the camera. They run only where something is baked.

A path starts a little above its place, looks at it, and meets it whatever else lies there: faces in the same place, and
what hides between. From there on it is a path like any other.
"""

import numpy as np

from engine.kernels.bake import draw_place, ray_to_background, ray_to_place
from engine.kernels.constants import INFINITY
from engine.kernels.prefetch import ask_for_ray, lane_ahead
from engine.kernels.rng import SETS_BEFORE_VERTICES, pixel_hash
from engine.kernels.surface import surface_point
from engine.kernels.vector import add, length, load, scale, store, subtract
from engine.runtime.jit import kernel
from engine.state.bake import (
    BAKE_DISTANCE,
    BAKE_FIRST_ROW,
    BAKE_IMAGE_WIDTH,
    BAKE_INSTANCE,
    BAKE_VIEW,
    PLACE_RADIUS,
    VIEW_BACKGROUND,
)
from engine.state.unit import ALL_STRATA
from engine.wavefront.columns import UNIT_SEED, UNIT_STRATA, UNIT_STRATUM, UNIT_USES_CACHE


@kernel
def _row_of(bake, unit, paths, lane):
    """Row of `bake.places` that a lane looks at, -1 = its pixel has none."""
    pixel = paths.pixel[lane]
    if unit.header[UNIT_STRATUM] == ALL_STRATA:
        pixel = pixel // unit.header[UNIT_STRATA]
    row = unit.pixels[pixel, 1] - bake.header[BAKE_FIRST_ROW]
    return bake.rows[row * bake.header[BAKE_IMAGE_WIDTH] + unit.pixels[pixel, 0]]


@kernel
def _begin(paths, lane, origin, direction, radius):
    """Give a lane another ray than the camera's."""
    store(paths.origin, lane, origin)
    store(paths.direction, lane, direction)
    store(paths.mis_origin, lane, origin)
    store(paths.mis_normal, lane, direction)
    paths.hit_distance[lane] = paths.reach[lane] = INFINITY
    paths.radius[lane] = radius
    paths.spread[lane] = 0.0


@kernel
def _end_behind(paths, lane):
    """End a path that has passed through its place: what is behind is none of the object's, as in Cycles."""
    through = 0.0
    for c in range(len(paths.channels)):
        through += paths.throughput[lane, c]
    paths.alpha[lane] -= through / np.float32(len(paths.channels))
    paths.alive[lane] = 0


@kernel
def aim_at_baked(scene, unit, work, queue):
    """Have new paths look at the places of their pixels; those of pixels that have none end, and those that have passed
    through a transparent place.

    The radiance cache takes all places to be seen from where the whole object is: paths end in it as early as they
    would for a camera there.

    Parameters
    ----------
    queue : LaneQueue
        `work.active`, of which new paths are those that have used no random numbers but the camera's.
    """
    bake, geometry, paths = scene.bake, scene.geometry, work.paths
    seed, uses_cache = unit.header[UNIT_SEED], unit.header[UNIT_USES_CACHE] != 0
    instance, view, distance = bake.header[BAKE_INSTANCE], bake.header[BAKE_VIEW], bake.numbers[BAKE_DISTANCE]
    has_seeds = bake.seeds.shape[0] > 0
    lanes, lane_count = queue.lanes, queue.count[0]
    for k in range(lane_count):
        lane = lanes[k]
        ask_for_ray(paths, lane_ahead(lanes, k, lane_count))
        if paths.dimension[lane] != SETS_BEFORE_VERTICES:
            if paths.depth[lane] == 0 and paths.transparent_depth[lane] > 0:
                _end_behind(paths, lane)
            continue
        row = _row_of(bake, unit, paths, lane)
        if row < 0:
            paths.alive[lane] = 0
            continue
        paths.alive[lane] = 1
        if has_seeds:
            paths.rng[lane] = pixel_hash(seed, bake.seeds[row], 0)
        u, v = draw_place(bake, row, paths.rng[lane], paths.sample[lane])
        p, ng, ns, error = surface_point(geometry, instance, bake.triangles[row], u, v, paths.time[lane])
        if view == VIEW_BACKGROUND:
            origin, direction, _reach = ray_to_background(p)
        else:
            origin, direction, _reach = ray_to_place(bake, p, ng, ns, error)
        _begin(paths, lane, origin, direction, bake.places[row, PLACE_RADIUS])
        if uses_cache:
            store(work.cached.origin, lane, add(p, scale(direction, -distance)))


@kernel
def meet_baked(scene, unit, work, queue):
    """Have new paths meet the places that they look at, or the background.

    Parameters
    ----------
    queue : LaneQueue
        `work.traced`.
    """
    bake, geometry, paths = scene.bake, scene.geometry, work.paths
    instance, view = bake.header[BAKE_INSTANCE], bake.header[BAKE_VIEW]
    lanes, lane_count = queue.lanes, queue.count[0]
    for k in range(lane_count):
        lane = lanes[k]
        ask_for_ray(paths, lane_ahead(lanes, k, lane_count))
        if paths.dimension[lane] != SETS_BEFORE_VERTICES:
            continue
        if view == VIEW_BACKGROUND:
            paths.hit_instance[lane] = -1
            paths.hit_distance[lane] = INFINITY
            continue
        row = _row_of(bake, unit, paths, lane)
        u, v = draw_place(bake, row, paths.rng[lane], paths.sample[lane])
        triangle = bake.triangles[row]
        p, _ng, _ns, _error = surface_point(geometry, instance, triangle, u, v, paths.time[lane])
        paths.hit_u[lane] = u
        paths.hit_v[lane] = v
        paths.hit_instance[lane] = instance
        paths.hit_triangle[lane] = triangle
        paths.hit_distance[lane] = length(subtract(p, load(paths.origin, lane)))
