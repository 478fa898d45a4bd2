# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether triangles lie in one place: in one plane, up to rounding, and over each other by more than an edge.

`enclose` and `compare` are for a library that looks for pairs of boxes which meet (`engine.accel.visit_pairs`). Both
get the address of a task, int64 words: the addresses of the scene's vertices and of further ones, float32 (N, 3), how
many of the former there are, and the addresses of the triangles, uint32 (P, 3), and of what is found, uint32 (P,).
"""

import math

from engine.kernels.addresses import lower_half, read_float, read_half, read_word, write_float
from engine.kernels.surface import RELATIVE_ERROR
from engine.kernels.vector import absolute, cross, dot, subtract
from engine.runtime.jit import kernel

# Bytes of a task.
_VERTICES, _FURTHER, _VERTEX_COUNT, _TRIANGLES, _FOUND = 0, 8, 16, 24, 32
#: Words of a task.
TASK_WORDS = 5
_ROW_BYTES, _NUMBER_BYTES = 12, 4
# Bytes of an RTCBoundsFunctionArguments and of an RTCCollision.
_BOUNDS_TASK, _BOUNDS_NUMBER, _BOUNDS_BOX, _BOX_UPPER = 0, 8, 16, 16
_PAIR_BYTES, _PAIR_FIRST, _PAIR_SECOND = 16, 4, 12
#: How far apart what counts as one plane may be, in rounding errors of a point: rays start off a surface by one, end
#: before a light by two, and errors are those of both points.
_REACH = 4.0
#: By how much triangles overlap at least, in the same errors.
_LEAST_OVERLAP = 8.0
#: Least squared cosine between normals: that much smaller triangles may be turned by rounding.
_LEAST_COSINE_SQUARED = 0.75


@kernel(float64_literals=True)
def _corner(task, number, k):
    """Corner k of a triangle, 3 float64."""
    index = read_half(read_word(task, _TRIANGLES), number * _ROW_BYTES + k * _NUMBER_BYTES)
    address, known = read_word(task, _VERTICES), read_word(task, _VERTEX_COUNT)
    if index >= known:
        address, index = read_word(task, _FURTHER), index - known
    row = index * _ROW_BYTES
    return 1.0 * read_float(address, row), 1.0 * read_float(address, row + 4), 1.0 * read_float(address, row + 8)


@kernel(float64_literals=True)
def _error(a, b, c):
    """Bound on the rounding error of a point on a triangle."""
    a, b, c = absolute(a), absolute(b), absolute(c)
    return RELATIVE_ERROR * max(a[0], a[1], a[2], b[0], b[1], b[2], c[0], c[1], c[2])


@kernel(called_by_c=True, float64_literals=True)
def enclose(arguments):
    """Give the box around a triangle, wide enough for what lies in its plane up to rounding."""
    task, number = read_word(arguments, _BOUNDS_TASK), read_half(arguments, _BOUNDS_NUMBER)
    box = read_word(arguments, _BOUNDS_BOX)
    a, b, c = _corner(task, number, 0), _corner(task, number, 1), _corner(task, number, 2)
    reach = _REACH * _error(a, b, c)
    for k in range(3):
        write_float(box, 4 * k, min(a[k], b[k], c[k]) - reach)
        write_float(box, _BOX_UPPER + 4 * k, max(a[k], b[k], c[k]) + reach)


@kernel(float64_literals=True)
def _are_apart(ax, ay, bx, by, cx, cy, dx, dy, ex, ey, fx, fy, least):
    """Whether one of the edges of triangle a, b, c, in a plane, has triangle d, e, f beyond it, or nearly so."""
    for _ in range(3):
        nx, ny = by - ay, ax - bx
        inside = (cx - ax) * nx + (cy - ay) * ny
        d, e, f = (dx - ax) * nx + (dy - ay) * ny, (ex - ax) * nx + (ey - ay) * ny, (fx - ax) * nx + (fy - ay) * ny
        depth = max(d, e, f) if inside > 0.0 else -min(d, e, f)
        if depth <= least * math.sqrt(nx * nx + ny * ny):
            return True
        ax, ay, bx, by, cx, cy = bx, by, cx, cy, ax, ay
    return False


@kernel(float64_literals=True)
def _flat(n, p):
    """A point without the coordinate along which a normal is longest."""
    x, y, z = absolute(n)
    if x >= y and x >= z:
        return p[1], p[2]
    return (p[2], p[0]) if y >= z else (p[0], p[1])


@kernel(float64_literals=True)
def _share_place(a0, a1, a2, b0, b1, b2):
    """Whether two triangles lie in one place."""
    n, m = cross(subtract(a1, a0), subtract(a2, a0)), cross(subtract(b1, b0), subtract(b2, b0))
    nn, mm, nm = dot(n, n), dot(m, m), dot(n, m)
    if not (nn > 0.0 and mm > 0.0) or nm * nm < _LEAST_COSINE_SQUARED * nn * mm:
        return False
    if nn < mm:
        a0, a1, a2, b0, b1, b2 = b0, b1, b2, a0, a1, a2
        n, nn = m, mm
    error = max(_error(a0, a1, a2), _error(b0, b1, b2))
    farthest = max(abs(dot(subtract(b0, a0), n)), abs(dot(subtract(b1, a0), n)), abs(dot(subtract(b2, a0), n)))
    reach = _REACH * error
    if farthest * farthest > reach * reach * nn:
        return False
    (ax, ay), (bx, by), (cx, cy) = _flat(n, a0), _flat(n, a1), _flat(n, a2)
    (dx, dy), (ex, ey), (fx, fy) = _flat(n, b0), _flat(n, b1), _flat(n, b2)
    least = _LEAST_OVERLAP * error
    return not (
        _are_apart(ax, ay, bx, by, cx, cy, dx, dy, ex, ey, fx, fy, least)
        or _are_apart(dx, dy, ex, ey, fx, fy, ax, ay, bx, by, cx, cy, least)
    )


@kernel(called_by_c=True, float64_literals=True)
def compare(task, pairs, count):
    """Note of pairs of triangles that lie in one place, at each of both, the least number of such another one."""
    found = read_word(task, _FOUND)
    for k in range(count):
        pair = k * _PAIR_BYTES
        first, second = read_half(pairs, pair + _PAIR_FIRST), read_half(pairs, pair + _PAIR_SECOND)
        if first != second and _share_place(
            _corner(task, first, 0), _corner(task, first, 1), _corner(task, first, 2),
            _corner(task, second, 0), _corner(task, second, 1), _corner(task, second, 2),
        ):
            lower_half(found, first * _NUMBER_BYTES, second)
            lower_half(found, second * _NUMBER_BYTES, first)
