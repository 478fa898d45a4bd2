# SPDX-License-Identifier: GPL-3.0-or-later
"""Node graphs to `ShaderArrays`: constants folded, equal work shared, one run of code for each mode of evaluation."""

from __future__ import annotations

import math
import sys
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from engine.array_types import Float32Array
from engine.kernels.bsdf.diffuse import MIN_DIFFUSE_ROUGHNESS
from engine.kernels.shader import ops_closure, ops_image, ops_input, ops_math
from engine.scene.content import Kept
from engine.scene.description import Image, Link, Node, NodeGraph, Notice
from engine.scene.digest import content_digest
from engine.shaders import nodes_closure, nodes_image, nodes_input, nodes_texture_math
from engine.shaders.blackbody import emission_temperature
from engine.shaders.folding import estimate_emission, fold
from engine.shaders.image_pool import ImagePool, ImagePoolCache, srgb_table
from engine.shaders.options import choice
from engine.shaders.program import Constant, ConstantPool, Instruction, InstructionList, Value, assemble
from engine.shaders.table import COLOR, FLOAT, VECTOR, Implicit, NodeTable, Operation, Socket, SocketType
from engine.shaders.vocabulary import CLOSURE_INPUTS, unknown_parts
from engine.spectral.observer import XYZ_TO_REC709
from engine.state import shaders as layout
from engine.state.shaders import MODE_CLOSURES, MODE_EMISSION, MODE_TRANSPARENCY, ShaderArrays, identity_camera

#: Deep chains of nodes recurse a few Python frames per node.
_RECURSION_LIMIT = 50_000

NODES: NodeTable = nodes_input.NODES | nodes_image.NODES | nodes_texture_math.NODES

_BUMP_INPUTS = ("Strength", "Distance", "Filter Width", "Height", "Normal")
_DISPLACEMENT_INPUTS = ("Height", "Midlevel", "Scale", "Normal")

_LUMINANCE = (0.2126390, 0.7151687, 0.0721923)
_GREY = Constant((0.8, 0.8, 0.8))
_ZERO = Constant((0.0,))
_ONE = Constant((1.0,))
_BLACK = Constant((0.0, 0.0, 0.0))
_NO_PIXELS = np.zeros((0, 0, 4), np.uint8)
#: Instructions that read `ShaderArrays.camera`.
_CAMERA_OPCODES = frozenset({
    ops_input.OP_CAMERA_COORDINATE, ops_input.OP_WINDOW, ops_input.OP_CAMERA_DATA, ops_input.OP_VECTOR_TRANSFORM
})


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
        'MATERIAL', 'WORLD' or 'LIGHT'.
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
    color: tuple[float, float, float] = (1.0, 1.0, 1.0)


def compile_programs(
    sources: Sequence[ProgramSource],
    images: Sequence[Image],
    camera: Float32Array | None = None,
    to_xyz: Float32Array | None = None,
    cache: ProgramCache | None = None,
) -> tuple[ShaderArrays, list[str], list[Notice]]:
    """Compile one program per source, in their order.

    Parameters
    ----------
    camera : float32 (CAMERA_ROWS, 12), optional
        Spaces of the camera, as `ShaderArrays.camera`; None: all are the world.
    to_xyz : float32 (3, 3), optional
        From the working space to CIE XYZ (D65); None for Rec.709.
    cache : ProgramCache, optional
        Updated: programs and images that have not changed are not made again.

    Returns
    -------
    ShaderArrays
    attribute_names : list of str
        Name of each attribute slot that programs read. `'X.tangent'` is the tangent of UV map X, `'.tangent'` that of
        each mesh's render-active UV map; `'object:x'` and `'instancer:x'` are custom properties. A mesh without the
        attribute leaves the slot absent.
    notices : list of Notice
        What is not supported, with `'name / node'` as subject.
    """
    cache = ProgramCache() if cache is None else cache
    scene = _SceneCompiler(images, to_xyz)
    with _recursion():
        compiled = cache.compile(scene, sources)
    camera = identity_camera() if camera is None else camera
    pool = cache.images.get(images)
    # An estimate of emission may see the camera.
    seen = camera.tobytes() if any(program.emission is None and program.sees_camera for program in compiled) else b""
    # Names and graphs of sources are in the programs.
    numbers = tuple((source.kind, source.pass_index, source.dispersion) for source in sources)
    arrays = cache.arrays.get(
        (compiled, numbers, cache.images.version, seen), lambda: scene.assemble(sources, compiled, pool, camera)
    )
    if not np.array_equal(arrays.camera, camera):
        arrays = arrays._replace(camera=camera)
    return arrays, scene.attribute_names, scene.notices + pool.notices


