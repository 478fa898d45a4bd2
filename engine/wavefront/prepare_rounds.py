# SPDX-License-Identifier: GPL-3.0-or-later
"""Stages: set up the points on curves and spheres, of which the stages for triangles know nothing."""

from engine.kernels.prefetch import ask_for_point, ask_for_ray, lane_ahead
from engine.kernels.rounds import prepare_round
from engine.kernels.vector import load
from engine.runtime.jit import kernel
from engine.state.geometry import INSTANCE_MESH, MESH_SHAPE, SHAPE_TRIANGLES
from engine.state.lanes import POINT_INSTANCE, POINT_TANGENT, POINT_U, POINT_V


@kernel
def _is_round(geometry, points, row):
    """Whether a point lies on a curve or sphere."""
    instance = points.integer[row, POINT_INSTANCE]
    return geometry.mesh_table[geometry.instance_table[instance, INSTANCE_MESH], MESH_SHAPE] != SHAPE_TRIANGLES


@kernel
def prepare_rounds(scene, unit, work, queue):
    """Complete the points of lanes whose rays have met curves or spheres, after `prepare_surface`."""
    geometry, paths, points = scene.geometry, work.paths, work.points
    lanes, lane_count = queue.lanes, queue.count[0]
    for k in range(lane_count):
        lane = lanes[k]
        ahead = lane_ahead(lanes, k, lane_count)
        ask_for_ray(paths, ahead)
        ask_for_point(points, ahead)
        if _is_round(geometry, points, lane):
            prepare_round(
                geometry, points, lane, paths.hit_u[lane], paths.hit_v[lane], load(paths.origin, lane),
                load(paths.direction, lane), paths.hit_distance[lane], paths.time[lane],
            )
        else:
            # What was there may be a curve's.
            for axis in range(3):
                points.real[lane, POINT_TANGENT + axis] = 0.0


@kernel
def prepare_passed_rounds(scene, unit, work, queue):
    """Complete the points at which shadow rays may pass curves or spheres; `queue` has rows of `work.shadows`."""
    geometry, shadows, points = scene.geometry, work.shadows, work.light_points
    for k in range(queue.count[0]):
        row = queue.lanes[k]
        if _is_round(geometry, points, row):
            # The ray goes on from there.
            prepare_round(
                geometry, points, row, points.real[row, POINT_U], points.real[row, POINT_V], load(shadows.origin, row),
                load(shadows.direction, row), 0.0, work.paths.time[shadows.lane[row]],
            )
