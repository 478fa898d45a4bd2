# SPDX-License-Identifier: GPL-3.0-or-later
"""The triangles that rays start and end on, and skip.

Rays start a rounding error off the surface that they leave, and end as far before the light they look for. Where that
shows (`engine.builder.same_place`) they start and end in place instead, and skip the very triangles that they start and
end on, and no other: this is Cycles' rule for all rays.
"""

from __future__ import annotations

from engine.accel.ray_words import (
    BOUNDARY_ARGUMENTS,
    CONTEXT_INSTANCE_COUNT,
    CONTEXT_LIGHT,
    CONTEXT_OWN,
    NONE,
    PASSING_ARGUMENTS,
    SKIPPING_ARGUMENTS,
)
from engine.runtime.jit import kernel
from engine.state.geometry import INSTANCE_MESH, MESH_FIRST_TRIANGLE

_RAY_CALLS_FILTER = 1 << 1


@kernel
def _name_triangle(bits, place, geometry, instance, triangle):
    """Write a triangle, instance -1: none, the way in which Embree's filter functions know it."""
    bits[CONTEXT_INSTANCE_COUNT] = geometry.instance_table.shape[0]
    if instance < 0:
        bits[place] = NONE
        bits[place + 1] = NONE
        return
    mesh = geometry.instance_table[instance, INSTANCE_MESH]
    bits[place] = instance
    bits[place + 1] = triangle - geometry.mesh_table[mesh, MESH_FIRST_TRIANGLE]


@kernel
def _call_filters(bits, flags):
    # Embree would call them for some of the instances only.
    bits[SKIPPING_ARGUMENTS] = flags
    bits[PASSING_ARGUMENTS] = flags
    bits[BOUNDARY_ARGUMENTS] = flags


@kernel
def start_on(bits, geometry, instance, triangle):
    """Say which triangle the next rays start on, which they skip; instance -1: none. They end on none.

    What `trace_closest_from`, `trace_passing` and the like are told stays until they are told something else.
    """
    _name_triangle(bits, CONTEXT_OWN, geometry, instance, triangle)
    bits[CONTEXT_LIGHT] = NONE
    bits[CONTEXT_LIGHT + 1] = NONE
    _call_filters(bits, _RAY_CALLS_FILTER if instance >= 0 else 0)


@kernel
def end_on(bits, geometry, instance, triangle):
    """Say which triangle the next rays end on, which they skip as well, instance -1: none; after `start_on`."""
    _name_triangle(bits, CONTEXT_LIGHT, geometry, instance, triangle)
    if instance >= 0:
        _call_filters(bits, _RAY_CALLS_FILTER)