@contextmanager
def _recursion() -> Iterator[None]:
    limit = sys.getrecursionlimit()
    sys.setrecursionlimit(max(limit, _RECURSION_LIMIT))
    try:
        yield
    finally:
        sys.setrecursionlimit(limit)


@dataclass(eq=False)
class _Compiled:
    """A program before it has an address: its instructions, the roots each mode runs, and facts.

    `asked` is what it took from the pools that it shares with other programs, in order: method, argument and answer.
    """

    instructions: list[Instruction]
    roots: dict[int, list[int]]
    flags: int
    emission: tuple[float, ...] | None
    transparency: tuple[float, ...] | None
    lambertian: tuple[float, ...] | None
    ahead: tuple[int, int]
    temperature: float
    asked: list[tuple[str, Any, Any]]
    notices: list[Notice]

    @property
    def sees_camera(self) -> bool:
        """Whether what it gives depends on where the camera is."""
        return any(instruction.opcode in _CAMERA_OPCODES for instruction in self.instructions)


class ProgramCache:
    """Programs and images of a session, kept while they stay the same."""

    def __init__(self) -> None:
        self._programs: dict[str, _Compiled] = {}
        #: Those of the newest description, in order of its sources: equal objects are equal programs.
        self.compiled: list[_Compiled] = []
        self.images = ImagePoolCache()
        self.arrays: Kept[ShaderArrays] = Kept()

    def compile(self, scene: _SceneCompiler, sources: Sequence[ProgramSource]) -> list[_Compiled]:
        """Programs of the sources: those at hand, where the pools that all share answer them as before."""
        programs: dict[str, _Compiled] = {}
        compiled = []
        for source in sources:
            digest = content_digest((source, scene.to_xyz))
            program = self._programs.get(digest)
            if program is None or not scene.answers(program):
                program = _ProgramCompiler(scene, source).compile()
            programs[digest] = program
            compiled.append(program)
        self._programs, self.compiled = programs, compiled
        return compiled


