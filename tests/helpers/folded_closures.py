# SPDX-License-Identifier: GPL-3.0-or-later
"""What tests of folded closures share: points to shade, and which instructions a program has."""

from __future__ import annotations

import numpy as np

from engine.state.lanes import POINT_NS, POINT_RAY_FLAGS, POINT_WO, RAY_DIFFUSE_ANCESTOR, ShadePoints
from engine.state.shaders import ShaderArrays
from tests.helpers.shader_harness import square_points


def opcodes_of(shaders: ShaderArrays) -> set[int]:
    """Opcodes of the first program's instructions."""
    opcodes, pc = set(), int(shaders.programs[0, 0])
    while pc < shaders.programs[0, 1]:
        opcodes.add(int(shaders.code[pc]))
        pc += int(shaders.code[pc + 1])
    return opcodes


def hemisphere_points(count: int = 500) -> ShadePoints:
    """Points of a square seen from all of the hemisphere, half of them about smooth normals up to a radian off."""
    rng = np.random.default_rng(5)
    points = square_points(rng.uniform(0.0, 1.0, (count, 2)))
    for column, slope in ((POINT_WO, 4.0), (POINT_NS, 0.3)):
        tilted = np.concatenate([rng.normal(0.0, slope, (count, 2)), np.ones((count, 1))], axis=1)
        points.real[:, column : column + 3] = tilted / np.linalg.norm(tilted, axis=1, keepdims=True)
    points.real[: count // 2, POINT_NS : POINT_NS + 3] = (0.0, 0.0, 1.0)
    points.integer[::3, POINT_RAY_FLAGS] |= RAY_DIFFUSE_ANCESTOR
    return points
