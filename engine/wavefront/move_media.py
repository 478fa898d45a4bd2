# SPDX-License-Identifier: GPL-3.0-or-later
"""Stage: look media that move by their own velocity up where their grids have what is at the points."""

from engine.kernels.path import real_3
from engine.kernels.shader.grids import moved_point
from engine.runtime.jit import kernel
from engine.state.lanes import POINT_INSTANCE, POINT_P, POINT_TIME


@kernel
def move_media(scene, unit, work, queue):
    """Move those of `work.light_points` that lie in such media.

    Parameters
    ----------
    queue : LaneQueue
        `work.tracked`, between finding collisions and `evaluate_shaders`.
    """
    points = work.light_points
    for k in range(queue.count[0]):
        row = queue.lanes[k]
        instance = points.integer[row, POINT_INSTANCE]
        if instance < 0:
            continue
        p = moved_point(scene.geometry, instance, points.real[row, POINT_TIME], real_3(points, row, POINT_P))
        for axis in range(3):
            points.real[row, POINT_P + axis] = p[axis]
