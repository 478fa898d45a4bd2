# SPDX-License-Identifier: GPL-3.0-or-later
"""Triangles of surfaces that emit, as the rows and bounds that light sampling needs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from engine.array_types import Float32Array, Int32Array
from engine.builder import light_tree as lt
from engine.builder.emission import SAMPLING_BACK, SAMPLING_FRONT_BACK, ProgramInfo, resolve_sampling
from engine.builder.motion import corners_in_motion, is_in_motion, world_corners
from engine.scene.description import VISIBLE_DIFFUSE, VISIBLE_GLOSSY, VISIBLE_TRANSMISSION, VISIBLE_VOLUME
from engine.state import lights as la
from engine.state.geometry import (
    INSTANCE_FLAG_MIRRORED,
    INSTANCE_FLAGS,
    INSTANCE_MATERIAL_OFFSET,
    INSTANCE_MESH,
    INSTANCE_VISIBILITY,
    MESH_FIRST_TRIANGLE,
    MESH_SHAPE,
    MESH_TRIANGLE_COUNT,
    SHAPE_TRIANGLES,
    GeometryArrays,
)

_VISIBLE_TO_SCATTERING = VISIBLE_DIFFUSE | VISIBLE_GLOSSY | VISIBLE_TRANSMISSION | VISIBLE_VOLUME


@dataclass
class EmissiveTriangles:
    """Emissive triangles found, T of them, and the way back from (instance, triangle).

    Attributes
    ----------
    emitters : int32 (T, EMITTER_WIDTH)
    rows : float32 (T, TRIANGLE_WIDTH)
        Of `LightArrays.triangles`.
    bounds : float32 (T, BOUNDS_WIDTH)
        For the light tree.
    lookup_offset, lookup : int64 (instances, 2), int32
        As in `LightArrays`.
    """

    emitters: Int32Array
    rows: Float32Array
    bounds: Float32Array
    lookup_offset: npt.NDArray[np.int64]
    lookup: Int32Array


def _emissive_instances(geometry: GeometryArrays, sides: Int32Array) -> np.ndarray:
    """Instances that have a material which is sampled as a light, and that scattered rays can see."""
    instances = geometry.instance_table
    if len(instances) == 0 or len(geometry.instance_materials) == 0 or not sides.any():
        return np.zeros(0, np.int64)
    slot_count = np.ones(len(geometry.mesh_table), np.int64)
    for mesh, row in enumerate(geometry.mesh_table):
        first, count = int(row[MESH_FIRST_TRIANGLE]), int(row[MESH_TRIANGLE_COUNT])
        if count:
            slot_count[mesh] = int(geometry.material_slots[first : first + count].max()) + 1
    programs = geometry.instance_materials
    emissive = np.where(programs >= 0, sides[np.maximum(programs, 0)] != 0, False)
    before = np.concatenate([[0], np.cumsum(emissive)])
    starts = np.minimum(instances[:, INSTANCE_MATERIAL_OFFSET].astype(np.int64), len(programs))
    ends = np.minimum(starts + slot_count[instances[:, INSTANCE_MESH]], len(programs))
    visible = (instances[:, INSTANCE_VISIBILITY] & _VISIBLE_TO_SCATTERING) != 0
    # Curves and spheres glow, but are not sampled, as in Cycles.
    visible &= geometry.mesh_table[instances[:, INSTANCE_MESH], MESH_SHAPE] == SHAPE_TRIANGLES
    return np.flatnonzero((before[ends] > before[starts]) & visible)


def _widen(bound: np.ndarray, shapes: Sequence[np.ndarray], normal: np.ndarray) -> None:
    """Bounds of triangles that move: all places, and all normals where they turn.

    Parameters
    ----------
    bound : float32 (T, BOUNDS_WIDTH), changed
    shapes : sequence of float64 (T, 3, 3)
        Corners at different times.
    normal : float64 (T, 3), at the middle of the shutter, unit
    """
    lower, upper = slice(lt.BOUNDS_LOWER, lt.BOUNDS_LOWER + 3), slice(lt.BOUNDS_UPPER, lt.BOUNDS_UPPER + 3)
    least = np.ones(len(bound))
    for corners in shapes:
        bound[:, lower] = np.minimum(bound[:, lower], corners.min(axis=1))
        bound[:, upper] = np.maximum(bound[:, upper], corners.max(axis=1))
        turned = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        length = np.maximum(np.linalg.norm(turned, axis=1), 1e-300)
        least = np.minimum(least, np.einsum("ij,ij->i", turned, normal) / length)
    # Between two keys normals are none of theirs, but hardly farther out.
    angle = np.arccos(np.clip(least, -1.0, 1.0))
    bound[:, lt.BOUNDS_NORMALS] = np.where(angle > 1e-3, np.minimum(1.05 * angle + 0.02, np.pi), 0.0)


@dataclass(frozen=True)
class _Found:
    """Emissive triangles of an instance that have an area, T of them.

    triangles : int64 (T,), in the mesh, whose first is `first`
    programs, flags : int32 (T,), the latter SAMPLING_*
    corners : float64 (T, 3, 3), in the world
    normals, areas : float64 (T, 3), unit, and (T,)
    """

    instance: int
    first: int
    triangles: np.ndarray
    programs: np.ndarray
    flags: np.ndarray
    corners: np.ndarray
    normals: np.ndarray
    areas: np.ndarray


def _find_in(geometry: GeometryArrays, sides: Int32Array, instance: int) -> _Found | None:
    """Triangles of an instance that are sampled as lights."""
    table = geometry.instance_table[instance]
    mesh = geometry.mesh_table[table[INSTANCE_MESH]]
    first, count = int(mesh[MESH_FIRST_TRIANGLE]), int(mesh[MESH_TRIANGLE_COUNT])
    slots = geometry.material_slots[first : first + count]
    program = geometry.instance_materials[int(table[INSTANCE_MATERIAL_OFFSET]) + slots]
    found = np.flatnonzero(np.where(program >= 0, sides[np.maximum(program, 0)] != 0, False))
    if len(found) == 0:
        return None
    corners = world_corners(geometry, instance, first + found)
    edge1, edge2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normal = np.cross(edge1, edge2)
    doubled = np.linalg.norm(normal, axis=1)
    longest = np.maximum((edge1**2).sum(1), (edge2**2).sum(1))
    good = np.isfinite(doubled) & (doubled > 1e-12 * longest) & (doubled > 1e-30)
    if not good.any():
        return None
    found, program = found[good], program[found[good]]
    normal, doubled = normal[good] / doubled[good, None], doubled[good]
    return _Found(instance, first, found, program, sides[program], corners[good], normal, 0.5 * doubled)


def _emitters_of(geometry: GeometryArrays, info: ProgramInfo, found: _Found) -> Int32Array:
    """Rows of `LightArrays.emitters`."""
    table = geometry.instance_table[found.instance]
    row = np.zeros((len(found.triangles), la.EMITTER_WIDTH), np.int32)
    row[:, la.EMITTER_KIND] = la.LIGHT_TRIANGLE
    row[:, la.EMITTER_LAMP] = -1
    row[:, la.EMITTER_INSTANCE] = found.instance
    row[:, la.EMITTER_TRIANGLE] = found.first + found.triangles
    row[:, la.EMITTER_PROGRAM] = np.where(info.emission_is_constant[found.programs], -1, found.programs)
    row[:, la.EMITTER_FLAGS] = found.flags
    row[:, la.EMITTER_FLAGS] |= la.EMITTER_MIRRORED if table[INSTANCE_FLAGS] & INSTANCE_FLAG_MIRRORED else 0
    row[:, la.EMITTER_FLAGS] |= la.EMITTER_MOVING if is_in_motion(geometry, found.instance) else 0
    row[:, la.EMITTER_VISIBILITY] = table[INSTANCE_VISIBILITY]
    return row


def _rows_of(info: ProgramInfo, found: _Found) -> Float32Array:
    """Rows of `LightArrays.triangles`."""
    corners = found.corners
    shape = np.empty((len(corners), la.TRIANGLE_WIDTH), np.float32)
    shape[:, la.TRIANGLE_V0 : la.TRIANGLE_V0 + 3] = corners[:, 0]
    shape[:, la.TRIANGLE_EDGE1 : la.TRIANGLE_EDGE1 + 3] = corners[:, 1] - corners[:, 0]
    shape[:, la.TRIANGLE_EDGE2 : la.TRIANGLE_EDGE2 + 3] = corners[:, 2] - corners[:, 0]
    shape[:, la.TRIANGLE_RADIANCE :] = np.where(
        info.emission_is_constant[found.programs, None], info.emission_estimate[found.programs], 1.0
    )
    return shape


def _bounds_of(geometry: GeometryArrays, info: ProgramInfo, found: _Found) -> Float32Array:
    """What the light tree goes by."""
    mirrored = bool(geometry.instance_table[found.instance, INSTANCE_FLAGS] & INSTANCE_FLAG_MIRRORED)
    outward = np.where((found.flags == SAMPLING_BACK) != mirrored, -1.0, 1.0)
    bound = np.zeros((len(found.corners), lt.BOUNDS_WIDTH), np.float32)
    bound[:, lt.BOUNDS_LOWER : lt.BOUNDS_LOWER + 3] = found.corners.min(axis=1)
    bound[:, lt.BOUNDS_UPPER : lt.BOUNDS_UPPER + 3] = found.corners.max(axis=1)
    bound[:, lt.BOUNDS_ENERGY] = found.areas * np.abs(info.emission_estimate[found.programs]).mean(axis=1)
    bound[:, lt.BOUNDS_AXIS : lt.BOUNDS_AXIS + 3] = found.normals * outward[:, None]
    bound[:, lt.BOUNDS_EMISSION] = 0.5 * np.pi
    bound[:, lt.BOUNDS_TWO_SIDED] = found.flags == SAMPLING_FRONT_BACK
    bound[:, lt.BOUNDS_SPREAD] = found.areas / np.pi
    if is_in_motion(geometry, found.instance):
        _widen(bound, corners_in_motion(geometry, found.instance, found.first + found.triangles), found.normals)
    return bound


def find_triangles(geometry: GeometryArrays, info: ProgramInfo) -> EmissiveTriangles:
    """Triangles of all instances whose material is sampled as a light; those without an area are left out."""
    sides = resolve_sampling(info)
    lookup_offset = np.full((max(1, len(geometry.instance_table)), 2), -1, np.int64)
    emitters, rows, bounds, lookup = [], [], [], []
    lookup_count = 0
    triangle_count = 0
    for instance in _emissive_instances(geometry, sides):
        found = _find_in(geometry, sides, instance)
        if found is None:
            continue
        emitters.append(_emitters_of(geometry, info, found))
        rows.append(_rows_of(info, found))
        bounds.append(_bounds_of(geometry, info, found))
        count = int(geometry.mesh_table[geometry.instance_table[instance, INSTANCE_MESH], MESH_TRIANGLE_COUNT])
        lookup_offset[instance] = (lookup_count, found.first)
        table_row = np.full(count, -1, np.int32)
        table_row[found.triangles] = triangle_count + np.arange(len(found.triangles))
        lookup.append(table_row)
        lookup_count += count
        triangle_count += len(found.triangles)

    def joined(parts: list[np.ndarray], width: int, dtype: type) -> np.ndarray:
        return np.concatenate(parts) if parts else np.zeros((0, width), dtype)

    return EmissiveTriangles(
        joined(emitters, la.EMITTER_WIDTH, np.int32),
        joined(rows, la.TRIANGLE_WIDTH, np.float32),
        joined(bounds, lt.BOUNDS_WIDTH, np.float32),
        lookup_offset,
        np.concatenate(lookup) if lookup else np.zeros(0, np.int32),
    )


#: More sources than this are not looked at one by one.
_MAX_SOURCES = 16


def find_sources(geometry: GeometryArrays, info: ProgramInfo) -> Float32Array | None:
    """Spheres around the emissive triangles of each instance, sampled as lights or not: centre and squared radius.

    None where they are too many, or not finite.
    """
    emits = np.asarray(info.has_emission, bool)
    instances = _emissive_instances(geometry, emits.astype(np.int32))
    if len(instances) > _MAX_SOURCES:
        return None
    spheres = np.zeros((len(instances), 4), np.float64)
    for row, instance in enumerate(instances):
        table = geometry.instance_table[instance]
        mesh = geometry.mesh_table[table[INSTANCE_MESH]]
        first, count = int(mesh[MESH_FIRST_TRIANGLE]), int(mesh[MESH_TRIANGLE_COUNT])
        slots = geometry.material_slots[first : first + count]
        program = geometry.instance_materials[int(table[INSTANCE_MATERIAL_OFFSET]) + slots]
        found = np.flatnonzero(np.where(program >= 0, emits[np.maximum(program, 0)], False))
        if len(found) == 0:
            spheres[row, 3] = -1.0
            continue
        shapes = corners_in_motion(geometry, instance, first + found)
        lower = np.min([shape.min(axis=(0, 1)) for shape in shapes], axis=0)
        upper = np.max([shape.max(axis=(0, 1)) for shape in shapes], axis=0)
        center = 0.5 * (lower + upper)
        spheres[row, :3] = center
        spheres[row, 3] = 1.01 * max(((shape - center) ** 2).sum(axis=-1).max() for shape in shapes)
    return spheres[spheres[:, 3] >= 0.0].astype(np.float32) if np.isfinite(spheres).all() else None
