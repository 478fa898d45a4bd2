# SPDX-License-Identifier: GPL-3.0-or-later
"""A graph from its surface output to closure instructions: weights through Mix and Add Shader, and displacement."""

from __future__ import annotations

from engine.kernels.shader import normal_ops, ops_closure, ops_displacement, ops_input
from engine.scene.attribute_names import UNDISPLACED, VERTEX_NORMALS
from engine.scene.description import Link, Node, NodeGraph
from engine.shaders import nodes_closure
from engine.shaders.arithmetic import ONE, ZERO
from engine.shaders.compiled_program import CompiledProgram, ProgramSource
from engine.shaders.dispersing_facets import with_dispersing_facets, with_one_index
from engine.shaders.media import LEFT_OUT, VaryingError, fold_medium, is_shader
from engine.shaders.medium import Medium
from engine.shaders.node_values import NodeBuilder, NodeValues, gives_values
from engine.shaders.pools import ScenePools
from engine.shaders.program import Constant, Instruction, Register, Value, is_zero
from engine.shaders.program_analysis import with_analysis
from engine.shaders.table import COLOR, FLOAT, VECTOR, Implicit, Socket
from engine.shaders.varying_media import lower_medium
from engine.state.shaders import (
    MODE_CLOSURES,
    MODE_EMISSION,
    MODE_TRANSPARENCY,
    PROGRAM_IS_BOUNDARY,
    PROGRAM_MAY_BE_TRANSPARENT,
)

_GREY = Constant((0.8, 0.8, 0.8))
_BLACK = Constant((0.0, 0.0, 0.0))
_WHITE = Constant((1.0, 1.0, 1.0))


