# SPDX-License-Identifier: GPL-3.0-or-later
"""What the outputs of nodes carry: each node is lowered once for each point, by its entry in the table of nodes."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import numpy as np
import numpy.typing as npt

from engine.array_types import Float32Array
from engine.kernels.shader import ops_input, ops_math, ops_rays
from engine.scene.description import Image, Link, Node, NodeGraph
from engine.shaders import (
    nodes_bump,
    nodes_closure,
    nodes_ies,
    nodes_image,
    nodes_input,
    nodes_patterns,
    nodes_rays,
    nodes_sky,
    nodes_texture_math,
)
from engine.shaders.arithmetic import Arithmetic
from engine.shaders.lamp_facts import LampFacts
from engine.shaders.pools import ScenePools
from engine.shaders.program import Constant, Instruction, Value
from engine.shaders.table import COLOR, FLOAT, VECTOR, Implicit, NodeTable, Operation, Socket, SocketType
from engine.shaders.vocabulary import SETTINGS, unknown_parts

NODES: NodeTable = (
    nodes_input.NODES | nodes_image.NODES | nodes_rays.NODES | nodes_sky.NODES | nodes_ies.NODES
    | nodes_texture_math.NODES | nodes_patterns.NODES
)

#: What counts instead of a link from what is not known.
UNLINKED = "as if it were not linked"

#: Identifier of an output to its value.
_Outputs = dict[str, tuple[Value, SocketType]]


def gives_values(kind: str) -> bool:
    """Whether nodes of this kind are in the table, as what `Operation`s, composites or single outputs say."""
    return kind in NODES or kind in nodes_input.OUTPUTS or kind in nodes_bump.COMPOSITES


class NodeValues:
    """Values of one graph.

    Parameters
    ----------
    is_inside : bool
        Whether they are wanted at points within a volume.
    has_smooth_voxels : bool
        Whether voxels there are interpolated by cubic splines.
    is_displaced : bool
        Whether the surface has been displaced.
    lamp : LampFacts or None
        `ProgramSource.lamp`.
    """

    def __init__(
        self, name: str, graph: NodeGraph, pools: ScenePools, *, is_inside: bool = False,
        has_smooth_voxels: bool = False, is_displaced: bool = False,
        lamp: LampFacts | None = None,
    ) -> None:
        self.name = name
        self.is_inside = is_inside
        self.has_smooth_voxels = has_smooth_voxels
        self.is_displaced = is_displaced
        self.lamp = lamp
        self.graph = graph
        self.pools = pools
        self.arithmetic = Arithmetic(pools)
        #: Outputs of node (index, axis, filter width); None while being computed.
        self._finished: dict[tuple[int, int, float], _Outputs | None] = {}
        self._linked_outputs = {
            (link.node, link.output) for node in graph.nodes for link in node.inputs.values() if isinstance(link, Link)
        }

    def notice(self, node: Node, problem: str, fallback: str) -> None:
        """Report something about a node."""
        self.pools.notice(f"{self.name} / {node.name}", problem, fallback)

    def notice_unknown(
        self, node: Node, known_inputs: Collection[str], known_settings: Collection[str] | None = None
    ) -> None:
        """Report inputs and settings of a node that are not known; None: its settings are in the vocabulary."""
        settings = SETTINGS.get(node.kind, ()) if known_settings is None else known_settings
        for part in unknown_parts(node, known_inputs, settings):
            self.notice(node, f"{part} is not supported", "as if it were not there")

    def exists(self, link: Link, reader: str) -> bool:
        """Whether a link comes from a node; if not, it is reported as `reader`'s."""
        if 0 <= link.node < len(self.graph.nodes):
            return True
        self.pools.notice(f"{self.name} / {reader}", "is linked to a node that does not exist", "unlinked")
        return False

    def is_linked(self, index: int, identifier: str) -> bool:
        """Whether anything in the graph reads this output."""
        return (index, identifier) in self._linked_outputs

    def value(self, link: Link, axis: int, width: float) -> tuple[Value, SocketType] | None:
        """What an output carries, at the point displaced along `axis`; None: nothing is known of it.

        Then there is no link, as in Cycles, which leaves links out whose node or output it does not know.
        """
        node = self.graph.nodes[link.node]
        outputs = self.outputs(link.node, axis, width)
        if link.output in outputs:
            return outputs[link.output]
        if outputs:
            self.notice(node, f"has no output {link.output!r}", UNLINKED)
        return None

    def outputs(self, index: int, axis: int, width: float) -> _Outputs:
        """All that a node's outputs carry, at the point displaced along `axis`."""
        key = (index, axis, width)
        if key in self._finished:
            known = self._finished[key]
            if known is None:
                self.notice(self.graph.nodes[index], "is part of a loop of links", "the loop is cut open there")
                return {}
            return known
        self._finished[key] = None
        outputs = self._lower(index, axis, width)
        self._finished[key] = outputs
        return outputs

    def forget(self) -> None:
        """Read the point anew from here on: it has changed."""
        self.arithmetic.code.forget()
        self._finished.clear()

    def emit(self, operation: Operation, builder: NodeBuilder) -> tuple[Value, ...]:
        """Values of the operation's outputs, folded where its inputs are constants."""
        inputs = tuple(builder.input(socket) for socket in operation.inputs)
        if operation.opcode < 0:
            return inputs
        if operation.opcode == ops_math.OP_LUMINANCE and self.pools.luminance is not None:
            return (self.arithmetic.convert(inputs[0], COLOR, FLOAT),)
        widths = tuple(socket.type.width for socket in operation.outputs)
        instruction = Instruction(operation.opcode, inputs, widths, operation.immediates)
        return self.arithmetic.append(instruction, operation.is_varying)

    def _lower(self, index: int, axis: int, width: float) -> _Outputs:
        node = self.graph.nodes[index]
        builder = NodeBuilder(self, index, axis, width)
        composite = nodes_bump.COMPOSITES.get(node.kind)
        if composite is not None:
            self.notice_unknown(node, composite.inputs)
            return {composite.output: (composite.emit(node, builder), VECTOR)}
        separate = nodes_input.OUTPUTS.get(node.kind)
        if separate is not None:
            self.notice_unknown(node, ())
            return _LazyOutputs(self, node, builder, separate)
        entry = NODES.get(node.kind)
        if entry is None:
            if node.kind in nodes_closure.CLOSURES or node.kind in nodes_closure.MIXES:
                problem = "is a shader linked to a value"
            else:
                problem = f"{node.kind} is not supported"
            self.notice(node, problem, UNLINKED)
            return {}
        operation = entry if isinstance(entry, Operation) else entry(node, builder)
        # What has no instruction has been reported whole, or has no inputs.
        if operation.opcode >= 0:
            self.notice_unknown(node, [socket.identifier for socket in operation.inputs])
        values = self.emit(operation, builder)
        if operation.opcode in (ops_math.OP_BLACKBODY, ops_math.OP_WAVELENGTH):
            values = (self.in_working_space(values[0]),)
        types = [socket.type for socket in operation.outputs]
        names = [socket.identifier for socket in operation.outputs]
        outputs = {name: (value, type_) for name, value, type_ in zip(names, values, types, strict=False)}
        if node.kind == "ShaderNodeAttribute":
            outputs["Vector"] = (outputs["Color"][0], VECTOR)
        elif operation.opcode == ops_rays.OP_RAYCAST:
            hit, place = (outputs[name][0] for name in nodes_rays.HIT_OUTPUTS)
            outputs.update(nodes_rays.hit_attributes(node, builder, hit, place))
        return outputs

    def in_working_space(self, color: Value) -> Value:
        """A colour that kernels know in Rec.709 only, in the working space."""
        matrix = self.pools.from_rec709
        if matrix is None:
            return color
        append = self.arithmetic.append
        channels = tuple(
            append(Instruction(ops_input.OP_DOT, (color, Constant(tuple(row))), (1,)), is_varying=False)[0]
            for row in matrix.tolist()
        )
        return append(Instruction(ops_math.OP_COMBINE_XYZ, channels, (3,)), is_varying=False)[0]


