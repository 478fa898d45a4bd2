# SPDX-License-Identifier: GPL-3.0-or-later
"""Run one entry of the node table on many inputs without the compiler: lower it, lay out its instruction, run it."""

from __future__ import annotations

from typing import Any

import numpy as np

from engine.kernels.shader.opcodes import MATH_FIRST, PATTERNS_FIRST, TEXTURE_FIRST
from engine.kernels.shader.ops_math import run_math_op
from engine.kernels.shader.ops_patterns import run_pattern_op
from engine.kernels.shader.ops_texture import run_texture_op
from engine.runtime.jit import kernel
from engine.scene.description import Node
from engine.shaders.nodes_patterns import NODES as PATTERNS
from engine.shaders.nodes_texture_math import NODES
from engine.shaders.table import Implicit
from engine.state.shaders import FIRST_REGISTER


class TableBuilder:
    """The part of the compiler that lowering functions talk to."""

    def __init__(self) -> None:
        self.values: list[float] = []
        self.notices: list[tuple[str, str]] = []

    def add_table(self, values: Any) -> int:
        start = len(self.values)
        self.values.extend(np.asarray(values, np.float32).ravel().tolist())
        return start

    def notice(self, problem: str, fallback: str) -> None:
        self.notices.append((problem, fallback))


@kernel
def _run_rows(code, memory, tables, sources, inputs, output, width, results):
    """For each row: copy its inputs into memory, run the instruction, copy out `width` floats."""
    for row in range(inputs.shape[0]):
        for column in range(inputs.shape[1]):
            memory[sources[column]] = inputs[row, column]
        if code[0] >= PATTERNS_FIRST:
            run_pattern_op(code, 0, memory)
        elif code[0] >= TEXTURE_FIRST:
            run_texture_op(code[0], code, 0, memory, tables)
        elif code[0] >= MATH_FIRST:
            run_math_op(code[0], code, 0, memory, tables)
        for column in range(width):
            results[row, column] = memory[output + column]


def run_node(
    kind: str, output: str, inputs: dict[str, Any], properties: dict[str, Any] | None = None
) -> np.ndarray:
    """Values of a node's output.

    Parameters
    ----------
    inputs : dict
        Socket identifier to a constant or a float32 array (rows,) or (rows, 3); all arrays with equal rows.

    Returns
    -------
    float32 (rows, 1 or 3)
    """
    builder = TableBuilder()
    entry = (NODES | PATTERNS)[kind]
    node = Node(kind, kind, {}, properties or {})
    operation = entry if not callable(entry) else entry(node, builder)
    assert not builder.notices, builder.notices

    slot = FIRST_REGISTER
    words = [operation.opcode, 0]
    output_slot, width = -1, 0
    for socket in operation.outputs:
        words.append(slot)
        if socket.identifier == output:
            output_slot, width = slot, socket.type.width
        slot += socket.type.width
    assert output_slot >= 0, f"{kind} has no output {output}"

    rows = max((len(value) for value in inputs.values() if isinstance(value, np.ndarray)), default=1)
    columns, sources = [], []
    unused = set(inputs)
    for socket in operation.inputs:
        value = inputs.get(socket.identifier, socket.default) if socket.identifier else socket.default
        unused.discard(socket.identifier)
        assert not isinstance(value, Implicit), f"give {socket.identifier} of {kind}"
        value = np.asarray(value, np.float32)
        if value.ndim == 0 or (value.ndim == 1 and value.shape[0] != rows) or socket.default is value:
            value = np.broadcast_to(value, (rows, *value.shape))
        value = value.reshape(rows, -1)
        if value.shape[1] == 1:
            value = np.repeat(value, socket.type.width, axis=1)
        words.append(slot)
        for channel in range(socket.type.width):
            sources.append(slot + channel)
            columns.append(value[:, channel])
        slot += socket.type.width
    assert not unused, f"{kind} has no inputs {unused}"
    words.extend(operation.immediates)
    words[1] = len(words)

    memory = np.zeros(slot, np.float32)
    results = np.zeros((rows, width), np.float32)
    _run_rows(
        np.array(words, np.int32),
        memory,
        np.array(builder.values or [0.0], np.float32),
        np.array(sources, np.int64),
        np.stack(columns, axis=1).astype(np.float32) if columns else np.zeros((rows, 0), np.float32),
        output_slot,
        width,
        results,
    )
    return results
