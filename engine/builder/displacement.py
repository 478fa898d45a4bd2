# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes moved by the displacement of their materials: a program looked up once at every vertex.

Rules are those of Cycles: a vertex goes by the first triangle around it that displaces, and sees the smooth normal
there; a mesh that several objects share is displaced as the first of them has it.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from engine.array_types import Float32Array, Int64Array
from engine.builder.dicing import dice
from engine.builder.displaced_normals import displaced_normals, face_normals, unit_vectors
from engine.builder.fans import split_at_fans
from engine.builder.geometry import build_geometry
from engine.builder.point_batches import PointBatches
from engine.builder.programs import Programs
from engine.kernels.bsdf import BsdfTables
from engine.scene.attribute_names import (
    DISPLACED_TANGENT,
    SMOOTH,
    UNDISPLACED,
    UNDISPLACED_NORMALS,
    VERTEX_NORMALS,
)
from engine.scene.content import Versions
from engine.scene.description import Attribute, Instances, Mesh, Notice, SceneDescription
from engine.scene.instances import select_instances
from engine.scene.tangents import compute_tangents
from engine.shaders.compiled_program import CompiledProgram
from engine.state import lanes as layout
from engine.state.geometry import GeometryArrays
from engine.state.lanes import LANE_COUNT
from engine.state.shaders import MODE_EMISSION

#: Barycentrics of a triangle's corners.
_CORNERS = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]], np.float32)


class KeptDisplacements:
    """Displaced meshes of the newest description, by what they were made from."""

    def __init__(self) -> None:
        self.versions = Versions()
        self.meshes: dict[Hashable, tuple[Mesh, list[Notice]]] = {}
        self._next = 0
        self._undiced = Versions()
        self._diced: dict[int, Mesh] = {}

    def diced(self, meshes: Sequence[Mesh], check_cancel: Callable[[], None]) -> list[Mesh]:
        """Meshes divided as they ask to be: those at hand that have not changed."""
        versions = self._undiced.of(meshes)
        # Freed first: old and new may not fit into memory together.
        self._diced = {version: mesh for version, mesh in self._diced.items() if version in versions}
        for version, mesh in zip(versions, meshes, strict=True):
            if mesh.dicing is not None and version not in self._diced:
                check_cancel()
                self._diced[version] = dice(mesh, mesh.dicing, check_cancel)
        return [self._diced.get(version, mesh) for version, mesh in zip(versions, meshes, strict=True)]

    def next_number(self) -> int:
        """A number that no earlier mesh has."""
        self._next += 1
        return self._next

    def forget(self) -> None:
        """Let go of all meshes."""
        self.versions.forget()
        self._undiced.forget()
        self._diced = {}
        self.meshes = {}


@dataclass(frozen=True)
class Displacing:
    """What displaces meshes, by material slot: programs, and which move normals too.

    programs : int32 (S,), -1 = none
    bends : bool (S,), whether normals are those of what has been displaced
    """

    programs: tuple[int, ...]
    bends: tuple[bool, ...]


