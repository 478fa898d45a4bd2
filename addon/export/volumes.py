# SPDX-License-Identifier: GPL-3.0-or-later
"""Volume objects to boxes with grids of voxels, read from OpenVDB files."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from engine.array_types import Float32Array
from engine.scene.description import Mesh
from engine.scene.grids import MOST_TILES, Grid, VolumeMotion, pack_grid, tile_count

from ..versions import read_setting
from .context import CachedMesh, ExportContext
from .materials import AttributeRequest
from .openvdb_module import find_openvdb

_LEFT_OUT = "left out of the picture"
_SCALARS = ("FloatGrid", "DoubleGrid", "Int32Grid", "Int64Grid", "BoolGrid")
_VECTORS = ("Vec3SGrid", "Vec3DGrid", "Vec3IGrid")
_TRIANGLES = np.array(
    [(0, 2, 3), (0, 3, 1), (4, 5, 7), (4, 7, 6), (0, 1, 5), (0, 5, 4), (2, 6, 7), (2, 7, 3), (0, 4, 6), (0, 6, 2),
     (1, 3, 7), (1, 7, 5)], np.uint32,
)  # fmt: skip


@dataclass(frozen=True)
class _Velocity:
    """What a volume moves by: names of grids of vectors, the first that there is counts, or of one for each axis."""

    names: tuple[str, ...]
    axes: tuple[str, str, str]
    still: float
    scale: float


@dataclass
class _Grids:
    """What was read of a file.

    boxes : list of float64 (8, 3), corners of the boxes around the grids in the space of the object
    """

    grids: dict[str, Grid] = field(default_factory=dict)
    boxes: list[np.ndarray] = field(default_factory=list)
    motion: VolumeMotion | None = None


def export_volume(
    context: ExportContext, volume: bpy.types.Volume, owner: bpy.types.Object, request: AttributeRequest, *,
    is_blurred: bool,
) -> Mesh | None:
    """A box around the voxels of a volume, with the grids that its materials ask for; None where there are none.

    Parameters
    ----------
    volume : Volume, evaluated
    owner : Object
        Whose evaluation made it.
    is_blurred : bool
        Whether the object is seen to move while the shutter is open.
    """
    module = find_openvdb()
    if module is None:
        context.notice(owner.name, "this Blender has no module that reads OpenVDB files", _LEFT_OUT)
        return None
    volume.grids.load()
    if volume.grids.error_message:
        context.notice(owner.name, f"its file cannot be read: {volume.grids.error_message}", _LEFT_OUT)
        return None
    if len(volume.grids) == 0:
        context.notice(owner.name, "has no grids", _LEFT_OUT)
        return None
    velocity = _velocity_of(context, volume, is_blurred=is_blurred)
    path, state = _file_of(volume)
    identity = (owner.original.name_full, volume.name_full, "volume")
    kept = context.cache.meshes.get(identity)
    if path and kept is not None and kept.request == (request, velocity, state):
        kept.last_used = context.cache.export_count
        return kept.mesh
    found = _read_grids(context, module, volume, owner, path, request, velocity)
    context.check_cancel()
    if not found.grids:
        return None
    corners = np.concatenate(found.boxes)
    low, high = corners.min(axis=0), corners.max(axis=0)
    # Splines reach a voxel further.
    further = max(_voxel_size(grid) for grid in found.grids.values()) if request.smooth else 0.0
    key = (*identity, context.cache.new_version())
    mesh = box_of_voxels(key, volume.name, low, high, found.grids, found.motion, further=further)
    context.cache.meshes[identity] = CachedMesh(mesh, (request, velocity, state), context.cache.export_count)
    return mesh


def box_of_voxels(
    key: Hashable, name: str, low: np.ndarray, high: np.ndarray, grids: dict[str, Grid], motion: VolumeMotion | None, *,
    further: float = 0.0,
) -> Mesh:
    """A box that grids are in, wherever they move.

    Parameters
    ----------
    low, high : float64 (3,)
        Corners in the space of the object.
    further : float
        How far beyond these there are values.
    """
    least, most = (np.zeros(3), np.zeros(3)) if motion is None else motion.displacement()
    first, last = low - further + least, high + further + most
    corners = [(x, y, z) for z in (first[2], last[2]) for y in (first[1], last[1]) for x in (first[0], last[0])]
    return Mesh(
        key=key,
        name=name,
        vertices=np.array(corners, np.float32),
        triangles=_TRIANGLES,
        corner_normals=None,
        material_slots=np.zeros(len(_TRIANGLES), np.int32),
        texture_space=np.array([(low + high) / 2.0, (high - low) / 2.0], np.float32),
        grids=grids,
        volume_motion=motion,
    )


def when_still(scene: bpy.types.Scene) -> float:
    """Time of the shutter at which, to Cycles, what moves by its velocity is where its grids say."""
    position = read_setting(scene.render, "motion_blur_position", scene)
    return {"START": 0.0, "END": scene.render.motion_blur_shutter - 1.0}.get(position, 0.5)


def shutter_seconds(scene: bpy.types.Scene) -> float:
    """How long the shutter is open [s]."""
    return scene.render.motion_blur_shutter / (scene.render.fps / scene.render.fps_base)


def _velocity_of(context: ExportContext, volume: bpy.types.Volume, *, is_blurred: bool) -> _Velocity | None:
    """What a volume moves by while the shutter is open, None: it does not."""
    in_seconds = getattr(volume, "velocity_unit", "FRAME") == "SECOND"
    # As in Cycles: what moves by the frame does so whatever its object says, and however long the shutter is open.
    if not context.is_blurred or (in_seconds and not is_blurred):
        return None
    scale = float(getattr(volume, "velocity_scale", 1.0)) * (shutter_seconds(context.scene) if in_seconds else 1.0)
    if scale == 0.0 or not math.isfinite(scale):
        return None
    x, y, z = (getattr(volume, f"velocity_{axis}_grid", "") or f"velocity_{axis}" for axis in "xyz")
    names = tuple(dict.fromkeys(name for name in (getattr(volume, "velocity_grid", ""), "velocity") if name))
    return _Velocity(names, (x, y, z), when_still(context.scene), scale)


def _voxel_size(grid: Grid) -> float:
    """The longest edge of a voxel in the space of the object."""
    return float(np.linalg.norm(np.linalg.inv(grid.to_index[:3, :3].astype(np.float64)), axis=0).max())


def medium_density(volume: bpy.types.Volume, transform: Float32Array) -> Float32Array:
    """Factor on the density of a volume in places of these transforms, float32 (N, 4, 4): float32 (N,).

    In object space a volume keeps its opacity as it is scaled, as in Cycles.
    """
    if volume.render.space != "OBJECT":
        return np.ones(len(transform), np.float32)
    diagonal = transform[:, :3, :3].sum(axis=2, dtype=np.float64) / np.sqrt(3.0)
    return (1.0 / np.maximum(np.linalg.norm(diagonal, axis=1), 1e-30)).astype(np.float32)


def _file_of(volume: bpy.types.Volume) -> tuple[str, Hashable]:
    """The file of the frame, '' of a volume that is in memory only, and what tells whether it has changed."""
    path = bpy.path.abspath(volume.grids.frame_filepath) if volume.filepath else ""
    try:
        status = Path(path).stat() if path else None
    except OSError:
        status = None
    if status is None:
        return "", None
    return path, (path, status.st_size, status.st_mtime_ns)


def _read_grids(
    context: ExportContext, module: Any, volume: bpy.types.Volume, owner: bpy.types.Object, path: str,
    request: AttributeRequest, velocity: _Velocity | None,
) -> _Grids:
    """The grids that are asked for, and that of the velocity."""
    with tempfile.TemporaryDirectory() as folder:
        if not path:
            path = str(Path(folder, "volume.vdb"))
            if not volume.grids.save(path):
                context.notice(owner.name, "its grids cannot be read", _LEFT_OUT)
                return _Grids()
        try:
            found, _metadata = module.readAll(path)
        except Exception as error:
            context.notice(owner.name, f"its file {path} cannot be read: {error}", _LEFT_OUT)
            return _Grids()
    names = [grid.name for grid in found]
    result = _Grids()
    for grid in found:
        if grid.name not in request.names or grid.name in result.grids:
            continue
        read = _read_grid(context, grid, f"{owner.name} / {grid.name}", (path, context.cache.new_version()))
        if read is not None:
            result.grids[grid.name], box = read
            result.boxes.append(box)
    if not result.grids:
        wanted = ", ".join(sorted(name for name in request.names if name)) or "none"
        problem = f"none of its grids ({', '.join(names) or 'it has none'}) is one that its material reads ({wanted})"
        context.notice(owner.name, problem, _LEFT_OUT)
    elif velocity is not None:
        result.motion = _read_motion(context, {grid.name: grid for grid in reversed(found)}, owner, path, velocity)
    return result


def _read_motion(
    context: ExportContext, found: dict[str, Any], owner: bpy.types.Object, path: str, velocity: _Velocity
) -> VolumeMotion | None:
    """The grid of a volume's velocity, made of those of three numbers where there is none of vectors."""
    vectors = next((found[name] for name in velocity.names if name in found), None)
    parts = [vectors] if vectors is not None else [found[name] for name in velocity.axes if name in found]
    if vectors is None and len(parts) < 3:
        return None
    subject = f"{owner.name} / {parts[0].name}"
    kinds = _SCALARS if vectors is None else _VECTORS
    if any(type(grid).__name__ not in kinds for grid in parts):
        context.notice(subject, f"velocities of type {parts[0].valueTypeName} are not supported", "it stands still")
        return None
    read = _read_grid(context, parts[0], subject, (path, context.cache.new_version()), others=parts[1:])
    return None if read is None else VolumeMotion(read[0], velocity.still, velocity.scale)