class _SceneCompiler:
    """Pools shared by all programs."""

    def __init__(self, images: Sequence[Image], to_xyz: Float32Array | None) -> None:
        self._images = images
        self.to_xyz = to_xyz
        #: Luminance of the working space's primaries, and the matrix to it from Rec.709; None where it is Rec.709.
        self.luminance: tuple[float, ...] | None = None
        self.from_rec709: npt.NDArray[np.float64] | None = None
        if to_xyz is not None:
            self.luminance = tuple(float(weight) for weight in to_xyz[1])
            self.from_rec709 = np.linalg.inv(XYZ_TO_REC709.astype(np.float64) @ to_xyz.astype(np.float64))
        self.attribute_names: list[str] = []
        self.notices: list[Notice] = []
        self._tables: list[Float32Array] = [srgb_table()]
        self._table_size = len(self._tables[0])
        self._known_tables: dict[bytes, int] = {}
        self._joined: Float32Array | None = None
        #: What the program in work has asked for, and what it reports.
        self._asked: list[tuple[str, Any, Any]] = []
        self._found: list[Notice] = []

    def begin(self) -> tuple[list[tuple[str, Any, Any]], list[Notice]]:
        """Begin a program: lists of what it will have asked for, and reported."""
        self._asked, self._found = [], []
        return self._asked, self._found

    def answers(self, program: _Compiled) -> bool:
        """Give a finished program what it asked for once more; whether all answers are the same."""
        self.begin()
        is_same = all(getattr(self, method)(argument) == answer for method, argument, answer in program.asked)
        if is_same:
            for notice in program.notices:
                self._report(notice)
        return is_same

    def _report(self, notice: Notice) -> None:
        if notice not in self.notices:
            self.notices.append(notice)

    def notice(self, subject: str, problem: str, fallback: str) -> None:
        """Report once."""
        self._found.append(Notice(subject, problem, fallback))
        self._report(self._found[-1])

    def attribute_slot(self, name: str) -> int:
        """Slot of a mesh attribute."""
        if name not in self.attribute_names:
            self.attribute_names.append(name)
        slot = self.attribute_names.index(name)
        self._asked.append(("attribute_slot", name, slot))
        return slot

    def add_table(self, values: npt.ArrayLike) -> int:
        """Index of the table's first float in the pool."""
        table = np.ascontiguousarray(values, np.float32).ravel()
        key = table.tobytes()
        if key not in self._known_tables:
            self._known_tables[key] = self._table_size
            self._tables.append(table)
            self._table_size += len(table)
            self._joined = None
        self._asked.append(("add_table", table, self._known_tables[key]))
        return self._known_tables[key]

    def image(self, index: int) -> Image | None:
        """An image without its pixels, None if it is missing."""
        image = None
        if 0 <= index < len(self._images):
            image = replace(self._images[index], key=None, pixels=_NO_PIXELS)
        self._asked.append(("image", index, image))
        return image

    def tables(self) -> Float32Array:
        """The pool so far."""
        if self._joined is None:
            self._joined = np.concatenate(self._tables)
        return self._joined

    def assemble(
        self,
        sources: Sequence[ProgramSource],
        compiled: Sequence[_Compiled],
        images: ImagePool,
        camera: Float32Array,
    ) -> ShaderArrays:
        """Assemble all programs into arrays."""
        pool = ConstantPool()
        pool.index(_ZERO)
        count = len(compiled)
        programs = np.zeros((max(count, 1), layout.PROGRAM_WIDTH), np.int32)
        values = np.zeros((max(count, 1), layout.VALUE_WIDTH), np.float32)
        code: list[int] = []
        constant_words: list[int] = []
        register_count = layout.FIRST_REGISTER
        for row, program in enumerate(compiled):
            for mode, roots in program.roots.items():
                part = assemble(program.instructions, roots, pool)
                programs[row, layout.PROGRAM_START + 2 * mode] = len(code)
                constant_words.extend(len(code) + word for word in part.constant_words)
                code.extend(part.words)
                programs[row, layout.PROGRAM_END + 2 * mode] = len(code)
                register_count = max(register_count, part.register_count)
            programs[row, layout.PROGRAM_FLAGS] = program.flags
            programs[row, [layout.PROGRAM_AHEAD_IMAGE, layout.PROGRAM_AHEAD_SLOT]] = program.ahead
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
            constants=np.array(pool.values, np.float32),
            programs=programs,
            program_values=values,
            program_pass_index=pass_index,
            program_dispersion=dispersion,
            program_temperature=temperature,
            images=images.table,
            pixels_byte=images.pixels_byte,
            pixels_float=images.pixels_float,
            tables=self.tables(),
            camera=camera,
            register_count=np.array([register_count], np.int64),
        )
        varying = [row for row, program in enumerate(compiled) if program.emission is None]
        if varying:
            kinds = [sources[row].kind for row in varying]
            estimates = estimate_emission(shaders, varying, kinds, len(self.attribute_names))
            values[varying, layout.VALUE_EMISSION : layout.VALUE_EMISSION + 3] = estimates
        return shaders


