# SPDX-License-Identifier: GPL-3.0-or-later
"""A shader program between its graph and its address: what it is made of, and what came of that."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple

from engine.kernels.shader import ops_input
from engine.scene.description import NodeGraph, Notice
from engine.shaders.lamp_facts import LampFacts
from engine.shaders.medium import Medium
from engine.shaders.program import Instruction
from engine.state.shaders import MODE_TRANSPARENCY

#: Instructions that read `ShaderArrays.camera`.
_CAMERA_OPCODES = frozenset(
    {ops_input.OP_CAMERA_COORDINATE, ops_input.OP_WINDOW, ops_input.OP_CAMERA_DATA, ops_input.OP_VECTOR_TRANSFORM}
)

#: What a program took from the pools that it shares with others: method, argument and answer.
Asked = tuple[str, Any, Any]


class AovColumns(NamedTuple):
    """Where a lane keeps an AOV: its first column of `row_width`; a colour has four, with alpha, a value one."""

    name: str
    is_color: bool
    column: int
    row_width: int


class WorldImage(NamedTuple):
    """A world that is one equirectangular image, for looking it up without the interpreter.

    image : row of `ShaderArrays.images`
    table : where in `ShaderArrays.tables` the matrix on directions is, -1 = none
    interpolation, unassociate : as `images.image_color` takes them
    factor : on the image's colour
    """

    image: int
    table: int
    interpolation: int
    unassociate: int
    factor: float


@dataclass(frozen=True)
class ProgramSource:
    """What one program is made of.

    Attributes
    ----------
    name : str
        Names the material, light or world in notices.
    graph : NodeGraph or None
        None: grey diffuse for a material, `color` as emission for a world, plain white emission for a light.
    kind : str
        'MATERIAL', 'WORLD' or 'LIGHT'; 'DISPLACEMENT': what a material moves vertices by, as emission.
    dispersion : float  [um^2]
        0 where it is not finite.
    """

    name: str
    graph: NodeGraph | None
    kind: str = "MATERIAL"
    pass_index: int = 0
    dispersion: float = 0.0
    use_bump_map_correction: bool = True
    use_transparent_shadow: bool = True
    has_smooth_voxels: bool = False
    color: tuple[float, float, float] = (1.0, 1.0, 1.0)
    #: `Material.displacement_method`.
    displacement_method: str = "BUMP"
    #: Of the lamp whose program it is, if that asks for any.
    lamp: LampFacts | None = None
    #: AOVs that the graph gives, if any.
    aovs: tuple[AovColumns, ...] = ()


@dataclass(eq=False)
class CompiledProgram:
    """A program before it has an address: its instructions, the roots each mode runs, and facts.

    `asked` is in the order of asking.
    """

    instructions: list[Instruction]
    roots: dict[int, list[int]]
    flags: int
    emission: tuple[float, ...] | None
    transparency: tuple[float, ...] | None
    lambertian: tuple[float, ...] | None
    ahead: tuple[int, int]
    world_image: WorldImage | None
    temperature: float
    asked: list[Asked]
    notices: list[Notice]
    #: Inside of what has this program; and whether its surface is nothing but the medium's boundary.
    medium: Medium | None = None
    is_boundary: bool = False
    #: Whether light goes through its surface by being bent.
    refracts: bool = False
    #: Whether light that it scatters stays together (`engine.shaders.sharp_lobes`).
    makes_caustics: bool = False
    #: Instructions of a medium that varies, which sees the point as it is, without displacement.
    medium_instructions: list[Instruction] = field(default_factory=list)
    medium_roots: list[int] = field(default_factory=list)

    @property
    def lets_through(self) -> bool:
        """Whether rays may go straight through its surface, transparent shadows or not."""
        is_transparent = bool(self.roots[MODE_TRANSPARENCY]) and self.transparency != (0.0, 0.0, 0.0)
        return self.is_boundary or is_transparent

    @property
    def sees_camera(self) -> bool:
        """Whether what it gives depends on where the camera is."""
        return any(
            instruction.opcode in _CAMERA_OPCODES for instruction in (*self.instructions, *self.medium_instructions)
        )
