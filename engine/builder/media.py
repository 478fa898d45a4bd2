# SPDX-License-Identifier: GPL-3.0-or-later
"""Media of compiled programs as arrays, and where in a scene there are any."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from engine.builder.majorants import KeptBounds, build_majorants, filled_by_media
from engine.kernels.bsdf import BsdfTables
from engine.kernels.surface import RELATIVE_ERROR
from engine.scene.description import Mesh
from engine.shaders.compiled_program import CompiledProgram
from engine.state import media as layout
from engine.state.geometry import INSTANCE_MATERIAL_OFFSET, INSTANCE_MESH, GeometryArrays
from engine.state.media import MediaArrays
from engine.state.shaders import ShaderArrays

#: Mean free paths that a ray may skip at a surface: about so much of what dense media scatter back is lost.
_MOST_SKIPPED = 1e-3


@dataclass(frozen=True)
class SceneMedia:
    """A scene's media.

    has_inside : bool (N,), whether there is a medium inside of an instance
    is_boundary : bool (N,), whether all of an instance's surface is a boundary of media and nothing else
    is_dense : whether what rays skip at surfaces matters; see `find_gaps` of `engine.wavefront.media_stacks`
    """

    arrays: MediaArrays
    has_inside: np.ndarray
    is_boundary: np.ndarray
    is_dense: bool

    @property
    def is_used(self) -> bool:
        """Whether paths can be in a medium."""
        return bool(self.arrays.world[0] >= 0 or self.has_inside.any())

    @property
    def emits(self) -> bool:
        """Whether some medium emits light."""
        emission = self.arrays.media[:, layout.MEDIUM_EMISSION : layout.MEDIUM_EMISSION + 3]
        # It is not known of media that vary, so these count.
        return self.is_used and (self.varies or bool(emission.any()))

    @property
    def varies(self) -> bool:
        """Whether paths can be in a medium that varies in space."""
        return bool(self.arrays.majorants.first[-1])


def _of_slots(wanted: np.ndarray, geometry: GeometryArrays, slot_counts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Whether any, and whether all, of the programs in an instance's slots are wanted: two bool (N,)."""
    table = geometry.instance_table
    if not len(table):
        return np.zeros(0, bool), np.zeros(0, bool)
    of_slot = wanted[geometry.instance_materials]
    sums = np.concatenate([[0], np.cumsum(of_slot)])
    starts = table[:, INSTANCE_MATERIAL_OFFSET].astype(np.int64)
    ends = np.minimum(starts + slot_counts[table[:, INSTANCE_MESH]], len(of_slot))
    counts = sums[ends] - sums[starts]
    return counts > 0, (counts > 0) & (counts == ends - starts)


def _largest_coordinate(geometry: GeometryArrays, meshes: Sequence[Mesh]) -> float:
    """At most how far from the origin anything is, along each axis [m]; of what moves, at one of the times."""
    reach = np.array([np.abs(mesh.vertices).max(initial=0.0) for mesh in meshes] or [0.0])
    placed = np.abs(geometry.transforms.reshape(-1, 3, 4))
    if not len(placed):
        return 0.0
    coordinates = placed[:, :, :3].sum(axis=2) * reach[geometry.instance_table[:, INSTANCE_MESH], None]
    return float(np.nanmax(coordinates + placed[:, :, 3]))


def _is_dense(arrays: MediaArrays, geometry: GeometryArrays, meshes: Sequence[Mesh]) -> bool:
    """Whether a ray may skip too much of a medium at a surface."""
    extinction = max(arrays.media[:, layout.MEDIUM_MAJORANT].max(), arrays.majorants.values.max(initial=0.0))
    if not extinction > 0.0:
        return False
    return bool(extinction * RELATIVE_ERROR * _largest_coordinate(geometry, meshes) > _MOST_SKIPPED)


def build_media(
    compiled: Sequence[CompiledProgram], world_program: int, geometry: GeometryArrays, slot_counts: np.ndarray,
    meshes: Sequence[Mesh], shaders: ShaderArrays, tables: BsdfTables, kept: KeptBounds,
) -> SceneMedia:
    """Flatten the media of a scene's programs.

    Parameters
    ----------
    compiled : sequence of CompiledProgram
        In the order of their numbers.
    world_program : int
        -1 = none.
    slot_counts : int (M,)
        Material slots of every mesh.
    meshes, shaders, tables
        Meshes, programs and tables of media that vary, to find how dense these are at each place.
    kept : KeptBounds
        Updated.
    """
    of_program = np.full(max(len(compiled), 1), -1, np.int32)
    rows: list[tuple[float, ...]] = []
    lobes: list[tuple[float, ...]] = []
    first_lobe = [0]
    programs: list[int] = []
    for number, program in enumerate(compiled):
        medium = program.medium
        if medium is None:
            continue
        of_program[number] = len(rows)
        total = np.zeros(3)
        for lobe in medium.lobes:
            total += lobe.scattering
            lobes.append((*lobe.scattering, lobe.g, lobe.alpha, lobe.delta))
        extinction = float((total + medium.absorption).max())
        rows.append((*medium.absorption, *total.tolist(), *medium.emission, extinction))
        programs.append(number if medium.varies else -1)
        first_lobe.append(len(lobes))
    has_medium, is_boundary = of_program >= 0, np.zeros(len(of_program), bool)
    is_boundary[: len(compiled)] = [program.is_boundary for program in compiled]
    varies = np.array(programs or [-1], np.int32) >= 0
    filled = list(filled_by_media(of_program, varies, world_program, geometry, meshes, slot_counts)) if rows else []
    arrays = MediaArrays(
        media=np.array(rows or [(0.0,) * layout.MEDIUM_WIDTH], np.float32),
        program=np.array(programs or [-1], np.int32),
        lobes=np.array(lobes or [(0.0,) * layout.LOBE_WIDTH], np.float32),
        first_lobe=np.array(first_lobe, np.int32),
        of_program=of_program,
        world=np.array([of_program[world_program] if world_program >= 0 else -1], np.int32),
        majorants=build_majorants(filled, compiled, geometry, shaders, tables, kept),
    )
    inside, _ = _of_slots(has_medium, geometry, slot_counts)
    _, boundary = _of_slots(has_medium & is_boundary, geometry, slot_counts)
    return SceneMedia(arrays, inside, boundary, _is_dense(arrays, geometry, meshes))
