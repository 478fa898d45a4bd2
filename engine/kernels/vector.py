# SPDX-License-Identifier: GPL-3.0-or-later
"""Three-component vectors as tuples of scalars: no arrays, no allocation, all inlined."""

import math

from engine.runtime.jit import kernel


@kernel
def dot(a, b):
    """Scalar product of two 3-tuples."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel
def cross(a, b):
    """Vector product of two 3-tuples."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


@kernel
def add(a, b):
    """Sum of two 3-tuples."""
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


@kernel
def subtract(a, b):
    """Difference of two 3-tuples."""
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


@kernel
def scale(a, s):
    """3-tuple times scalar."""
    return (a[0] * s, a[1] * s, a[2] * s)


@kernel
def multiply(a, b):
    """Product of two 3-tuples, one by one."""
    return (a[0] * b[0], a[1] * b[1], a[2] * b[2])


@kernel
def negate(a):
    """The opposite 3-tuple."""
    return (-a[0], -a[1], -a[2])


@kernel
def length(a):
    """Euclidean length of a 3-tuple."""
    return math.sqrt(dot(a, a))


@kernel
def normalize(a):
    """Unit vector along `a`; `a` itself if its length is zero."""
    squared = dot(a, a)
    if squared > 0.0:
        return scale(a, 1.0 / math.sqrt(squared))
    return a


@kernel
def orthonormal_basis(n):
    """Two unit tangents completing unit normal `n` to a right-handed frame.

    References: Duff et al. 2017, "Building an Orthonormal Basis, Revisited", listing 3.
    """
    sign = math.copysign(1.0, n[2])
    a = -1.0 / (sign + n[2])
    b = n[0] * n[1] * a
    tangent = (1.0 + sign * n[0] * n[0] * a, sign * b, -sign * n[0])
    bitangent = (b, sign + n[1] * n[1] * a, -n[1])
    return tangent, bitangent


@kernel
def to_world(local, tangent, bitangent, n):
    """Local frame coordinates (x, y, z along tangent, bitangent, normal) to world space."""
    return (
        local[0] * tangent[0] + local[1] * bitangent[0] + local[2] * n[0],
        local[0] * tangent[1] + local[1] * bitangent[1] + local[2] * n[1],
        local[0] * tangent[2] + local[1] * bitangent[2] + local[2] * n[2],
    )


@kernel
def to_local(world, tangent, bitangent, n):
    """World space vector to local frame coordinates."""
    return dot(world, tangent), dot(world, bitangent), dot(world, n)


@kernel
def load(array, row):
    """Row of a float32 (N, >=3) array as a 3-tuple."""
    return (array[row, 0], array[row, 1], array[row, 2])


@kernel
def store(array, row, value):
    """Write a 3-tuple into a row of a float32 (N, >=3) array."""
    array[row, 0] = value[0]
    array[row, 1] = value[1]
    array[row, 2] = value[2]


@kernel
def transform_point(matrices, row, p):
    """Apply affine matrix `row` of a float32 (N, 12) array (3x4, row-major) to a point."""
    return (
        matrices[row, 0] * p[0] + matrices[row, 1] * p[1] + matrices[row, 2] * p[2] + matrices[row, 3],
        matrices[row, 4] * p[0] + matrices[row, 5] * p[1] + matrices[row, 6] * p[2] + matrices[row, 7],
        matrices[row, 8] * p[0] + matrices[row, 9] * p[1] + matrices[row, 10] * p[2] + matrices[row, 11],
    )


@kernel
def transform_direction(matrices, row, d):
    """Apply the linear part of affine matrix `row` to a direction (not normalised)."""
    return (
        matrices[row, 0] * d[0] + matrices[row, 1] * d[1] + matrices[row, 2] * d[2],
        matrices[row, 4] * d[0] + matrices[row, 5] * d[1] + matrices[row, 6] * d[2],
        matrices[row, 8] * d[0] + matrices[row, 9] * d[1] + matrices[row, 10] * d[2],
    )


@kernel
def transform_normal(inverses, row, n):
    """Apply the inverse transpose to a normal, given the *inverse* affine matrix `row` (not normalised)."""
    return (
        inverses[row, 0] * n[0] + inverses[row, 4] * n[1] + inverses[row, 8] * n[2],
        inverses[row, 1] * n[0] + inverses[row, 5] * n[1] + inverses[row, 9] * n[2],
        inverses[row, 2] * n[0] + inverses[row, 6] * n[1] + inverses[row, 10] * n[2],
    )
