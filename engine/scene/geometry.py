# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes and instances of a description, checked and flattened into `GeometryArrays`."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from engine.scene import arrays as layout
from engine.scene.arrays import Float32Array, GeometryArrays
from engine.scene.description import VISIBLE_ALL, Instances, Mesh, Notice, SceneDescription
from engine.scene.motion import MOST_KEYS, keys_of_motions

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


def plain_instances(
    transforms: npt.ArrayLike, *, meshes: int | Sequence[int] = 0, materials: int | Sequence[int] = 0,
    name: str = "Object",
) -> Instances:
    """Instances with nothing special about them, seen by every ray.

    Parameters
    ----------
    transforms : float (N, 4, 4), object to world
    meshes, materials : int or sequence of N
        Of all, or of each.
    """
    transforms = np.asarray(transforms, np.float32).reshape(-1, 4, 4)
    count = len(transforms)
    of_each = not isinstance(materials, int)
    return Instances(
        mesh=np.full(count, meshes, np.int32),
        transform=transforms,
        material_offset=np.arange(count, dtype=np.int32) if of_each else np.zeros(count, np.int32),
        materials=np.atleast_1d(np.asarray(materials, np.int32)),
        visibility=np.full(count, VISIBLE_ALL, np.uint32),
        pass_index=np.zeros(count, np.int32),
        random=np.zeros(count, np.float32),
        color=np.ones((count, 4), np.float32),
        is_holdout=np.zeros(count, np.bool_),
        name=[name] * count,
        dupli_generated=np.zeros((count, 3), np.float32),
        dupli_uv=np.zeros((count, 2), np.float32),
        is_shadow_catcher=np.zeros(count, np.bool_),
    )


def empty_instances() -> Instances:
    """`Instances` of nothing."""
    return plain_instances(np.zeros((0, 4, 4)), materials=())


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


