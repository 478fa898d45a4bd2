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
from engine.state.geometry import (
    INSTANCE_MESH,
    MESH_FIRST_TRIANGLE,
    MESH_SHAPE,
    MESH_TRIANGLE_COUNT,
    SHAPE_TRIANGLES,
)

_RAY_CALLS_FILTER = 1 << 1


@kernel
def _name_triangle(bits, place, geometry, instance, triangle):
    """Write a triangle, instance -1: none, the way in which Embree's filter functions know it."""
    bits[CONTEXT_INSTANCE_COUNT] = geometry.instance_table.shape[0]
    if instance < 0:
        name_none(bits, place)
        return
    mesh = geometry.instance_table[instance, INSTANCE_MESH]
    first, count = triangle, 1
    if geometry.mesh_table[mesh, MESH_SHAPE] != SHAPE_TRIANGLES:
        first, count = _curve_of(geometry, mesh, triangle)
    bits[place] = instance
    bits[place + 1] = first - geometry.mesh_table[mesh, MESH_FIRST_TRIANGLE]
    bits[place + 2] = count


@kernel
def name_none(bits, place):
    """Write that there is no such triangle."""
    bits[place] = NONE
    bits[place + 1] = NONE
    bits[place + 2] = 0


@kernel
def _curve_of(geometry, mesh, segment):
    """The first segment of a segment's curve, and how many it has; a sphere is one by itself."""
    root = geometry.triangles[segment, 2]
    begin = geometry.mesh_table[mesh, MESH_FIRST_TRIANGLE]
    end = begin + geometry.mesh_table[mesh, MESH_TRIANGLE_COUNT]
    first, last = segment, segment
    while first > begin and geometry.triangles[first - 1, 2] == root:
        first -= 1
    while last + 1 < end and geometry.triangles[last + 1, 2] == root:
        last += 1
    return first, last + 1 - first


@kernel
def call_filters(bits, is_wanted):
    """Say whether Embree calls filter functions, of its own accord it would for some of the instances only."""
    flags = _RAY_CALLS_FILTER if is_wanted else 0
    bits[SKIPPING_ARGUMENTS] = flags
    bits[PASSING_ARGUMENTS] = flags
    bits[BOUNDARY_ARGUMENTS] = flags


@kernel
def start_on(bits, geometry, instance, triangle):
    """Say which triangle the next rays start on, which they skip; instance -1: none. They end on none.

    Of a curve they skip all. What `trace_closest_from`, `trace_passing` and the like are told stays until they are told
    something else.
    """
    _name_triangle(bits, CONTEXT_OWN, geometry, instance, triangle)
    name_none(bits, CONTEXT_LIGHT)
    call_filters(bits, instance >= 0)


@kernel
def go_on_behind(bits, geometry, instance, triangle):
    """As `start_on`, but of a curve the next rays skip the one segment, as they have passed it."""
    start_on(bits, geometry, instance, triangle)
    if instance >= 0:
        mesh = geometry.instance_table[instance, INSTANCE_MESH]
        bits[CONTEXT_OWN + 1] = triangle - geometry.mesh_table[mesh, MESH_FIRST_TRIANGLE]
        bits[CONTEXT_OWN + 2] = 1


@kernel
def end_on(bits, geometry, instance, triangle):
    """Say which triangle the next rays end on, which they skip as well, instance -1: none; after `start_on`."""
    _name_triangle(bits, CONTEXT_LIGHT, geometry, instance, triangle)
    if instance >= 0:
        call_filters(bits, True)
