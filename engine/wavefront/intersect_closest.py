# SPDX-License-Identifier: GPL-3.0-or-later
"""Stage: find what each path's ray hits first."""

import numpy as np

from engine.accel import trace_closest
from engine.jit import kernel
from engine.kernels.prefetch import ask_for_ray, lane_ahead
from engine.kernels.vector import load
from engine.scene.arrays import INSTANCE_MESH, MESH_FIRST_TRIANGLE
from engine.state import RAY_DIFFUSE, RAY_GLOSSY, RAY_TRANSMIT

_NO_INSTANCE = np.uint32(0xFFFFFFFF)


@kernel
def intersect_closest(scene, ray, bits, address, geometry, paths, lanes, lane_count):
    """Trace `lane_count` rays; a miss leaves `hit_instance` at -1. Arguments as `accel.trace_closest`."""
    for k in range(lane_count):
        lane = lanes[k]
        ask_for_ray(paths, lane_ahead(lanes, k, lane_count))
        visibility = paths.flags[lane] & 31
        if visibility & RAY_TRANSMIT:
            # Visibility to diffuse and glossy rays is about reflection only.
            visibility &= ~(RAY_DIFFUSE | RAY_GLOSSY)
        hit = trace_closest(
            scene, ray, bits, address, load(paths.origin, lane), load(paths.direction, lane), 0.0,
            paths.hit_distance[lane], paths.time[lane], visibility,
        )
        if hit:
            instance = bits[19]
            if instance == _NO_INSTANCE:
                instance = bits[18]
            paths.hit_distance[lane] = ray[8]
            paths.hit_u[lane] = ray[15]
            paths.hit_v[lane] = ray[16]
            paths.hit_instance[lane] = np.int32(instance)
            mesh = geometry.instance_table[np.int64(instance), INSTANCE_MESH]
            paths.hit_triangle[lane] = geometry.mesh_table[mesh, MESH_FIRST_TRIANGLE] + np.int32(bits[17])
        else:
            paths.hit_instance[lane] = -1