def _affine_inverse(matrices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Inverse, float32 (N, 3, 4), zeros where singular, and determinant, float64 (N,), of (N, 4, 4) affine matrices.

    By cofactors: LAPACK takes a call a matrix, which is seconds for a hundred thousand instances.
    """
    # (3, N): column by column, so that numpy works along rows of memory.
    a, b, c, offset = (np.ascontiguousarray(matrices[:, :3, k].T, np.float64) for k in range(4))

    def cross(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        return np.stack([u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]])

    # Rows of the inverse are the cross products of the columns, over the determinant.
    with np.errstate(over="ignore", invalid="ignore"):
        rows = np.stack([cross(b, c), cross(c, a), cross(a, b)])
        determinant = np.einsum("kn,kn->n", a, rows[0])
    good = np.isfinite(determinant) & (np.abs(determinant) > 1e-30)
    rows *= np.where(good, 1.0 / np.where(good, determinant, 1.0), 0.0)
    inverse = np.empty((len(matrices), 3, 4), np.float32)
    inverse[:, :, :3] = rows.transpose(2, 0, 1)
    inverse[:, :, 3] = -np.einsum("rkn,kn->nr", rows, offset)
    return inverse, determinant


def _turned_normals(normals: np.ndarray, inverse: np.ndarray) -> np.ndarray:
    """Normals (..., 3) of a surface by the inverse of its transform's linear part, unit."""
    turned = normals.reshape(-1, 3) @ inverse
    lengths = np.sqrt(np.einsum("ij,ij->i", turned, turned))
    return (turned / np.maximum(lengths, 1e-30)[:, None]).reshape(normals.shape)


def _usable_motions(instances: Instances, notices: list[Notice]) -> dict[int, np.ndarray]:
    """Motions that can be followed, by instance, in order."""
    usable = {}
    for index, steps in sorted(instances.motion.items()):
        if not 0 <= index < len(instances.mesh):
            raise ValueError(f"a motion is of instance {index}, and there are {len(instances.mesh)}")
        if 2 <= len(steps) <= MOST_KEYS and steps.shape[1:] == (4, 4) and np.isfinite(steps).all():
            usable[index] = steps
            continue
        problem = f"its motion is NaN, infinite, or not of 2 to {MOST_KEYS} steps"
        notices.append(Notice(f"object {instances.name[index]}", problem, "it stands still"))
    return usable


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


def build_geometry(
    description: SceneDescription, attribute_names: Sequence[str], notices: list[Notice]
) -> GeometryArrays:
    """Flatten meshes and instances.

    Meshes with a single user are stored in world space, so that most scenes become one flat hierarchy; the others stay
    in object space and are instanced.

    Parameters
    ----------
    description : SceneDescription
    attribute_names : sequence of str
        Attribute slots in the order the shader programs number them.
    notices : list of Notice
        What was left out is appended.

    Raises
    ------
    ValueError
        For a motion of an instance that does not exist.
    """
    meshes, instances = description.meshes, description.instances
    instance_count = len(instances.mesh)
    users = np.bincount(instances.mesh, minlength=len(meshes)) if instance_count else np.zeros(len(meshes), np.int64)

    transforms = np.ascontiguousarray(instances.transform[:, :3, :].reshape(instance_count, 12), np.float32)
    finite = np.isfinite(transforms).all(axis=1)
    matrices = instances.transform if finite.all() else np.where(finite[:, None, None], instances.transform, 0.0)
    inverse, determinant = _affine_inverse(matrices)
    inverses = inverse.reshape(instance_count, 12)
    singular = ~finite | (inverses == 0.0).all(axis=1)

    vertices, triangles, normals, slots = [], [], [], []
    attribute_data: list[np.ndarray] = []
    motion_rows: list[tuple[int, ...]] = []
    motions = _usable_motions(instances, notices)
    mesh_table = np.zeros((max(len(meshes), 1), layout.MESH_WIDTH), np.int32)
    attribute_count = max(len(attribute_names), 1)
    attribute_table = np.zeros((max(len(meshes), 1) * attribute_count, layout.ATTRIBUTE_WIDTH), np.int64)
    slot_of = {name: slot for slot, name in enumerate(attribute_names)}
    texture_space = np.zeros((max(len(meshes), 1), 6), np.float32)
    texture_space[:, 3:] = 1.0
    first_user = np.full(len(meshes), -1)
    first_user[instances.mesh[::-1]] = np.arange(instance_count)[::-1]
    flags = np.zeros(instance_count, np.int32)
    vertex_total = triangle_total = normal_total = data_total = 0
    for index, mesh in enumerate(meshes):
        positions = np.asarray(mesh.vertices, np.float32)
        user = int(first_user[index])
        # A singular transform cannot be undone for the shader, but its flattened surface can still be seen: bake it.
        steps = _steps(mesh, notices)
        if user >= 0 and (users[index] == 1) and finite[user] and user not in motions:
            matrix = instances.transform[user].astype(np.float64)
            with np.errstate(invalid="ignore", over="ignore"):
                positions = (positions @ matrix[:3, :3].T + matrix[:3, 3]).astype(np.float32)
                if steps is not None:
                    steps = (steps @ matrix[:3, :3].T + matrix[:3, 3]).astype(np.float32)
            flags[user] |= layout.INSTANCE_FLAG_BAKED
        keep = _usable_triangles(mesh, positions, notices)
        mesh_triangles = mesh.triangles if keep is None else mesh.triangles[keep]
        corner_normals = mesh.corner_normals
        step_normals = mesh.motion_normals if steps is not None and corner_normals is not None else None
        if steps is not None and corner_normals is not None and step_normals is None:
            step_normals = np.broadcast_to(corner_normals, (len(steps), *corner_normals.shape))
        if corner_normals is not None and keep is not None:
            corner_normals = corner_normals[keep]
            step_normals = None if step_normals is None else step_normals[:, keep]
        if user >= 0 and flags[user] & layout.INSTANCE_FLAG_BAKED:
            if corner_normals is not None and not singular[user]:
                linear = inverses[user].reshape(3, 4)[:, :3].astype(np.float64)
                corner_normals = _turned_normals(corner_normals, linear)
                step_normals = None if step_normals is None else _turned_normals(step_normals, linear)
            elif singular[user]:
                corner_normals = step_normals = None
        mesh_table[index, : layout.MESH_FIRST_NORMAL] = (
            triangle_total,
            len(mesh_triangles),
            vertex_total,
            len(positions),
        )
        mesh_table[index, layout.MESH_FIRST_NORMAL] = -1 if corner_normals is None else normal_total
        mesh_table[index, layout.MESH_MOTION] = -1
        mesh_table[index, layout.MESH_DEFAULT_UV] = slot_of.get(mesh.default_uv, -1)
        mesh_table[index, layout.MESH_DEFAULT_COLOR] = slot_of.get(mesh.default_color, -1)
        if mesh.texture_space is not None:
            texture_space[index] = mesh.texture_space.reshape(6)
        for name, attribute in mesh.attributes.items():
            slot = slot_of.get(name)
            if slot is None:
                continue
            data = np.asarray(attribute.data, np.float32)
            if keep is not None and attribute.domain == "CORNER":
                data = data.reshape(len(keep), 3, -1)[keep].reshape(-1, data.shape[-1])
            elif keep is not None and attribute.domain == "FACE":
                data = data[keep]
            attribute_table[index * attribute_count + slot] = (_DOMAINS[attribute.domain], data.shape[1], data_total)
            attribute_data.append(data.reshape(-1))
            data_total += data.size
        vertices.append(positions)
        triangles.append(mesh_triangles + np.uint32(vertex_total))
        slots.append(mesh.material_slots if keep is None else mesh.material_slots[keep])
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

    unusable = np.flatnonzero(singular & ((flags & layout.INSTANCE_FLAG_BAKED) == 0))
    for index in unusable[:8]:
        notices.append(Notice(f"object {instances.name[index]}", "its transform cannot be inverted", "it is left out"))
    if len(unusable) > 8:
        notices.append(Notice(f"{len(unusable) - 8} more instances", "their transforms cannot be inverted", "left out"))

    table = np.zeros((max(instance_count, 1), layout.INSTANCE_WIDTH), np.int32)
    values = np.zeros((max(instance_count, 1), layout.VALUE_WIDTH), np.float32)
    motion_keys: list[Float32Array] = []
    if instance_count:
        key_total = 0
        motion_keys = keys_of_motions(list(motions.values()))
        for index, keys in zip(motions, motion_keys, strict=True):
            table[index, layout.INSTANCE_FIRST_KEY] = key_total
            table[index, layout.INSTANCE_KEY_COUNT] = len(keys)
            flags[index] |= layout.INSTANCE_FLAG_MOVING
            key_total += len(keys)
        flags[determinant < 0.0] |= layout.INSTANCE_FLAG_MIRRORED
        flags[instances.is_holdout] |= layout.INSTANCE_FLAG_HOLDOUT
        visibility = instances.visibility.astype(np.int32)
        visibility[unusable] = 0
        table[:, layout.INSTANCE_MESH] = instances.mesh
        table[:, layout.INSTANCE_MATERIAL_OFFSET] = instances.material_offset
        table[:, layout.INSTANCE_PASS_INDEX] = instances.pass_index
        table[:, layout.INSTANCE_VISIBILITY] = visibility
        table[:, layout.INSTANCE_FLAGS] = flags
        values[:, layout.VALUE_RANDOM] = instances.random
        values[:, layout.VALUE_COLOR : layout.VALUE_COLOR + 4] = instances.color
        values[:, layout.VALUE_GENERATED : layout.VALUE_GENERATED + 3] = instances.dupli_generated
        values[:, layout.VALUE_UV : layout.VALUE_UV + 2] = instances.dupli_uv
        if instances.terminator_offset is not None:
            values[:, layout.VALUE_TERMINATOR] = instances.terminator_offset

    def joined(parts: list[np.ndarray], width: int, dtype: type) -> np.ndarray:
        if not parts:
            return np.zeros((0, width), dtype)
        return np.ascontiguousarray(np.concatenate(parts), dtype).reshape(-1, width)

    all_vertices = np.zeros((vertex_total + _VERTEX_PADDING, 3), np.float32)
    if vertices:
        np.concatenate(vertices, out=all_vertices[:vertex_total])
    return GeometryArrays(
        vertices=all_vertices,
        triangles=joined(triangles, 3, np.uint32),
        corner_normals=joined(normals, 9, np.float32),
        material_slots=joined(slots, 1, np.int32).reshape(-1),
        mesh_table=mesh_table,
        instance_table=table[:instance_count] if instance_count else table[:0],
        transforms=transforms,
        inverses=np.ascontiguousarray(inverses),
        instance_values=values[:instance_count] if instance_count else values[:0],
        instance_materials=np.ascontiguousarray(instances.materials, np.int32),
        attribute_table=attribute_table,
        attribute_data=joined([d.reshape(-1, 1) for d in attribute_data], 1, np.float32).reshape(-1),
        texture_space=texture_space,
        attribute_count=np.array([attribute_count], np.int64),
        motion_table=joined([np.array([row]) for row in motion_rows], layout.MOTION_WIDTH, np.int32),
        motion_transforms=joined(motion_keys, 12, np.float32),
    )
