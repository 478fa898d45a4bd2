# SPDX-License-Identifier: GPL-3.0-or-later
"""Evaluating a perceptron without bias in a kernel: ReLU layers and a linear last one, a batch of rows at a time.

A block of six rows by sixteen columns stays in twelve vector registers while the inner loop runs over a layer's inputs:
per input two loads of weights and six of activations feed twelve multiply-adds, so that arithmetic is the limit and not
memory. Weights are packed into panels of sixteen columns, each contiguous: in a plain matrix 128 wide the rows of a
panel would evict one another from the level-1 cache. Rows go through all layers in chunks that stay in that cache.

The sum over inputs runs in one order for every element, whatever the batch: a row's result depends on that row alone.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from engine.array_types import Float32Array, Int64Array
from engine.runtime.bundle import Bundle, array_of
from engine.runtime.jit import kernel

#: Widest layer that threads have memory for.
MAX_WIDTH = 128
#: Columns of a panel, and rows that are computed at once.
PANEL = 16
BLOCK_ROWS = 6
#: Rows that go through all layers together: 128 activations each and a panel of weights fill 32 KiB.
CHUNK_ROWS = 48

_LANES = 8
_CACHE_LINE = 64

# Columns of Perceptron.layer
LAYER_INPUTS = 0
LAYER_PANELS = 1
LAYER_FIRST = 2
LAYER_FIELDS = 3


class Perceptron(Bundle):
    """Weights of all layers, packed.

    layer : int64 (layers, LAYER_FIELDS), inputs, panels of outputs, index of the first weight
    weights : float32 (count,), for each layer and panel the rows of its matrix: (inputs, PANEL)
    """

    layer: Int64Array
    weights: Float32Array


def pack_perceptron(matrices: Sequence[Float32Array]) -> Perceptron:
    """`Perceptron` of weight matrices float32 (inputs, outputs), first layer first; outputs are padded with zeros."""
    layer = np.zeros((len(matrices), LAYER_FIELDS), np.int64)
    first = 0
    for index, matrix in enumerate(matrices):
        panel_count = -(-matrix.shape[1] // PANEL)
        layer[index] = matrix.shape[0], panel_count, first
        first += matrix.shape[0] * panel_count * PANEL
    storage = np.zeros(first + _CACHE_LINE // 4, np.float32)
    # Panels begin at cache lines, so that no load straddles two.
    skip = -storage.ctypes.data % _CACHE_LINE // 4
    weights = storage[skip : skip + first]
    for (input_count, panel_count, start), matrix in zip(layer.tolist(), matrices, strict=True):
        panels = weights[start : start + input_count * panel_count * PANEL].reshape(panel_count, input_count, PANEL)
        padded = np.zeros((input_count, panel_count * PANEL), np.float32)
        padded[:, : matrix.shape[1]] = matrix
        panels[...] = padded.reshape(input_count, panel_count, PANEL).transpose(1, 0, 2)
    return Perceptron(layer, weights)


def allocate_scratch(widest: int) -> Float32Array:
    """Activations of a chunk before and after a layer: float32 (2 * CHUNK_ROWS, columns), for one thread.

    Parameters
    ----------
    widest : int
        Inputs of the first layer or outputs of any, whichever are more.
    """
    columns = -(-widest // PANEL) * PANEL
    storage = np.zeros(2 * CHUNK_ROWS * columns + _CACHE_LINE // 4, np.float32)
    skip = -storage.ctypes.data % _CACHE_LINE // 4
    return storage[skip : skip + 2 * CHUNK_ROWS * columns].reshape(2 * CHUNK_ROWS, columns)


@intrinsic
def _multiply_block(typing_context, scratch, source, target, weights, first, depth, column, is_rectified):
    """scratch[target:target + BLOCK_ROWS, column:column + PANEL] = the same rows of `source` times a panel.

    Written as vector instructions: left to itself, LLVM keeps the sums in memory. `scratch` is float32 (rows, columns),
    `weights` float32 (count,), all others int64; `depth` is at least 1. Where `is_rectified` is not 0, NaN and negative
    sums become 0.
    """

    def codegen(context, builder, signature, arguments):
        rows_value, source, target, weights_value, first, depth, column, is_rectified = arguments
        rows = array_of(context, builder, signature.args[0], rows_value)
        packed = array_of(context, builder, signature.args[3], weights_value)
        intp = first.type
        single = ir.FloatType()
        vector = ir.VectorType(single, _LANES)
        vector_count = PANEL // _LANES
        width = cgutils.unpack_tuple(builder, rows.shape)[1]
        zero = ir.Constant(vector, None)

        inputs = [
            builder.gep(rows.data, [builder.mul(builder.add(source, ir.Constant(intp, row)), width)])
            for row in range(BLOCK_ROWS)
        ]
        before = builder.block
        loop = builder.append_basic_block("inputs")
        after = builder.append_basic_block("sums")
        builder.branch(loop)

        builder.position_at_end(loop)
        k = builder.phi(intp, "k")
        k.add_incoming(ir.Constant(intp, 0), before)
        sums = [[builder.phi(vector) for _ in range(vector_count)] for _ in range(BLOCK_ROWS)]
        at = builder.add(first, builder.mul(k, ir.Constant(intp, PANEL)))
        loaded = []
        for part in range(vector_count):
            pointer = builder.gep(packed.data, [builder.add(at, ir.Constant(intp, part * _LANES))])
            loaded.append(builder.load(builder.bitcast(pointer, vector.as_pointer()), align=4))
        lanes = ir.Constant(ir.VectorType(ir.IntType(32), _LANES), None)
        undefined = ir.Constant(vector, ir.Undefined)
        following = []
        for row in range(BLOCK_ROWS):
            value = builder.load(builder.gep(inputs[row], [k]))
            lane = builder.insert_element(undefined, value, ir.Constant(ir.IntType(32), 0))
            spread = builder.shuffle_vector(lane, undefined, lanes)
            for part in range(vector_count):
                product = builder.fmul(spread, loaded[part], flags=("contract",))
                total = builder.fadd(sums[row][part], product, flags=("contract",))
                sums[row][part].add_incoming(zero, before)
                following.append((sums[row][part], total))
        next_k = builder.add(k, ir.Constant(intp, 1))
        for phi, total in following:
            phi.add_incoming(total, loop)
        k.add_incoming(next_k, loop)
        builder.cbranch(builder.icmp_signed("<", next_k, depth), loop, after)

        builder.position_at_end(after)
        keep = builder.icmp_signed("==", is_rectified, ir.Constant(intp, 0))
        for index, (_, total) in enumerate(following):
            row, part = divmod(index, vector_count)
            rectified = builder.select(builder.fcmp_ordered(">", total, zero), total, zero)
            value = builder.select(keep, total, rectified)
            offset = builder.mul(builder.add(target, ir.Constant(intp, row)), width)
            offset = builder.add(builder.add(offset, column), ir.Constant(intp, part * _LANES))
            pointer = builder.gep(rows.data, [offset])
            builder.store(value, builder.bitcast(pointer, vector.as_pointer()), align=4)
        return context.get_dummy_value()

    arguments = (scratch, types.int64, types.int64, weights, *((types.int64,) * 4))
    return types.none(*arguments), codegen


@kernel
def evaluate_chunk(perceptron, row_count, scratch):
    """Send the first rows of `scratch` through all layers.

    Parameters
    ----------
    perceptron : Perceptron
    row_count : int, at most CHUNK_ROWS
    scratch : float32 (2 * CHUNK_ROWS, columns), of `allocate_scratch`; inputs in the first `row_count` rows. Rows up to
        the next multiple of BLOCK_ROWS are computed too, from whatever is there

    Returns
    -------
    int
        Row of `scratch` where the outputs begin. Infinity and NaN are possible where weights or inputs are huge.
    """
    source = np.int64(0)
    target = np.int64(CHUNK_ROWS)
    layer_count = perceptron.layer.shape[0]
    for index in range(layer_count):
        depth = perceptron.layer[index, LAYER_INPUTS]
        first = perceptron.layer[index, LAYER_FIRST]
        is_rectified = np.int64(index + 1 < layer_count)
        for panel in range(perceptron.layer[index, LAYER_PANELS]):
            for row in range(0, row_count, BLOCK_ROWS):
                _multiply_block(
                    scratch, source + row, target + row, perceptron.weights, first, depth, panel * PANEL, is_rectified
                )
            first += depth * PANEL
        source, target = target, source
    return source


@kernel
def evaluate_perceptron(perceptron, inputs, row_count, scratch, out):
    """Outputs of the last layer for a batch of any size.

    Parameters
    ----------
    perceptron : Perceptron
    inputs : float32 (N, inputs of the first layer)
    row_count : int, rows to do, at most N
    scratch : float32 (2 * CHUNK_ROWS, columns), of `allocate_scratch`
    out : float32 (at least row_count, outputs), written
    """
    for start in range(0, row_count, CHUNK_ROWS):
        chunk = min(row_count - start, np.int64(CHUNK_ROWS))
        for row in range(chunk):
            for j in range(inputs.shape[1]):
                scratch[row, j] = inputs[start + row, j]
        first = evaluate_chunk(perceptron, chunk, scratch)
        for row in range(chunk):
            for j in range(out.shape[1]):
                out[start + row, j] = scratch[first + row, j]
