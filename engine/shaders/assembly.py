# SPDX-License-Identifier: GPL-3.0-or-later
"""Compiled programs of a scene to the arrays that kernels read."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from engine.array_types import Float32Array
from engine.shaders.compiled_program import CompiledProgram, ProgramSource
from engine.shaders.folding import estimate_emission
from engine.shaders.image_pool import ImagePool
from engine.shaders.pools import ScenePools
from engine.shaders.program import Constant, ConstantPool, assemble
from engine.state import shaders as layout
from engine.state.shaders import MODE_MEDIUM, ShaderArrays


def shader_arrays(
    sources: Sequence[ProgramSource],
    compiled: Sequence[CompiledProgram],
    pools: ScenePools,
    images: ImagePool,
    camera: Float32Array,
) -> ShaderArrays:
    """Assemble all programs into arrays."""
    constants = ConstantPool()
    constants.index(Constant((0.0,)))
    count = len(compiled)
    programs = np.zeros((max(count, 1), layout.PROGRAM_WIDTH), np.int32)
    values = np.zeros((max(count, 1), layout.VALUE_WIDTH), np.float32)
    code: list[int] = []
    constant_words: list[int] = []
    register_count = layout.FIRST_REGISTER
    for row, program in enumerate(compiled):
        parts = [(mode, program.instructions, roots) for mode, roots in program.roots.items()]
        for mode, instructions, roots in (*parts, (MODE_MEDIUM, program.medium_instructions, program.medium_roots)):
            part = assemble(instructions, roots, constants)
            programs[row, layout.PROGRAM_START + 2 * mode] = len(code)
            constant_words.extend(len(code) + word for word in part.constant_words)
            code.extend(part.words)
            programs[row, layout.PROGRAM_END + 2 * mode] = len(code)
            register_count = max(register_count, part.register_count)
        programs[row, layout.PROGRAM_FLAGS] = program.flags
        programs[row, [layout.PROGRAM_AHEAD_IMAGE, layout.PROGRAM_AHEAD_SLOT]] = program.ahead
        if program.world_image is not None:
            image, table, interpolation, unassociate, factor = program.world_image
            programs[row, layout.PROGRAM_WORLD_IMAGE] = image + 1
            programs[row, layout.PROGRAM_WORLD_TABLE] = table
            programs[row, layout.PROGRAM_WORLD_INTERPOLATION] = interpolation
            programs[row, layout.PROGRAM_WORLD_UNASSOCIATE] = unassociate
            values[row, layout.VALUE_WORLD] = factor
        if program.emission is not None:
            values[row, layout.VALUE_EMISSION : layout.VALUE_EMISSION + 3] = program.emission
        if program.transparency is not None:
            values[row, layout.VALUE_TRANSPARENCY : layout.VALUE_TRANSPARENCY + 3] = program.transparency
        if program.lambertian is not None:
            values[row, layout.VALUE_LAMBERTIAN : layout.VALUE_LAMBERTIAN + 3] = program.lambertian
    words = np.array(code or [0], np.int32)
    words[constant_words] += register_count
    pass_index = np.zeros(max(count, 1), np.float32)
    pass_index[:count] = [source.pass_index for source in sources]
    dispersion = np.zeros(max(count, 1), np.float32)
    dispersion[:count] = [source.dispersion if math.isfinite(source.dispersion) else 0.0 for source in sources]
    temperature = np.zeros(max(count, 1), np.float32)
    temperature[:count] = [program.temperature for program in compiled]
    shaders = ShaderArrays(
        code=words,
        constants=np.array(constants.values, np.float32),
        programs=programs,
        program_values=values,
        program_pass_index=pass_index,
        program_dispersion=dispersion,
        program_temperature=temperature,
        images=images.table,
        pixels_byte=images.pixels_byte,
        pixels_float=images.pixels_float,
        tables=pools.tables(),
        camera=camera,
        register_count=np.array([register_count], np.int64),
    )
    varying = [
        row for row, program in enumerate(compiled) if program.emission is None and sources[row].kind != "DISPLACEMENT"
    ]
    if varying:
        asked = [(sources[row].kind, sources[row].lamp) for row in varying]
        estimates = estimate_emission(shaders, varying, asked, len(pools.attribute_names))
        values[varying, layout.VALUE_EMISSION : layout.VALUE_EMISSION + 3] = estimates
    return shaders