class SurfaceCompiler:
    """Compiles one graph."""

    def __init__(self, pools: ScenePools, source: ProgramSource) -> None:
        self.source = source
        self._pools = pools
        #: Nodes with facets that others stand for.
        self._replaced: list[str] = []
        self._graph = source.graph if source.graph is not None else NodeGraph()
        if source.dispersion != 0.0:
            self._graph, self._replaced = with_dispersing_facets(self._graph)
        is_displaced = source.displacement_method != "BUMP" and self._graph.displacement is not None
        self._values = NodeValues(
            source.name, self._graph, pools, is_displaced=is_displaced, lamp=source.lamp
        )
        self._arithmetic = self._values.arithmetic
        self._code = self._arithmetic.code
        #: Instructions that each mode runs for their effect.
        self._roots: dict[int, list[int]] = {MODE_CLOSURES: [], MODE_EMISSION: [], MODE_TRANSPARENCY: []}
        #: What is linked to the output, but for nodes that are not known: these are no link in Cycles either.
        self._surface_link: Link | None = None
        self._volume_link: Link | None = None

    def compile(self) -> CompiledProgram:
        """Walk the graph from its surface output."""
        asked, notices = self._pools.begin()
        for name in self._replaced:
            problem = "facets by Beckmann that disperse are not supported"
            self._pools.notice(f"{self.source.name} / {name}", problem, "GGX of the same roughness")
        for name in with_one_index(self._graph) if self.source.dispersion != 0.0 else ():
            problem = "dispersion of anisotropic glass, and of glass with a thin film, is not supported"
            self._pools.notice(f"{self.source.name} / {name}", problem, "it bends all wavelengths alike")
        self._surface_link, self._volume_link = (
            None if self.source.kind == "DISPLACEMENT" else self._known(link, otherwise)
            for link, otherwise in ((self._graph.surface, "no surface"), (self._graph.volume, LEFT_OUT))
        )
        if self.source.kind == "DISPLACEMENT":
            self._offset()
        elif self.source.graph is None:
            self._default_surface()
        else:
            self._displacement()
            self._surface()
            self._aovs()
        program = with_analysis(self.source, self._code.instructions, self._roots, asked, notices)
        if self._volume_link is not None:
            self._inside(program, self._volume_link)
        if self._is_boundary:
            program.is_boundary = True
            program.flags |= PROGRAM_IS_BOUNDARY | PROGRAM_MAY_BE_TRANSPARENT
        return program

    def _inside(self, program: CompiledProgram, volume: Link) -> None:
        """The medium inside, as numbers where it is the same everywhere, else as code."""
        try:
            program.medium = fold_medium(self._values_inside(), volume)
        except VaryingError:
            values = self._values_inside()
            program.medium_roots = lower_medium(values, volume)
            program.medium_instructions = values.arithmetic.code.instructions
            if program.medium_roots:
                program.medium = Medium(varies=True)

    def _values_inside(self) -> NodeValues:
        return NodeValues(
            self.source.name, self._graph, self._pools, is_inside=True, has_smooth_voxels=self.source.has_smooth_voxels
        )

    @property
    def _is_boundary(self) -> bool:
        """Whether there is a volume inside and nothing on the surface, which then is not there for light."""
        return self.source.kind == "MATERIAL" and self._volume_link is not None and self._surface_link is None

    def _known(self, link: Link | None, otherwise: str) -> Link | None:
        if link is None or not self._values.exists(link, "the output"):
            return None
        node = self._graph.nodes[link.node]
        if node.properties.get("is_conversion"):
            return link if self._known(node.inputs["Color"], otherwise) is not None else None
        if is_shader(node.kind) or gives_values(node.kind):
            return link
        self._values.notice(node, f"{node.kind} is not supported", otherwise)
        return None

    def add_closure(self, instruction: Instruction, modes: tuple[int, ...]) -> None:
        """Append a closure instruction that the given modes run."""
        index = self._code.append_effect(instruction)
        for mode in modes:
            self._roots[mode].append(index)

    def _default_surface(self) -> None:
        builder = _ClosureBuilder(self, self._values, -1)
        if self.source.kind == "MATERIAL":
            operands = (builder.input(Socket("Normal", VECTOR, Implicit.NORMAL)), _GREY, ZERO)
            builder.closure(ops_closure.opcode("DIFFUSE"), ONE, operands, (1,), modes=(MODE_CLOSURES,))
        elif any(self.source.color):
            color = Constant(tuple(float(c) for c in self.source.color))
            builder.closure(ops_closure.OP_EMISSION, ONE, (color, ONE), modes=(MODE_CLOSURES, MODE_EMISSION))

    def _surface(self) -> None:
        surface = self._surface_link
        if self._is_boundary:
            builder = _ClosureBuilder(self, self._values, -1)
            modes = (MODE_CLOSURES, MODE_TRANSPARENCY)
            builder.closure(ops_closure.OP_TRANSPARENT, ONE, (_WHITE,), modes=modes)
        if surface is None:
            return
        weights: dict[int, Value] = {surface.node: ONE}
        for index in self._shader_order(surface.node):
            weight = weights.get(index)
            if weight is None or is_zero(weight):
                continue
            self._shader(index, weight, weights)

    def _aovs(self) -> None:
        """Values for the AOVs that are asked for; the camera sees a world by its emission alone."""
        known = {aov.name: aov for aov in self.source.aovs}
        modes = (MODE_CLOSURES, MODE_EMISSION) if self.source.kind == "WORLD" else (MODE_CLOSURES,)
        for index in self._graph.aovs:
            builder = _ClosureBuilder(self, self._values, index)
            aov = known.get(builder.node.properties["aov_name"])
            if aov is None:
                continue
            socket = Socket("Color", COLOR) if aov.is_color else Socket("Value", FLOAT)
            immediates = (aov.column, 3 if aov.is_color else 1, aov.row_width)
            builder.closure(ops_closure.OP_AOV, ONE, (builder.input(socket),), immediates, modes=modes)

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
                    node = self._graph.nodes[index]
                    self._values.notice(node, "is part of a loop of links", "the loop is cut open there")
                elif link.node not in state:
                    visit(link.node)
            state[index] = 2
            order.append(index)

        visit(root)
        return order[::-1]

    def _shader_links(self, index: int) -> list[Link | None]:
        """Links into the shader sockets of a Mix or Add Shader, None where nothing usable is linked."""
        node = self._graph.nodes[index]
        if node.kind not in nodes_closure.MIXES:
            return []
        links = (node.inputs.get(name) for name in ("Shader", "Shader_001"))
        return [link if isinstance(link, Link) and self._values.exists(link, node.name) else None for link in links]

    def _shader(self, index: int, weight: Value, weights: dict[int, Value]) -> None:
        node = self._graph.nodes[index]
        builder = _ClosureBuilder(self, self._values, index)
        if node.kind in nodes_closure.MIXES:
            self._values.notice_unknown(node, nodes_closure.MIXES[node.kind])
            shares: tuple[Value, Value] = (weight, weight)
            if node.kind == nodes_closure.MIX_SHADER:
                shares = self._arithmetic.mix_weights(weight, builder.input(Socket("Fac", FLOAT, 0.5)))
            for link, share in zip(self._shader_links(index), shares, strict=True):
                if link is not None:
                    weights[link.node] = self._arithmetic.add(weights.get(link.node, ZERO), share)
            return
        closure = nodes_closure.CLOSURES.get(node.kind)
        if closure is not None:
            if closure.inputs is not None:
                self._values.notice_unknown(node, closure.inputs, closure.settings)
            closure.emit(node, weight, builder)
        elif gives_values(node.kind):
            # Blender shows a colour linked to the surface as emission.
            outputs = self._values.outputs(index, 0, 0.0)
            value, type_ = next(iter(outputs.values()), (_BLACK, COLOR))
            operands = (self._arithmetic.convert(value, type_, COLOR), ONE)
            builder.closure(ops_closure.OP_EMISSION, weight, operands, modes=(MODE_CLOSURES, MODE_EMISSION))
        else:
            self._values.notice(node, f"{node.kind} is not supported", "black")

    def _displacement(self) -> None:
        """Displacement as bump: the shading normal is replaced before the surface reads it.

        Emission and transparency alone are evaluated with the undisplaced normal.
        """
        link = self._graph.displacement
        method = self.source.displacement_method
        if link is None or method == "DISPLACEMENT" or not self._values.exists(link, "the output"):
            return
        position = self._undisplace() if method == "BOTH" else None
        heights = self._heights(link)
        if position is None and len(set(heights)) <= 1:
            return
        slot = normal_ops.BUMPED_IN_WORLD if position is None else self._pools.attribute_slot(UNDISPLACED)
        normal = NodeBuilder(self._values, -1).input(Socket("Normal", VECTOR, Implicit.NORMAL))
        bumped: Value = normal
        if len(set(heights)) > 1:
            operands = (*heights, ONE, ONE, normal, Constant((0.1,)))
            bump = Instruction(ops_input.OP_BUMP, operands, (3,), (0, slot))
            bumped = self._code.append(bump)[0]
        self._effect(ops_input.OP_SET_NORMAL, bumped)
        if position is not None:
            self._effect(ops_displacement.OP_SET_POSITION, position)
        # What follows must read the point again.
        self._values.forget()

    def _heights(self, link: Link) -> list[Value]:
        """Displacement along the normal, at the point and beside it; none where nothing is known of it."""
        builder = NodeBuilder(self._values, -1)
        builder.node = Node("displacement", self._graph.nodes[link.node].name)
        normal = builder.input(Socket("Normal", VECTOR, Implicit.NORMAL))
        heights: list[Value] = []
        for axis in (0, 1, 2):
            found = self._values.value(link, axis, 0.1)
            if found is None:
                return []
            vector = self._arithmetic.convert(*found, VECTOR)
            heights.append(self._code.append(Instruction(ops_input.OP_DOT, (vector, normal), (1,)))[0])
        return heights

    def _undisplace(self) -> Value:
        """Put the point where it was before displacement, for the bump of what is finer; where it is now."""
        slots = (self._pools.attribute_slot(UNDISPLACED), self._pools.attribute_slot(VERTEX_NORMALS))
        index = self._code.append_effect(Instruction(ops_displacement.OP_UNDISPLACE, (), (3,), slots))
        self._roots[MODE_CLOSURES].append(index)
        self._values.forget()
        return Register(index, 0, 3)

    def _effect(self, opcode: int, value: Value) -> None:
        """Append an instruction that changes the point for the closures."""
        index = self._code.append_effect(Instruction(opcode, (value,), ()))
        self._roots[MODE_CLOSURES].append(index)

    def _offset(self) -> None:
        """What the displacement moves a vertex by, in the world: left where emission is."""
        link = self._graph.displacement
        if link is None or not self._values.exists(link, "the output"):
            return
        found = self._values.value(link, 0, 0.0)
        if found is not None:
            operands = (ONE, self._arithmetic.convert(*found, VECTOR), ONE)
            self.add_closure(Instruction(ops_closure.OP_EMISSION, operands, ()), (MODE_EMISSION,))


class _ClosureBuilder(NodeBuilder):
    """What entries of closures see of the compiler besides."""

    def __init__(self, compiler: SurfaceCompiler, values: NodeValues, index: int) -> None:
        super().__init__(values, index)
        self._compiler = compiler
        self.multiply = values.arithmetic.multiply
        self.saturate = values.arithmetic.saturate

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
