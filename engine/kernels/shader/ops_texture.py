# SPDX-License-Identifier: GPL-3.0-or-later
"""Procedural textures as instructions; layout as in ops_math."""

import numpy as np

from engine.kernels.memory import read3, write3
from engine.kernels.shader.ies import ies_intensity
from engine.kernels.shader.opcodes import TEXTURE_FIRST
from engine.kernels.shader.procedural_misc import brick, checker, gradient, magic, wave, white_noise
from engine.kernels.shader.procedural_noise import Fractal, noise_texture
from engine.kernels.shader.procedural_voronoi import Voronoi, voronoi_texture
from engine.kernels.shader.sky import sky_color
from engine.runtime.jit import kernel
from engine.state.shaders import SINK

OP_CHECKER = TEXTURE_FIRST + 0  # color, fac <- vector, color1, color2, scale
# fac, color <- vector, w, scale, detail, roughness, lacunarity, offset, gain, distortion
#   | dimensions, kind, normalize
OP_NOISE = TEXTURE_FIRST + 1
OP_GRADIENT = TEXTURE_FIRST + 2  # color, fac <- vector | kind
# distance, color, position, w, radius <- vector, w, scale, detail, roughness, lacunarity, smoothness, exponent,
#   randomness | dimensions, feature, metric, normalize
OP_VORONOI = TEXTURE_FIRST + 3
# color, fac <- vector, scale, distortion, detail, detail scale, detail roughness, phase | kind, direction, profile
OP_WAVE = TEXTURE_FIRST + 4
# color, fac <- vector, color1, color2, mortar, scale, mortar size, mortar smooth, bias, brick width, row height,
#   offset, squash | offset frequency, squash frequency
OP_BRICK = TEXTURE_FIRST + 5
OP_MAGIC = TEXTURE_FIRST + 6  # color, fac <- vector, scale, distortion | depth, wraps scaled
OP_WHITE_NOISE = TEXTURE_FIRST + 7  # value, color <- vector, w | dimensions
OP_SKY = TEXTURE_FIRST + 8  # color <- vector | table, kind; those from here on look around
OP_IES = TEXTURE_FIRST + 9  # fac <- vector, strength | table


@kernel
def _look_around(opcode, code, pc, memory, tables):
    """What a table holds by direction: a sky, or the light of a luminaire."""
    direction = read3(memory, code[pc + 3])
    if opcode == OP_SKY:
        write3(memory, code[pc + 2], sky_color(tables, code[pc + 4], code[pc + 5], direction))
    else:
        memory[code[pc + 2]] = memory[code[pc + 4]] * ies_intensity(tables, code[pc + 5], direction)


