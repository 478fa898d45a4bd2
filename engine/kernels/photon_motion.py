# SPDX-License-Identifier: GPL-3.0-or-later
"""Photons where things move: how densely they begin at a time, and where surfaces are on which they are gathered.

Photons begin by areas in the middle of the shutter; at another time a triangle is larger or smaller, and they begin
there less or more densely. They are gathered by where their surface is in the middle of the shutter, so that a disc
goes along with it.
"""

import math

import numpy as np

from engine.kernels.motion import moving_triangle
from engine.kernels.path import real_3
from engine.kernels.surface import surface_point
from engine.kernels.vector import cross, dot, negate, subtract
from engine.runtime.jit import kernel
from engine.state.lanes import POINT_FLAG_BACKFACING, POINT_FLAGS, POINT_NG, POINT_P
from engine.state.photons import MOVES, RESTING

#: Of a triangle, below which nothing is told from it [m^2].
_LEAST_AREA = np.float32(1e-30)


@kernel
def _area_at(geometry, instance, triangle, time):
    """Area of a triangle that moves, in the world [m^2]."""
    v0, v1, v2 = moving_triangle(geometry, instance, triangle, time)
    normal = cross(subtract(v1, v0), subtract(v2, v0))
    return max(np.float32(0.5) * math.sqrt(dot(normal, normal)), _LEAST_AREA)


@kernel
def growth_at(scene, instance, triangle, time):
    """How much larger a triangle is at a time than in the middle of the shutter; 1 where it stands still."""
    if not scene.casters.instances[instance] & MOVES:
        return np.float32(1.0)
    before = _area_at(scene.geometry, instance, triangle, RESTING)
    return _area_at(scene.geometry, instance, triangle, time) / before


@kernel
def density_of_start(scene, start, instance, triangle, time):
    """Density with which photons begin at a place of a caster at a time [m^-2].

    Parameters
    ----------
    start : int, row of `PhotonMap.place_density`
    instance, triangle : int, where it is
    """
    return scene.photons.place_density[start] / growth_at(scene, instance, triangle, time)


@kernel
def resting_place(scene, paths, points, lane):
    """Where photons are gathered that arrive at what a lane has met.

    Returns
    -------
    p, ng : tuples of 3 float32
        The place in the middle of the shutter, world [m], and the normal there, on the lane's side.
    instance : float32
        The one that has been met if it moves, else -1: as PHOTON_MOVES.
    growth : float32, `growth_at` the path's time
    """
    instance, triangle = np.int64(paths.hit_instance[lane]), np.int64(paths.hit_triangle[lane])
    if not scene.casters.instances[instance] & MOVES:
        return real_3(points, lane, POINT_P), real_3(points, lane, POINT_NG), np.float32(-1.0), np.float32(1.0)
    p, ng, _ns, _error = surface_point(
        scene.geometry, instance, triangle, paths.hit_u[lane], paths.hit_v[lane], RESTING
    )
    if points.integer[lane, POINT_FLAGS] & POINT_FLAG_BACKFACING:
        ng = negate(ng)
    return p, ng, np.float32(instance), growth_at(scene, instance, triangle, paths.time[lane])
