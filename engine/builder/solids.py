# SPDX-License-Identifier: GPL-3.0-or-later
"""Which meshes enclose a space: only what is within it meets them from the other side.

Over a closed surface the integral of x_i n_j is the volume where i = j, and 0 elsewhere (divergence theorem). So no
edge has to be looked at. Vertices that lie on each other, or a hole far smaller than the mesh, make no difference.
"""

from __future__ import annotations

from engine.array_types import Float32Array, Int32Array, Uint32Array
from engine.runtime.jit import kernel
from engine.state.geometry import (
    MESH_FIRST_TRIANGLE,
    MESH_FIRST_VERTEX,
    MESH_SHAPE,
    MESH_SOLID,
    MESH_TRIANGLE_COUNT,
    SHAPE_TRIANGLES,
)

#: By how much of the volume the integrals may differ.
_MOST_OFF = 0.01


@kernel
def _is_solid(vertices, triangles, first, count, origin):
    """Whether triangles enclose a space: bool.

    Parameters
    ----------
    vertices : float32 (V, 3); triangles : uint32 (T, 3)
    first, count : int, rows of these
    origin : int, a row of vertices near them
    """
    xx = xy = xz = yx = yy = yz = zx = zy = zz = 0.0
    sum_x = sum_y = sum_z = extent = 0.0
    o0, o1, o2 = float(vertices[origin, 0]), float(vertices[origin, 1]), float(vertices[origin, 2])
    for row in range(first, first + count):
        a, b, c = triangles[row, 0], triangles[row, 1], triangles[row, 2]
        a0, a1, a2 = vertices[a, 0] - o0, vertices[a, 1] - o1, vertices[a, 2] - o2
        b0, b1, b2 = vertices[b, 0] - o0, vertices[b, 1] - o1, vertices[b, 2] - o2
        c0, c1, c2 = vertices[c, 0] - o0, vertices[c, 1] - o1, vertices[c, 2] - o2
        u0, u1, u2, v0, v1, v2 = b0 - a0, b1 - a1, b2 - a2, c0 - a0, c1 - a1, c2 - a2
        # Twice the area times the normal, and three times the middle.
        n0, n1, n2 = u1 * v2 - u2 * v1, u2 * v0 - u0 * v2, u0 * v1 - u1 * v0
        m0, m1, m2 = a0 + b0 + c0, a1 + b1 + c1, a2 + b2 + c2
        sum_x, sum_y, sum_z = sum_x + n0, sum_y + n1, sum_z + n2
        xx, xy, xz = xx + m0 * n0, xy + m0 * n1, xz + m0 * n2
        yx, yy, yz = yx + m1 * n0, yy + m1 * n1, yz + m1 * n2
        zx, zy, zz = zx + m2 * n0, zy + m2 * n1, zz + m2 * n2
        extent = max(extent, abs(m0), abs(m1), abs(m2))
    volume = (xx + yy + zz) / 3.0
    most = _MOST_OFF * abs(volume)
    mixed = max(abs(xy), abs(xz), abs(yx), abs(yz), abs(zx), abs(zy))
    uneven = max(abs(xx - volume), abs(yy - volume), abs(zz - volume))
    # Where the sum of the normals is not 0 either, the others depend on the origin.
    return max(mixed, uneven, extent * max(abs(sum_x), abs(sum_y), abs(sum_z))) < most


def mark_solids(mesh_table: Int32Array, vertices: Float32Array, triangles: Uint32Array) -> None:
    """Fill MESH_SOLID.

    Parameters
    ----------
    mesh_table : int32 (M, MESH_WIDTH), with all else about triangles
    vertices : float32 (V, 3); triangles : uint32 (T, 3), of all meshes
    """
    for row in mesh_table:
        if row[MESH_SHAPE] == SHAPE_TRIANGLES and row[MESH_TRIANGLE_COUNT]:
            first, count, origin = (int(row[k]) for k in (MESH_FIRST_TRIANGLE, MESH_TRIANGLE_COUNT, MESH_FIRST_VERTEX))
            row[MESH_SOLID] = _is_solid(vertices, triangles, first, count, origin)
