# SPDX-License-Identifier: GPL-3.0-or-later
"""Motion blur: meshes, strands and points that change their shape while the shutter is open."""

from __future__ import annotations

import hashlib
import itertools
from dataclasses import dataclass, field, replace
from typing import Any

import bpy
import numpy as np
import numpy.typing as npt

from engine.array_types import Float32Array
from engine.scene.description import Mesh, SceneDescription

from .context import ExportContext
from .instances import Appearance, Appearances
from .moments import Moment
from .normals import read_normals
from .particle_hair import ParticleHair, read_hair_shape
from .positions import read_positions
from .rounds import as_many_keys, read_offsets, read_shape
from .shutter import Shutter
from .topology import Faces, Topology, read_faces, read_topology

#: A point attribute [m/s] that stands for positions at other times, in meshes of simulations.
_VELOCITY = "velocity"
#: Times Cycles makes of velocities.
_VELOCITY_STEPS = 3
#: Up to this, keys of hair have not moved [m].
_HAIR_NOISE = 1e-5


class ShapeTrack:
    """Shapes of all meshes at all times, of which only those that change are kept."""

    def __init__(
        self,
        context: ExportContext,
        description: SceneDescription,
        appearances: Appearances,
        chosen: npt.NDArray[np.intp],
        shutter: Shutter,
    ) -> None:
        """Find the meshes that may change; Blender stands at the middle of the shutter.

        Parameters
        ----------
        chosen : intp (N,)
            Rows of `appearances` that the instances of `description` are.
        """
        self._context = context
        self._shutter = shutter
        self._description = description
        self._shapes: list[_Shape] = []
        order = np.argsort(description.instances.mesh, kind="stable")
        bounds = np.searchsorted(description.instances.mesh[order], np.arange(len(description.meshes) + 1))
        for row, (first, end) in enumerate(itertools.pairwise(bounds.tolist())):
            items = chosen[order[first:end]]
            kinds = [appearances.kinds[row] for row in np.unique(appearances.kind[items]).tolist()]
            kinds = [kind for kind in kinds if kind.use_deform_motion and kind.motion_step_count > 0]
            if kinds and kinds[0].rounds is not None:
                self._add_rounds(row, items, kinds, kinds[0].rounds)
            elif kinds and kinds[0].mesh is not None and kinds[0].mesh.is_editmode:
                # Its datablock may be empty (`export_mesh`).
                context.notice(kinds[0].name, "it is in Edit Mode", "it keeps its shape while the shutter is open")
            elif kinds and kinds[0].mesh is not None:
                self._add(row, items, kinds, kinds[0].mesh)
        #: Most times of any mesh, 0 if none may change.
        self.step_count = max((shape.step_count for shape in self._shapes), default=0)

    def _add(self, row: int, items: npt.NDArray[np.intp], kinds: list[Appearance], source: bpy.types.Mesh) -> None:
        self._context.check_cancel()
        mesh = self._description.meshes[row]
        has_velocity = _has_velocity(source)
        if not has_velocity and not any(_can_deform(kind.owner) for kind in kinds):
            return
        shape = _Shape(row, items, mesh, kinds[0].name, max(kind.motion_step_count for kind in kinds))
        if has_velocity:
            _follow_velocity(self._context, self._shutter, shape, source)
        else:
            shape.is_read = True
            shape.faces = read_faces(source)
            if mesh.corner_normals is not None:
                source.calc_loop_triangles()
                shape.topology = read_topology(source, len(mesh.triangles))
        self._shapes.append(shape)

    def _add_rounds(self, row: int, items: npt.NDArray[np.intp], kinds: list[Appearance], source: Any) -> None:
        """The same for curves, points and hair, which are looked at whatever made them."""
        self._context.check_cancel()
        step_count = max(kind.motion_step_count for kind in kinds)
        shape = _Shape(row, items, self._description.meshes[row], kinds[0].name, step_count)
        if isinstance(source, ParticleHair):
            # What was evaluated at one time is gone at another.
            shape.grows_on = source.owner.original
            shape.is_read = True
        elif _has_velocity(source):
            _follow_velocity(self._context, self._shutter, shape, source)
        else:
            shape.is_read = True
            if isinstance(source, bpy.types.Curves):
                shape.offsets = read_offsets(source)
        self._shapes.append(shape)

    def look(self, step: int, count: int, moment: Moment, where: npt.NDArray[np.intp]) -> None:
        """Read what is due at the time `step` of `count`; `where` intp has the rows of `moment` of all items."""
        for shape in self._shapes:
            stride = (count - 1) // (shape.step_count - 1)
            if not shape.is_read or step % stride != 0:
                continue
            found = where[shape.items]
            found = found[found >= 0]
            if len(found):
                self._context.check_cancel()
                if shape.mesh.rounds is None:
                    self._read(shape, step // stride, moment.data[found[0]])
                else:
                    self._read_rounds(shape, step // stride, moment.data[found[0]], shape.mesh.rounds.radii)

    def _read_rounds(self, shape: _Shape, step: int, source: Any, middle_radii: Float32Array) -> None:
        middle = shape.mesh.vertices
        if shape.grows_on is not None:
            positions, radii = read_hair_shape(self._context, shape.grows_on.evaluated_get(self._context.depsgraph))
        else:
            positions, radii = read_shape(source)
            if shape.offsets is not None:
                offsets = read_offsets(source)
                has_other_keys = len(offsets) == len(shape.offsets) and not np.array_equal(offsets, shape.offsets)
                if has_other_keys and np.diff(offsets).all():
                    positions, radii = (as_many_keys(part, offsets, shape.offsets) for part in (positions, radii))
        if len(positions) != len(middle):
            self._context.notice(
                shape.name,
                "has other strands or points at another time of the shutter: its shape is not blurred",
                "its shape in the middle",
            )
            shape.give_up()
            return
        if not isinstance(source, bpy.types.PointCloud):
            # As in Cycles, points swell, and strands are at all times as thick as in the middle.
            radii = middle_radii
        # As in Cycles: keys of hair come back from the world, never quite to where they were.
        allowed = _HAIR_NOISE if shape.grows_on is not None else 0.0
        with np.errstate(invalid="ignore"):
            moved = np.abs(positions - middle).max(initial=0.0), np.abs(radii - middle_radii).max(initial=0.0)
        if max(moved) <= allowed:
            return
        shape.vertices[step] = self._repaired(shape, positions, middle)
        shape.radii[step] = self._repaired(shape, radii, middle_radii)

    def _read(self, shape: _Shape, step: int, source: bpy.types.Mesh) -> None:
        middle = shape.mesh
        positions = read_positions(source) if len(source.vertices) == len(middle.vertices) else None
        if positions is not None and np.array_equal(positions, middle.vertices):
            return
        if positions is None or read_faces(source) != shape.faces:
            self._context.notice(
                shape.name,
                "has other vertices or faces at another time of the shutter: its shape is not blurred",
                "its shape in the middle",
            )
            shape.give_up()
            return
        normals = read_normals(source, shape.topology) if shape.topology is not None else None
        shape.vertices[step] = self._repaired(shape, positions, middle.vertices)
        if normals is not None and middle.corner_normals is not None:
            shape.normals[step] = self._repaired(shape, normals, middle.corner_normals)

    def _repaired(self, shape: _Shape, values: Float32Array, middle: Float32Array) -> Float32Array:
        """Without NaN and infinity that are not in the middle too."""
        is_good = np.isfinite(values)
        if is_good.all():
            return values
        problem = "has vertices that are not finite while the shutter is open"
        self._context.notice(shape.name, problem, "then where they are in the middle")
        return np.where(is_good, values, middle)

    def finish(self) -> None:
        """Put the meshes that changed into the description, under keys that tell how."""
        meshes = self._description.meshes
        for shape in self._shapes:
            if not shape.vertices:
                continue
            self._context.check_cancel()
            vertices = _with_middle(shape.mesh.vertices, shape.vertices, shape.step_count)
            normals = None
            if shape.mesh.corner_normals is not None:
                normals = _with_middle(shape.mesh.corner_normals, shape.normals, shape.step_count)
            rounds, radii = shape.mesh.rounds, None
            if rounds is not None:
                if shape.radii:
                    radii = _with_middle(rounds.radii, shape.radii, shape.step_count)
                rounds = replace(rounds, motion_radii=radii)
            digest = hashlib.blake2b(vertices.data, digest_size=16)
            for part in (normals, radii):
                if part is not None:
                    digest.update(part.data)
            row = shape.row
            key = (meshes[row].key, digest.hexdigest())
            meshes[row] = replace(
                meshes[row], key=key, motion_vertices=vertices, motion_normals=normals, rounds=rounds
            )


@dataclass
class _Shape:
    """A mesh, its row in the description, and the items that show it."""

    row: int
    items: npt.NDArray[np.intp]
    mesh: Mesh
    name: str
    step_count: int
    #: Whether there is anything to be read at other times.
    is_read: bool = False
    #: What a mesh's must be like to be the same; None of curves and points.
    faces: Faces | None = None
    #: Where curves begin, in the middle.
    offsets: npt.NDArray[np.int64] | None = None
    #: Whose hair it is, original.
    grows_on: bpy.types.Object | None = None
    #: None where every face is flat.
    topology: Topology | None = None
    #: By time; those of the middle are the mesh's own.
    vertices: dict[int, Float32Array] = field(default_factory=dict)
    normals: dict[int, Float32Array] = field(default_factory=dict)
    #: Of curves and points.
    radii: dict[int, Float32Array] = field(default_factory=dict)

    def give_up(self) -> None:
        """Forget what was read, and read no more."""
        self.is_read = False
        self.faces = self.topology = None
        self.vertices.clear()
        self.normals.clear()
        self.radii.clear()


def _has_velocity(source: Any) -> bool:
    velocity = source.attributes.get(_VELOCITY)
    return velocity is not None and (velocity.domain, velocity.data_type) == ("POINT", "FLOAT_VECTOR")


def _can_deform(owner: bpy.types.Object) -> bool:
    """Whether an object's evaluation may give its mesh another shape at another time."""
    if owner.type != "MESH" or len(owner.modifiers) > 0:
        return True
    return getattr(owner.original.data, "shape_keys", None) is not None


def _follow_velocity(context: ExportContext, shutter: Shutter, shape: _Shape, source: Any) -> None:
    """As Cycles: vertices go straight on, [m/s], whatever the mesh is at other times."""
    flat = np.empty(len(shape.mesh.vertices) * 3, np.float32)
    source.attributes[_VELOCITY].data.foreach_get("vector", flat)
    render = context.scene.render
    seconds = 0.5 * shutter.length * render.fps_base / render.fps
    move = np.nan_to_num(flat.reshape(-1, 3), posinf=0.0, neginf=0.0) * np.float32(seconds)
    shape.step_count = _VELOCITY_STEPS
    if move.any():
        shape.vertices = {0: shape.mesh.vertices - move, 2: shape.mesh.vertices + move}


def _with_middle(middle: Float32Array, others: dict[int, Float32Array], count: int) -> Float32Array:
    """All times, float32 (count, ...); where nothing was read, the middle."""
    result = np.repeat(middle[None], count, axis=0)
    for step, values in others.items():
        result[step] = values
    return result