class NodeBuilder:
    """What node entries see of the compiler: one node, at the point displaced along `axis` (0 = not)."""

    def __init__(self, values: NodeValues, index: int, axis: int = 0, filter_width: float = 0.0) -> None:
        self._values = values
        self.index = index
        self.axis = axis
        self.filter_width = filter_width if axis else 0.0
        self._width = filter_width
        self.node = values.graph.nodes[index] if index >= 0 else Node("", "")

    def input(self, socket: Socket) -> Value:
        """Value of an input socket, converted to its type."""
        given = self.node.inputs.get(socket.identifier) if socket.identifier else None
        values = self._values
        if isinstance(given, Link):
            found = values.value(given, self.axis, self._width) if values.exists(given, self.node.name) else None
            if found is not None:
                return values.arithmetic.convert(*found, socket.type)
            given = given.otherwise
        if given is None:
            given = socket.default
        if isinstance(given, Implicit):
            operation = nodes_input.IMPLICIT[given](self.node, self)
            return values.arithmetic.convert(values.emit(operation, self)[0], operation.outputs[0].type, socket.type)
        return _constant(given, socket)

    def constant_input(self, socket: Socket) -> tuple[float, ...] | None:
        """The value of an input if it is a constant, else None."""
        value = self.input(socket)
        return value.value if isinstance(value, Constant) else None

    def is_linked(self, identifier: str) -> bool:
        """Whether anything reads this output of the node."""
        return self._values.is_linked(self.index, identifier)

    def displaced(self, axis: int, filter_width: float) -> NodeBuilder:
        """The same node at the point displaced along `axis`."""
        return NodeBuilder(self._values, self.index, axis, filter_width)

    def append(self, instruction: Instruction, is_varying: bool) -> tuple[Value, ...]:
        """Append an instruction, or fold it."""
        return self._values.arithmetic.append(instruction, is_varying)

    def notice(self, problem: str, fallback: str) -> None:
        """Report something about the node."""
        self._values.notice(self.node, problem, fallback)

    def add_table(self, values: npt.ArrayLike) -> int:
        """Index of the first of `values` in the pool of tables."""
        return self._values.pools.add_table(values)

    def attribute_slot(self, name: str) -> int:
        """Slot of a mesh attribute."""
        return self._values.pools.attribute_slot(name)

    @property
    def lamp(self) -> LampFacts | None:
        """`ProgramSource.lamp`."""
        return self._values.lamp

    @property
    def to_xyz(self) -> Float32Array | None:
        """Matrix of the working space to CIE XYZ; None: it is Rec.709."""
        return self._values.pools.to_xyz

    @property
    def is_inside(self) -> bool:
        """Whether the point is within a volume, where attributes are grids."""
        return self._values.is_inside

    @property
    def is_displaced(self) -> bool:
        """Whether the surface has been displaced."""
        return self._values.is_displaced

    @property
    def has_smooth_voxels(self) -> bool:
        """Whether grids are interpolated by cubic splines."""
        return self._values.has_smooth_voxels

    def has_grid(self, name: str) -> bool:
        """Whether any volume of the scene has a grid of this name."""
        return self._values.pools.has_grid(name)

    def image(self, index: int) -> tuple[int, Image] | None:
        """Row of an image and what it is but for its pixels, None if it is missing."""
        image = self._values.pools.image(index)
        if image is None:
            self.notice("has no image", "magenta, as Cycles shows it")
        return None if image is None else (index, image)


class _LazyOutputs(_Outputs):
    """Outputs of a node that has an instruction for each: lowered when first asked for."""

    def __init__(self, values: NodeValues, node: Node, builder: NodeBuilder, entries: nodes_input.Outputs) -> None:
        super().__init__()
        self._parts: tuple[Any, ...] = (values, node, builder, entries)

    def __contains__(self, identifier: object) -> bool:
        return identifier in self._parts[3]

    def __bool__(self) -> bool:
        return True

    def __missing__(self, identifier: str) -> tuple[Value, SocketType]:
        values, node, builder, entries = self._parts
        operation = entries[identifier](node, builder)
        # What an instruction gives besides has a name.
        place = next((row for row, socket in enumerate(operation.outputs) if not socket.identifier), 0)
        self[identifier] = (values.emit(operation, builder)[place], operation.outputs[place].type)
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