def displace_meshes(
    description: SceneDescription, programs: Programs, compiled: Sequence[CompiledProgram], seen: Hashable,
    kept: KeptDisplacements, tables: BsdfTables, *, attribute_names: Sequence[str], threads: int,
    check_cancel: Callable[[], None],
) -> tuple[SceneDescription, list[Notice]]:
    """The description with its meshes where their materials move them; the same where none does.

    Parameters
    ----------
    compiled : sequence of CompiledProgram
        By number of program.
    seen : hashable
        What programs depend on besides themselves: images, the camera.
    kept : KeptDisplacements
        Updated.
    attribute_names : sequence of str
        Attribute slots in the order the programs number them.
    threads : int
        For what more than one can do.
    """
    if not (programs.displacement_programs >= 0).any():
        kept.forget()
        return description, []
    instances = description.instances
    groups = _groups(description, programs)
    versions = kept.versions.of(description.meshes)
    meshes, mesh_of = list(description.meshes), instances.mesh.copy()
    is_taken = np.zeros(len(meshes), np.bool_)
    known, notices = kept.meshes, []
    kept.meshes = {}
    is_taken[[number for number, displacing in groups if displacing is None]] = True
    for (number, displacing), rows in groups.items():
        if displacing is None:
            continue
        check_cancel()
        owner = select_instances(instances, rows[:1])
        used = tuple(compiled[program] for program in displacing.programs if program >= 0)
        key = (versions[number], displacing, used, seen, _instance_key(owner))
        if key not in known:
            evaluation = _Evaluation(description, programs, tables, attribute_names, threads, check_cancel)
            known[key] = evaluation.displaced(meshes[number], owner, displacing, kept.next_number())
        mesh, found = kept.meshes[key] = known[key]
        notices += found
        if is_taken[number]:
            mesh_of[rows] = len(meshes)
            meshes.append(mesh)
        else:
            is_taken[number], meshes[number] = True, mesh
    return replace(description, meshes=meshes, instances=replace(instances, mesh=mesh_of)), notices


def _groups(
    description: SceneDescription, programs: Programs
) -> dict[tuple[int, Displacing | None], Int64Array]:
    """Instances by mesh and by what displaces it."""
    instances = description.instances
    if not len(instances.mesh):
        return {}
    bends = np.array([material.displacement_method == "DISPLACEMENT" for material in description.materials], bool)
    pairs = np.stack([instances.mesh, instances.material_offset], axis=1)
    different, of_pair = np.unique(pairs, axis=0, return_inverse=True)
    order = np.argsort(of_pair.reshape(-1), kind="stable")
    starts = np.searchsorted(of_pair.reshape(-1)[order], np.arange(len(different) + 1))
    groups: dict[tuple[int, Displacing | None], list[Int64Array]] = {}
    for pair, (number, offset) in enumerate(different.tolist()):
        slots = description.meshes[number].material_slots
        count = int(slots.max()) + 1 if len(slots) else 0
        materials = instances.materials[offset : offset + count]
        found = np.where(materials >= 0, programs.displacement_programs[materials], -1)
        displacing = None
        if (found >= 0).any():
            of_slot = (found >= 0) & (materials >= 0) & bends[materials]
            displacing = Displacing(tuple(found.tolist()), tuple(of_slot.tolist()))
        groups.setdefault((number, displacing), []).append(order[starts[pair] : starts[pair + 1]])
    return {key: np.sort(np.concatenate(rows)) for key, rows in groups.items()}


def _instance_key(owner: Instances) -> Hashable:
    """What a program may read of an object."""
    columns = (owner.transform, owner.pass_index, owner.random, owner.color, owner.dupli_generated, owner.dupli_uv)
    properties = tuple((name, values.tobytes()) for name, values in owner.properties.items())
    motion = tuple(steps.tobytes() for steps in owner.motion.values())
    return (*(column.tobytes() for column in columns), properties, motion)


