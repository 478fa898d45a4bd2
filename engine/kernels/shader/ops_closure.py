# SPDX-License-Identifier: GPL-3.0-or-later
"""Closure instructions: each adds its lobes, emission or transparency to the lane's closures.

They have no outputs. The first input is always the weight that Mix and Add Shader nodes give the closure.
"""

from engine.kernels.bsdf.diffuse import add_diffuse, add_emission, add_holdout, add_translucent, add_transparent
from engine.kernels.bsdf.glossy import add_glass, add_glossy, add_refraction
from engine.kernels.bsdf.kinds import CLOSURE_NO_REFLECTIVE_CAUSTICS, CLOSURE_NO_REFRACTIVE_CAUSTICS
from engine.kernels.bsdf.normals import valid_specular_normal
from engine.kernels.bsdf.principled import PrincipledInputs, add_principled
from engine.kernels.shader.memory import read3
from engine.kernels.shader.normal_ops import safe_normal
from engine.kernels.shader.opcodes import CLOSURE_FIRST
from engine.kernels.shader.surface import read_point
from engine.kernels.vector import scale
from engine.runtime.jit import kernel
from engine.state.lanes import POINT_FLAG_BACKFACING, POINT_FLAGS, POINT_NG, POINT_NS, POINT_WO

OP_EMISSION = CLOSURE_FIRST + 0  # weight, color, strength
OP_TRANSPARENT = CLOSURE_FIRST + 1  # weight, color
OP_HOLDOUT = CLOSURE_FIRST + 2  # weight
OP_ALPHA = CLOSURE_FIRST + 3  # weight, alpha: what alpha lets through
OP_DIFFUSE = CLOSURE_FIRST + 4  # weight, normal, color, roughness
OP_TRANSLUCENT = CLOSURE_FIRST + 5  # weight, normal, color
OP_GLOSSY = CLOSURE_FIRST + 6  # weight, normal, color, roughness, anisotropy, rotation, tangent | distribution
OP_REFRACTION = CLOSURE_FIRST + 7  # weight, normal, color, roughness, ior | distribution
OP_GLASS = CLOSURE_FIRST + 8  # weight, normal, color, roughness, ior | distribution
# weight, normal, coat normal, tangent, base color, metallic, roughness, diffuse roughness, ior, specular level,
# specular tint, anisotropic, rotation, transmission, coat weight, coat roughness, coat ior, coat tint, sheen weight,
# sheen roughness, sheen tint, emission color, emission strength, alpha | distribution
OP_PRINCIPLED = CLOSURE_FIRST + 9


@kernel(forceinline=True)
def run_closure_op(opcode, code, pc, memory, points, closures, tables, lane):
    """Run the instruction at `pc`. A weight of zero adds nothing."""
    w = memory[code[pc + 2]]
    if w == 0.0:
        return
    if opcode == OP_EMISSION:
        color = read3(memory, code[pc + 3])
        add_emission(closures, lane, scale(color, w * memory[code[pc + 4]]))
        return
    if opcode == OP_TRANSPARENT:
        add_transparent(closures, lane, scale(read3(memory, code[pc + 3]), w))
        return
    if opcode == OP_ALPHA:
        through = w * (1.0 - min(max(memory[code[pc + 3]], 0.0), 1.0))
        add_transparent(closures, lane, (through, through, through))
        return
    if opcode == OP_HOLDOUT:
        add_holdout(closures, lane, (w, w, w))
        return
    ns = read_point(points, lane, POINT_NS)
    n = safe_normal(read3(memory, code[pc + 3]), ns)
    if opcode == OP_DIFFUSE:
        color = read3(memory, code[pc + 4])
        add_diffuse(closures, lane, scale(color, w), n, memory[code[pc + 5]], color)
        return
    ng = read_point(points, lane, POINT_NG)
    wo = read_point(points, lane, POINT_WO)
    backfacing = (points.integer[lane, POINT_FLAGS] & POINT_FLAG_BACKFACING) != 0
    if opcode == OP_PRINCIPLED:
        inputs = PrincipledInputs(
            distribution=code[pc + 26],
            base_color=read3(memory, code[pc + 6]),
            metallic=memory[code[pc + 7]],
            roughness=memory[code[pc + 8]],
            diffuse_roughness=memory[code[pc + 9]],
            ior=memory[code[pc + 10]],
            specular_level=memory[code[pc + 11]],
            specular_tint=read3(memory, code[pc + 12]),
            anisotropic=memory[code[pc + 13]],
            anisotropic_rotation=memory[code[pc + 14]],
            tangent=read3(memory, code[pc + 5]),
            transmission=memory[code[pc + 15]],
            coat_weight=memory[code[pc + 16]],
            coat_roughness=memory[code[pc + 17]],
            coat_ior=memory[code[pc + 18]],
            coat_tint=read3(memory, code[pc + 19]),
            coat_normal=safe_normal(read3(memory, code[pc + 4]), ns),
            sheen_weight=memory[code[pc + 20]],
            sheen_roughness=memory[code[pc + 21]],
            sheen_tint=read3(memory, code[pc + 22]),
            emission_color=read3(memory, code[pc + 23]),
            emission_strength=memory[code[pc + 24]],
            alpha=memory[code[pc + 25]],
        )
        add_principled(closures, tables, lane, (w, w, w), wo, ng, n, backfacing, inputs)
        return
    color = read3(memory, code[pc + 4])
    n = valid_specular_normal(closures, lane, ng, wo, n)
    if opcode == OP_TRANSLUCENT:
        add_translucent(closures, lane, scale(color, w), n)
    elif opcode == OP_GLOSSY:
        if closures.flags[lane] & CLOSURE_NO_REFLECTIVE_CAUSTICS == 0:
            add_glossy(
                closures,
                tables,
                lane,
                (w, w, w),
                color,
                wo,
                n,
                read3(memory, code[pc + 8]),
                code[pc + 9],
                memory[code[pc + 5]],
                memory[code[pc + 6]],
                memory[code[pc + 7]],
            )
    elif opcode == OP_REFRACTION:
        if closures.flags[lane] & CLOSURE_NO_REFRACTIVE_CAUSTICS == 0:
            add_refraction(
                closures,
                tables,
                lane,
                (w, w, w),
                color,
                wo,
                n,
                code[pc + 7],
                memory[code[pc + 5]],
                memory[code[pc + 6]],
                backfacing,
            )
    elif opcode == OP_GLASS:
        add_glass(
            closures,
            tables,
            lane,
            (w, w, w),
            color,
            wo,
            n,
            code[pc + 7],
            memory[code[pc + 5]],
            memory[code[pc + 6]],
            backfacing,
        )
