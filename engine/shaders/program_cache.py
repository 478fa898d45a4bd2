# SPDX-License-Identifier: GPL-3.0-or-later
"""Programs, images and arrays of a session, kept from one description to the next."""

from __future__ import annotations

from collections.abc import Sequence

from engine.scene.content import Kept
from engine.scene.digest import content_digest
from engine.shaders.compiled_program import CompiledProgram, ProgramSource
from engine.shaders.image_pool import ImagePoolCache
from engine.shaders.pools import ScenePools
from engine.shaders.surface_compiler import SurfaceCompiler
from engine.state.shaders import ShaderArrays


class ProgramCache:
    """Programs and images of a session, kept while they stay the same."""

    def __init__(self) -> None:
        self._programs: dict[str, CompiledProgram] = {}
        #: Those of the newest description, in order of its sources: equal objects are equal programs.
        self.compiled: list[CompiledProgram] = []
        self.images = ImagePoolCache()
        self.arrays: Kept[ShaderArrays] = Kept()

    def compile(self, pools: ScenePools, sources: Sequence[ProgramSource]) -> list[CompiledProgram]:
        """Programs of the sources: those at hand, where the pools that all share answer them as before."""
        programs: dict[str, CompiledProgram] = {}
        compiled = []
        for source in sources:
            digest = content_digest((source, pools.to_xyz))
            program = self._programs.get(digest)
            if program is None or not pools.answers(program):
                program = SurfaceCompiler(pools, source).compile()
            programs[digest] = program
            compiled.append(program)
        self._programs, self.compiled = programs, compiled
        return compiled
