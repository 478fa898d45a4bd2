# SPDX-License-Identifier: GPL-3.0-or-later
"""Fetching ahead of time what is read of the triangles that rays have met."""

import numpy as np

from engine.kernels.prefetch import prefetch
from engine.runtime.jit import kernel
from engine.state.geometry import INSTANCE_MESH, MESH_FIRST_NORMAL, MESH_FIRST_TRIANGLE

#: How many lanes ahead hits are asked for, then their triangles, and then their vertices: memory is that much slower
#: than the stage.
HITS_AHEAD = 12
TRIANGLES_AHEAD = 8
VERTICES_AHEAD = 4


@kernel
def ask_for_triangle(geometry, paths, lane):
    """Prefetch what `prepare_point` will read of a hit, but for the vertices."""
    instance = paths.hit_instance[lane]
    if instance >= 0:
        triangle = np.int64(paths.hit_triangle[lane])
        prefetch(geometry.triangles, triangle)
        prefetch(geometry.material_slots, triangle)
        mesh = geometry.instance_table[instance, INSTANCE_MESH]
        first_normal = geometry.mesh_table[mesh, MESH_FIRST_NORMAL]
        if first_normal >= 0:
            prefetch(geometry.corner_normals, first_normal + triangle - geometry.mesh_table[mesh, MESH_FIRST_TRIANGLE])


@kernel
def ask_for_vertices(geometry, paths, lane):
    """Prefetch the vertices of a hit."""
    if paths.hit_instance[lane] >= 0:
        triangle = paths.hit_triangle[lane]
        for corner in range(3):
            prefetch(geometry.vertices, np.int64(geometry.triangles[triangle, corner]))
