# SPDX-License-Identifier: GPL-3.0-or-later
"""Rays that go on behind what they hit: shadow rays through what is clear, and rays that find boundaries of media."""

from __future__ import annotations

import numpy as np

from engine.accel.library import rtc_occluded
from engine.accel.ray_words import (
    BOUNDARY_ARGUMENTS,
    BOUNDARY_ORDER,
    BOUNDARY_WIDTH,
    CONTEXT_COUNT,
    CONTEXT_INSTANCE_COUNT,
    CONTEXT_MASKS,
    FIRST_BOUNDARY,
    HIT_DISTANCE,
    MOST_BOUNDARIES,
    PASSING_ARGUMENTS,
    WORD_BYTES,
)
from engine.accel.rays import set_ray
from engine.runtime.jit import kernel
from engine.state.geometry import (
    INSTANCE_FLAG_BAKED,
    INSTANCE_FLAG_MIRRORED,
    INSTANCE_FLAGS,
    INSTANCE_MESH,
    MESH_FIRST_TRIANGLE,
)


@kernel
def prepare_filters(bits, masks, instance_count):
    """Say which instances are of what kind, for `trace_passing` and `trace_boundaries`.

    `masks` is `Accelerator.mask_handle`, an array of `instance_count` rows.
    """
    bits[CONTEXT_MASKS] = masks & 0xFFFFFFFF
    bits[CONTEXT_MASKS + 1] = masks >> 32
    bits[CONTEXT_INSTANCE_COUNT] = instance_count


@kernel
def _search_through(scene, ray, bits, address, arguments):
    """How often a filter function was called on the ray and let the search go on; -1 if the search was ended."""
    bits[CONTEXT_COUNT] = 0
    rtc_occluded(scene, address, address + arguments * WORD_BYTES)
    return np.int64(-1) if ray[HIT_DISTANCE] < 0.0 else np.int64(bits[CONTEXT_COUNT])


@kernel
def trace_passing(scene, ray, bits, address, origin, direction, near, far, time, mask):
    """How many hits on the segment shadow rays may pass, of what the mask selects; -1 if anything else lies on it.

    Arguments as `trace_closest`; see `prepare_filters`. What `start_on` and `end_on` have named does not count.
    """
    set_ray(ray, bits, origin, direction, near, far, time, mask)
    return _search_through(scene, ray, bits, address, PASSING_ARGUMENTS)


@kernel
def trace_boundaries(scene, ray, bits, address, origin, direction, near, far, time, mask):
    """Find all hits of a segment on what has a medium inside; `read_boundary` reads them.

    Parameters
    ----------
    mask : int
        MASK_MEDIUM, and others that end the search where they meet anything else. The others: as `trace_closest`; see
        `prepare_filters`. What `start_on` and `end_on` have named does not count.

    Returns
    -------
    int
        How many there are, which may be more than the MOST_BOUNDARIES that are kept; -1 if anything else lies on the
        segment.
    """
    set_ray(ray, bits, origin, direction, near, far, time, mask)
    count = _search_through(scene, ray, bits, address, BOUNDARY_ARGUMENTS)
    for k in range(min(count, MOST_BOUNDARIES)):
        distance = ray[FIRST_BOUNDARY + BOUNDARY_WIDTH * k]
        place = k
        while place > 0:
            before = bits[BOUNDARY_ORDER + place - 1]
            if not ray[FIRST_BOUNDARY + BOUNDARY_WIDTH * np.int64(before)] > distance:
                break
            bits[BOUNDARY_ORDER + place] = before
            place -= 1
        bits[BOUNDARY_ORDER + place] = k
    return count


@kernel
def read_boundary(ray, bits, geometry, k):
    """Hit number k, in the order of the distance, of those that `trace_boundaries` has kept.

    Returns
    -------
    instance, triangle, distance, u, v
        As of `read_hit`.
    is_back : bool
        Whether the triangle's normal points along the ray.
    """
    row = FIRST_BOUNDARY + BOUNDARY_WIDTH * np.int64(bits[BOUNDARY_ORDER + k])
    instance = np.int64(bits[row + 4])
    mesh, flags = geometry.instance_table[instance, INSTANCE_MESH], geometry.instance_table[instance, INSTANCE_FLAGS]
    triangle = np.int64(geometry.mesh_table[mesh, MESH_FIRST_TRIANGLE]) + np.int64(bits[row + 3])
    along = ray[row + 5] * ray[row + 8] + ray[row + 6] * ray[row + 9] + ray[row + 7] * ray[row + 10]
    # What is mirrored has been turned inside out where its triangles are stored in world space.
    is_turned = flags & INSTANCE_FLAG_BAKED != 0 and flags & INSTANCE_FLAG_MIRRORED != 0
    return instance, triangle, ray[row], ray[row + 1], ray[row + 2], along < 0.0 if is_turned else along > 0.0
