# SPDX-License-Identifier: GPL-3.0-or-later
"""Instances of a description, checked, and with the meshes they place flattened into `GeometryArrays`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
import numpy.typing as npt

from engine.accel.accelerator import Accelerator
from engine.accel.hierarchies import MeshHierarchies
from engine.array_types import Float32Array, Int64Array
from engine.builder.motion import MOST_KEYS, keys_of_motions
from engine.builder.rounds import is_uniform
from engine.builder.shapes import Attributes, Placement, Shapes, build_attributes, build_shapes
from engine.scene.content import Kept, Versions
from engine.scene.description import Instances, Mesh, Notice, SceneDescription
from engine.scene.rounds import SPHERES
from engine.state import geometry as layout
from engine.state.geometry import GeometryArrays

#: Segments of curves that are stored in world space, beside triangles.
_LARGEST_BAKED_CURVES = 1 << 16


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


class GeometryCache:
    """What of a session's geometry is kept between frames.

    Parameters
    ----------
    expects_moves : bool
        Whether what has been moved once will be again, as in a viewport: it is instanced from then on.

    Attributes
    ----------
    mesh_keys : tuple of int
        Numbers of the newest description's meshes: equal ones have the same content.
    slot_counts : int64 (M,)
        Material slots that each of them uses, one at least.
    """

    def __init__(self, *, expects_moves: bool = False) -> None:
        self._expects_moves = expects_moves
        #: Where the only users of meshes stood last, by the meshes' numbers; and numbers of those that have been moved.
        self._stood: dict[int, bytes] = {}
        self._moved: set[int] = set()
        self.mesh_keys: tuple[int, ...] = ()
        self.slot_counts: Int64Array = np.ones(1, np.int64)
        self.hierarchies: MeshHierarchies | None = None
        self.accelerator: Kept[Accelerator] = Kept()
        self.mesh_versions = Versions()
        #: With notices, as every step that gives any.
        self.shapes: Kept[tuple[Shapes, list[Notice]]] = Kept()
        self.attributes: Kept[Attributes] = Kept()
        self.geometry: Kept[tuple[GeometryArrays, list[Notice]]] = Kept()

    def give_up(self, meshes: Sequence[Mesh]) -> None:
        """Free the arrays of the newest description's meshes, of which those of the geometry are copies.

        Nothing is built of these meshes again; others are built as if there had been none.
        """
        self.mesh_versions.forget()
        for mesh in meshes:
            mesh.vertices, mesh.triangles = np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint32)
            mesh.material_slots, mesh.attributes = np.zeros(0, np.int32), {}
            mesh.corner_normals = mesh.motion_vertices = mesh.motion_normals = mesh.rounds = None

    @property
    def has_moved(self) -> bool:
        """Whether anything of the newest description has been moved."""
        return bool(self._moved)

    def moved_meshes(self, first_user: Int64Array, users: Int64Array, instances: Instances) -> npt.NDArray[np.bool_]:
        """Which of the newest description's meshes have been moved, or were before.

        Parameters
        ----------
        first_user, users : int64 (M,)
            First instance of each mesh, and how many instances there are.
        """
        moved = np.zeros(len(users), np.bool_)
        if not self._expects_moves:
            return moved
        before, self._stood = self._stood, {}
        for mesh in np.flatnonzero(users == 1).tolist():
            number = self.mesh_keys[mesh]
            place = self._stood[number] = instances.transform[first_user[mesh]].tobytes()
            moved[mesh] = number in self._moved or before.get(number, place) != place
        self._moved = {self.mesh_keys[mesh] for mesh in np.flatnonzero(moved).tolist()}
        return moved


def _instances_key(instances: Instances, properties_key: object) -> object:
    """What of instances geometry depends on: all."""
    apart = ("name", "motion", "asset", "properties")
    columns = [getattr(instances, item.name) for item in fields(instances) if item.name not in apart]
    return (
        tuple(instances.name),
        tuple(None if column is None else np.ascontiguousarray(column).tobytes() for column in columns),
        tuple((index, steps.shape, steps.tobytes()) for index, steps in sorted(instances.motion.items())),
        properties_key,
    )


def _properties_key(instances: Instances) -> object:
    return tuple((name, values.shape, values.tobytes()) for name, values in instances.properties.items())


@dataclass(frozen=True)
class _Placed:
    """Transforms of N instances, as arrays; which of them have an inverse, and which meshes are stored in world space.

    placements : of each mesh, None = in object space
    is_baked : bool (N,), the only user of such a mesh
    """

    transforms: Float32Array
    inverses: Float32Array
    determinant: np.ndarray
    is_singular: np.ndarray
    is_baked: np.ndarray
    placements: list[Placement | None]


def _may_be_baked(mesh: Mesh, transform: Float32Array) -> bool:
    if mesh.rounds is None:
        return True
    # Many segments take less memory in a compact hierarchy of their own, and are traced as fast.
    is_large = mesh.rounds.shape != SPHERES and len(mesh.triangles) > _LARGEST_BAKED_CURVES
    return not is_large and is_uniform(transform)


def _place(
    instances: Instances, meshes: Sequence[Mesh], motions: dict[int, np.ndarray], cache: GeometryCache
) -> _Placed:
    """Where meshes are stored.

    Those with a single user that stands still are stored in world space, so that most scenes are one flat hierarchy;
    the others stay in object space and are instanced, as are very many curves, and curves and spheres that are
    stretched.
    """
    count, mesh_count = len(instances.mesh), len(meshes)
    transforms = np.ascontiguousarray(instances.transform[:, :3, :].reshape(count, 12), np.float32)
    finite = np.isfinite(transforms).all(axis=1)
    matrices = instances.transform if finite.all() else np.where(finite[:, None, None], instances.transform, 0.0)
    inverse, determinant = _affine_inverse(matrices)
    inverses = np.ascontiguousarray(inverse.reshape(count, 12))
    singular = ~finite | (inverses == 0.0).all(axis=1)
    users = np.bincount(instances.mesh, minlength=mesh_count) if count else np.zeros(mesh_count, np.int64)
    first_user = np.full(mesh_count, -1)
    first_user[instances.mesh[::-1]] = np.arange(count)[::-1]
    is_baked = np.zeros(count, np.bool_)
    is_moved = cache.moved_meshes(first_user, users, instances)
    placements: list[Placement | None] = [None] * mesh_count
    for mesh, user in enumerate(first_user.tolist()):
        is_alone = user >= 0 and users[mesh] == 1 and finite[user] and user not in motions and not is_moved[mesh]
        if is_alone and _may_be_baked(meshes[mesh], instances.transform[user]):
            is_baked[user] = True
            placements[mesh] = Placement(instances.transform[user], None if singular[user] else inverse[user])
    return _Placed(transforms, inverses, determinant, singular, is_baked, placements)


def build_geometry(
    description: SceneDescription, attribute_names: Sequence[str], notices: list[Notice], *,
    default_program: int = -1, cache: GeometryCache | None = None,
) -> GeometryArrays:
    """Flatten meshes and instances.

    Parameters
    ----------
    description : SceneDescription
    attribute_names : sequence of str
        Attribute slots in the order the shader programs number them.
    notices : list of Notice
        What was left out is appended.
    default_program : int
        Program of slots without a material.
    cache : GeometryCache, optional
        Updated: arrays are those at hand where nothing in them has changed.

    Raises
    ------
    ValueError
        For a motion of an instance that does not exist.
    """
    cache = GeometryCache() if cache is None else cache
    meshes, instances = description.meshes, description.instances
    keys = cache.mesh_keys = cache.mesh_versions.of(meshes)
    names = tuple(attribute_names)
    properties_key = _properties_key(instances)

    def build() -> tuple[GeometryArrays, list[Notice]]:
        motion_notices: list[Notice] = []
        motions = _usable_motions(instances, motion_notices)
        placed = _place(instances, meshes, motions, cache)

        def shape() -> tuple[Shapes, list[Notice]]:
            found: list[Notice] = []
            # Freed first: they hold on to the arrays that are to be replaced.
            cache.accelerator.drop()
            if cache.hierarchies is not None:
                cache.hierarchies.keep_only(keys)
                cache.hierarchies.standing.drop()
            return build_shapes(meshes, placed.placements, found), found

        where = tuple(None if item is None else item.transform.tobytes() for item in placed.placements)
        shapes, shape_notices = cache.shapes.get((keys, where), shape)
        cache.slot_counts = shapes.slot_counts
        kept = cache.shapes.version if any(k is not None for k in shapes.kept_triangles) else 0
        attributes = cache.attributes.get(
            (keys, kept, names, properties_key),
            lambda: build_attributes(meshes, shapes.kept_triangles, names, instances.properties),
        )
        found = motion_notices + shape_notices
        return _assemble(instances, motions, placed, shapes, attributes, default_program, found), found

    arrays, found = cache.geometry.get((keys, names, default_program, _instances_key(instances, properties_key)), build)
    notices += found
    return arrays


def _assemble(
    instances: Instances, motions: dict[int, np.ndarray], placed: _Placed, shapes: Shapes, attributes: Attributes,
    default_program: int, notices: list[Notice],
) -> GeometryArrays:
    """The arrays of a scene from those of its meshes; instances without an inverse are left out, with a notice."""
    count = len(instances.mesh)
    unusable = np.flatnonzero(placed.is_singular & ~placed.is_baked)
    for index in unusable[:8]:
        notices.append(Notice(f"object {instances.name[index]}", "its transform cannot be inverted", "it is left out"))
    if len(unusable) > 8:
        notices.append(Notice(f"{len(unusable) - 8} more instances", "their transforms cannot be inverted", "left out"))

    table = np.zeros((count, layout.INSTANCE_WIDTH), np.int32)
    values = np.zeros((count, layout.VALUE_WIDTH), np.float32)
    flags = np.where(placed.is_baked, layout.INSTANCE_FLAG_BAKED, 0).astype(np.int32)
    motion_keys = keys_of_motions(list(motions.values()))
    key_total = 0
    for index, keys in zip(motions, motion_keys, strict=True):
        table[index, layout.INSTANCE_FIRST_KEY] = key_total
        table[index, layout.INSTANCE_KEY_COUNT] = len(keys)
        flags[index] |= layout.INSTANCE_FLAG_MOVING
        key_total += len(keys)
    flags[placed.determinant < 0.0] |= layout.INSTANCE_FLAG_MIRRORED
    flags[instances.is_holdout] |= layout.INSTANCE_FLAG_HOLDOUT
    if instances.is_shadow_catcher is not None:
        flags[instances.is_shadow_catcher & ~instances.is_holdout] |= layout.INSTANCE_FLAG_CATCHER
    visibility = instances.visibility.astype(np.int32)
    visibility[unusable] = 0
    table[:, layout.INSTANCE_MESH] = instances.mesh
    table[:, layout.INSTANCE_MATERIAL_OFFSET] = instances.material_offset
    table[:, layout.INSTANCE_PASS_INDEX] = instances.pass_index
    table[:, layout.INSTANCE_VISIBILITY] = visibility
    table[:, layout.INSTANCE_FLAGS] = flags
    table[:, layout.INSTANCE_LIGHT_GROUP] = -1 if instances.light_group is None else instances.light_group
    values[:, layout.VALUE_RANDOM] = instances.random
    values[:, layout.VALUE_COLOR : layout.VALUE_COLOR + 4] = instances.color
    values[:, layout.VALUE_GENERATED : layout.VALUE_GENERATED + 3] = instances.dupli_generated
    values[:, layout.VALUE_UV : layout.VALUE_UV + 2] = instances.dupli_uv
    if instances.terminator_offset is not None:
        values[:, layout.VALUE_TERMINATOR] = instances.terminator_offset
    if instances.shading_offset is not None:
        values[:, layout.VALUE_SHADING_OFFSET] = np.clip(instances.shading_offset, 0.0, 1.0)
    if instances.occlusion_distance is not None:
        values[:, layout.VALUE_OCCLUSION] = instances.occlusion_distance
    values[:, layout.VALUE_DENSITY] = 1.0 if instances.medium_density is None else instances.medium_density

    mesh_table = shapes.mesh_table.copy()
    columns = [layout.MESH_DEFAULT_UV, layout.MESH_DEFAULT_COLOR, layout.MESH_UNDEFORMED]
    mesh_table[:, columns] = attributes.default_slots
    materials = np.where(instances.materials >= 0, instances.materials, default_program)
    return GeometryArrays(
        vertices=shapes.vertices,
        triangles=shapes.triangles,
        corner_normals=shapes.corner_normals,
        material_slots=shapes.material_slots,
        mesh_table=mesh_table,
        instance_table=table,
        transforms=placed.transforms,
        inverses=placed.inverses,
        instance_values=values,
        instance_materials=np.ascontiguousarray(materials, np.int32),
        attribute_table=attributes.table,
        attribute_data=attributes.data,
        radii=shapes.radii,
        texture_space=shapes.texture_space,
        attribute_count=attributes.count,
        motion_table=shapes.motion_table,
        motion_transforms=_joined_keys(motion_keys),
        grids=attributes.grids,
    )


def _joined_keys(keys: list[Float32Array]) -> Float32Array:
    return np.concatenate(keys) if keys else np.zeros((0, 12), np.float32)
