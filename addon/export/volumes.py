# SPDX-License-Identifier: GPL-3.0-or-later
"""Volume objects to boxes with grids of voxels, read from OpenVDB files."""

from __future__ import annotations

import tempfile
from collections.abc import Hashable
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from engine.array_types import Float32Array
from engine.scene.description import Mesh
from engine.scene.grids import MOST_TILES, Grid, pack_grid, tile_count

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


def export_volume(
    context: ExportContext, volume: bpy.types.Volume, owner: bpy.types.Object, request: AttributeRequest
) -> Mesh | None:
    """A box around the voxels of a volume, with the grids that its materials ask for; None where there are none.

    Parameters
    ----------
    volume : Volume, evaluated
    owner : Object
        Whose evaluation made it.
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
    if context.is_blurred and any(grid.name.startswith("velocity") for grid in volume.grids):
        context.notice(owner.name, "motion blur by the velocity of a volume is not supported", "it stands still")
    path, state = _file_of(volume)
    identity = (owner.original.name_full, volume.name_full, "volume")
    kept = context.cache.meshes.get(identity)
    if path and kept is not None and kept.request == (request, state):
        kept.last_used = context.cache.export_count
        return kept.mesh
    grids, boxes = _read_grids(context, module, volume, owner, path, request)
    context.check_cancel()
    if not grids:
        return None
    low, high = boxes.reshape(-1, 3).min(axis=0), boxes.reshape(-1, 3).max(axis=0)
    corners = [(x, y, z) for z in (low[2], high[2]) for y in (low[1], high[1]) for x in (low[0], high[0])]
    mesh = Mesh(
        key=(*identity, context.cache.new_version()),
        name=volume.name,
        vertices=np.array(corners, np.float32),
        triangles=_TRIANGLES,
        corner_normals=None,
        material_slots=np.zeros(len(_TRIANGLES), np.int32),
        texture_space=np.array([(low + high) / 2.0, (high - low) / 2.0], np.float32),
        grids=grids,
    )
    context.cache.meshes[identity] = CachedMesh(mesh, (request, state), context.cache.export_count)
    return mesh


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
    request: AttributeRequest,
) -> tuple[dict[str, Grid], np.ndarray]:
    """Grids by name, and the corners of the boxes around them in the space of the object: float64 (G, 8, 3)."""
    with tempfile.TemporaryDirectory() as folder:
        if not path:
            path = str(Path(folder, "volume.vdb"))
            if not volume.grids.save(path):
                context.notice(owner.name, "its grids cannot be read", _LEFT_OUT)
                return {}, np.zeros((0, 8, 3))
        try:
            found, _metadata = module.readAll(path)
        except Exception as error:
            context.notice(owner.name, f"its file {path} cannot be read: {error}", _LEFT_OUT)
            return {}, np.zeros((0, 8, 3))
    names = [grid.name for grid in found]
    grids: dict[str, Grid] = {}
    boxes = []
    for grid in found:
        if grid.name not in request.names or grid.name in grids:
            continue
        read = _read_grid(context, grid, f"{owner.name} / {grid.name}", (path, context.cache.new_version()))
        if read is not None:
            grids[grid.name], box = read
            boxes.append(box)
    if not grids:
        wanted = ", ".join(sorted(name for name in request.names if name)) or "none"
        problem = f"none of its grids ({', '.join(names) or 'it has none'}) is one that its material reads ({wanted})"
        context.notice(owner.name, problem, _LEFT_OUT)
    return grids, np.array(boxes)


def _read_grid(context: ExportContext, grid: Any, subject: str, key: Hashable) -> tuple[Grid, np.ndarray] | None:
    kind = type(grid).__name__
    if kind not in (*_SCALARS, *_VECTORS):
        context.notice(subject, f"grids of type {grid.valueTypeName} are not supported", "as if it were not there")
        return None
    if grid.activeVoxelCount() == 0:
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
    first, last = grid.evalActiveVoxelBoundingBox()
    if tile_count(first, last) > MOST_TILES:
        size = " x ".join(str(int(b) - int(a) + 1) for a, b in zip(first, last, strict=True))
        context.notice(subject, f"its voxels lie too far apart: in a box of {size}", "as if it were not there")
        return None
    is_scalar = kind in _SCALARS

    def read(start: tuple[int, ...], shape: tuple[int, ...]) -> np.ndarray:
        context.check_cancel()
        values = np.zeros(shape if is_scalar else (*shape, 3), np.float32)
        grid.copyToArray(values, ijk=start)
        return values[..., None] if is_scalar else values

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