class _ProgramCompiler:
    """Compiles one graph."""

    def __init__(self, scene: _SceneCompiler, source: ProgramSource) -> None:
        self.scene = scene
        self.source = source
        self.graph = source.graph if source.graph is not None else NodeGraph()
        self.code = InstructionList()
        self.flags = 0
        self._roots: dict[int, list[int]] = {MODE_CLOSURES: [], MODE_EMISSION: [], MODE_TRANSPARENCY: []}
        #: Outputs of node (index, axis, filter width): identifier to (value, type); None while being computed.
        self._finished: dict[tuple[int, int, float], dict[str, tuple[Value, SocketType]] | None] = {}
        self._linked_outputs = {
            (link.node, link.output)
            for node in self.graph.nodes
            for link in node.inputs.values()
            if isinstance(link, Link)
        }

    def compile(self) -> _Compiled:
        """Walk the graph from its surface output."""
        asked, notices = self.scene.begin()
        self._surface()
        instructions = self.code.instructions
        emission = self._constant_emission()
        transparency = self._constant_transparency()
        if self._roots[MODE_EMISSION]:
            self.flags |= layout.PROGRAM_HAS_EMISSION
        if emission is not None:
            self.flags |= layout.PROGRAM_EMISSION_CONSTANT
        if self._roots[MODE_TRANSPARENCY] and self.source.use_transparent_shadow and transparency != (0.0, 0.0, 0.0):
            self.flags |= layout.PROGRAM_MAY_BE_TRANSPARENT
        if transparency is not None:
            self.flags |= layout.PROGRAM_TRANSPARENCY_CONSTANT
        if not self.source.use_bump_map_correction:
            self.flags |= layout.PROGRAM_NO_BUMP_CORRECTION
        closures = [instructions[root] for root in self._roots[MODE_CLOSURES]]
        if any(closure.opcode >= ops_closure.OP_DIFFUSE for closure in closures):
            self.flags |= layout.PROGRAM_HAS_LOBES
        normal = ops_input.OP_NORMAL
        if all(
            isinstance(value, Constant) or instructions[value.instruction].opcode == normal
            for closure in closures
            for value in closure.inputs
        ):
            self.flags |= layout.PROGRAM_IS_CONSTANT
        lambertian = self._lambertian(closures)
        if lambertian is not None:
            self.flags |= layout.PROGRAM_IS_LAMBERTIAN
        ahead = self._foreseen_image()
        temperature = emission_temperature(self.source.graph)
        return _Compiled(
            instructions, self._roots, self.flags, emission, transparency, lambertian, ahead, temperature, asked,
            notices,
        )

    def _foreseen_image(self) -> tuple[int, int]:
        """PROGRAM_AHEAD_IMAGE and PROGRAM_AHEAD_SLOT."""
        instructions = self.code.instructions
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

    def _lambertian(self, closures: Sequence[Instruction]) -> tuple[float, ...] | None:
        """Weight of the only closure, if that is a constant Lambertian lobe about the smooth normal, else None."""
        if len(closures) != 1 or closures[0].opcode != ops_closure.OP_DIFFUSE:
            return None
        weight, normal, color, roughness = closures[0].inputs
        if not (isinstance(weight, Constant) and isinstance(color, Constant) and isinstance(roughness, Constant)):
            return None
        if isinstance(normal, Constant) or self.code.instructions[normal.instruction].opcode != ops_input.OP_NORMAL:
            return None
        if not roughness.value[0] < MIN_DIFFUSE_ROUGHNESS:
            return None
        return tuple(float(np.float32(weight.value[0]) * np.float32(channel)) for channel in color.value)

    # -----------------------------------------------------------------------------------------------------------------
    # Closures

    def _surface(self) -> None:
        source = self.source
        if source.graph is None:
            builder = _Builder(self, -1, 0, 0.0)
            if source.kind == "MATERIAL":
                operands = (builder.input(Socket("Normal", VECTOR, Implicit.NORMAL)), _GREY, _ZERO)
                builder.closure(ops_closure.OP_DIFFUSE, _ONE, operands, modes=(MODE_CLOSURES,))
            elif any(source.color):
                color = Constant(tuple(float(c) for c in source.color))
                modes = (MODE_CLOSURES, MODE_EMISSION)
                builder.closure(ops_closure.OP_EMISSION, _ONE, (color, _ONE), modes=modes)
            return
        self._displacement()
        if self.graph.volume is not None:
            self.scene.notice(source.name, "has a volume, which is not supported", "no volume")
        if self.graph.surface is None or not self._exists(self.graph.surface, "the output"):
            return
        weights: dict[int, Value] = {self.graph.surface.node: _ONE}
        for index in self._shader_order(self.graph.surface.node):
            weight = weights.get(index)
            if weight is None or nodes_closure.is_zero(weight):
                continue
            self._shader(index, weight, weights)

    def _shader_order(self, root: int) -> list[int]:
        """Shader nodes reached from `root`, each before those it mixes or adds."""
        order: list[int] = []
        state: dict[int, int] = {}

        def visit(index: int) -> None:
            state[index] = 1
            for link in reversed(self._shader_links(index)):
                if link is None:
                    continue
                if state.get(link.node) == 1:
                    self._notice(self.graph.nodes[index], "is part of a loop of links", "the loop is cut open there")
                elif link.node not in state:
                    visit(link.node)
            state[index] = 2
            order.append(index)

        visit(root)
        return order[::-1]

    def _shader_links(self, index: int) -> list[Link | None]:
        """Links into the shader sockets of a Mix or Add Shader, None where nothing usable is linked."""
        node = self.graph.nodes[index]
        if node.kind == nodes_closure.MIX_SHADER:
            names = ("Shader", "Shader_001")
        elif node.kind == nodes_closure.ADD_SHADER:
            names = ("Shader", "Shader_001")
        else:
            return []
        links = (node.inputs.get(name) for name in names)
        return [link if isinstance(link, Link) and self._exists(link, node.name) else None for link in links]

    def _shader(self, index: int, weight: Value, weights: dict[int, Value]) -> None:
        node = self.graph.nodes[index]
        builder = _Builder(self, index, 0, 0.0)
        if node.kind in CLOSURE_INPUTS:
            self._notice_unknown(node, CLOSURE_INPUTS[node.kind])
        if node.kind in (nodes_closure.MIX_SHADER, nodes_closure.ADD_SHADER):
            shares: tuple[Value, Value] = (weight, weight)
            if node.kind == nodes_closure.MIX_SHADER:
                shares = self._mix_weights(weight, builder.input(Socket("Fac", FLOAT, 0.5)))
            for link, share in zip(self._shader_links(index), shares, strict=True):
                if link is not None:
                    weights[link.node] = self.add(weights.get(link.node, _ZERO), share)
            return
        emit = nodes_closure.CLOSURES.get(node.kind)
        if emit is not None:
            emit(node, weight, builder)
        elif node.kind in NODES or node.kind in nodes_input.OUTPUTS:
            # Blender shows a colour linked to the surface as emission.
            outputs = self._outputs(index, 0, 0.0)
            value, type_ = next(iter(outputs.values()), (_BLACK, COLOR))
            operands = (self.convert(value, type_, COLOR), _ONE)
            builder.closure(ops_closure.OP_EMISSION, weight, operands, modes=(MODE_CLOSURES, MODE_EMISSION))
        else:
            self._notice(node, f"{node.kind} is not supported", "black")

    def _mix_weights(self, weight: Value, fac: Value) -> tuple[Value, Value]:
        if isinstance(fac, Constant):
            f = min(max(fac.value[0], 0.0), 1.0)
            return self.multiply(weight, Constant((1.0 - f,))), self.multiply(weight, Constant((f,)))
        first, second = self.code.append(Instruction(ops_input.OP_MIX_WEIGHTS, (weight, fac), (1, 1)))
        return first, second

    def add_closure(self, instruction: Instruction, modes: tuple[int, ...]) -> None:
        """Append a closure instruction that the given modes run."""
        index = self.code.append_effect(instruction)
        for mode in modes:
            self._roots[mode].append(index)

    def _displacement(self) -> None:
        """Displacement as bump: the shading normal is replaced before the surface reads it.

        Emission and transparency alone are evaluated with the undisplaced normal.
        """
        link = self.graph.displacement
        if link is None or not self._exists(link, "the output"):
            return
        builder = _Builder(self, -1, 0, 0.0)
        name = self.graph.nodes[link.node].name
        builder.node = Node("displacement", name)
        normal = builder.input(Socket("Normal", VECTOR, Implicit.NORMAL))
        heights = []
        for axis in (0, 1, 2):
            value, type_ = self._value(link, axis, 0.1)
            vector = self.convert(value, type_, VECTOR)
            heights.append(self.code.append(Instruction(ops_input.OP_DOT, (vector, normal), (1,)))[0])
        if len(set(heights)) == 1:
            return
        operands = (*heights, _ONE, _ONE, normal, Constant((0.1,)))
        bumped = self.code.append(Instruction(ops_input.OP_BUMP, operands, (3,), (0, 0)))[0]
        index = self.code.append_effect(Instruction(ops_input.OP_SET_NORMAL, (bumped,), ()))
        self._roots[MODE_CLOSURES].append(index)
        # What follows must read the point again.
        self.code.forget()
        self._finished.clear()

    # -----------------------------------------------------------------------------------------------------------------
    # Facts

    def _constant_emission(self) -> tuple[float, ...] | None:
        total = np.zeros(3)
        for root in self._roots[MODE_EMISSION]:
            closure = self.code.instructions[root]
            values = [value.value for value in closure.inputs if isinstance(value, Constant)]
            if closure.opcode != ops_closure.OP_EMISSION or len(values) != len(closure.inputs):
                return None
            total += values[0][0] * values[2][0] * np.array(values[1])
        return tuple(float(x) for x in total)

    def _constant_transparency(self) -> tuple[float, ...] | None:
        total = np.zeros(3)
        for root in self._roots[MODE_TRANSPARENCY]:
            closure = self.code.instructions[root]
            values = [value.value for value in closure.inputs if isinstance(value, Constant)]
            if len(values) != len(closure.inputs) or closure.opcode == ops_closure.OP_HOLDOUT:
                return None
            if closure.opcode == ops_closure.OP_ALPHA:
                total += values[0][0] * (1.0 - min(max(values[1][0], 0.0), 1.0))
            else:
                total += values[0][0] * np.array(values[1])
        return tuple(float(x) for x in total)

    # -----------------------------------------------------------------------------------------------------------------
    # Values

    def _notice(self, node: Node, problem: str, fallback: str) -> None:
        self.scene.notice(f"{self.source.name} / {node.name}", problem, fallback)

    def _notice_unknown(self, node: Node, known_inputs: Collection[str]) -> None:
        for part in unknown_parts(node, known_inputs):
            self._notice(node, f"{part} is not supported", "as if it were not there")

    def _exists(self, link: Link, reader: str) -> bool:
        if 0 <= link.node < len(self.graph.nodes):
            return True
        self.scene.notice(f"{self.source.name} / {reader}", "is linked to a node that does not exist", "unlinked")
        return False

    def is_linked(self, index: int, identifier: str) -> bool:
        """Whether anything in the graph reads this output."""
        return (index, identifier) in self._linked_outputs

    def _value(self, link: Link, axis: int, width: float) -> tuple[Value, SocketType]:
        """What an output carries, at the point displaced along `axis`."""
        node = self.graph.nodes[link.node]
        outputs = self._outputs(link.node, axis, width)
        if link.output in outputs:
            return outputs[link.output]
        if outputs:
            self._notice(node, f"has no output {link.output!r}", "0")
        return _ZERO, FLOAT

    def _outputs(self, index: int, axis: int, width: float) -> dict[str, tuple[Value, SocketType]]:
        key = (index, axis, width)
        if key in self._finished:
            known = self._finished[key]
            if known is None:
                self._notice(self.graph.nodes[index], "is part of a loop of links", "the loop is cut open there")
                return {}
            return known
        self._finished[key] = None
        outputs = self._lower(index, axis, width)
        self._finished[key] = outputs
        return outputs

    def _lower(self, index: int, axis: int, width: float) -> dict[str, tuple[Value, SocketType]]:
        node = self.graph.nodes[index]
        builder = _Builder(self, index, axis, width)
        if node.kind == "ShaderNodeBump":
            self._notice_unknown(node, _BUMP_INPUTS)
            return {"Normal": (self._bump(node, builder), VECTOR)}
        if node.kind == "ShaderNodeDisplacement":
            self._notice_unknown(node, _DISPLACEMENT_INPUTS)
            return {"Displacement": (self._displacement_vector(node, builder), VECTOR)}
        separate = nodes_input.OUTPUTS.get(node.kind)
        if separate is not None:
            self._notice_unknown(node, ())
            return _LazyOutputs(self, node, builder, separate)
        entry = NODES.get(node.kind)
        if entry is None:
            fallback = "0"
            if node.kind in nodes_closure.CLOSURES:
                problem = "is a shader linked to a value"
            else:
                problem = f"{node.kind} is not supported"
            self._notice(node, problem, fallback)
            return {}
        operation = entry if isinstance(entry, Operation) else entry(node, builder)
        # What has no instruction has been reported whole, or has no inputs.
        if operation.opcode >= 0:
            self._notice_unknown(node, [socket.identifier for socket in operation.inputs])
        values = self._in_working_space(operation, self.emit(operation, builder))
        types = [socket.type for socket in operation.outputs]
        names = [socket.identifier for socket in operation.outputs]
        outputs = {name: (value, type_) for name, value, type_ in zip(names, values, types, strict=False)}
        if node.kind == "ShaderNodeAttribute":
            outputs["Vector"] = (outputs["Color"][0], VECTOR)
        return outputs

    def _in_working_space(self, operation: Operation, values: tuple[Value, ...]) -> tuple[Value, ...]:
        """Colours that kernels know in Rec.709 only, in the working space."""
        matrix = self.scene.from_rec709
        if matrix is None or operation.opcode not in (ops_math.OP_BLACKBODY, ops_math.OP_WAVELENGTH):
            return values
        channels = tuple(
            self.append(Instruction(ops_input.OP_DOT, (values[0], Constant(tuple(row))), (1,)), is_varying=False)[0]
            for row in matrix.tolist()
        )
        return self.append(Instruction(ops_math.OP_COMBINE_XYZ, channels, (3,)), is_varying=False)

    def emit(self, operation: Operation, builder: _Builder) -> tuple[Value, ...]:
        """Values of the operation's outputs, folded where its inputs are constants."""
        inputs = tuple(builder.input(socket) for socket in operation.inputs)
        if operation.opcode < 0:
            return inputs
        if operation.opcode == ops_math.OP_LUMINANCE and self.scene.luminance is not None:
            return (self.convert(inputs[0], COLOR, FLOAT),)
        widths = tuple(socket.type.width for socket in operation.outputs)
        return self.append(Instruction(operation.opcode, inputs, widths, operation.immediates), operation.is_varying)

    def append(self, instruction: Instruction, is_varying: bool) -> tuple[Value, ...]:
        """Append an instruction, or fold it."""
        constant = all(isinstance(value, Constant) for value in instruction.inputs)
        if constant and not is_varying:
            return fold(instruction, self.scene.tables())
        return self.code.append(instruction)

    def _bump(self, node: Node, builder: _Builder) -> Value:
        normal = builder.input(Socket("Normal", VECTOR, Implicit.NORMAL))
        height = node.inputs.get("Height")
        strength = builder.input(Socket("Strength", FLOAT, 1.0))
        distance = builder.input(Socket("Distance", FLOAT, 1.0))
        if not isinstance(height, Link) or nodes_closure.is_zero(strength) or nodes_closure.is_zero(distance):
            return normal
        width = builder.input(Socket("Filter Width", FLOAT, float(node.properties.get("filter_width", 0.1))))
        if not isinstance(width, Constant):
            self._notice(node, "has a Filter Width that is not constant", "0.1")
            width = Constant((0.1,))
        heights = []
        for axis in (0, 1, 2):
            at_axis = _Builder(self, builder.index, axis, width.value[0])
            heights.append(at_axis.input(Socket("Height", FLOAT, 1.0)))
        if len(set(heights)) == 1:
            return normal
        operands = (*heights, strength, distance, normal, width)
        immediates = (int(bool(node.properties.get("invert", False))), 0)
        return self.append(Instruction(ops_input.OP_BUMP, operands, (3,), immediates), is_varying=True)[0]

    def _displacement_vector(self, node: Node, builder: _Builder) -> Value:
        """Displacement node: normal times (height - midlevel) times scale."""
        height = builder.input(Socket("Height", FLOAT, 0.0))
        midlevel = builder.input(Socket("Midlevel", FLOAT, 0.5))
        scale = builder.input(Socket("Scale", FLOAT, 1.0))
        normal = builder.input(Socket("Normal", VECTOR, Implicit.NORMAL))
        in_object_space = choice(node, builder, "space", ("WORLD", "OBJECT"), "OBJECT")
        operands = (height, midlevel, scale, normal)
        instruction = Instruction(ops_input.OP_DISPLACEMENT, operands, (3,), (in_object_space,))
        return self.append(instruction, is_varying=True)[0]

    # Arithmetic that needs no kernel where its operands are constants.

    def convert(self, value: Value, source: SocketType, target: SocketType) -> Value:
        """A value on a socket of another type: colours become luminance, vectors their mean, floats repeat."""
        if source.width == target.width:
            return value
        if target is FLOAT:
            if isinstance(value, Constant):
                weights = (self.scene.luminance or _LUMINANCE) if source is COLOR else (1.0 / 3.0,) * 3
                return Constant((float(sum(w * x for w, x in zip(weights, value.value, strict=True))),))
            if source is COLOR and self.scene.luminance is not None:
                weighted = (value, Constant(self.scene.luminance))
                return self.code.append(Instruction(ops_input.OP_DOT, weighted, (1,)))[0]
            opcode = ops_input.OP_COLOR_TO_FLOAT if source is COLOR else ops_input.OP_VECTOR_TO_FLOAT
            return self.code.append(Instruction(opcode, (value,), (1,)))[0]
        if isinstance(value, Constant):
            return Constant(value.value * 3)
        return self.code.append(Instruction(ops_input.OP_FLOAT_TO_VECTOR, (value,), (3,)))[0]

    def multiply(self, a: Value, b: Value) -> Value:
        """Product of two scalars."""
        if isinstance(a, Constant) and isinstance(b, Constant):
            return Constant((a.value[0] * b.value[0],))
        for x, y in ((a, b), (b, a)):
            if x == _ONE:
                return y
            if x == _ZERO:
                return _ZERO
        return self.code.append(Instruction(ops_input.OP_MULTIPLY, (a, b), (1,)))[0]

    def add(self, a: Value, b: Value) -> Value:
        """Sum of two scalars."""
        if isinstance(a, Constant) and isinstance(b, Constant):
            return Constant((a.value[0] + b.value[0],))
        if a == _ZERO:
            return b
        if b == _ZERO:
            return a
        return self.code.append(Instruction(ops_input.OP_ADD, (a, b), (1,)))[0]


