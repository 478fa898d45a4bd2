# SPDX-License-Identifier: GPL-3.0-or-later
"""Programs of media that vary in space, looked up at points of what they fill."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from engine.array_types import Float32Array
from engine.builder.point_batches import PointBatches
from engine.kernels.bsdf import BsdfTables
from engine.kernels.shader import ops_input
from engine.kernels.shader.light_path import LIGHT_PATH_LENGTH
from engine.scene.grids import Grid
from engine.shaders.compiled_program import CompiledProgram
from engine.state import geometry as geometry_layout
from engine.state import lanes as lane_layout
from engine.state.geometry import GeometryArrays
from engine.state.lanes import CLOSURE_WEIGHT
from engine.state.media import WORLD
from engine.state.shaders import MODE_MEDIUM, ShaderArrays

#: Kinds of rays that a program may tell apart.
_RAY_KINDS = (
    lane_layout.RAY_CAMERA, lane_layout.RAY_DIFFUSE | lane_layout.RAY_REFLECT,
    lane_layout.RAY_GLOSSY | lane_layout.RAY_REFLECT, lane_layout.RAY_TRANSMIT, lane_layout.RAY_VOLUME,
    lane_layout.RAY_SHADOW,
)  # fmt: skip
#: Depths that a program may be told: what it makes of those in between is no larger, if it grows or falls steadily.
_RAY_DEPTHS = (0, 1, 2, 4, 12)
_POINT_DEPTHS = [
    lane_layout.POINT_PATH_DEPTH, lane_layout.POINT_DIFFUSE_DEPTH, lane_layout.POINT_GLOSSY_DEPTH,
    lane_layout.POINT_TRANSMISSION_DEPTH, lane_layout.POINT_TRANSPARENT_DEPTH,
]  # fmt: skip


class Ray(NamedTuple):
    """What a program may know of a ray: its kind (RAY_*), and all its depths."""

    flags: int
    depth: int


def rays_of(program: CompiledProgram) -> list[Ray]:
    """Rays that a medium's program may tell apart."""
    read = {
        instruction.immediates[0] for instruction in program.medium_instructions
        if instruction.opcode == ops_input.OP_LIGHT_PATH
    }  # fmt: skip
    kinds = _RAY_KINDS if any(output < LIGHT_PATH_LENGTH for output in read) else _RAY_KINDS[:1]
    depths = _RAY_DEPTHS if any(output > LIGHT_PATH_LENGTH for output in read) else _RAY_DEPTHS[:1]
    return [Ray(flags, depth) for flags in kinds for depth in depths]


@dataclass(frozen=True)
class Filled:
    """What a medium that varies fills: an instance, or the world.

    lower, upper : float64 (3,), corners in the space of the object
    to_world : float64 (S, 3, 4), at times from the shutter's opening to its closing; one where it stands still
    grids : voxels that a program may read
    displacement : float64 (2, 3), the least and the most that what is in them moves while the shutter is open, along
        each axis of the object
    """

    instance: int
    medium: int
    program: int
    lower: np.ndarray
    upper: np.ndarray
    to_world: np.ndarray
    grids: tuple[Grid, ...] = ()
    displacement: np.ndarray = field(default_factory=lambda: np.zeros((2, 3)))


class MediumLookup:
    """Looks programs up at points."""

    def __init__(self, shaders: ShaderArrays, geometry: GeometryArrays, tables: BsdfTables) -> None:
        self._read = (shaders, geometry, tables)
        self._plain: ShaderArrays | None = None
        self._batches = PointBatches(shaders)

    def __call__(
        self, filled: Filled, points: np.ndarray, times: np.ndarray, ray: Ray, *, by_lines: bool = False
    ) -> tuple[Float32Array, Float32Array]:
        """Largest channels of extinction and emission at points of the world, float32 (N,).

        `by_lines`: voxels count as they are at their centres, where cubic splines would smooth them.
        """
        if by_lines and self._plain is None:
            self._plain = _without_splines(self._read[0])
        shaders, geometry, tables = self._read
        if by_lines and self._plain is not None:
            shaders = self._plain
        batches = self._batches
        real, integer = batches.points.real, batches.points.integer
        real[:] = 0.0
        real[:, [lane_layout.POINT_WO + 2, lane_layout.POINT_NG + 2, lane_layout.POINT_NS + 2]] = 1.0
        integer[:] = 0
        integer[:, lane_layout.POINT_INSTANCE] = filled.instance
        integer[:, [lane_layout.POINT_TRIANGLE, lane_layout.POINT_LIGHT]] = -1
        integer[:, lane_layout.POINT_PROGRAM] = filled.program
        integer[:, lane_layout.POINT_RAY_FLAGS] = ray.flags
        integer[:, _POINT_DEPTHS] = ray.depth
        extinction, emission = np.empty(len(points), np.float32), np.empty(len(points), np.float32)
        places = {lane_layout.POINT_P: points, lane_layout.POINT_TIME: times}
        for part, count in batches.run(shaders, geometry, tables, MODE_MEDIUM, places):
            closures = batches.closures
            weights = closures.param[:count, :, CLOSURE_WEIGHT : CLOSURE_WEIGHT + 3]
            in_use = np.arange(weights.shape[1])[None, :, None] < closures.count[:count, None, None]
            total = closures.transparency[:count, :3] + np.where(in_use, weights, 0.0).sum(axis=1)
            extinction[part] = total.max(axis=1)
            emission[part] = closures.emission[:count, :3].max(axis=1)
        if filled.instance != WORLD:
            density = geometry.instance_values[filled.instance, geometry_layout.VALUE_DENSITY]
            extinction, emission = extinction * density, emission * density
        for values in (extinction, emission):
            np.nan_to_num(values, copy=False, nan=0.0, posinf=0.0, neginf=0.0)
        return extinction, emission


def _without_splines(shaders: ShaderArrays) -> ShaderArrays:
    """The same programs, but with voxels that are interpolated by straight lines."""
    code = shaders.code.copy()
    for start, end in shaders.programs[:, 2 * MODE_MEDIUM : 2 * MODE_MEDIUM + 2]:
        pc = int(start)
        while pc < end:
            if code[pc] == ops_input.OP_GRID:
                code[pc + 7] = 0
            pc += int(code[pc + 1])
    return shaders._replace(code=code)


def has_splines(program: CompiledProgram) -> bool:
    """Whether a medium interpolates voxels by cubic splines."""
    return any(
        instruction.opcode == ops_input.OP_GRID and instruction.immediates[1] != 0
        for instruction in program.medium_instructions
    )
