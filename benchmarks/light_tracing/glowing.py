# SPDX-License-Identifier: GPL-3.0-or-later
"""Triangles of meshes that glow evenly, on both their sides, as Blender's do."""

from __future__ import annotations

import numpy as np

from engine.builder.motion import world_corners
from engine.builder.scene import Scene
from engine.state.geometry import (
    INSTANCE_MATERIAL_OFFSET,
    INSTANCE_MESH,
    MESH_FIRST_TRIANGLE,
    MESH_SHAPE,
    MESH_TRIANGLE_COUNT,
    SHAPE_TRIANGLES,
)
from engine.state.shaders import PROGRAM_EMISSION_CONSTANT, PROGRAM_FLAGS, PROGRAM_HAS_EMISSION, VALUE_EMISSION


def glowing_triangles(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Corners, float64 (T, 3, 3), world space [m], and radiance, float64 (T, 3), of all that glows and has an area.

    Raises
    ------
    ValueError
        If something glows that is no mesh, or whose emission is not the same everywhere.
    """
    geometry, flags = scene.geometry, scene.shaders.programs[:, PROGRAM_FLAGS]
    corners, radiance = [np.zeros((0, 3, 3))], [np.zeros((0, 3))]
    for instance, table in enumerate(geometry.instance_table):
        mesh = geometry.mesh_table[table[INSTANCE_MESH]]
        rows = np.arange(mesh[MESH_FIRST_TRIANGLE], mesh[MESH_FIRST_TRIANGLE] + mesh[MESH_TRIANGLE_COUNT])
        programs = geometry.instance_materials[table[INSTANCE_MATERIAL_OFFSET] + geometry.material_slots[rows]]
        found = np.where(programs >= 0, flags[np.maximum(programs, 0)], 0)
        shines = found & PROGRAM_HAS_EMISSION != 0
        if not shines.any():
            continue
        if mesh[MESH_SHAPE] != SHAPE_TRIANGLES:
            raise ValueError("curves or points emit light: photons are traced for meshes that do")
        if not (found[shines] & PROGRAM_EMISSION_CONSTANT).all():
            raise ValueError("a mesh's emission varies: give it a plain Emission")
        corners.append(world_corners(geometry, instance, rows[shines]))
        radiance.append(scene.shaders.program_values[programs[shines], VALUE_EMISSION : VALUE_EMISSION + 3])
    placed, emitted = np.concatenate(corners), np.concatenate(radiance).astype(np.float64)
    across = np.cross(placed[:, 1] - placed[:, 0], placed[:, 2] - placed[:, 0])
    kept = (np.linalg.norm(across, axis=1) > 0.0) & (emitted.max(axis=1, initial=0.0) > 0.0)
    return placed[kept], emitted[kept]