class _Evaluation:
    """Looks displacement up at vertices."""

    def __init__(
        self, description: SceneDescription, programs: Programs, tables: BsdfTables, attribute_names: Sequence[str],
        threads: int, check_cancel: Callable[[], None],
    ) -> None:
        self._description, self._programs, self._tables = description, programs, tables
        self._attribute_names = attribute_names
        self._threads, self._check_cancel = threads, check_cancel

    def displaced(
        self, mesh: Mesh, owner: Instances, displacing: Displacing, number: int
    ) -> tuple[Mesh, list[Notice]]:
        """A mesh after displacement, with a key of its own by `number`, and what went wrong."""
        to_world = owner.transform[0].astype(np.float64)
        in_range = not len(mesh.triangles) or int(mesh.triangles.max()) < len(mesh.vertices)
        if not in_range or not np.isfinite(to_world).all() or abs(np.linalg.det(to_world[:3, :3])) < 1e-30:
            # Whoever builds the geometry reports it.
            return mesh, []
        mesh = split_at_fans(mesh)
        program_of = np.array(displacing.programs, np.int32)[mesh.material_slots]
        triangles, corners = _first_triangles(mesh, program_of >= 0)
        offsets = np.zeros(mesh.vertices.shape, np.float32)
        vertices = np.flatnonzero(triangles >= 0)
        offsets[vertices] = self._offsets(mesh, owner, vertices, triangles[vertices], corners[vertices], program_of)
        notices = []
        is_bad = ~np.isfinite(offsets)
        if is_bad.any():
            count = int(is_bad.any(axis=1).sum())
            problem = f"its displacement is NaN or infinite at {count} vertices"
            notices.append(Notice(f"mesh {mesh.name}", problem, "they stay where they are along those axes"))
            offsets[is_bad] = 0.0
        bends = np.array(displacing.bends, bool)[mesh.material_slots]
        moved = _moved(mesh, offsets, bends, self._attribute_names)
        return replace(moved, key=("displaced", mesh.key, number)), notices

    def _offsets(
        self, mesh: Mesh, owner: Instances, vertices: np.ndarray, triangles: np.ndarray, corners: np.ndarray,
        program_of: np.ndarray,
    ) -> Float32Array:
        """What vertices are moved by in the object's space, float32 (N, 3), each seen as a corner of a triangle."""
        owner = replace(owner, mesh=np.zeros(1, np.int32), motion={})
        # Where a vertex is no number, none of its triangles is shown, but they must not get out of step.
        finite = replace(
            mesh, vertices=np.nan_to_num(mesh.vertices, posinf=0.0, neginf=0.0), motion_vertices=None,
            motion_normals=None,
        )  # fmt: skip
        description = replace(self._description, meshes=[finite], instances=owner)
        names = self._attribute_names
        geometry = build_geometry(description, names, [], default_program=self._programs.default_program)
        of_vertices = mesh.attributes.get(VERTEX_NORMALS)
        to_object = np.linalg.inv(owner.transform[0].astype(np.float64))
        offsets = np.empty((len(vertices), 3), np.float32)

        def look_up(part: slice) -> None:
            at, corner = triangles[part], corners[part]
            flat = face_normals(finite.vertices, mesh.triangles[at])
            normals = flat
            if of_vertices is not None:
                normals = of_vertices.data[vertices[part]]
            elif mesh.corner_normals is not None:
                normals = mesh.corner_normals[at, corner]
            positions = finite.vertices[vertices[part]] @ owner.transform[0, :3, :3].T + owner.transform[0, :3, 3]
            seen = _Seen(
                positions, unit_vectors(flat @ to_object[:3, :3]), unit_vectors(normals @ to_object[:3, :3]), at,
                _CORNERS[corner], program_of[at],
            )  # fmt: skip
            found = self._look_up(geometry, seen)
            with np.errstate(invalid="ignore", over="ignore"):
                offsets[part] = found @ to_object[:3, :3].T

        # A whole number of batches for each part, and enough parts to be asked now and then whether to go on.
        size = 16 * LANE_COUNT
        parts = [slice(start, start + size) for start in range(0, len(vertices), size)]
        with ThreadPoolExecutor(self._threads, thread_name_prefix="displacement") as pool:
            for _ in pool.map(look_up, parts):
                self._check_cancel()
        return offsets

    def _look_up(self, geometry: GeometryArrays, seen: _Seen) -> Float32Array:
        """What programs give at points of the only instance of a geometry, float32 (N, 3), in the world."""
        shaders = self._programs.arrays
        batches = PointBatches(shaders)
        batches.points.real[:, layout.POINT_TIME] = 0.5
        batches.points.integer[:, layout.POINT_LIGHT] = -1
        real = {
            layout.POINT_P: seen.positions, layout.POINT_NG: seen.face_normals, layout.POINT_NS: seen.normals,
            layout.POINT_WO: seen.normals, layout.POINT_U: seen.barycentrics,
        }  # fmt: skip
        integer = {layout.POINT_TRIANGLE: seen.triangles, layout.POINT_PROGRAM: seen.programs}
        found = np.empty(seen.positions.shape, np.float32)
        for part, count in batches.run(shaders, geometry, self._tables, MODE_EMISSION, real, integer):
            found[part] = batches.closures.emission[:count, :3]
        return found


