# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes split where corners of a vertex part: displacement then tears them open there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from engine.scene.attribute_names import FANS, VERTEX_NORMALS
from engine.scene.description import Attribute, Mesh


def split_at_fans(mesh: Mesh) -> Mesh:
    """A mesh with a vertex for each fan, with the normals that its corners have; the same one where it has no fans."""
    fans = mesh.attributes.get(FANS)
    if fans is None or not len(mesh.triangles):
        return mesh
    corners = mesh.triangles.reshape(-1).astype(np.int64)
    wide = int(fans.data.max()) + 1
    found, first, of_corner = np.unique(
        corners * wide + fans.data[:, 0].astype(np.int64), return_index=True, return_inverse=True
    )
    vertex_of = found // wide
    attributes = {
        name: Attribute("POINT", one.data[vertex_of]) if one.domain == "POINT" else one
        for name, one in mesh.attributes.items() if name != FANS
    }  # fmt: skip
    if mesh.corner_normals is not None:
        attributes[VERTEX_NORMALS] = Attribute("POINT", mesh.corner_normals.reshape(-1, 3)[first])
    return replace(
        mesh,
        vertices=mesh.vertices[vertex_of],
        triangles=of_corner.reshape(-1, 3).astype(np.uint32),
        attributes=attributes,
        motion_vertices=None if mesh.motion_vertices is None else mesh.motion_vertices[:, vertex_of],
    )
