# SPDX-License-Identifier: GPL-3.0-or-later
"""The Vector Math and Vector Rotate nodes on 3-tuples."""

import math

from engine.kernels.limits import at_least, at_most
from engine.kernels.vector import add, cross, dot, length, negate, scale, subtract
from engine.runtime.jit import kernel

#: Operations that are one of the Math node's, component by component (Blender's name -> the Math node's).
COMPONENT_OPERATIONS = {
    "ADD": "ADD",
    "SUBTRACT": "SUBTRACT",
    "MULTIPLY": "MULTIPLY",
    "DIVIDE": "DIVIDE",
    "MULTIPLY_ADD": "MULTIPLY_ADD",
    "ABSOLUTE": "ABSOLUTE",
    "POWER": "POWER",
    "SIGN": "SIGN",
    "ROUND": "ROUND",
    "FLOOR": "FLOOR",
    "CEIL": "CEIL",
    "FRACTION": "FRACT",
    "MODULO": "MODULO",
    "WRAP": "WRAP",
    "SNAP": "SNAP",
    "SINE": "SINE",
    "COSINE": "COSINE",
    "TANGENT": "TANGENT",
}

#: Operations on whole vectors; an operation's code is its place here. The last three give a number. The smaller and the
#: larger are no operations of the Math node: where one component is NaN the second is taken, whichever it is.
VECTOR_OPERATIONS = (
    "CROSS_PRODUCT", "PROJECT", "REFLECT", "REFRACT", "FACEFORWARD", "SCALE", "NORMALIZE", "MINIMUM", "MAXIMUM",
    "DOT_PRODUCT", "DISTANCE", "LENGTH",
)  # fmt: skip

(
    _CROSS_PRODUCT, _PROJECT, _REFLECT, _REFRACT, _FACEFORWARD, _SCALE, _NORMALIZE, _MINIMUM, _MAXIMUM,
    _DOT, _DISTANCE, _LENGTH,
) = range(len(VECTOR_OPERATIONS))  # fmt: skip

ROTATE_AXIS_ANGLE = 0
ROTATE_X = 1
ROTATE_Y = 2
ROTATE_Z = 3
ROTATE_EULER = 4


@kernel
def _unit(a):
    size = length(a)
    return scale(a, 1.0 / size) if size != 0.0 else a


@kernel
def _refract(incident, normal, eta):
    cosine = dot(normal, incident)
    k = 1.0 - eta * eta * (1.0 - cosine * cosine)
    if k < 0.0:
        return 0.0, 0.0, 0.0
    return subtract(scale(incident, eta), scale(normal, eta * cosine + math.sqrt(k)))


@kernel
def vector_operation(operation, a, b, c, factor):
    """Operations of the Vector Math node on whole vectors.

    Parameters
    ----------
    operation : int
        Index into VECTOR_OPERATIONS.
    a, b, c : 3-tuples of float32
    factor : float32
        Socket Scale: the factor, or the ratio of refractive indices.

    Returns
    -------
    vector, value
        One of the two is meant, the other 0.
    """
    vector = (0.0, 0.0, 0.0)
    value = 0.0
    if operation == _CROSS_PRODUCT:
        vector = cross(a, b)
    elif operation == _PROJECT:
        squared = dot(b, b)
        if squared != 0.0:
            vector = scale(b, dot(a, b) / squared)
    elif operation == _REFLECT or operation == _REFRACT:
        normal = _unit(b)
        if operation == _REFRACT:
            vector = _refract(a, normal, factor)
        else:
            vector = subtract(a, scale(normal, 2.0 * dot(a, normal)))
    elif operation == _FACEFORWARD:
        vector = a if dot(c, b) < 0.0 else negate(a)
    elif operation == _SCALE:
        vector = scale(a, factor)
    elif operation == _NORMALIZE:
        vector = _unit(a)
    elif operation == _MINIMUM:
        vector = (at_most(a[0], b[0]), at_most(a[1], b[1]), at_most(a[2], b[2]))
    elif operation == _MAXIMUM:
        vector = (at_least(a[0], b[0]), at_least(a[1], b[1]), at_least(a[2], b[2]))
    elif operation == _DOT:
        value = dot(a, b)
    elif operation == _DISTANCE:
        value = length(subtract(a, b))
    else:
        value = length(a)
    return vector, value


@kernel
def _rotate_about(p, axis, angle):
    """Rodrigues' rotation of p about the unit axis."""
    cosine = math.cos(angle)
    sine = math.sin(angle)
    along = (1.0 - cosine) * dot(axis, p)
    return add(add(scale(p, cosine), scale(cross(axis, p), sine)), scale(axis, along))


@kernel
def rotate_vector(kind, vector, center, axis, angle, rotation, invert):
    """The Vector Rotate node.

    Parameters
    ----------
    kind : int
        ROTATE_*; angles in radians. Euler angles turn about x first, then y, then z.
    """
    p = subtract(vector, center)
    sign = -1.0 if invert else 1.0
    if kind == ROTATE_EULER:
        # An inverse goes through the same turns backwards: z, y, x.
        for turn in range(3):
            which = 2 - turn if invert else turn
            unit = (1.0, 0.0, 0.0)
            if which == 1:
                unit = (0.0, 1.0, 0.0)
            elif which == 2:
                unit = (0.0, 0.0, 1.0)
            p = _rotate_about(p, unit, sign * rotation[which])
        return add(p, center)
    if kind == ROTATE_X:
        axis = (1.0, 0.0, 0.0)
    elif kind == ROTATE_Y:
        axis = (0.0, 1.0, 0.0)
    elif kind == ROTATE_Z:
        axis = (0.0, 0.0, 1.0)
    size = length(axis)
    if size == 0.0:
        return vector
    return add(_rotate_about(p, scale(axis, 1.0 / size), sign * angle), center)
