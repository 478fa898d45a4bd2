# SPDX-License-Identifier: GPL-3.0-or-later
"""Instructions of volumes: what a node adds to the medium at a point.

Comments give each instruction's inputs. They leave absorption in `Closures.transparency`, scattering as the weights of
phase functions, both [m^-1], and emission in `Closures.emission`, radiance a metre.
"""

import math

import numpy as np

from engine.kernels.bsdf.closures import average
from engine.kernels.bsdf.phase import add_phase
from engine.kernels.limits import at_least, clamp
from engine.kernels.memory import read3
from engine.kernels.shader.opcodes import VOLUME_FIRST
from engine.kernels.vector import scale
from engine.runtime.jit import kernel
from engine.state.lanes import CLOSURE_WEIGHT

OP_ABSORPTION = VOLUME_FIRST + 0  # weight, color, density
OP_SCATTER = VOLUME_FIRST + 1  # weight, color, density, g, alpha, delta
OP_COEFFICIENTS = VOLUME_FIRST + 2  # weight, absorption, scattering, emission, g, alpha, delta
#: weight, color, density, absorption color, g, emission strength, emission color, share of black body, tint,
#: temperature [K], colour of a black body of this temperature
OP_PRINCIPLED = VOLUME_FIRST + 3

#: Stefan and Boltzmann's constant over pi, in the unit of emission that Cycles has here.
STEFAN_BOLTZMANN = np.float32(5.670373e-8 * 1e-6 / math.pi)
#: Mean cosines are kept off -1 and 1 by this much, as in Cycles.
LEAST_SPREAD = np.float32(1e-3)


@kernel
def _scatter(closures, lane, scattering, g, alpha, delta):
    """Append a phase function that has this much scattering."""
    scattering = (at_least(scattering[0], 0.0), at_least(scattering[1], 0.0), at_least(scattering[2], 0.0))
    mean = average(scattering)
    if not mean > 0.0:
        return
    g = clamp(g, LEAST_SPREAD - 1.0, 1.0 - LEAST_SPREAD)
    i = add_phase(closures, lane, mean, g, clamp(alpha, 0.0, 1e4), delta)
    if i >= 0:
        for c in range(3):
            closures.param[lane, i, CLOSURE_WEIGHT + c] = scattering[c]


@kernel
def _absorb(closures, lane, absorption):
    for c in range(3):
        closures.transparency[lane, c] += at_least(absorption[c], 0.0)


@kernel
def _emit(closures, lane, emission):
    for c in range(3):
        closures.emission[lane, c] += at_least(emission[c], 0.0)


@kernel
def _left(color):
    """What a colour lacks of white."""
    return at_least(1.0 - color[0], 0.0), at_least(1.0 - color[1], 0.0), at_least(1.0 - color[2], 0.0)


@kernel
def _principled(closures, lane, weight, memory, code, pc):
    density = weight * at_least(memory[code[pc + 4]], 0.0)
    color = read3(memory, code[pc + 3])
    if density > 0.0:
        clear = read3(memory, code[pc + 5])
        rest = _left(color)
        root = _left(
            (
                math.sqrt(at_least(clear[0], 0.0)),
                math.sqrt(at_least(clear[1], 0.0)),
                math.sqrt(at_least(clear[2], 0.0)),
            )
        )
        _absorb(closures, lane, scale((rest[0] * root[0], rest[1] * root[1], rest[2] * root[2]), density))
        _scatter(closures, lane, scale(color, density), memory[code[pc + 6]], 0.0 * density, 0.0 * density)
    strength = memory[code[pc + 7]]
    if strength > 0.0:
        _emit(closures, lane, scale(read3(memory, code[pc + 8]), weight * strength))
    share = memory[code[pc + 9]]
    if share > 0.0:
        temperature = at_least(memory[code[pc + 11]], 0.0)
        square = temperature * temperature
        intensity = STEFAN_BOLTZMANN * (1.0 + share * (square * square - 1.0)) * weight
        tint, hot = read3(memory, code[pc + 10]), read3(memory, code[pc + 12])
        _emit(closures, lane, scale((tint[0] * hot[0], tint[1] * hot[1], tint[2] * hot[2]), intensity))


@kernel
def run_volume_op(opcode, closures, lane, weight, memory, code, pc):
    """Run the instruction at `pc`; `weight` is its first input, not 0."""
    if opcode == OP_PRINCIPLED:
        _principled(closures, lane, weight, memory, code, pc)
        return
    if opcode == OP_COEFFICIENTS:
        _absorb(closures, lane, scale(read3(memory, code[pc + 3]), weight))
        scattering = scale(read3(memory, code[pc + 4]), weight)
        _emit(closures, lane, scale(read3(memory, code[pc + 5]), weight))
        _scatter(closures, lane, scattering, memory[code[pc + 6]], memory[code[pc + 7]], memory[code[pc + 8]])
        return
    density = weight * at_least(memory[code[pc + 4]], 0.0)
    color = read3(memory, code[pc + 3])
    if opcode == OP_ABSORPTION:
        _absorb(closures, lane, scale((1.0 - color[0], 1.0 - color[1], 1.0 - color[2]), density))
    else:
        scattering = scale(color, density)
        _scatter(closures, lane, scattering, memory[code[pc + 5]], memory[code[pc + 6]], memory[code[pc + 7]])
