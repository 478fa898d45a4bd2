# SPDX-License-Identifier: GPL-3.0-or-later
"""Rays that meet one instance alone, for walks below its surface: its hierarchy is asked, in the space of the mesh."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass

import numpy as np

from engine.accel.accelerator import build_standing
from engine.accel.hierarchies import EmbreeScene, MeshHierarchies
from engine.accel.ray_words import (
    CONTEXT_INSTANCE_COUNT,
    CONTEXT_LIGHT,
    CONTEXT_OWN,
    HIT_DISTANCE,
    HIT_TRIANGLE,
    HIT_U,
    NONE,
)
from engine.accel.rays import trace_closest, trace_closest_from
from engine.accel.skipped_triangles import call_filters, name_none
from engine.array_types import Int64Array
from engine.kernels.motion import direction_to_object, point_to_object
from engine.runtime.jit import kernel
from engine.state.geometry import (
    INSTANCE_FLAG_BAKED,
    INSTANCE_FLAGS,
    INSTANCE_MESH,
    MESH_FIRST_TRIANGLE,
    MESH_SHAPE,
    MESH_TRIANGLE_COUNT,
    SHAPE_TRIANGLES,
    GeometryArrays,
)


@dataclass
class LocalScenes:
    """Hierarchies of single instances.

    Attributes
    ----------
    scenes : list of EmbreeScene
    handles : int64 (I,)
        Their addresses by instance, 0 where none is wanted; without rows if none is wanted at all.
    """

    scenes: list[EmbreeScene]
    handles: Int64Array


def build_local_scenes(
    geometry: GeometryArrays, hierarchies: MeshHierarchies, mesh_keys: Sequence[Hashable], is_wanted: np.ndarray
) -> LocalScenes:
    """Hierarchies of single instances.

    Parameters
    ----------
    geometry : GeometryArrays
    hierarchies : MeshHierarchies
        Those of instanced meshes are taken from here, or built and left here.
    mesh_keys : sequence of hashable (M,)
        See `build_accelerator`.
    is_wanted : bool (I,)
        Of which instances.

    Raises
    ------
    MemoryError, RuntimeError
        When Embree reports an error.
    """
    table = geometry.instance_table
    scenes: list[EmbreeScene] = []
    handles = np.zeros(len(table) if is_wanted.any() else 0, np.int64)
    everything = np.full(len(table), NONE, np.uint32)
    meshes = geometry.mesh_table[table[:, INSTANCE_MESH]]
    # Light goes into no hair and no points, as in Cycles.
    has_triangles = (meshes[:, MESH_TRIANGLE_COUNT] > 0) & (meshes[:, MESH_SHAPE] == SHAPE_TRIANGLES)
    for instance in np.flatnonzero(is_wanted & has_triangles).tolist():
        mesh = int(table[instance, INSTANCE_MESH])
        if table[instance, INSTANCE_FLAGS] & INSTANCE_FLAG_BAKED:
            scene = build_standing(hierarchies.device, geometry, np.array([instance]), everything)
        else:
            scene = hierarchies.of(mesh_keys[mesh], geometry, mesh)
        scenes.append(scene)
        handles[instance] = scene.address
    hierarchies.device.check()
    return LocalScenes(scenes, handles)


@kernel
def to_mesh_space(geometry, instance, time, p, direction):
    """A ray in the space that the instance's mesh is stored in; the direction's length is what distances are in."""
    if geometry.instance_table[instance, INSTANCE_FLAGS] & INSTANCE_FLAG_BAKED:
        return p, direction
    return point_to_object(geometry, instance, time, p), direction_to_object(geometry, instance, time, direction)


@kernel
def leave_triangle(bits, geometry, instance, triangle):
    """Say which triangle of the instance the next ray of `trace_local_from` starts on, which it skips."""
    table = geometry.instance_table
    # In the hierarchy of a mesh that is the only geometry, and in one of what stands still its id is the instance's.
    is_baked = table[instance, INSTANCE_FLAGS] & INSTANCE_FLAG_BAKED != 0
    bits[CONTEXT_INSTANCE_COUNT] = table.shape[0]
    bits[CONTEXT_OWN] = instance if is_baked else 0
    bits[CONTEXT_OWN + 1] = triangle - geometry.mesh_table[table[instance, INSTANCE_MESH], MESH_FIRST_TRIANGLE]
    bits[CONTEXT_OWN + 2] = 1
    name_none(bits, CONTEXT_LIGHT)
    call_filters(bits, True)


@kernel
def trace_local_from(scene, ray, bits, address, origin, direction, near, far, time):
    """As `trace_local` from `near` on, but for the triangle that `leave_triangle` has named."""
    return trace_closest_from(scene, ray, bits, address, origin, direction, near, far, time, NONE)


@kernel
def trace_local(scene, ray, bits, address, origin, direction, far, time):
    """Whether a ray in the space of a mesh meets it; `read_local` reads the answer. See `trace_closest`.

    Parameters
    ----------
    scene : intp, of `build_local_scenes`
    """
    return trace_closest(scene, ray, bits, address, origin, direction, 0.0, far, time, NONE)


@kernel
def read_local(ray, bits, geometry, instance):
    """Triangle, distance and barycentrics of what `trace_local` has hit, as `read_hit` has them."""
    first = geometry.mesh_table[geometry.instance_table[instance, INSTANCE_MESH], MESH_FIRST_TRIANGLE]
    return np.int32(first + np.int32(bits[HIT_TRIANGLE])), ray[HIT_DISTANCE], ray[HIT_U], ray[HIT_U + 1]
