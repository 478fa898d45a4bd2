# SPDX-License-Identifier: GPL-3.0-or-later
"""The Math node: one number from up to three. Where mathematics has no answer the result is Cycles', mostly 0."""

import math

import numpy as np

from engine.kernels.limits import at_least, clamp, clamp_unit, larger, smaller
from engine.runtime.jit import kernel

#: Blender's names of the operations; an operation's code is its place here.
MATH_OPERATIONS = (
    "ADD", "SUBTRACT", "MULTIPLY", "DIVIDE", "MULTIPLY_ADD", "POWER", "LOGARITHM", "SQRT", "INVERSE_SQRT", "ABSOLUTE",
    "EXPONENT", "MINIMUM", "MAXIMUM", "LESS_THAN", "GREATER_THAN", "SIGN", "COMPARE", "SMOOTH_MIN", "SMOOTH_MAX",
    "ROUND", "FLOOR", "CEIL", "TRUNC", "FRACT", "MODULO", "FLOORED_MODULO", "WRAP", "SNAP", "PINGPONG", "SINE",
    "COSINE", "TANGENT", "ARCSINE", "ARCCOSINE", "ARCTANGENT", "ARCTAN2", "SINH", "COSH", "TANH", "RADIANS", "DEGREES",
)  # fmt: skip

(
    _ADD, _SUBTRACT, _MULTIPLY, _DIVIDE, _MULTIPLY_ADD, _POWER, _LOGARITHM, _SQRT, _INVERSE_SQRT, _ABSOLUTE,
    _EXPONENT, _MINIMUM, _MAXIMUM, _LESS_THAN, _GREATER_THAN, _SIGN, _COMPARE, _SMOOTH_MIN, _SMOOTH_MAX,
    _ROUND, _FLOOR, _CEIL, _TRUNC, _FRACT, _MODULO, _FLOORED_MODULO, _WRAP, _SNAP, _PINGPONG, _SINE,
    _COSINE, _TANGENT, _ARCSINE, _ARCCOSINE, _ARCTANGENT, _ARCTAN2, _SINH, _COSH, _TANH, _RADIANS, _DEGREES,
) = range(len(MATH_OPERATIONS))  # fmt: skip

_DEGREE = np.float32(np.pi / 180.0)
_RADIAN = np.float32(180.0 / np.pi)
_EPSILON = np.float32(np.finfo(np.float32).eps)


@kernel
def safe_divide(a, b):
    """a / b, 0 where b is 0."""
    return a / b if b != 0.0 else 0.0


@kernel
def safe_power(a, b):
    """a ** b; 1 for b = 0, 0 for a = 0 or where the result is not real."""
    if b == 0.0:
        return 1.0
    if a == 0.0 or (a < 0.0 and b != np.trunc(b)):
        return 0.0
    return math.pow(a, b)


@kernel
def _smooth_minimum(a, b, width):
    smaller = min(a, b)
    if width == 0.0:
        return smaller
    h = max(width - abs(a - b), 0.0) / width
    return smaller - h * h * h * width / 6.0


