# SPDX-License-Identifier: GPL-3.0-or-later
"""Stage: find what each path's ray hits first."""

import numpy as np

from engine.accel.masks import CATCHER_MASK_SHIFT
from engine.accel.rays import read_hit, trace_closest, trace_closest_from
from engine.accel.skipped_triangles import start_on
from engine.kernels.prefetch import ask_for_ray, lane_ahead
from engine.kernels.surface import behind, ray_start
from engine.kernels.vector import load, store
from engine.runtime.jit import kernel
from engine.state.lanes import (
    RAY_CATCHER_HIT,
    RAY_DIFFUSE,
    RAY_GLOSSY,
    RAY_STARTS_ON,
    RAY_SUBSURFACE,
    RAY_TRANSMIT,
    RAY_TRANSPARENT,
    RAY_VOLUME,
)
from engine.wavefront.columns import CLOSEST_RAYS, SCENE_HANDLE, UNIT_FOLLOWS


@kernel
def intersect_closest(scene, unit, work, queue):
    """Trace the lanes' rays; a miss leaves `hit_instance` at -1."""
    handle, geometry, paths = scene.header[SCENE_HANDLE], scene.geometry, work.paths
    ray, bits, address = work.ray, work.ray_bits, work.ray_address[0]
    follows = unit.header[UNIT_FOLLOWS] != 0
    lanes, lane_count = queue.lanes, queue.count[0]
    work.counts[CLOSEST_RAYS] += lane_count
    for k in range(lane_count):
        lane = lanes[k]
        ask_for_ray(paths, lane_ahead(lanes, k, lane_count))
        if paths.flags[lane] & RAY_SUBSURFACE:
            # It is where it has come out.
            continue
        visibility = paths.flags[lane] & 31
        if visibility & RAY_TRANSMIT:
            # Visibility to diffuse and glossy rays is about reflection only.
            visibility &= ~(RAY_DIFFUSE | RAY_GLOSSY)
        if visibility & RAY_VOLUME:
            # What media have scattered sees what diffuse surfaces see, as in Cycles.
            visibility |= RAY_DIFFUSE
        if follows and paths.flags[lane] & RAY_CATCHER_HIT:
            visibility <<= CATCHER_MASK_SHIFT
        origin, direction = load(paths.origin, lane), load(paths.direction, lane)
        far, time = paths.hit_distance[lane], paths.time[lane]
        if paths.flags[lane] & RAY_STARTS_ON:
            instance, triangle = paths.hit_instance[lane], paths.hit_triangle[lane]
            origin = ray_start(geometry, instance, triangle, origin, direction, time)
            store(paths.origin, lane, origin)
            near = behind(paths.mis_distance[lane]) if paths.flags[lane] & RAY_TRANSPARENT else np.float32(0.0)
            start_on(bits, geometry, instance, triangle)
            hit = trace_closest_from(handle, ray, bits, address, origin, direction, near, far, time, visibility)
        else:
            hit = trace_closest(handle, ray, bits, address, origin, direction, 0.0, far, time, visibility)
        if hit:
            instance, triangle, distance, u, v = read_hit(ray, bits, geometry)
            paths.hit_distance[lane] = distance
            paths.hit_u[lane] = u
            paths.hit_v[lane] = v
            paths.hit_instance[lane] = instance
            paths.hit_triangle[lane] = triangle
        else:
            paths.hit_instance[lane] = -1
