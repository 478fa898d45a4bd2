# SPDX-License-Identifier: GPL-3.0-or-later
"""Running programs at compile time: single instructions on constants, and whole programs on a stand-in surface."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np

from engine.array_types import Float32Array
from engine.kernels.bsdf.tables import load_tables
from engine.kernels.shader.interpreter import evaluate_shaders
from engine.shaders.lamp_facts import LampFacts
from engine.shaders.program import Constant, Instruction
from engine.state import geometry as layout
from engine.state.geometry import GeometryArrays
from engine.state.grids import no_grids
from engine.state.lanes import (
    POINT_INSTANCE,
    POINT_LIGHT,
    POINT_NG,
    POINT_NS,
    POINT_P,
    POINT_PROGRAM,
    POINT_RAY_FLAGS,
    POINT_RAY_LENGTH,
    POINT_TRIANGLE,
    POINT_U,
    POINT_V,
    POINT_WO,
    RAY_DIFFUSE,
    RAY_EMISSION,
    RAY_REFLECT,
    Closures,
    ShadePoints,
    allocate_closures,
    allocate_points,
)
from engine.state.shaders import (
    FIRST_REGISTER,
    IMAGE_WIDTH,
    MODE_CLOSURES,
    MODE_EMISSION,
    PROGRAM_END,
    PROGRAM_WIDTH,
    VALUE_WIDTH,
    ShaderArrays,
    allocate_memory,
    identity_camera,
)

_SIDE = 16


def stand_in_geometry(attribute_count: int) -> GeometryArrays:
    """A unit square of two triangles; every attribute is its UV map (u, v, 0, 1)."""
    vertices = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 0]], np.float32)
    triangles = np.array([[0, 1, 2], [0, 2, 3]], np.uint32)
    corners = vertices[triangles.ravel()].copy()
    data = np.concatenate([corners[:, :2], np.zeros((6, 1)), np.ones((6, 1))], axis=1).astype(np.float32)
    mesh = np.zeros((1, layout.MESH_WIDTH), np.int32)
    mesh[0, layout.MESH_TRIANGLE_COUNT] = 2
    mesh[0, layout.MESH_VERTEX_COUNT] = 4
    without = [layout.MESH_FIRST_NORMAL, layout.MESH_MOTION, layout.MESH_UNDEFORMED, layout.MESH_FIRST_RADIUS]
    mesh[0, without] = -1
    count = max(attribute_count, 1)
    table = np.tile(np.array([layout.DOMAIN_CORNER, 4, 0], np.int64), (count, 1))
    identity = np.eye(4, dtype=np.float32)[:3].reshape(1, 12).copy()
    return GeometryArrays(
        vertices=vertices,
        triangles=triangles,
        corner_normals=np.zeros((1, 9), np.float32),
        material_slots=np.zeros(2, np.int32),
        mesh_table=mesh,
        instance_table=np.zeros((1, layout.INSTANCE_WIDTH), np.int32),
        transforms=identity,
        inverses=identity.copy(),
        instance_values=np.full((1, layout.VALUE_WIDTH), 0.5, np.float32),
        instance_materials=np.zeros(1, np.int32),
        attribute_table=table,
        attribute_data=np.ascontiguousarray(data.ravel()),
        radii=np.zeros(1, np.float32),
        texture_space=np.array([[0.5, 0.5, 0.0, 0.5, 0.5, 0.5]], np.float32),
        attribute_count=np.array([count], np.int64),
        motion_table=np.zeros((1, layout.MOTION_WIDTH), np.int32),
        motion_transforms=np.zeros((1, 12), np.float32),
        grids=no_grids(),
    )


@cache
def _one_lane() -> tuple[GeometryArrays, ShadePoints, Closures, np.ndarray]:
    points = allocate_points(1)
    points.integer[0, POINT_INSTANCE] = -1
    return stand_in_geometry(1), points, allocate_closures(1), np.zeros(1, np.int32)


def fold(instruction: Instruction, tables: Float32Array) -> tuple[Constant, ...]:
    """Outputs of an instruction whose inputs are all constants, computed by its own kernel."""
    line = [instruction.opcode, 0]
    at = FIRST_REGISTER
    outputs = []
    for width in instruction.output_widths:
        outputs.append(at)
        at += width
    line += outputs
    register_count = at
    values: list[float] = []
    for value in instruction.inputs:
        assert isinstance(value, Constant)
        line.append(register_count + len(values))
        values.extend(value.value)
    line += instruction.immediates
    line[1] = len(line)
    programs = np.zeros((1, PROGRAM_WIDTH), np.int32)
    programs[0, PROGRAM_END] = len(line)
    shaders = ShaderArrays(
        code=np.array(line, np.int32),
        constants=np.array(values or [0.0], np.float32),
        programs=programs,
        program_values=np.zeros((1, VALUE_WIDTH), np.float32),
        program_pass_index=np.zeros(1, np.float32),
        program_dispersion=np.zeros(1, np.float32),
        program_temperature=np.zeros(1, np.float32),
        images=np.zeros((1, IMAGE_WIDTH), np.int64),
        pixels_byte=np.zeros(4, np.uint8),
        pixels_float=np.zeros(4, np.float32),
        tables=tables,
        camera=identity_camera(),
        register_count=np.array([register_count], np.int64),
    )
    memory = allocate_memory(shaders)
    geometry, points, closures, lanes = _one_lane()
    evaluate_shaders(shaders, geometry, load_tables(), points, closures, lanes, 1, memory, MODE_CLOSURES)
    return tuple(
        Constant(tuple(float(x) for x in memory.floats[slot : slot + width]))
        for slot, width in zip(outputs, instruction.output_widths, strict=True)
    )


def estimate_emission(
    shaders: ShaderArrays, programs: Sequence[int], owners: Sequence[tuple[str, LampFacts | None]], attribute_count: int
) -> Float32Array:
    """Mean radiance of each program as diffuse light rays see it, for choosing among lights, not for shading.

    Materials are seen from the front over a unit square whose every attribute is its UV map; worlds and lights over
    all directions, and lights over all places of theirs. `owners` are `ProgramSource.kind` and `lamp`.
    """
    sample_count = _SIDE * _SIDE
    points = allocate_points(sample_count)
    closures = allocate_closures(sample_count)
    lanes = np.arange(sample_count, dtype=np.int32)
    geometry = stand_in_geometry(attribute_count)
    memory = allocate_memory(shaders)
    result = np.zeros((len(programs), 3), np.float32)
    for row, (program, (kind, lamp)) in enumerate(zip(programs, owners, strict=True)):
        if kind == "MATERIAL":
            _spread_over_square(points)
        else:
            _spread_over_sphere(points)
        if kind == "LIGHT":
            _spread_over_lamp(points, lamp)
        points.integer[:, POINT_RAY_FLAGS] = RAY_DIFFUSE | RAY_REFLECT | RAY_EMISSION
        points.integer[:, POINT_LIGHT] = 0 if kind == "LIGHT" else -1
        points.integer[:, POINT_PROGRAM] = program
        evaluate_shaders(shaders, geometry, load_tables(), points, closures, lanes, sample_count, memory, MODE_EMISSION)
        emission = np.nan_to_num(closures.emission[:, :3].astype(np.float64), posinf=0.0, neginf=0.0)
        result[row] = np.maximum(emission, 0.0).mean(axis=0)
    return result


def _grid() -> tuple[np.ndarray, np.ndarray]:
    steps = (np.arange(_SIDE, dtype=np.float32) + np.float32(0.5)) / np.float32(_SIDE)
    x, y = np.meshgrid(steps, steps)
    return x.ravel(), y.ravel()


def _spread_over_square(points: ShadePoints) -> None:
    x, y = _grid()
    real, integer = points.real, points.integer
    real[:] = 0.0
    real[:, POINT_P] = x
    real[:, POINT_P + 1] = y
    for column in (POINT_WO, POINT_NG, POINT_NS):
        real[:, column + 2] = 1.0
    # Triangle 0 has corners 00, 10, 11: x = u + v, y = v. Triangle 1 has 00, 11, 01: x = u, y = u + v.
    lower = y <= x
    real[:, POINT_U] = np.where(lower, x - y, x)
    real[:, POINT_V] = np.where(lower, y, y - x)
    real[:, POINT_RAY_LENGTH] = 1.0
    integer[:] = 0
    integer[:, POINT_TRIANGLE] = np.where(lower, 0, 1)


def _spread_over_lamp(points: ShadePoints, lamp: LampFacts | None) -> None:
    """From points over a sphere to those of a lamp."""
    x, y = _grid()
    real = points.real
    # (1 - u - v, u) are its coordinates.
    real[:, POINT_U], real[:, POINT_V] = y, 1.0 - x - y
    if lamp is not None:
        real[:, POINT_P : POINT_P + 3] = np.array(lamp.middle) + real[:, POINT_P : POINT_P + 3] @ np.array(lamp.reach)


def _spread_over_sphere(points: ShadePoints) -> None:
    x, y = _grid()
    z = 2.0 * y - 1.0
    r = np.sqrt(1.0 - z * z)
    direction = np.stack([r * np.cos(2.0 * np.pi * x), r * np.sin(2.0 * np.pi * x), z], axis=1)
    points.real[:] = 0.0
    points.real[:, POINT_P : POINT_P + 3] = direction
    for column in (POINT_WO, POINT_NG, POINT_NS):
        points.real[:, column : column + 3] = -direction
    points.real[:, POINT_RAY_LENGTH] = 1.0
    points.integer[:] = 0
    points.integer[:, POINT_INSTANCE] = -1