@dataclass(frozen=True)
class _Seen:
    """Points as programs see them, N of them, in the world: where, both normals, triangle, place on it, program."""

    positions: np.ndarray
    face_normals: np.ndarray
    normals: np.ndarray
    triangles: np.ndarray
    barycentrics: np.ndarray
    programs: np.ndarray


def _first_triangles(mesh: Mesh, is_displacing: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of each vertex the first triangle that displaces it, -1 = none, and which of its corners the vertex is."""
    rows = np.flatnonzero(is_displacing)
    of_corners = mesh.triangles[rows].reshape(-1)
    first = np.full(len(mesh.vertices), -1, np.int64)
    # The last of equal indices is kept: backwards that is the first.
    first[of_corners[::-1]] = np.arange(len(of_corners), dtype=np.int64)[::-1]
    triangles = np.where(first >= 0, rows[first // 3] if len(rows) else -1, -1)
    return triangles, first % 3


def _moved(mesh: Mesh, offsets: Float32Array, bends: np.ndarray, asked: Sequence[str]) -> Mesh:
    """A mesh with its vertices moved, at all times alike, its normals after that, and what it was before."""
    vertices = (mesh.vertices + offsets).astype(np.float32)
    normals = displaced_normals(mesh, mesh.vertices, vertices, mesh.corner_normals, bends)
    motion_vertices, motion_normals = mesh.motion_vertices, mesh.motion_normals
    if motion_vertices is not None:
        motion_vertices = (motion_vertices + offsets[None]).astype(np.float32)
        if motion_normals is not None and mesh.motion_vertices is not None:
            motion_normals = np.stack([
                displaced_normals(mesh, before, after, corner_normals, bends)
                for before, after, corner_normals in zip(
                    mesh.motion_vertices, motion_vertices, motion_normals, strict=True
                )
            ])  # fmt: skip
    attributes = dict(mesh.attributes)
    if UNDISPLACED in asked:
        attributes[UNDISPLACED] = Attribute("POINT", mesh.vertices)
    if mesh.corner_normals is not None:
        before = mesh.corner_normals.reshape(-1, 3)
        if UNDISPLACED_NORMALS in asked:
            attributes[UNDISPLACED_NORMALS] = Attribute("CORNER", _smooth_normals(mesh, before))
        if VERTEX_NORMALS in asked and VERTEX_NORMALS not in attributes:
            attributes[VERTEX_NORMALS] = Attribute("CORNER", before)
    moved = replace(
        mesh, vertices=vertices, corner_normals=normals, motion_vertices=motion_vertices,
        motion_normals=motion_normals, attributes=attributes,
    )  # fmt: skip
    _add_tangents(moved, asked)
    return moved


def _add_tangents(moved: Mesh, asked: Sequence[str]) -> None:
    """Add the tangents of a displaced mesh that programs ask for."""
    is_smooth = moved.attributes.get(SMOOTH)
    is_flat = None if is_smooth is None else is_smooth.data[:, 0] == 0.0
    for name in asked:
        uv = moved.attributes.get(name.removesuffix(DISPLACED_TANGENT) or moved.default_uv)
        if name.endswith(DISPLACED_TANGENT) and uv is not None and uv.data.shape[1] == 2 and len(moved.triangles):
            moved.attributes[name] = compute_tangents(moved, uv.data, is_flat)


def _smooth_normals(mesh: Mesh, corner_normals: np.ndarray) -> Float32Array:
    """Normals of corners, 0 on flat faces."""
    is_smooth = mesh.attributes.get(SMOOTH)
    if is_smooth is None:
        return corner_normals
    return (corner_normals * np.repeat(is_smooth.data, 3, axis=0)).astype(np.float32)

