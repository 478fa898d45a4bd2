# SPDX-License-Identifier: GPL-3.0-or-later
"""The table of node kinds: what a newcomer extends, by one entry here and one kernel.

An entry maps a node kind to an `Operation`: the opcode of its instruction, its input sockets with types and defaults,
its output sockets, and integers packed behind the operands ("immediates": enum properties, table offsets). Where these
depend on the node's properties the entry is a function `lower(node, builder) -> Operation`. The kernel belonging to the
opcode is a branch in its group's function (`run_math_op`, `run_texture_op`, ... in engine/kernels/shader/ops_*.py).

The instruction that results is laid out as

    code[pc]     opcode
    code[pc+1]   length
    code[pc+2+k] memory index of output k, in the order of `outputs` (SINK = nobody reads it)
    then         memory index of each input, in the order of `inputs` (1 or 3 floats there)
    then         the immediates

What the compiler does for every entry, so that kernels need not: unlinked sockets become constants (`Socket.default`,
or the value in the node); linked values are converted to the socket's type as Cycles does; an instruction whose inputs
are all constants is run once at compile time by the very same kernel (unless `is_varying`); equal instructions on equal
operands run once; instructions nobody reads are dropped; where a Bump node needs heights at displaced points, what
depends on the point is emitted again.

Example: a node without options, and one with an enum and a table.

    NODES["ShaderNodeInvert"] = Operation(
        OP_INVERT,
        inputs=(Socket("Fac", FLOAT, 1.0), Socket("Color", COLOR, (0.0, 0.0, 0.0))),
        outputs=(Socket("Color", COLOR),),
    )

    def _color_ramp(node, builder):
        offset = builder.add_table(node.properties["ramp"])          # float32, any shape; deduplicated
        return Operation(OP_RAMP, (Socket("Fac", FLOAT, 0.5),),
                         (Socket("Color", COLOR), Socket("Alpha", FLOAT)), immediates=(offset, 256))

    NODES["ShaderNodeValToRGB"] = _color_ramp

In kernels a table is read as `tables[code[pc + k] + i]` (the immediate is the first float's index).
A float property that is not a socket is passed as an input that no node has: `Socket("", FLOAT, node.properties["x"])`.
A socket whose unlinked default comes from the surface uses an `Implicit` as its default, such as `Implicit.GENERATED`
for the Vector of procedural textures. Report what is not supported with `builder.notice(problem, fallback)`; enums read
by `options.choice` are reported by it. A new node's settings belong into `vocabulary.SETTINGS`. Closures have a table
of their own, engine/kernels/bsdf/lobes.py.
Identifiers are those of Blender 5.2 (`socket.identifier`), so a Mix node's are `Factor_Float`, `A_Color`, ...
Integer, boolean and rotation sockets are FLOAT, FLOAT and VECTOR.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import Any, Protocol

import numpy.typing as npt

from engine.scene.description import Node


class SocketType(Enum):
    """What a socket carries."""

    FLOAT = 1
    VECTOR = 2
    COLOR = 3
    SHADER = 4

    @property
    def width(self) -> int:
        """Floats it takes in memory."""
        return 1 if self is SocketType.FLOAT else 3


FLOAT = SocketType.FLOAT
VECTOR = SocketType.VECTOR
COLOR = SocketType.COLOR
SHADER = SocketType.SHADER


class Implicit(Enum):
    """Unlinked defaults that come from the surface."""

    NORMAL = "normal"
    GENERATED = "generated"
    UV = "uv"
    POSITION = "position"
    TANGENT = "tangent"
    OBJECT_NORMAL = "object normal"
    CURVE_RANDOM = "random number of a curve"
    CURVE_NORMAL = "normal of a curve, as it is stored"
    EDGE_U = "first edge of a triangle"
    EDGE_V = "last edge of a triangle"
    INCOMING = "direction that light leaves in"
    LOCAL_INCOMING = "direction that light leaves in, in the object's own space"
    CURVE_THICKNESS = "thickness of a curve"


@dataclass(frozen=True)
class Socket:
    """One socket: `identifier` as in `Node.inputs` and `Link.output`.

    `default` is used where the node gives no value; float, 3-tuple, or `Implicit`. Outputs ignore it.
    """

    identifier: str
    type: SocketType
    default: float | tuple[float, ...] | Implicit = 0.0


@dataclass(frozen=True)
class Operation:
    """One instruction, see the module's docstring. `is_varying`: it reads the shading point, so it is never folded."""

    opcode: int
    inputs: tuple[Socket, ...]
    outputs: tuple[Socket, ...]
    immediates: tuple[int, ...] = ()
    is_varying: bool = False


class Builder(Protocol):
    """What a lowering function may ask of the compiler."""

    def add_table(self, values: npt.ArrayLike) -> int:
        """Index of the first of `values` (flattened, float32) in the pool of tables."""

    def notice(self, problem: str, fallback: str) -> None:
        """Report something unsupported about the node being lowered."""


Lowering = Callable[[Node, Any], Operation]
NodeTable = dict[str, Operation | Lowering]