class _Builder:
    """What node entries see of the compiler: one node, at the point displaced along `axis` (0 = not)."""

    def __init__(self, compiler: _ProgramCompiler, index: int, axis: int, filter_width: float) -> None:
        self._compiler = compiler
        self.index = index
        self.axis = axis
        self.filter_width = filter_width if axis else 0.0
        self._width = filter_width
        self.node = compiler.graph.nodes[index] if index >= 0 else Node("", "")

    def input(self, socket: Socket) -> Value:
        """Value of an input socket, converted to its type."""
        given = self.node.inputs.get(socket.identifier) if socket.identifier else None
        compiler = self._compiler
        if isinstance(given, Link):
            if compiler._exists(given, self.node.name):
                value, type_ = compiler._value(given, self.axis, self._width)
                return compiler.convert(value, type_, socket.type)
            given = None
        if given is None:
            given = socket.default
        if isinstance(given, Implicit):
            operation = nodes_input.IMPLICIT[given](self.node, self)
            return compiler.convert(compiler.emit(operation, self)[0], VECTOR, socket.type)
        return _constant(given, socket)

    def constant_input(self, socket: Socket) -> tuple[float, ...] | None:
        """The value of an input if it is a constant, else None."""
        value = self.input(socket)
        return value.value if isinstance(value, Constant) else None

    def is_linked(self, identifier: str) -> bool:
        """Whether anything reads this output of the node."""
        return self._compiler.is_linked(self.index, identifier)

    def notice(self, problem: str, fallback: str) -> None:
        """Report something about the node."""
        self._compiler._notice(self.node, problem, fallback)

    def add_table(self, values: npt.ArrayLike) -> int:
        """Index of the first of `values` in the pool of tables."""
        return self._compiler.scene.add_table(values)

    def attribute_slot(self, name: str) -> int:
        """Slot of a mesh attribute."""
        return self._compiler.scene.attribute_slot(name)

    def image(self, index: int) -> tuple[int, Image] | None:
        """Row of an image and what it is but for its pixels, None if it is missing."""
        image = self._compiler.scene.image(index)
        if image is None:
            self.notice("has no image", "magenta, as Cycles shows it")
        return None if image is None else (index, image)

    def multiply(self, a: Value, b: Value) -> Value:
        """Product of two scalars."""
        return self._compiler.multiply(a, b)

    def saturate(self, value: Value) -> Value:
        """Scalar clamped to [0, 1]."""
        if isinstance(value, Constant):
            return Constant((min(max(value.value[0], 0.0), 1.0),))
        return self._compiler.code.append(Instruction(ops_input.OP_SATURATE, (value,), (1,)))[0]

    def closure(
        self,
        opcode: int,
        weight: Value,
        operands: tuple[Value, ...],
        immediates: tuple[int, ...] = (),
        *,
        modes: tuple[int, ...],
    ) -> None:
        """Append a closure instruction run in `modes`."""
        self._compiler.add_closure(Instruction(opcode, (weight, *operands), (), immediates), modes)


