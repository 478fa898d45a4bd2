# SPDX-License-Identifier: GPL-3.0-or-later
"""Instances as triangles in the world, where that takes no more memory than it is worth: grass, leaves, gravel, chairs.

Boxes of instances that lie close together overlap, so a ray looks into many hierarchies of a few triangles each. A
hierarchy over the triangles themselves sends it into few. What shading reads stays the mesh and its transform: Embree
alone has copies.
"""

from __future__ import annotations

import numpy as np

from engine.accel.geometry_calls import (
    BUFFER_INDEX,
    BUFFER_VERTEX,
    FORMAT_FLOAT3,
    FORMAT_UINT3,
    GEOMETRY_TRIANGLE,
    attach,
    commit,
    new_geometry,
    release,
    set_buffer,
    set_filtered,
    set_mask,
)
from engine.accel.hierarchies import Device, EmbreeScene
from engine.accel.masks import MASK_MEDIUM, MASK_SHADOW_TRANSPARENT
from engine.array_types import Int64Array
from engine.runtime.jit import kernel
from engine.state.geometry import (
    INSTANCE_FLAG_BAKED,
    INSTANCE_FLAG_IN_PLACE,
    INSTANCE_FLAGS,
    INSTANCE_KEY_COUNT,
    INSTANCE_MESH,
    MESH_FIRST_TRIANGLE,
    MESH_FIRST_VERTEX,
    MESH_MOTION,
    MESH_SHAPE,
    MESH_TRIANGLE_COUNT,
    MESH_VERTEX_COUNT,
    SHAPE_TRIANGLES,
    GeometryArrays,
)

_CORNERS_BYTES = 12

#: Meshes of so many triangles take about as much memory in the world as their instances would.
_SMALL = 16
#: Triangles of larger meshes that are flattened, at some 120 bytes each.
_MOST_TRIANGLES = 1 << 20
def are_flattened(geometry: GeometryArrays, masks: np.ndarray) -> np.ndarray:
    """Which instances are: bool (I,). Of triangles that stand still, those of small meshes, and of others the smallest.

    What has a medium inside stays an instance: which side of a boundary is its back depends on where it is stored. So
    does what lies in one place with other things: which of these is met depends on last bits, as in Cycles.

    Parameters
    ----------
    masks : uint32 (I,)
        By which rays each instance is found.
    """
    table = geometry.instance_table
    meshes = geometry.mesh_table[table[:, INSTANCE_MESH]]
    stand_still = (table[:, INSTANCE_KEY_COUNT] == 0) & (meshes[:, MESH_MOTION] < 0)
    are_instanced = table[:, INSTANCE_FLAGS] & (INSTANCE_FLAG_BAKED | INSTANCE_FLAG_IN_PLACE) == 0
    may_be = (meshes[:, MESH_SHAPE] == SHAPE_TRIANGLES) & stand_still & are_instanced
    may_be &= (masks != 0) & (masks & np.uint32(MASK_MEDIUM) == 0)
    sizes = geometry.mesh_table[:, MESH_TRIANGLE_COUNT].astype(np.int64)
    of_meshes = np.bincount(table[may_be, INSTANCE_MESH], minlength=len(sizes)) * sizes
    by_size = np.argsort(sizes, kind="stable")
    is_small = sizes <= _SMALL
    fits = np.empty(len(sizes), np.bool_)
    fits[by_size] = np.cumsum(np.where(is_small, 0, of_meshes)[by_size]) <= _MOST_TRIANGLES
    found: np.ndarray = may_be & (is_small | fits)[table[:, INSTANCE_MESH]]
    return found


def attach_flattened(
    device: Device, scene: EmbreeScene, geometry: GeometryArrays, rows: Int64Array, masks: np.ndarray
) -> None:
    """Attach instances of small meshes as geometries of their own, in the world; `rows` are their ids."""
    if not len(rows):
        return
    table = geometry.mesh_table[geometry.instance_table[rows, INSTANCE_MESH]].astype(np.int64)
    counts = table[:, MESH_VERTEX_COUNT]
    ends = np.cumsum(counts)
    # Embree reads four numbers of a vertex, and so one behind the last.
    places = np.zeros((int(ends[-1]) + 1, 3), np.float32)
    _place(geometry.vertices, geometry.transforms, rows, table[:, MESH_FIRST_VERTEX], counts, places)
    scene.keep(places)
    # Numbers of vertices in `triangles` are those of all meshes: seen from so far before, a copy's fit them.
    starts = places.ctypes.data + (ends - counts - table[:, MESH_FIRST_VERTEX]) * places.strides[0]
    corners = geometry.triangles.ctypes.data + table[:, MESH_FIRST_TRIANGLE] * _CORNERS_BYTES
    _attach_triangles(
        device.address, scene.address, rows, starts, table[:, MESH_FIRST_VERTEX] + counts, corners,
        table[:, MESH_TRIANGLE_COUNT], masks[rows], masks[rows] & np.uint32(MASK_SHADOW_TRANSPARENT) != 0,
    )


@kernel
def _place(vertices, transforms, rows, first_vertices, counts, places):
    """Write the instances' vertices in the world, float32 (P, 3), one instance after the other."""
    place = 0
    for k in range(rows.shape[0]):
        row = rows[k]
        for vertex in range(first_vertices[k], first_vertices[k] + counts[k]):
            x, y, z = vertices[vertex, 0], vertices[vertex, 1], vertices[vertex, 2]
            for axis in range(3):
                at = 4 * axis
                places[place, axis] = (
                    transforms[row, at] * x + transforms[row, at + 1] * y + transforms[row, at + 2] * z
                    + transforms[row, at + 3]
                )
            place += 1


@kernel
def _attach_triangles(device, scene, ids, vertices, vertex_counts, corners, triangle_counts, masks, are_filtered):
    """Attach geometries: `vertices` and `corners`, intp (K,), are the addresses of their buffers."""
    for k in range(ids.shape[0]):
        handle = new_geometry(device, np.int32(GEOMETRY_TRIANGLE))
        set_buffer(
            handle, np.int32(BUFFER_VERTEX), np.uint32(0), np.int32(FORMAT_FLOAT3), vertices[k], 0, _CORNERS_BYTES,
            vertex_counts[k],
        )
        set_buffer(
            handle, np.int32(BUFFER_INDEX), np.uint32(0), np.int32(FORMAT_UINT3), corners[k], 0, _CORNERS_BYTES,
            triangle_counts[k],
        )
        set_mask(handle, masks[k])
        set_filtered(handle, are_filtered[k])
        commit(handle)
        attach(scene, handle, np.uint32(ids[k]))
        release(handle)
