# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes of a description, checked and laid one after the other: vertices, triangles, normals, attributes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from engine.array_types import Float32Array, Int32Array, Int64Array, Uint32Array
from engine.builder.grids import build_grids
from engine.builder.motion import MOST_KEYS
from engine.scene.description import Mesh, Notice
from engine.state import geometry as layout
from engine.state.grids import GridArrays

_DOMAINS = {
    "POINT": layout.DOMAIN_POINT,
    "FACE": layout.DOMAIN_FACE,
    "CORNER": layout.DOMAIN_CORNER,
    "MESH": layout.DOMAIN_MESH,
}
#: Embree reads 16 bytes at the last vertex.
_VERTEX_PADDING = 1
#: Embree leaves out, without a word, triangles with larger coordinates.
_LARGEST_COORDINATE = 1.8e18


@dataclass(frozen=True)
class Placement:
    """Where the only user of a mesh stands: its vertices are stored in world space.

    transform : float32 (4, 4), finite
    inverse : float32 (3, 4), or None where there is none
    """

    transform: Float32Array
    inverse: Float32Array | None


@dataclass(frozen=True)
class Shapes:
    """Meshes one after the other; see `GeometryArrays` for the arrays of the same names.

    mesh_table : without the columns of attributes
    kept_triangles : of each mesh bool (T,), those that are in the arrays, or None where all are
    slot_counts : int64 (M,), material slots that each mesh uses, one at least
    """

    vertices: Float32Array
    triangles: Uint32Array
    corner_normals: Float32Array
    material_slots: Int32Array
    mesh_table: Int32Array
    motion_table: Int32Array
    texture_space: Float32Array
    kept_triangles: list[np.ndarray | None]
    slot_counts: Int64Array


@dataclass(frozen=True)
class Attributes:
    """Attributes of all meshes that programs read; see `GeometryArrays`.

    default_slots : int32 (M, 2), slots of the render-active UV map and colour, -1 = none
    """

    table: Int64Array
    data: Float32Array
    count: Int64Array
    default_slots: Int32Array
    grids: GridArrays


def _usable_triangles(mesh: Mesh, vertices: np.ndarray, notices: list[Notice]) -> np.ndarray | None:
    """Mask of triangles worth keeping, or None where all are: indices in range, vertices where rays can find them."""
    triangles = mesh.triangles
    if len(triangles) == 0:
        return None
    in_range = None
    if int(triangles.max()) >= len(vertices):
        in_range = (triangles < len(vertices)).all(axis=1)
    # Smallest and largest are NaN if any is.
    if in_range is None and -_LARGEST_COORDINATE < vertices.min() and vertices.max() < _LARGEST_COORDINATE:
        return None
    finite_vertex = (np.abs(vertices) < _LARGEST_COORDINATE).all(axis=1)
    keep = np.ones(len(triangles), np.bool_) if in_range is None else in_range
    keep[keep] = finite_vertex[triangles[keep]].all(axis=1)
    if keep.all():
        return None
    notices.append(
        Notice(
            f"mesh {mesh.name}",
            f"{int((~keep).sum())} faces have vertices that are NaN, infinite, too far away or missing",
            "these faces are left out",
        )
    )
    return keep


def _turned_normals(normals: np.ndarray, inverse: np.ndarray) -> np.ndarray:
    """Normals (..., 3) of a surface by the inverse of its transform's linear part, unit."""
    turned = normals.reshape(-1, 3) @ inverse
    lengths = np.sqrt(np.einsum("ij,ij->i", turned, turned))
    return (turned / np.maximum(lengths, 1e-30)[:, None]).reshape(normals.shape)


def _steps(mesh: Mesh, notices: list[Notice]) -> np.ndarray | None:
    """Vertices at each step of a mesh that changes its shape, float32 (S, V, 3), where they can be used."""
    steps = mesh.motion_vertices
    if steps is None:
        return None
    is_good = steps.shape[1:] == np.asarray(mesh.vertices).shape and 2 <= len(steps) <= MOST_KEYS
    if is_good and mesh.motion_normals is not None and mesh.corner_normals is not None:
        is_good = mesh.motion_normals.shape == (len(steps), *mesh.corner_normals.shape)
    if is_good and (np.abs(steps) < _LARGEST_COORDINATE).all():
        return np.asarray(steps, np.float32)
    problem = "its shape at other times of the shutter has other vertices, or some that are NaN or infinite"
    notices.append(Notice(f"mesh {mesh.name}", problem, "it keeps its shape"))
    return None


def _joined(parts: list[np.ndarray], width: int, dtype: type) -> np.ndarray:
    if not parts:
        return np.zeros((0, width), dtype)
    return np.ascontiguousarray(np.concatenate(parts), dtype).reshape(-1, width)


