# SPDX-License-Identifier: GPL-3.0-or-later
"""Rays that look for the closest hit, or for any.

Ray queries are LLVM symbols, so that kernels calling them can be cached on disk (a ctypes pointer baked into a kernel
could not).
"""

from __future__ import annotations

import numpy as np

from engine.accel.library import rtc_intersect, rtc_occluded
from engine.accel.ray_words import (
    HIT_DISTANCE,
    HIT_GEOMETRY,
    HIT_INSTANCE,
    HIT_TRIANGLE,
    HIT_U,
    NONE,
    SKIPPING_ARGUMENTS,
    WORD_BYTES,
)
from engine.runtime.jit import kernel
from engine.state.geometry import INSTANCE_MESH, MESH_FIRST_TRIANGLE


@kernel
def set_ray(ray, bits, origin, direction, near, far, time, mask):
    """Write what Embree reads of a ray; arguments as `trace_closest`."""
    ray[0], ray[1], ray[2] = origin
    ray[3] = near
    ray[4], ray[5], ray[6] = direction
    ray[7] = time
    ray[HIT_DISTANCE] = far
    bits[9] = mask
    bits[10] = 0
    bits[11] = 0


@kernel
def _search_closest(scene, ray, bits, address, arguments):
    """Whether Embree finds a closest hit of the ray; `arguments` is the address of Embree's own, or 0."""
    bits[HIT_TRIANGLE] = NONE
    bits[HIT_GEOMETRY] = NONE
    bits[HIT_INSTANCE] = NONE
    rtc_intersect(scene, address, arguments)
    return bits[HIT_GEOMETRY] != NONE


@kernel
def trace_closest(scene, ray, bits, address, origin, direction, near, far, time, mask):
    """Closest hit along one ray; `read_hit` reads the answer.

    Parameters
    ----------
    scene, address : intp
        Embree's scene and the address of `ray`.
    ray, bits : float32 (SCRATCH_WORDS,), 16-byte aligned, and the same memory as uint32
    origin, direction : 3-tuples, world; near, far : float32, in units of `direction`'s length

    Returns
    -------
    bool
        True on a hit.
    """
    set_ray(ray, bits, origin, direction, near, far, time, mask)
    return _search_closest(scene, ray, bits, address, 0)


@kernel
def trace_closest_from(scene, ray, bits, address, origin, direction, near, far, time, mask):
    """As `trace_closest`, but for what `start_on` and `end_on` have named."""
    set_ray(ray, bits, origin, direction, near, far, time, mask)
    return _search_closest(scene, ray, bits, address, address + SKIPPING_ARGUMENTS * WORD_BYTES)


@kernel
def read_hit(ray, bits, geometry):
    """What `trace_closest` has hit.

    Returns
    -------
    instance, triangle : int32
        Rows of `GeometryArrays.instance_table` and `triangles`.
    distance : float32, in units of the direction's length
    u, v : float32
        Barycentrics as Embree has them: P = (1 - u - v) v0 + u v1 + v v2.
    """
    # Triangles in world space have the id of their instance themselves: at top level, where the instance's id is all
    # ones, or in the hierarchy of what stands still, whose own id is the one behind the last.
    found = bits[HIT_INSTANCE]
    if found >= np.uint32(geometry.instance_table.shape[0]):
        found = bits[HIT_GEOMETRY]
    instance = np.int32(found)
    mesh = geometry.instance_table[instance, INSTANCE_MESH]
    triangle = np.int32(geometry.mesh_table[mesh, MESH_FIRST_TRIANGLE] + np.int32(bits[HIT_TRIANGLE]))
    return instance, triangle, ray[HIT_DISTANCE], ray[HIT_U], ray[HIT_U + 1]


@kernel
def trace_occluded(scene, ray, bits, address, origin, direction, near, far, time, mask):
    """True if anything the mask selects lies on the segment; arguments as `trace_closest`."""
    set_ray(ray, bits, origin, direction, near, far, time, mask)
    rtc_occluded(scene, address, 0)
    return ray[HIT_DISTANCE] < 0.0


@kernel
def trace_occluded_from(scene, ray, bits, address, origin, direction, near, far, time, mask):
    """As `trace_occluded`, but for what `start_on` and `end_on` have named."""
    set_ray(ray, bits, origin, direction, near, far, time, mask)
    rtc_occluded(scene, address, address + SKIPPING_ARGUMENTS * WORD_BYTES)
    return ray[HIT_DISTANCE] < 0.0
