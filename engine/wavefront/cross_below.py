# SPDX-License-Identifier: GPL-3.0-or-later
"""Stage: paths that have gone in below a surface come out in other media than they were in.

Runs only where paths can do so, and media have boundaries.
"""

import numpy as np

from engine.accel.masks import MASK_MEDIUM
from engine.accel.rays import read_hit, trace_closest
from engine.kernels.media import cross_boundary
from engine.kernels.path import real_3
from engine.kernels.surface import offset_origin, program_of, surface_point
from engine.kernels.vector import dot, normalize, subtract
from engine.runtime.jit import kernel
from engine.state.lanes import POINT_P
from engine.state.media import MAX_MEDIA
from engine.wavefront.columns import MEDIA_DROPPED, SCENE_HANDLE


@kernel
def _cross_between(scene, work, lane, end):
    """Enter and leave what lies on the straight line from where a path has gone in to `end`.

    All but the instance that it has gone through, as in Cycles: its medium is not where the walk is.
    """
    geometry, paths, time = scene.geometry, work.paths, work.paths.time[lane]
    origin, own = real_3(work.points, lane, POINT_P), paths.hit_instance[lane]
    for _ in range(2 * MAX_MEDIA):
        way = subtract(end, origin)
        if not trace_closest(
            scene.header[SCENE_HANDLE], work.ray, work.ray_bits, work.ray_address[0], origin, way, 0.0, np.float32(1.0),
            time, MASK_MEDIUM,
        ):
            return
        instance, triangle, _distance, u, v = read_hit(work.ray, work.ray_bits, geometry)
        p, ng, _ns, error = surface_point(geometry, instance, triangle, u, v, time)
        origin = offset_origin(p, ng, normalize(way), error)
        medium = scene.media.of_program[program_of(geometry, instance, triangle)]
        if instance != own and medium >= 0:
            if not cross_boundary(work.media, lane, instance, medium, dot(ng, way) >= 0.0):
                work.counts[MEDIA_DROPPED] += 1
        if dot(subtract(end, origin), way) <= 0.0:
            return


@kernel
def cross_below(scene, unit, work, queue):
    """Let paths that come out from below a surface be in the media that are there.

    Parameters
    ----------
    queue : LaneQueue
        `work.walking`: those that have come out, whose points are still where they have gone in.
    """
    geometry, paths = scene.geometry, work.paths
    lanes, lane_count = queue.lanes, queue.count[0]
    for k in range(lane_count):
        lane = lanes[k]
        end, _ng, _ns, _error = surface_point(
            geometry, paths.hit_instance[lane], paths.hit_triangle[lane], paths.hit_u[lane], paths.hit_v[lane],
            paths.time[lane],
        )
        _cross_between(scene, work, lane, end)
