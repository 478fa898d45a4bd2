# SPDX-License-Identifier: GPL-3.0-or-later
"""Simulated smoke and fire to boxes with grids of voxels, read from the domain as the simulation has left it."""

from __future__ import annotations

import math
from collections.abc import Hashable
from dataclasses import dataclass
from typing import Any

import bpy
import numpy as np

from engine.array_types import Float32Array
from engine.scene.description import Mesh
from engine.scene.grids import Grid, VolumeMotion, pack_grid

from .context import ExportContext
from .materials import AttributeRequest
from .volumes import box_of_voxels, shutter_seconds, when_still

_LEFT_OUT = "left out of the picture"


@dataclass(frozen=True)
class Gas:
    """A domain of smoke and fire: the mesh whose texture space is filled, and its evaluated settings."""

    mesh: bpy.types.Mesh
    settings: Any


@dataclass(frozen=True)
class _Kind:
    """A grid of a domain: its property, numbers a voxel, and whether it has the voxels that noise adds."""

    source: str
    width: int = 1
    is_fine: bool = True


#: By the names that materials have for them. Velocities and heat have no finer voxels than the simulation.
_KINDS = {
    "density": _Kind("density_grid"),
    "color": _Kind("color_grid", 4),
    "flame": _Kind("flame_grid"),
    "heat": _Kind("heat_grid", is_fine=False),
    "temperature": _Kind("temperature_grid"),
    "velocity": _Kind("velocity_grid", 3, is_fine=False),
}


def gas_of(shown: bpy.types.Object) -> Any:
    """Settings of the gas that an evaluated object's mesh is but the bounds of, None: it is a mesh."""
    for modifier in shown.modifiers:
        if modifier.type == "FLUID" and modifier.fluid_type == "DOMAIN" and modifier.show_render:
            settings = modifier.domain_settings
            if settings is not None and settings.domain_type == "GAS":
                return settings
    return None


def export_gas(
    context: ExportContext, gas: Gas, owner: bpy.types.Object, request: AttributeRequest, *, is_blurred: bool
) -> Mesh | None:
    """A box around a domain's voxels, with the grids that its materials ask for; None where there is nothing.

    Parameters
    ----------
    owner : Object
        Whose evaluation made the mesh.
    is_blurred : bool
        Whether the object is seen to move while the shutter is open.
    """
    settings = gas.settings
    frame = context.scene.frame_current
    if not settings.cache_frame_start <= frame <= settings.cache_frame_end:
        context.notice(owner.name, "its simulation has nothing at this frame", _LEFT_OUT)
        return None
    middle = np.array(gas.mesh.texspace_location, np.float64)
    half = np.maximum(np.abs(np.array(gas.mesh.texspace_size, np.float64)), 1e-12)
    key: Hashable = (owner.original.name_full, "gas", context.cache.new_version())
    grids = {}
    for name in sorted(request.names & _KINDS.keys()):
        context.check_cancel()
        grid = _read_grid((key, name), _KINDS[name], settings, middle, half)
        if grid is not None:
            grids[name] = grid
    if not grids:
        wanted = ", ".join(sorted(name for name in request.names if name)) or "none"
        context.notice(owner.name, f"its simulation has nothing of what its material reads ({wanted})", _LEFT_OUT)
        return None
    motion = _motion_of(context, (key, "motion"), settings, middle, half) if is_blurred else None
    # Values fade to 0 within a voxel of the last one, whose centre lies half a voxel inside.
    voxel = 2.0 * half / np.array(settings.domain_resolution)
    further = float(voxel.max()) if request.smooth else 0.0
    mesh = box_of_voxels(
        key, gas.mesh.name, middle - half - 0.5 * voxel, middle + half + 0.5 * voxel, grids, motion, further=further
    )
    mesh.texture_space = np.array([middle, half], np.float32)
    return mesh


def _motion_of(
    context: ExportContext, key: Hashable, settings: Any, middle: np.ndarray, half: np.ndarray
) -> VolumeMotion | None:
    scale = settings.velocity_scale * shutter_seconds(context.scene)
    if scale == 0.0 or not math.isfinite(scale):
        return None
    velocity = _read_grid(key, _KINDS["velocity"], settings, middle, half)
    return None if velocity is None else VolumeMotion(velocity, when_still(context.scene), scale)


def _read_grid(key: Hashable, kind: _Kind, settings: Any, middle: np.ndarray, half: np.ndarray) -> Grid | None:
    """One of a domain's grids, over the texture space of its mesh; None: there is nothing of it."""
    size = np.array(settings.domain_resolution, np.int64)
    if kind.is_fine and settings.use_noise:
        size = size * settings.noise_scale
    values = _read_values(getattr(settings, kind.source))
    if len(values) != size.prod() * kind.width:
        return None
    # x runs fastest.
    voxels = np.ascontiguousarray(values.reshape(*size[::-1], kind.width).transpose(2, 1, 0, 3))
    voxels[(np.abs(voxels) <= settings.clipping).all(axis=3)] = 0.0
    if not voxels.any():
        return None
    to_index = np.diag([*(size / (2.0 * half)), 1.0])
    to_index[:3, 3] = (half - middle) * size / (2.0 * half) - 0.5

    def read(start: tuple[int, ...], shape: tuple[int, ...]) -> np.ndarray:
        padded = np.zeros((*shape, kind.width), np.float32)
        part = voxels[start[0] : start[0] + shape[0], : shape[1], : shape[2]]
        padded[: part.shape[0], : part.shape[1], : part.shape[2]] = part
        return padded

    first, last = (0, 0, 0), (int(size[0]) - 1, int(size[1]) - 1, int(size[2]) - 1)
    return pack_grid(key, to_index, first, last, read)[0]


def _read_values(grid: Any) -> Float32Array:
    values = np.zeros(len(grid), np.float32)
    if len(values):
        grid.foreach_get(values)
    return values