@kernel
def math_operation(operation, a, b, c):
    """The Math node.

    Parameters
    ----------
    operation : int
        Index into MATH_OPERATIONS.
    a, b, c : float32
        The sockets in order; unused ones are ignored.
    """
    if operation == _ADD:
        return a + b
    if operation == _SUBTRACT:
        return a - b
    if operation == _MULTIPLY:
        return a * b
    if operation == _DIVIDE:
        return safe_divide(a, b)
    if operation == _MULTIPLY_ADD:
        return a * b + c
    if operation == _POWER:
        return safe_power(a, b)
    if operation == _LOGARITHM:
        return safe_divide(math.log(a), math.log(b)) if a > 0.0 and b > 0.0 else 0.0
    if operation == _SQRT:
        return math.sqrt(at_least(a, 0.0))
    if operation == _INVERSE_SQRT:
        return 1.0 / math.sqrt(a) if a > 0.0 else 0.0
    if operation == _ABSOLUTE:
        return abs(a)
    if operation == _EXPONENT:
        return math.exp(a)
    if operation == _MINIMUM:
        return smaller(a, b)
    if operation == _MAXIMUM:
        return larger(a, b)
    if operation == _LESS_THAN:
        return 1.0 if a < b else 0.0
    if operation == _GREATER_THAN:
        return 1.0 if a > b else 0.0
    if operation == _SIGN:
        return 0.0 if a == 0.0 else math.copysign(1.0, a)
    if operation == _COMPARE:
        return 1.0 if a == b or abs(a - b) <= max(c, _EPSILON) else 0.0
    if operation == _SMOOTH_MIN:
        return _smooth_minimum(a, b, c)
    if operation == _SMOOTH_MAX:
        return -_smooth_minimum(-a, -b, c)
    if operation == _ROUND:
        return np.floor(a + 0.5)
    if operation == _FLOOR:
        return np.floor(a)
    if operation == _CEIL:
        return np.ceil(a)
    if operation == _TRUNC:
        return np.trunc(a)
    if operation == _FRACT:
        return a - np.floor(a)
    if operation == _MODULO:
        return np.fmod(a, b) if b != 0.0 else 0.0
    if operation == _FLOORED_MODULO:
        return a - np.floor(a / b) * b if b != 0.0 else 0.0
    if operation == _WRAP:
        width = b - c
        return a - width * np.floor((a - c) / width) if width != 0.0 else c
    if operation == _SNAP:
        return np.floor(safe_divide(a, b)) * b
    if operation == _PINGPONG:
        if b == 0.0:
            return 0.0
        cycles = (a - b) / (b * 2.0)
        return abs((cycles - np.floor(cycles)) * b * 2.0 - b)
    if operation == _SINE:
        return math.sin(a)
    if operation == _COSINE:
        return math.cos(a)
    if operation == _TANGENT:
        return math.tan(a)
    if operation == _ARCSINE:
        return math.asin(clamp(a, -1.0, 1.0))
    if operation == _ARCCOSINE:
        return math.acos(clamp(a, -1.0, 1.0))
    if operation == _ARCTANGENT:
        return math.atan(a)
    if operation == _ARCTAN2:
        return math.atan2(a, b) if a != 0.0 or b != 0.0 else 0.0
    if operation == _SINH:
        return math.sinh(a)
    if operation == _COSH:
        return math.cosh(a)
    if operation == _TANH:
        return math.tanh(a)
    if operation == _RADIANS:
        return a * _DEGREE
    if operation == _DEGREES:
        return a * _RADIAN
    return 0.0


MAP_LINEAR = 0
MAP_STEPPED = 1
MAP_SMOOTHSTEP = 2
MAP_SMOOTHERSTEP = 3


@kernel
def map_range(value, from_min, from_max, to_min, to_max, steps, interpolation, is_clamped, is_number):
    """The Map Range node on one number or component.

    Parameters
    ----------
    interpolation : int
        MAP_*.
    is_clamped : bool
        Limit to the interval between `to_min` and `to_max`.
    is_number : bool
        What Cycles makes of an empty source interval: 0 for numbers (then clamped), `to_min` for vectors.

    References: Perlin 2002, "Improving Noise" (the quintic step).
    """
    width = from_max - from_min
    t = safe_divide(value - from_min, width)
    if interpolation == MAP_STEPPED:
        t = np.floor(t * (steps + 1.0)) / steps if steps > 0.0 else 0.0
    elif interpolation != MAP_LINEAR:
        t = clamp_unit(t)
        if interpolation == MAP_SMOOTHSTEP:
            t = t * t * (3.0 - 2.0 * t)
        else:
            t = t * t * t * (t * (t * 6.0 - 15.0) + 10.0)
    result = 0.0 if is_number and width == 0.0 else to_min + t * (to_max - to_min)
    if is_clamped:
        result = clamp(result, min(to_min, to_max), max(to_min, to_max))
    return result


@kernel
def lookup(tables, first, stride, size, position, interpolate, extrapolate):
    """Value of a table of `size` entries, `stride` floats apart, at `position` in [0, 1].

    Beyond the ends: the end, or the line through the last two entries.
    """
    last = np.float32(size - 1)
    if extrapolate and position < 0.0:
        start = tables[first]
        return start - (start - tables[first + stride]) * position * last
    if extrapolate and position > 1.0:
        end = tables[first + (size - 1) * stride]
        return end + (end - tables[first + (size - 2) * stride]) * (position - 1.0) * last
    scaled = clamp_unit(position) * last
    index = min(max(int(scaled), 0), size - 1)
    t = scaled - np.float32(index)
    value = tables[first + index * stride]
    if interpolate and t > 0.0:
        value = (1.0 - t) * value + t * tables[first + (index + 1) * stride]
    return value
