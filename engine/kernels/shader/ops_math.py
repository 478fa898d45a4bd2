# SPDX-License-Identifier: GPL-3.0-or-later
"""Instructions on numbers, vectors and colours: each reads its operands, computes, writes its results.

Layout of an instruction at `pc`: opcode, length, outputs, inputs, immediates, in the order its entry in
engine/shaders/nodes_texture_math.py lists them. An instruction's outputs never share memory with its inputs.
"""

from engine.kernels.limits import at_least, clamp, clamp_unit
from engine.kernels.memory import read3, write3
from engine.kernels.shader.color_math import (
    COLOR_HSL,
    COLOR_HSV,
    blackbody,
    blend,
    gamma_channel,
    hsl_to_rgb,
    hsv_to_rgb,
    hue_saturation_value,
    luminance,
    rgb_to_hsl,
    rgb_to_hsv,
)
from engine.kernels.shader.opcodes import MATH_FIRST
from engine.kernels.shader.scalar_math import lookup, map_range, math_operation
from engine.kernels.shader.vector_math import rotate_vector, vector_operation
from engine.runtime.jit import kernel

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


@kernel(forceinline=True)
def run_math_op(opcode, code, pc, memory, tables):
    """Run the instruction at `pc`. `tables` is the pool of ramps and curves (ShaderArrays.tables).

    One function, not one a group: LLVM would compile each group's call tree once more.
    """
    out = code[pc + 2]

    # -----------------------------------------------------------------------------------------------------------------
    # Numbers

    if opcode == OP_MATH:
        value = math_operation(code[pc + 6], memory[code[pc + 3]], memory[code[pc + 4]], memory[code[pc + 5]])
        memory[out] = clamp_unit(value) if code[pc + 7] != 0 else value
    elif opcode == OP_CLAMP:
        low = memory[code[pc + 4]]
        high = memory[code[pc + 5]]
        if code[pc + 6] != 0 and low > high:
            low, high = high, low
        memory[out] = clamp(memory[code[pc + 3]], low, high)
    elif opcode == OP_MIX_FLOAT:
        share = memory[code[pc + 3]]
        if code[pc + 6] != 0:
            share = clamp_unit(share)
        memory[out] = memory[code[pc + 4]] * (1.0 - share) + memory[code[pc + 5]] * share
    elif opcode == OP_LUMINANCE:
        memory[out] = luminance(read3(memory, code[pc + 3]))

    # -----------------------------------------------------------------------------------------------------------------
    # Vectors

    elif opcode == OP_COMBINE_XYZ:
        write3(memory, out, (memory[code[pc + 3]], memory[code[pc + 4]], memory[code[pc + 5]]))
    elif opcode == OP_SEPARATE_XYZ:
        vector = read3(memory, code[pc + 5])
        memory[out] = vector[0]
        memory[code[pc + 3]] = vector[1]
        memory[code[pc + 4]] = vector[2]
    elif opcode == OP_VECTOR_COMPONENTS:
        a, b, c = code[pc + 4], code[pc + 5], code[pc + 6]
        for axis in range(3):
            memory[out + axis] = math_operation(code[pc + 7], memory[a + axis], memory[b + axis], memory[c + axis])
        memory[code[pc + 3]] = 0.0
    elif opcode == OP_VECTOR_MATH:
        vector, number = vector_operation(
            code[pc + 8],
            read3(memory, code[pc + 4]),
            read3(memory, code[pc + 5]),
            read3(memory, code[pc + 6]),
            memory[code[pc + 7]],
        )
        write3(memory, out, vector)
        memory[code[pc + 3]] = number
    elif opcode == OP_MAP_RANGE or opcode == OP_MAP_RANGE_VECTOR:
        is_number = opcode == OP_MAP_RANGE
        for axis in range(1 if is_number else 3):
            from_min = memory[code[pc + 4] + axis]
            from_max = memory[code[pc + 5] + axis]
            value = map_range(
                memory[code[pc + 3] + axis],
                from_min,
                from_max,
                memory[code[pc + 6] + axis],
                memory[code[pc + 7] + axis],
                memory[code[pc + 8] + axis],
                code[pc + 9],
                code[pc + 10],
                is_number,
            )
            memory[out + axis] = value
    elif opcode == OP_MIX_VECTOR:
        step = 0 if code[pc + 7] != 0 else 1  # a uniform factor is one number
        for axis in range(3):
            share = memory[code[pc + 3] + step * axis]
            if code[pc + 6] != 0:
                share = clamp_unit(share)
            memory[out + axis] = memory[code[pc + 4] + axis] * (1.0 - share) + memory[code[pc + 5] + axis] * share
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
        write3(memory, out, rotated)

    # -----------------------------------------------------------------------------------------------------------------
    # Colours

    elif opcode == OP_MIX_COLOR:
        share = memory[code[pc + 3]]
        if code[pc + 7] != 0:
            share = clamp_unit(share)
        color = blend(code[pc + 6], share, read3(memory, code[pc + 4]), read3(memory, code[pc + 5]))
        if code[pc + 8] != 0:
            color = (clamp_unit(color[0]), clamp_unit(color[1]), clamp_unit(color[2]))
        write3(memory, out, color)
    elif opcode == OP_INVERT:
        fac = memory[code[pc + 3]]
        for channel in range(3):
            memory[out + channel] = fac + memory[code[pc + 4] + channel] * (1.0 - 2.0 * fac)
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
        gamma = memory[code[pc + 4]]
        for channel in range(3):
            memory[out + channel] = gamma_channel(memory[code[pc + 3] + channel], gamma)
    elif opcode == OP_BRIGHT_CONTRAST:
        contrast = memory[code[pc + 5]]
        shift = memory[code[pc + 4]] - 0.5 * contrast
        for channel in range(3):
            memory[out + channel] = at_least((1.0 + contrast) * memory[code[pc + 3] + channel] + shift, 0.0)
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

    # -----------------------------------------------------------------------------------------------------------------
    # Ramps, curves, spectra: lookups in the pool of tables

    elif opcode == OP_RAMP or opcode == OP_CURVES or opcode == OP_FLOAT_CURVE or opcode == OP_WAVELENGTH:
        fac = 1.0
        low = 0.0
        width = 1.0
        source = pc + 3  # of the word that names what is looked up
        immediates = pc + 5
        stride = 3
        step = 0  # from one channel of the source to the next
        interpolate = True
        extrapolate = False
        if opcode == OP_RAMP:
            source = pc + 4
            stride = 4
            interpolate = code[pc + 7] != 0
        elif opcode == OP_WAVELENGTH:
            low = memory[code[pc + 4]]
            width = memory[code[pc + 5]] - low
            immediates = pc + 6
        else:
            fac = memory[code[pc + 3]]
            source = pc + 4
            low = memory[code[pc + 5]]
            width = memory[code[pc + 6]] - low
            immediates = pc + 7
            extrapolate = code[pc + 9] != 0
            if opcode == OP_CURVES:
                step = 1
            else:
                stride = 1
        for channel in range(stride):
            before = memory[code[source] + step * channel]
            position = (before - low) / width
            value = lookup(
                tables, code[immediates] + channel, stride, code[immediates + 1], position, interpolate, extrapolate
            )
            if opcode == OP_WAVELENGTH:
                value = at_least(value, 0.0) if position >= 0.0 and position < 1.0 else 0.0
            elif opcode != OP_RAMP:
                value = (1.0 - fac) * before + fac * value
            if channel < 3:
                memory[out + channel] = value
            else:
                memory[code[pc + 3]] = value