def build_shapes(
    meshes: Sequence[Mesh], placements: Sequence[Placement | None], notices: list[Notice]
) -> Shapes:
    """Lay meshes one after the other.

    Parameters
    ----------
    meshes : sequence of Mesh
    placements : sequence of Placement or None
        Of meshes that are to be stored in world space; None: in object space.
    notices : list of Notice
        What was left out is appended.
    """
    vertices, triangles, normals, slots = [], [], [], []
    motion_rows: list[tuple[int, ...]] = []
    kept_triangles: list[np.ndarray | None] = []
    mesh_table = np.zeros((max(len(meshes), 1), layout.MESH_WIDTH), np.int32)
    slot_counts = np.ones(max(len(meshes), 1), np.int64)
    texture_space = np.zeros((max(len(meshes), 1), 6), np.float32)
    texture_space[:, 3:] = 1.0
    vertex_total = triangle_total = normal_total = 0
    for index, (mesh, placement) in enumerate(zip(meshes, placements, strict=True)):
        positions = np.asarray(mesh.vertices, np.float32)
        steps = _steps(mesh, notices)
        if placement is not None:
            # A singular transform cannot be undone for the shader, but its flattened surface can still be seen.
            matrix = placement.transform.astype(np.float64)
            with np.errstate(invalid="ignore", over="ignore"):
                positions = (positions @ matrix[:3, :3].T + matrix[:3, 3]).astype(np.float32)
                if steps is not None:
                    steps = (steps @ matrix[:3, :3].T + matrix[:3, 3]).astype(np.float32)
        keep = _usable_triangles(mesh, positions, notices)
        kept_triangles.append(keep)
        mesh_triangles = mesh.triangles if keep is None else mesh.triangles[keep]
        corner_normals = mesh.corner_normals
        step_normals = mesh.motion_normals if steps is not None and corner_normals is not None else None
        if steps is not None and corner_normals is not None and step_normals is None:
            step_normals = np.broadcast_to(corner_normals, (len(steps), *corner_normals.shape))
        if corner_normals is not None and keep is not None:
            corner_normals = corner_normals[keep]
            step_normals = None if step_normals is None else step_normals[:, keep]
        if placement is not None:
            if placement.inverse is None:
                corner_normals = step_normals = None
            elif corner_normals is not None:
                linear = placement.inverse[:, :3].astype(np.float64)
                corner_normals = _turned_normals(corner_normals, linear)
                step_normals = None if step_normals is None else _turned_normals(step_normals, linear)
        mesh_table[index, : layout.MESH_FIRST_NORMAL] = (
            triangle_total,
            len(mesh_triangles),
            vertex_total,
            len(positions),
        )
        mesh_table[index, layout.MESH_FIRST_NORMAL] = -1 if corner_normals is None else normal_total
        mesh_table[index, layout.MESH_MOTION] = -1
        if mesh.texture_space is not None:
            texture_space[index] = mesh.texture_space.reshape(6)
        vertices.append(positions)
        triangles.append(mesh_triangles + np.uint32(vertex_total))
        slots.append(mesh.material_slots if keep is None else mesh.material_slots[keep])
        if len(mesh_triangles):
            slot_counts[index] = int(slots[-1].max()) + 1
        if corner_normals is not None:
            normals.append(np.asarray(corner_normals, np.float32).reshape(-1, 9))
            normal_total += len(mesh_triangles)
        vertex_total += len(positions)
        triangle_total += len(mesh_triangles)
        if steps is not None:
            mesh_table[index, layout.MESH_MOTION] = len(motion_rows)
            motion_rows.append((len(steps), vertex_total, -1 if step_normals is None else normal_total, 0))
            vertices.append(steps.reshape(-1, 3))
            vertex_total += len(vertices[-1])
            if step_normals is not None:
                normals.append(np.asarray(step_normals, np.float32).reshape(-1, 9))
                normal_total += len(normals[-1])
    all_vertices = np.zeros((vertex_total + _VERTEX_PADDING, 3), np.float32)
    if vertices:
        np.concatenate(vertices, out=all_vertices[:vertex_total])
    return Shapes(
        vertices=all_vertices,
        triangles=_joined(triangles, 3, np.uint32),
        corner_normals=_joined(normals, 9, np.float32),
        material_slots=_joined(slots, 1, np.int32).reshape(-1),
        mesh_table=mesh_table,
        motion_table=_joined([np.array([row]) for row in motion_rows], layout.MOTION_WIDTH, np.int32),
        texture_space=texture_space,
        kept_triangles=kept_triangles,
        slot_counts=slot_counts,
    )


def build_attributes(
    meshes: Sequence[Mesh], kept_triangles: Sequence[np.ndarray | None], attribute_names: Sequence[str]
) -> Attributes:
    """Lay the attributes of meshes one after the other.

    Parameters
    ----------
    meshes : sequence of Mesh
    kept_triangles : sequence
        Of `build_shapes`.
    attribute_names : sequence of str
        Attribute slots in the order the shader programs number them.
    """
    slot_of = {name: slot for slot, name in enumerate(attribute_names)}
    count = max(len(attribute_names), 1)
    table = np.zeros((max(len(meshes), 1) * count, layout.ATTRIBUTE_WIDTH), np.int64)
    default_slots = np.zeros((max(len(meshes), 1), 2), np.int32)
    parts: list[np.ndarray] = []
    total = 0
    grids, grid_numbers = build_grids(meshes, slot_of)
    for (index, name), number in grid_numbers.items():
        table[index * count + slot_of[name]] = (layout.DOMAIN_GRID, meshes[index].grids[name].width, number)
    for index, (mesh, keep) in enumerate(zip(meshes, kept_triangles, strict=True)):
        default_slots[index] = slot_of.get(mesh.default_uv, -1), slot_of.get(mesh.default_color, -1)
        for name, attribute in mesh.attributes.items():
            slot = slot_of.get(name)
            if slot is None:
                continue
            data = np.asarray(attribute.data, np.float32)
            if keep is not None and attribute.domain == "CORNER":
                data = data.reshape(len(keep), 3, -1)[keep].reshape(-1, data.shape[-1])
            elif keep is not None and attribute.domain == "FACE":
                data = data[keep]
            table[index * count + slot] = (_DOMAINS[attribute.domain], data.shape[1], total)
            parts.append(data.reshape(-1, 1))
            total += data.size
    return Attributes(
        table, _joined(parts, 1, np.float32).reshape(-1), np.array([count], np.int64), default_slots, grids
    )
