# SPDX-License-Identifier: GPL-3.0-or-later
"""What is known of a program before it runs: constant emission and transparency, flags, the image that it will read."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from engine.kernels.bsdf.diffuse import MIN_DIFFUSE_ROUGHNESS
from engine.kernels.bsdf.linked_lobes import ADDED
from engine.kernels.shader import ops_closure, ops_image, ops_input, ops_rays
from engine.scene.description import Notice
from engine.shaders.blackbody import emission_temperature
from engine.shaders.compiled_program import Asked, CompiledProgram, ProgramSource, WorldImage
from engine.shaders.program import Constant, Instruction, Value, is_zero
from engine.shaders.sharp_lobes import makes_caustics
from engine.state import shaders as layout
from engine.state.shaders import MODE_CLOSURES, MODE_EMISSION, MODE_TRANSPARENCY

#: Which operands of PRINCIPLED are transmission and subsurface weight, and thin wall, behind the weight.
_TRANSMISSION = 13
_SUBSURFACE = 24
_THIN_WALL = 29
_TRACING = (ops_rays.OP_OCCLUSION, ops_rays.OP_BEVEL, ops_rays.OP_RAYCAST)


def with_analysis(
    source: ProgramSource,
    instructions: list[Instruction],
    roots: dict[int, list[int]],
    asked: list[Asked],
    notices: list[Notice],
) -> CompiledProgram:
    """The program of these instructions and roots, with all that is known of it."""
    transparency = _constant_transparency(instructions, roots[MODE_TRANSPARENCY])
    lambertian = _lambertian(instructions, roots[MODE_CLOSURES])
    # AOVs change nothing of how a surface looks.
    closures, emitting = (
        [root for root in roots[mode] if instructions[root].opcode != ops_closure.OP_AOV]
        for mode in (MODE_CLOSURES, MODE_EMISSION)
    )
    has_aovs = len(closures) < len(roots[MODE_CLOSURES])
    flags = _closure_flags(instructions, closures)
    emission = _constant_emission(instructions, emitting)
    lets_through = bool(roots[MODE_TRANSPARENCY]) and transparency != (0.0, 0.0, 0.0)
    facts: Mapping[int, bool] = {
        layout.PROGRAM_HAS_EMISSION: bool(emitting),
        layout.PROGRAM_HAS_AOVS: has_aovs,
        layout.PROGRAM_EMISSION_CONSTANT: emission is not None,
        layout.PROGRAM_MAY_BE_TRANSPARENT: lets_through and source.use_transparent_shadow,
        layout.PROGRAM_TRANSPARENCY_CONSTANT: transparency is not None,
        layout.PROGRAM_NO_BUMP_CORRECTION: not source.use_bump_map_correction,
        layout.PROGRAM_IS_LAMBERTIAN: lambertian is not None,
        layout.PROGRAM_HAS_SUBSURFACE: _has_subsurface(instructions, closures),
        layout.PROGRAM_HAS_PORTAL: any(map(_is_portal, map(instructions.__getitem__, closures))),
        layout.PROGRAM_TRACES: any(instruction.opcode in _TRACING for instruction in instructions),
        layout.PROGRAM_TRACES_LOCALLY: any(map(_traces_locally, instructions)),
    }
    for flag, is_set in facts.items():
        flags |= flag if is_set else 0
    ahead = _foreseen_image(instructions)
    world_image = _world_image(instructions, emitting) if source.kind == "WORLD" else None
    temperature = emission_temperature(source.graph)
    return CompiledProgram(
        instructions, roots, flags, emission, transparency, lambertian, ahead, world_image, temperature, asked, notices,
        refracts=_refracts(instructions, closures), makes_caustics=makes_caustics(instructions, closures),
    )  # fmt: skip


def _traces_locally(instruction: Instruction) -> bool:
    """Whether rays of a node meet the object alone."""
    if instruction.opcode == ops_rays.OP_OCCLUSION:
        return bool(instruction.immediates[1] & ops_rays.OCCLUSION_LOCAL)
    return instruction.opcode == ops_rays.OP_BEVEL or (
        instruction.opcode == ops_rays.OP_RAYCAST and instruction.immediates[0] != 0
    )


def _refracts(instructions: Sequence[Instruction], roots: Sequence[int]) -> bool:
    """Whether some lobe bends light that goes through."""
    bending = {ops_closure.opcode(name) for name in ("GLASS", "PLAIN_GLASS", "REFRACTION")}
    principled = ops_closure.opcode("PRINCIPLED")
    return any(
        instructions[root].opcode in bending
        or _adds(instructions[root], "GLASS")
        or (
            instructions[root].opcode == principled
            and not is_zero(instructions[root].inputs[_TRANSMISSION])
            and not _is_thin(instructions[root].inputs)
        )
        for root in roots
    )


def _is_thin(inputs: Sequence[Value]) -> bool:
    """Whether a PRINCIPLED is a thin wall everywhere: nothing is bent, nothing goes below."""
    wall = inputs[_THIN_WALL]
    return isinstance(wall, Constant) and wall.value[0] != 0.0


def _has_subsurface(instructions: Sequence[Instruction], roots: Sequence[int]) -> bool:
    """Whether some lobe lets light in that comes out elsewhere."""
    of_node, principled = (ops_closure.opcode(name) for name in ("SUBSURFACE", "PRINCIPLED"))
    for root in roots:
        opcode, inputs = instructions[root].opcode, instructions[root].inputs
        if opcode == of_node:
            return True
        if opcode == principled and not is_zero(inputs[_SUBSURFACE]) and not _is_thin(inputs):
            return True
    return False


def _adds(instruction: Instruction, linked: str) -> bool:
    """Whether a closure is the linked one of that name (`engine.kernels.bsdf.linked_lobes.ADDED`)."""
    return instruction.opcode == ops_closure.opcode("LINKED") and instruction.immediates[0] == ADDED[linked]


def _is_portal(instruction: Instruction) -> bool:
    """Whether a closure sends rays on elsewhere."""
    return _adds(instruction, "PORTAL")


def _closure_flags(instructions: Sequence[Instruction], roots: Sequence[int]) -> int:
    """PROGRAM_HAS_LOBES and PROGRAM_IS_CONSTANT."""
    closures = [instructions[root] for root in roots]
    flags = 0
    if any(closure.opcode >= ops_closure.LOBES_FIRST for closure in closures):
        flags |= layout.PROGRAM_HAS_LOBES
    if all(
        isinstance(value, Constant) or instructions[value.instruction].opcode == ops_input.OP_NORMAL
        for closure in closures
        for value in closure.inputs
    ):
        flags |= layout.PROGRAM_IS_CONSTANT
    return flags


def _foreseen_image(instructions: Sequence[Instruction]) -> tuple[int, int]:
    """PROGRAM_AHEAD_IMAGE and PROGRAM_AHEAD_SLOT."""
    for instruction in instructions:
        if instruction.opcode != ops_image.OP_IMAGE:
            continue
        image, projection = instruction.immediates[:2]
        vector = instruction.inputs[0]
        if image < 0 or projection != ops_image.PROJECTION_FLAT or isinstance(vector, Constant):
            continue
        source = instructions[vector.instruction]
        slot = source.immediates[1] if source.opcode == ops_input.OP_ATTRIBUTE else -2
        if vector.output == 0 and slot >= -1:
            return image + 1, slot
    return 0, 0


def _lambertian(instructions: Sequence[Instruction], roots: Sequence[int]) -> tuple[float, ...] | None:
    """Weight of the only closure, if that is a constant Lambertian lobe about the smooth normal, else None."""
    if len(roots) != 1 or instructions[roots[0]].opcode != ops_closure.opcode("DIFFUSE"):
        return None
    weight, normal, color, roughness = instructions[roots[0]].inputs
    if not (isinstance(weight, Constant) and isinstance(color, Constant) and isinstance(roughness, Constant)):
        return None
    if isinstance(normal, Constant) or instructions[normal.instruction].opcode != ops_input.OP_NORMAL:
        return None
    if not roughness.value[0] < MIN_DIFFUSE_ROUGHNESS:
        return None
    return tuple(float(np.float32(weight.value[0]) * np.float32(channel)) for channel in color.value)


def _world_image(instructions: Sequence[Instruction], roots: Sequence[int]) -> WorldImage | None:
    """How to look up a world that shows nothing but one equirectangular image, turned or not, else None."""
    if len(roots) != 1 or instructions[roots[0]].opcode != ops_closure.OP_EMISSION:
        return None
    weight, color, strength = instructions[roots[0]].inputs
    if not isinstance(weight, Constant) or not isinstance(strength, Constant) or isinstance(color, Constant):
        return None
    lookup = instructions[color.instruction]
    if lookup.opcode != ops_image.OP_ENVIRONMENT or color.output != 0:
        return None
    image, projection, interpolation, _, unassociate = lookup.immediates
    vector = lookup.inputs[0]
    if image < 0 or projection != ops_image.PROJECTION_EQUIRECTANGULAR or isinstance(vector, Constant):
        return None
    source, table = instructions[vector.instruction], -1
    if source.opcode == ops_input.OP_TRANSFORM_POINT and source.immediates[1] == 0:
        table, inner = source.immediates[0], source.inputs[0]
        if isinstance(inner, Constant):
            return None
        source = instructions[inner.instruction]
    # Both are the direction in a world; with an axis they are looked up beside it.
    if source.opcode not in (ops_input.OP_POSITION, ops_input.OP_GENERATED) or source.immediates[0] != 0:
        return None
    factor = float(np.float32(weight.value[0]) * np.float32(strength.value[0]))
    return WorldImage(image, table, interpolation, unassociate, factor)


def _constant_emission(instructions: Sequence[Instruction], roots: Sequence[int]) -> tuple[float, ...] | None:
    total = np.zeros(3)
    for root in roots:
        closure = instructions[root]
        values = [value.value for value in closure.inputs if isinstance(value, Constant)]
        if closure.opcode != ops_closure.OP_EMISSION or len(values) != len(closure.inputs):
            return None
        total += values[0][0] * values[2][0] * np.array(values[1])
    return tuple(float(x) for x in total)


def _constant_transparency(instructions: Sequence[Instruction], roots: Sequence[int]) -> tuple[float, ...] | None:
    total = np.zeros(3)
    for root in roots:
        closure = instructions[root]
        values = [value.value for value in closure.inputs if isinstance(value, Constant)]
        if len(values) != len(closure.inputs) or closure.opcode == ops_closure.OP_HOLDOUT:
            return None
        if closure.opcode == ops_closure.opcode("PRINCIPLED"):
            return None
        if closure.opcode == ops_closure.OP_ALPHA:
            total += values[0][0] * (1.0 - min(max(values[1][0], 0.0), 1.0))
        else:
            total += values[0][0] * np.array(values[1])
    return tuple(float(x) for x in total)
