# SPDX-License-Identifier: GPL-3.0-or-later
"""Positions of the vertices of evaluated meshes, as they are and as they were before deformation."""

from __future__ import annotations

import bpy
import numpy as np

from engine.array_types import Float32Array


def read_positions(mesh: bpy.types.Mesh) -> Float32Array:
    """Positions of the vertices, float32 (V, 3)."""
    flat = np.empty(len(mesh.vertices) * 3, np.float32)
    position = mesh.attributes.get("position")
    if position is not None:
        position.data.foreach_get("vector", flat)
    else:
        mesh.vertices.foreach_get("co", flat)
    return flat.reshape(-1, 3)


def read_undeformed(mesh: bpy.types.Mesh) -> Float32Array:
    """Positions before modifiers and shape keys moved the vertices, float32 (V, 3).

    Blender remembers them for final renders; in windows they are the positions as they are.
    """
    flat = np.empty(len(mesh.vertices) * 3, np.float32)
    mesh.vertices.foreach_get("undeformed_co", flat)
    return flat.reshape(-1, 3)
