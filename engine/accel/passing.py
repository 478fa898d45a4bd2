# SPDX-License-Identifier: GPL-3.0-or-later
"""Rays that go on behind what they hit: shadow rays through what is clear, and rays that find boundaries of media."""

from __future__ import annotations

import numpy as np

from engine.accel.library import rtc_occluded
from engine.accel.ray_words import (
    BOUNDARY_ARGUMENTS,
    CONTEXT_COUNT,
    CONTEXT_INSTANCE_COUNT,
    CONTEXT_MASKS,
    CONTEXT_MOST,
    FIRST_KEPT,
    HIT_DISTANCE,
    KEPT_ORDER,
    KEPT_WIDTH,
    MOST_BOUNDARIES,
    MOST_PASSED,
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
def _sort_kept(ray, bits, count):
    """Put the numbers of the first `count` hits that were kept in the order of the distance."""
    for k in range(count):
        distance = ray[FIRST_KEPT + KEPT_WIDTH * k]
        place = k
        while place > 0:
            before = bits[KEPT_ORDER + place - 1]
            if not ray[FIRST_KEPT + KEPT_WIDTH * np.int64(before)] > distance:
                break
            bits[KEPT_ORDER + place] = before
            place -= 1
        bits[KEPT_ORDER + place] = k


@kernel
def limit_passing(bits, most):
    """Say how many hits the next rays of `trace_passing` may pass; fewer than 0: none."""
    bits[CONTEXT_MOST] = max(most, 0)


@kernel
def trace_passing(scene, ray, bits, address, origin, direction, near, far, time, mask):
    """Find all hits of a segment on what shadow rays may pass, of what the mask selects; `read_kept` reads them.

    Arguments as `trace_closest`; see `prepare_filters` and `limit_passing`. What `start_on` and `end_on` have named
    does not count.

    Returns
    -------
    int
        How many there are, of which the closest MOST_PASSED are kept; -1 if they are more than the ray may pass, or if
        anything else lies on the segment.
    """
    set_ray(ray, bits, origin, direction, near, far, time, mask)
    count = _search_through(scene, ray, bits, address, PASSING_ARGUMENTS)
    _sort_kept(ray, bits, min(count, MOST_PASSED))
    return count


@kernel
def read_kept(ray, bits, geometry, k):
    """Hit number k, in the order of the distance, of those that a search has kept: as of `read_hit`."""
    row = FIRST_KEPT + KEPT_WIDTH * np.int64(bits[KEPT_ORDER + k])
    instance = np.int64(bits[row + 4])
    mesh = geometry.instance_table[instance, INSTANCE_MESH]
    triangle = np.int64(geometry.mesh_table[mesh, MESH_FIRST_TRIANGLE]) + np.int64(bits[row + 3])
    return instance, triangle, ray[row], ray[row + 1], ray[row + 2]


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
    _sort_kept(ray, bits, min(count, MOST_BOUNDARIES))
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
    row = FIRST_KEPT + KEPT_WIDTH * np.int64(bits[KEPT_ORDER + k])
    instance, triangle, distance, u, v = read_kept(ray, bits, geometry, k)
    flags = geometry.instance_table[instance, INSTANCE_FLAGS]
    along = ray[row + 5] * ray[row + 8] + ray[row + 6] * ray[row + 9] + ray[row + 7] * ray[row + 10]
    # What is mirrored has been turned inside out where its triangles are stored in world space.
    is_turned = flags & INSTANCE_FLAG_BAKED != 0 and flags & INSTANCE_FLAG_MIRRORED != 0
    return instance, triangle, distance, u, v, along < 0.0 if is_turned else along > 0.0
