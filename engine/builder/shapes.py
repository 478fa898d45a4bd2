# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes of a description, checked and laid one after the other: vertices, triangles, normals, attributes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from engine.array_types import Float32Array, Int32Array, Int64Array, Uint32Array
from engine.builder.grids import build_grids
from engine.builder.motion import MOST_KEYS
from engine.builder.rounds import SHAPES, lay_radii
from engine.builder.solids import mark_solids
from engine.scene.attribute_names import UNDEFORMED
from engine.scene.description import Mesh, Notice
from engine.state import geometry as layout
from engine.state.grids import GridArrays

_DOMAINS = {
    "POINT": layout.DOMAIN_POINT,
    "FACE": layout.DOMAIN_FACE,
    "CORNER": layout.DOMAIN_CORNER,
}
#: Rows of a mesh that are converted at a time.
_ROWS = 1 << 16
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
    radii: Float32Array
    texture_space: Float32Array
    kept_triangles: list[np.ndarray | None]
    slot_counts: Int64Array


@dataclass(frozen=True)
class Attributes:
    """Attributes of all meshes that programs read; see `GeometryArrays`.

    default_slots : int32 (M, 3), slots of the render-active UV map and colour and of undeformed positions, -1 = none
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


def _write_points(points: np.ndarray, placement: Placement | None, out: np.ndarray) -> None:
    """Points (N, 3), where they are placed, into `out`, float32 (N, 3). By rows: a mesh is large enough once."""
    if placement is None:
        out[...] = points
        return
    # A singular transform cannot be undone for the shader, but its flattened surface can still be seen.
    matrix = placement.transform.astype(np.float64)
    for first in range(0, len(points), _ROWS):
        rows = slice(first, first + _ROWS)
        with np.errstate(invalid="ignore", over="ignore"):
            out[rows] = points[rows] @ matrix[:3, :3].T + matrix[:3, 3]


def _write_normals(normals: np.ndarray, placement: Placement | None, out: np.ndarray) -> None:
    """Normals of corners (T, 3, 3), turned as the surface is, unit, into `out`, float32 (T, 9). By rows."""
    flat, written = normals.reshape(-1, 3), out.reshape(-1, 3)
    if placement is None or placement.inverse is None:
        written[...] = flat
        return
    inverse = placement.inverse[:, :3].astype(np.float64)
    for first in range(0, len(flat), _ROWS):
        rows = slice(first, first + _ROWS)
        turned = flat[rows] @ inverse
        lengths = np.sqrt(np.einsum("ij,ij->i", turned, turned))
        written[rows] = turned / np.maximum(lengths, 1e-30)[:, None]


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
        Placement of a mesh that is to be stored in world space; None: in object space.
    notices : list of Notice
        What was left out is appended.
    """
    steps_of = [_steps(mesh, notices) for mesh in meshes]
    vertices, first_vertices = _lay_vertices(meshes, placements, steps_of)
    kept_triangles = [
        _usable_triangles(mesh, vertices[first : first + len(mesh.vertices)], notices)
        for mesh, first in zip(meshes, first_vertices, strict=True)
    ]
    triangle_counts = [
        len(mesh.triangles) if keep is None else int(np.count_nonzero(keep))
        for mesh, keep in zip(meshes, kept_triangles, strict=True)
    ]
    normals_of = [
        _normals_by_step(mesh, placement, steps)
        for mesh, placement, steps in zip(meshes, placements, steps_of, strict=True)
    ]
    triangles = np.empty((sum(triangle_counts), 3), np.uint32)
    slots = np.empty(len(triangles), np.int32)
    normal_total = sum(len(parts) * count for parts, count in zip(normals_of, triangle_counts, strict=True))
    normals = np.empty((normal_total, 9), np.float32)
    motion_rows: list[tuple[int, ...]] = []
    mesh_table = np.zeros((max(len(meshes), 1), layout.MESH_WIDTH), np.int32)
    slot_counts = np.ones(max(len(meshes), 1), np.int64)
    texture_space = np.zeros((max(len(meshes), 1), 6), np.float32)
    texture_space[:, 3:] = 1.0
    first_triangle = first_normal = 0
    for index, (mesh, keep) in enumerate(zip(meshes, kept_triangles, strict=True)):
        count, first_vertex, steps = triangle_counts[index], first_vertices[index], steps_of[index]
        rows = slice(first_triangle, first_triangle + count)
        np.add(mesh.triangles if keep is None else mesh.triangles[keep], np.uint32(first_vertex), out=triangles[rows])
        slots[rows] = mesh.material_slots if keep is None else mesh.material_slots[keep]
        if count:
            slot_counts[index] = int(slots[rows].max()) + 1
        mesh_table[index, : layout.MESH_FIRST_NORMAL] = first_triangle, count, first_vertex, len(mesh.vertices)
        mesh_table[index, layout.MESH_FIRST_NORMAL] = first_normal if normals_of[index] else -1
        mesh_table[index, layout.MESH_MOTION] = -1
        if mesh.rounds is not None:
            mesh_table[index, layout.MESH_SHAPE] = SHAPES[mesh.rounds.shape]
            mesh_table[index, layout.MESH_SUBDIVISIONS] = mesh.rounds.subdivisions
        if mesh.texture_space is not None:
            texture_space[index] = mesh.texture_space.reshape(6)
        if steps is not None:
            mesh_table[index, layout.MESH_MOTION] = len(motion_rows)
            first_of_steps = first_normal + count if len(normals_of[index]) > 1 else -1
            motion_rows.append((len(steps), first_vertex + len(mesh.vertices), first_of_steps, 0))
        for part in normals_of[index]:
            part = part if keep is None else part[keep]
            _write_normals(part, placements[index], normals[first_normal : first_normal + count])
            first_normal += count
        first_triangle += count
    transforms = [None if placement is None else placement.transform for placement in placements]
    step_counts = [0 if steps is None else len(steps) for steps in steps_of]
    radii, mesh_table[: len(meshes), layout.MESH_FIRST_RADIUS] = lay_radii(meshes, transforms, step_counts, notices)
    mark_solids(mesh_table, vertices, triangles)
    return Shapes(
        vertices=vertices,
        triangles=triangles,
        corner_normals=normals,
        material_slots=slots,
        mesh_table=mesh_table,
        motion_table=_joined([np.array([row]) for row in motion_rows], layout.MOTION_WIDTH, np.int32),
        radii=radii,
        texture_space=texture_space,
        kept_triangles=kept_triangles,
        slot_counts=slot_counts,
    )


