# SPDX-License-Identifier: GPL-3.0-or-later
"""Instructions on numbers, vectors and colours: each reads its operands, computes, writes its results.

Layout of an instruction at `pc`: opcode, length, outputs, inputs, immediates, in the order its entry in
engine/shaders/nodes_texture_math.py lists them. Operands are read before anything is written: they may share memory.
"""

import numpy as np

from engine.jit import kernel
from engine.kernels.shader.color_math import (
    COLOR_HSL,
    COLOR_HSV,
    blackbody,
    blend,
    clamp_unit,
    gamma_channel,
    hsl_to_rgb,
    hsv_to_rgb,
    hue_saturation_value,
    luminance,
    rgb_to_hsl,
    rgb_to_hsv,
)
from engine.kernels.shader.memory import read3, write3
from engine.kernels.shader.opcodes import MATH_FIRST
from engine.kernels.shader.scalar_math import lookup, map_range, math_operation
from engine.kernels.shader.vector_math import rotate_vector, vector_operation

OP_CLAMP = MATH_FIRST + 0  # value <- value, min, max | is_range
OP_COMBINE_XYZ = MATH_FIRST + 1  # vector <- x, y, z
OP_INVERT = MATH_FIRST + 2  # color <- fac, color
OP_MATH = MATH_FIRST + 3  # value <- a, b, c | operation, clamp
OP_VECTOR_COMPONENTS = MATH_FIRST + 4  # vector, value <- a, b, c | operation of the Math node
OP_VECTOR_MATH = MATH_FIRST + 5  # vector, value <- a, b, c, scale | operation
OP_MIX_COLOR = MATH_FIRST + 6  # color <- factor, a, b | mode, clamp factor, clamp result
OP_MIX_FLOAT = MATH_FIRST + 7  # value <- factor, a, b | clamp factor
OP_MIX_VECTOR = MATH_FIRST + 8  # vector <- factor (number or vector), a, b | clamp factor, is uniform
OP_MAP_RANGE = MATH_FIRST + 9  # value <- value, from min, from max, to min, to max, steps | interpolation, clamp
OP_MAP_RANGE_VECTOR = MATH_FIRST + 10  # the same on vectors
OP_COMBINE_COLOR = MATH_FIRST + 11  # color <- red, green, blue | model
OP_SEPARATE_COLOR = MATH_FIRST + 12  # red, green, blue <- color | model
OP_SEPARATE_XYZ = MATH_FIRST + 13  # x, y, z <- vector
OP_LUMINANCE = MATH_FIRST + 14  # value <- color
OP_HUE_SATURATION = MATH_FIRST + 15  # color <- hue, saturation, value, fac, color
OP_GAMMA = MATH_FIRST + 16  # color <- color, gamma
OP_BRIGHT_CONTRAST = MATH_FIRST + 17  # color <- color, bright, contrast
OP_BLACKBODY = MATH_FIRST + 18  # color <- temperature
OP_RAMP = MATH_FIRST + 19  # color, alpha <- fac | table (RGBA), size, interpolate
OP_CURVES = MATH_FIRST + 20  # color <- fac, color, min x, max x | table (RGB), size, extrapolate
OP_FLOAT_CURVE = MATH_FIRST + 21  # value <- factor, value, min x, max x | table, size, extrapolate
OP_VECTOR_ROTATE = MATH_FIRST + 22  # vector <- vector, center, axis, angle, rotation | kind, invert
OP_WAVELENGTH = MATH_FIRST + 23  # color <- wavelength, first [nm], last [nm] | table (RGB), size