def _voxel_bounds(grids: Sequence[Any]) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Indices of the first and the last of the voxels of grids, along each axis."""
    bounds = [grid.evalActiveVoxelBoundingBox() for grid in grids if grid.activeVoxelCount() > 0]
    first, last = (np.array([bound[end] for bound in bounds]) for end in (0, 1))
    return tuple(first.min(axis=0).tolist()), tuple(last.max(axis=0).tolist())


def _read_grid(
    context: ExportContext, grid: Any, subject: str, key: Hashable, others: Sequence[Any] = ()
) -> tuple[Grid, np.ndarray] | None:
    """A grid, and the corners of the box around it in the space of the object, float64 (8, 3).

    Parameters
    ----------
    others : sequence
        Further components of the values, one a grid, of numbers as the first is.
    """
    kind = type(grid).__name__
    if kind not in (*_SCALARS, *_VECTORS):
        context.notice(subject, f"grids of type {grid.valueTypeName} are not supported", "as if it were not there")
        return None
    if all(part.activeVoxelCount() == 0 for part in (grid, *others)):
        context.notice(subject, "the grid is empty", "as if it were not there")
        return None
    to_object = np.eye(4)
    origin = np.array(grid.transform.indexToWorld((0.0, 0.0, 0.0)))
    for axis, unit in enumerate(((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))):
        to_object[:3, axis] = np.array(grid.transform.indexToWorld(unit)) - origin
    to_object[:3, 3] = origin
    if not np.isfinite(to_object).all() or np.linalg.det(to_object) == 0.0:
        context.notice(subject, "the grid's transform cannot be inverted", "as if it were not there")
        return None
    first, last = _voxel_bounds([grid, *others])
    if tile_count(first, last) > MOST_TILES:
        size = " x ".join(str(int(b) - int(a) + 1) for a, b in zip(first, last, strict=True))
        context.notice(subject, f"its voxels lie too far apart: in a box of {size}", "as if it were not there")
        return None
    is_scalar = kind in _SCALARS

    def read(start: tuple[int, ...], shape: tuple[int, ...]) -> np.ndarray:
        context.check_cancel()
        values = np.zeros(shape if is_scalar else (*shape, 3), np.float32)
        grid.copyToArray(values, ijk=start)
        if not is_scalar:
            return values
        components = [values]
        for other in others:
            components.append(np.zeros(shape, np.float32))
            other.copyToArray(components[-1], ijk=start)
        return np.stack(components, axis=-1)

    packed, wrong = pack_grid(key, np.linalg.inv(to_object), first, last, read)
    if wrong.not_finite:
        context.notice(subject, f"{wrong.not_finite} voxels are no numbers", "0")
    if wrong.negative and grid.name == "density":
        context.notice(subject, f"{wrong.negative} voxels have a negative density", "nothing is there")
    if len(packed.voxels) == 0:
        context.notice(subject, "the grid is 0 everywhere", "as if it were not there")
        return None
    # Values fade to 0 within a voxel of the last one.
    low, high = np.array(first) - 1.0, np.array(last) + 1.0
    corners = np.array([(x, y, z) for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])
    return packed, corners @ to_object[:3, :3].T + to_object[:3, 3]