@kernel(forceinline=True)
def run_texture_op(opcode, code, pc, memory, tables):
    """Run the instruction at `pc`. `tables` is the pool of ramps and curves (ShaderArrays.tables).

    One function, as in ops_math.
    """
    if opcode == OP_NOISE:
        dimensions = code[pc + 13]
        p = read3(memory, code[pc + 4])
        scale = memory[code[pc + 6]]
        x, y, z, w = p[0] * scale, p[1] * scale, p[2] * scale, memory[code[pc + 5]] * scale
        if dimensions == 1:
            x = w
        # With the wave texture's types, so that `fractal_noise` is compiled once.
        fractal = Fractal(
            dimensions=np.int64(dimensions),
            kind=np.int64(code[pc + 14]),
            detail=memory[code[pc + 7]],
            roughness=memory[code[pc + 8]],
            lacunarity=memory[code[pc + 9]],
            offset=memory[code[pc + 10]],
            gain=memory[code[pc + 11]],
            normalize=np.int64(code[pc + 15]),
        )
        color = noise_texture(x, y, z, w, fractal, memory[code[pc + 12]], 1 if code[pc + 3] == SINK else 3)
        memory[code[pc + 2]] = color[0]
        write3(memory, code[pc + 3], color)
    elif opcode == OP_VORONOI:
        dimensions = code[pc + 16]
        p = read3(memory, code[pc + 7])
        x, y, z, w = p[0], p[1], p[2], memory[code[pc + 8]]
        if dimensions == 1:
            x = w
        if dimensions < 2:
            y = 0.0
        if dimensions < 3:
            z = 0.0
        if dimensions < 4:
            w = 0.0
        voronoi = Voronoi(
            dimensions=dimensions,
            feature=code[pc + 17],
            metric=code[pc + 18],
            scale=memory[code[pc + 9]],
            detail=memory[code[pc + 10]],
            roughness=memory[code[pc + 11]],
            lacunarity=memory[code[pc + 12]],
            smoothness=memory[code[pc + 13]],
            exponent=memory[code[pc + 14]],
            randomness=memory[code[pc + 15]],
            normalize=code[pc + 19],
        )
        distance, red, green, blue, px, py, pz, pw = voronoi_texture(x, y, z, w, voronoi)
        memory[code[pc + 2]] = distance
        write3(memory, code[pc + 3], (red, green, blue))
        if dimensions == 1:
            write3(memory, code[pc + 4], (0.0, 0.0, 0.0))
            memory[code[pc + 5]] = px
        else:
            write3(memory, code[pc + 4], (px, py, pz))
            memory[code[pc + 5]] = pw
        memory[code[pc + 6]] = distance
    elif opcode == OP_BRICK:
        p = read3(memory, code[pc + 4])
        first = read3(memory, code[pc + 5])
        second = read3(memory, code[pc + 6])
        joint = read3(memory, code[pc + 7])
        scale = memory[code[pc + 8]]
        tint, mortar = brick(
            p[0] * scale,
            p[1] * scale,
            memory[code[pc + 9]],
            memory[code[pc + 10]],
            memory[code[pc + 11]],
            memory[code[pc + 12]],
            memory[code[pc + 13]],
            memory[code[pc + 14]],
            code[pc + 16],
            memory[code[pc + 15]],
            code[pc + 17],
        )
        keep = (1.0 - mortar) * (1.0 - tint)
        other = (1.0 - mortar) * tint
        color = (
            keep * first[0] + other * second[0] + mortar * joint[0],
            keep * first[1] + other * second[1] + mortar * joint[1],
            keep * first[2] + other * second[2] + mortar * joint[2],
        )
        memory[code[pc + 3]] = mortar
        write3(memory, code[pc + 2], color)
    elif opcode == OP_CHECKER:
        p = read3(memory, code[pc + 4])
        scale = memory[code[pc + 7]]
        fac = checker(p[0] * scale, p[1] * scale, p[2] * scale)
        memory[code[pc + 3]] = fac
        write3(memory, code[pc + 2], read3(memory, code[pc + 5] if fac == 1.0 else code[pc + 6]))
    elif opcode == OP_MAGIC:
        p = read3(memory, code[pc + 4])
        color = magic(p[0], p[1], p[2], memory[code[pc + 5]], code[pc + 7], memory[code[pc + 6]], code[pc + 8] != 0)
        memory[code[pc + 3]] = (color[0] + color[1] + color[2]) / 3.0
        write3(memory, code[pc + 2], color)
    elif opcode == OP_WHITE_NOISE:
        p = read3(memory, code[pc + 4])
        value, red, green, blue = white_noise(p[0], p[1], p[2], memory[code[pc + 5]], code[pc + 6])
        memory[code[pc + 2]] = value
        write3(memory, code[pc + 3], (red, green, blue))
    elif opcode >= OP_SKY:
        _look_around(opcode, code, pc, memory, tables)
    else:
        p = read3(memory, code[pc + 4])
        value = 0.0
        if opcode == OP_WAVE:
            scale = memory[code[pc + 5]]
            value = wave(
                p[0] * scale,
                p[1] * scale,
                p[2] * scale,
                code[pc + 11],
                code[pc + 12],
                code[pc + 13],
                memory[code[pc + 6]],
                memory[code[pc + 7]],
                memory[code[pc + 8]],
                memory[code[pc + 9]],
                memory[code[pc + 10]],
            )
        else:
            value = gradient(p[0], p[1], p[2], code[pc + 5])
        memory[code[pc + 3]] = value
        write3(memory, code[pc + 2], (value, value, value))