@kernel
def _run_vector_op(opcode, code, pc, memory):
    """Vector Math component by component, mixing and mapping of vectors: one call site each for the big functions."""
    if opcode == OP_MAP_RANGE_VECTOR:
        a = read3(memory, code[pc + 3])
        from_min = read3(memory, code[pc + 4])
        from_max = read3(memory, code[pc + 5])
        to_min = read3(memory, code[pc + 6])
        to_max = read3(memory, code[pc + 7])
        steps = read3(memory, code[pc + 8])
        x, y, z = 0.0, 0.0, 0.0
        for axis in range(3):
            value = map_range(
                a[axis], from_min[axis], from_max[axis], to_min[axis], to_max[axis], steps[axis],
                code[pc + 9], code[pc + 10],
            )  # fmt: skip
            if axis == 0:
                x = value
            elif axis == 1:
                y = value
            else:
                z = value
        write3(memory, code[pc + 2], (x, y, z))
        return
    if opcode == OP_MIX_VECTOR:
        share = memory[code[pc + 3]]
        factor = (share, share, share)
        if code[pc + 7] == 0:
            factor = read3(memory, code[pc + 3])
        a = read3(memory, code[pc + 4])
        b = read3(memory, code[pc + 5])
        if code[pc + 6] != 0:
            factor = (clamp_unit(factor[0]), clamp_unit(factor[1]), clamp_unit(factor[2]))
        mixed = (
            a[0] * (1.0 - factor[0]) + b[0] * factor[0],
            a[1] * (1.0 - factor[1]) + b[1] * factor[1],
            a[2] * (1.0 - factor[2]) + b[2] * factor[2],
        )
        write3(memory, code[pc + 2], mixed)
        return
    a = read3(memory, code[pc + 4])
    b = read3(memory, code[pc + 5])
    c = read3(memory, code[pc + 6])
    if opcode == OP_VECTOR_MATH:
        vector, number = vector_operation(code[pc + 8], a, b, c, memory[code[pc + 7]])
        write3(memory, code[pc + 2], vector)
        memory[code[pc + 3]] = number
        return
    x, y, z = 0.0, 0.0, 0.0
    for axis in range(3):
        value = math_operation(code[pc + 7], a[axis], b[axis], c[axis])
        if axis == 0:
            x = value
        elif axis == 1:
            y = value
        else:
            z = value
    write3(memory, code[pc + 2], (x, y, z))
    memory[code[pc + 3]] = 0.0


@kernel
def _run_table_op(opcode, code, pc, memory, tables):
    """Ramps, curves and spectra: lookups in the pool of tables."""
    # Where the operands are, and per channel the value that is looked up.
    fac = 1.0
    low = 0.0
    width = 1.0
    x, y, z = 0.0, 0.0, 0.0
    last = pc + 5  # of the words before the immediates
    stride = np.int64(3)
    interpolate = np.int64(1)
    extrapolate = np.int64(0)
    if opcode == OP_RAMP:
        x = memory[code[pc + 4]]
        last = pc + 4
        stride = np.int64(4)
        interpolate = np.int64(code[pc + 7])
    elif opcode == OP_WAVELENGTH:
        x = memory[code[pc + 3]]
        low = memory[code[pc + 4]]
        width = memory[code[pc + 5]] - low
    else:
        fac = memory[code[pc + 3]]
        source = code[pc + 4]
        low = memory[code[pc + 5]]
        width = memory[code[pc + 6]] - low
        last = pc + 6
        extrapolate = np.int64(code[pc + 9])
        x = memory[source]
        if opcode == OP_CURVES:
            y = memory[source + 1]
            z = memory[source + 2]
        else:
            stride = np.int64(1)
    out = code[pc + 2]
    for channel in range(stride):
        before = x
        if opcode == OP_CURVES and channel > 0:
            before = y if channel == 1 else z
        position = (before - low) / width
        value = lookup(tables, code[last + 1] + channel, stride, code[last + 2], position, interpolate, extrapolate)
        if opcode == OP_WAVELENGTH:
            value = max(value, 0.0) if position >= 0.0 and position < 1.0 else 0.0
        elif opcode != OP_RAMP:
            value = (1.0 - fac) * before + fac * value
        if channel < 3:
            memory[out + channel] = value
        else:
            memory[code[pc + 3]] = value


@kernel
def _run_color_op(opcode, code, pc, memory):
    """Instructions that make a colour of colours."""
    out = code[pc + 2]
    if opcode == OP_MIX_COLOR:
        factor = memory[code[pc + 3]]
        if code[pc + 7] != 0:
            factor = clamp_unit(factor)
        color = blend(code[pc + 6], factor, read3(memory, code[pc + 4]), read3(memory, code[pc + 5]))
        if code[pc + 8] != 0:
            color = (clamp_unit(color[0]), clamp_unit(color[1]), clamp_unit(color[2]))
        write3(memory, out, color)
    elif opcode == OP_INVERT:
        fac = memory[code[pc + 3]]
        color = read3(memory, code[pc + 4])
        keep = 1.0 - 2.0 * fac
        write3(memory, out, (fac + color[0] * keep, fac + color[1] * keep, fac + color[2] * keep))
    elif opcode == OP_HUE_SATURATION:
        color = hue_saturation_value(
            read3(memory, code[pc + 7]),
            memory[code[pc + 3]],
            memory[code[pc + 4]],
            memory[code[pc + 5]],
            memory[code[pc + 6]],
        )
        write3(memory, out, color)
    elif opcode == OP_GAMMA:
        color = read3(memory, code[pc + 3])
        gamma = memory[code[pc + 4]]
        write3(
            memory,
            out,
            (gamma_channel(color[0], gamma), gamma_channel(color[1], gamma), gamma_channel(color[2], gamma)),
        )
    elif opcode == OP_BRIGHT_CONTRAST:
        color = read3(memory, code[pc + 3])
        contrast = memory[code[pc + 5]]
        slope = 1.0 + contrast
        shift = memory[code[pc + 4]] - 0.5 * contrast
        write3(
            memory,
            out,
            (
                max(slope * color[0] + shift, 0.0),
                max(slope * color[1] + shift, 0.0),
                max(slope * color[2] + shift, 0.0),
            ),
        )
    elif opcode == OP_COMBINE_COLOR:
        color = (memory[code[pc + 3]], memory[code[pc + 4]], memory[code[pc + 5]])
        if code[pc + 6] == COLOR_HSV:
            color = hsv_to_rgb(color)
        elif code[pc + 6] == COLOR_HSL:
            color = hsl_to_rgb(color)
        write3(memory, out, color)
    elif opcode == OP_SEPARATE_COLOR:
        color = read3(memory, code[pc + 5])
        if code[pc + 6] == COLOR_HSV:
            color = rgb_to_hsv(color)
        elif code[pc + 6] == COLOR_HSL:
            color = rgb_to_hsl(color)
        memory[out] = color[0]
        memory[code[pc + 3]] = color[1]
        memory[code[pc + 4]] = color[2]
    elif opcode == OP_BLACKBODY:
        write3(memory, out, blackbody(memory[code[pc + 3]]))