def _lay_vertices(
    meshes: Sequence[Mesh], placements: Sequence[Placement | None], steps_of: Sequence[np.ndarray | None]
) -> tuple[Float32Array, list[int]]:
    """Vertices of all meshes, each followed by those of its steps, and where each mesh's begin."""
    sizes = [
        len(mesh.vertices) * (1 if steps is None else 1 + len(steps))
        for mesh, steps in zip(meshes, steps_of, strict=True)
    ]
    laid = np.zeros((sum(sizes) + _VERTEX_PADDING, 3), np.float32)
    firsts = (np.cumsum(sizes, dtype=np.int64) - sizes).tolist() if sizes else []
    for mesh, placement, steps, first in zip(meshes, placements, steps_of, firsts, strict=True):
        count = len(mesh.vertices)
        _write_points(np.asarray(mesh.vertices, np.float32), placement, laid[first : first + count])
        for step, positions in enumerate(() if steps is None else steps, 1):
            at = first + step * count
            _write_points(positions, placement, laid[at : at + count])
    return laid, firsts


def _normals_by_step(mesh: Mesh, placement: Placement | None, steps: np.ndarray | None) -> list[np.ndarray]:
    """Normals of a mesh's corners (T, 3, 3): those at the middle of the shutter, then those of each step.

    None where faces are flat, or flattened by a transform.
    """
    normals = mesh.corner_normals
    if normals is None or (placement is not None and placement.inverse is None):
        return []
    if steps is None:
        return [normals]
    at_steps = [normals] * len(steps) if mesh.motion_normals is None else list(mesh.motion_normals)
    return [normals, *at_steps]


def build_attributes(
    meshes: Sequence[Mesh], kept_triangles: Sequence[np.ndarray | None], attribute_names: Sequence[str],
    properties: Mapping[str, Float32Array],
) -> Attributes:
    """Lay the attributes of meshes one after the other, and behind them those of instances.

    Parameters
    ----------
    meshes : sequence of Mesh
    kept_triangles : sequence
        Triangles that `build_shapes` has kept.
    attribute_names : sequence of str
        Attribute slots in the order the shader programs number them.
    properties : mapping
        `Instances.properties`.
    """
    slot_of = {name: slot for slot, name in enumerate(attribute_names)}
    count = max(len(attribute_names), 1)
    table = np.zeros((max(len(meshes), 1) * count, layout.ATTRIBUTE_WIDTH), np.int64)
    default_slots = np.zeros((max(len(meshes), 1), 3), np.int32)
    parts: list[np.ndarray] = []
    total = 0
    grids, grid_numbers = build_grids(meshes, slot_of)
    for (index, name), number in grid_numbers.items():
        table[index * count + slot_of[name]] = (layout.DOMAIN_GRID, meshes[index].grids[name].width, number)
    for index, (mesh, keep) in enumerate(zip(meshes, kept_triangles, strict=True)):
        undeformed = slot_of.get(UNDEFORMED, -1) if UNDEFORMED in mesh.attributes else -1
        default_slots[index] = slot_of.get(mesh.default_uv, -1), slot_of.get(mesh.default_color, -1), undeformed
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
    for name, values in properties.items():
        slot = slot_of.get(name)
        if slot is not None:
            table[slot::count] = (layout.DOMAIN_INSTANCE, values.shape[1], total)
            parts.append(values.reshape(-1, 1))
            total += values.size
    return Attributes(
        table, _joined(parts, 1, np.float32).reshape(-1), np.array([count], np.int64), default_slots, grids
    )