class _LazyOutputs(dict[str, tuple[Value, SocketType]]):
    """Outputs of a node that has an instruction for each: lowered when first asked for."""

    def __init__(
        self, compiler: _ProgramCompiler, node: Node, builder: _Builder, entries: nodes_input.Outputs
    ) -> None:
        super().__init__()
        self._parts: tuple[Any, ...] = (compiler, node, builder, entries)

    def __contains__(self, identifier: object) -> bool:
        return identifier in self._parts[3]

    def __bool__(self) -> bool:
        return True

    def __missing__(self, identifier: str) -> tuple[Value, SocketType]:
        compiler, node, builder, entries = self._parts
        operation = entries[identifier](node, builder)
        self[identifier] = (compiler.emit(operation, builder)[0], operation.outputs[0].type)
        return self[identifier]


def _constant(given: Any, socket: Socket) -> Constant:
    """An unlinked value as the socket's type; what makes no sense becomes zero."""
    width = socket.type.width
    if isinstance(given, (int, float, np.integer, np.floating)):
        return Constant((float(given),) * width)
    try:
        values = tuple(float(x) for x in given)
    except (TypeError, ValueError):
        return Constant((0.0,) * width)
    if width == 1:
        return Constant(values[:1] or (0.0,))
    return Constant((values + (0.0, 0.0, 0.0))[:3])