@kernel(forceinline=True)
def run_math_op(opcode, code, pc, memory, tables):
    """Run the instruction at `pc`. `tables` is the pool of ramps and curves (ShaderArrays.tables)."""
    if opcode == OP_MATH:
        value = math_operation(code[pc + 6], memory[code[pc + 3]], memory[code[pc + 4]], memory[code[pc + 5]])
        memory[code[pc + 2]] = clamp_unit(value) if code[pc + 7] != 0 else value
    elif opcode == OP_CLAMP:
        low = memory[code[pc + 4]]
        high = memory[code[pc + 5]]
        if code[pc + 6] != 0 and low > high:
            low, high = high, low
        memory[code[pc + 2]] = min(max(memory[code[pc + 3]], low), high)
    elif opcode == OP_COMBINE_XYZ:
        write3(memory, code[pc + 2], (memory[code[pc + 3]], memory[code[pc + 4]], memory[code[pc + 5]]))
    elif opcode == OP_SEPARATE_XYZ:
        vector = read3(memory, code[pc + 5])
        memory[code[pc + 2]] = vector[0]
        memory[code[pc + 3]] = vector[1]
        memory[code[pc + 4]] = vector[2]
    elif opcode == OP_MIX_FLOAT:
        factor = memory[code[pc + 3]]
        if code[pc + 6] != 0:
            factor = clamp_unit(factor)
        memory[code[pc + 2]] = memory[code[pc + 4]] * (1.0 - factor) + memory[code[pc + 5]] * factor
    elif opcode == OP_MAP_RANGE:
        from_min = memory[code[pc + 4]]
        from_max = memory[code[pc + 5]]
        to_min = memory[code[pc + 6]]
        to_max = memory[code[pc + 7]]
        value = map_range(
            memory[code[pc + 3]], from_min, from_max, to_min, to_max, memory[code[pc + 8]],
            code[pc + 9], code[pc + 10],
        )  # fmt: skip
        if from_min == from_max:  # 0 for numbers, unlike vectors
            value = 0.0
            if code[pc + 10] != 0:
                value = min(max(value, min(to_min, to_max)), max(to_min, to_max))
        memory[code[pc + 2]] = value
    elif opcode == OP_LUMINANCE:
        memory[code[pc + 2]] = luminance(read3(memory, code[pc + 3]))
    elif opcode == OP_VECTOR_ROTATE:
        rotated = rotate_vector(
            code[pc + 8],
            read3(memory, code[pc + 3]),
            read3(memory, code[pc + 4]),
            read3(memory, code[pc + 5]),
            memory[code[pc + 6]],
            read3(memory, code[pc + 7]),
            code[pc + 9],
        )
        write3(memory, code[pc + 2], rotated)
    elif (
        opcode == OP_VECTOR_COMPONENTS
        or opcode == OP_VECTOR_MATH
        or opcode == OP_MIX_VECTOR
        or opcode == OP_MAP_RANGE_VECTOR
    ):
        _run_vector_op(opcode, code, pc, memory)
    elif opcode == OP_RAMP or opcode == OP_CURVES or opcode == OP_FLOAT_CURVE or opcode == OP_WAVELENGTH:
        _run_table_op(opcode, code, pc, memory, tables)
    else:
        _run_color_op(opcode, code, pc, memory)
