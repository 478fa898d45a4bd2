# SPDX-License-Identifier: GPL-3.0-or-later
"""Layers of small perceptrons without bias, for kernels: a block of rows times a matrix, all sums in registers.

A library's product of matrices has to be called from Python and pays from hundreds of rows on; LLVM does not find a
good order of the three loops by itself, it stores each sum at every step. So the inner block is written in its own
terms: ROW_BLOCK rows by four vectors of eight columns are twelve sums, which with three factors and one vector of
weights fill the sixteen registers of AVX2.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.imputils import impl_ret_untracked
from numba.extending import intrinsic
from numba.np.arrayobj import make_array

from engine.jit import kernel

#: Rows whose sums are held at once.
ROW_BLOCK = 3
#: Columns of a vector register: widths of layers must be multiples.
VECTOR = 8
_WIDE = 4 * VECTOR
#: Widest layer that threads have memory for.
MAX_WIDTH = 128

_FLOAT = ir.FloatType()
_VECTOR = ir.VectorType(_FLOAT, VECTOR)
_WORD = ir.IntType(64)


def _make_block(row_count: int, vector_count: int) -> Callable[..., Any]:
    """An intrinsic for `row_count` rows by `vector_count` vectors of columns; see `multiply`."""

    @intrinsic
    def block(typing_context, source, source_at, source_stride, weights, weights_at, in_width, out_width, target,
              target_at, target_stride):  # fmt: skip
        def codegen(context: Any, builder: ir.IRBuilder, signature: Any, arguments: Any) -> Any:
            (source_, source_at_, source_stride_, weights_, weights_at_, in_width_, out_width_, target_, target_at_,
             target_stride_) = arguments  # fmt: skip
            multiply_add = ir.FunctionType(_VECTOR, [_VECTOR] * 3)
            fma = cgutils.get_or_insert_function(builder.module, multiply_add, f"llvm.fmuladd.v{VECTOR}f32")

            def data(index: int, value: Any) -> Any:
                array = make_array(signature.args[index])(context, builder, value)
                return builder.bitcast(array.data, _FLOAT.as_pointer())

            def splat(value: Any) -> Any:
                single = builder.insert_element(ir.Constant(_VECTOR, ir.Undefined), value, ir.Constant(_WORD, 0))
                mask = ir.Constant(ir.VectorType(ir.IntType(32), VECTOR), [0] * VECTOR)
                return builder.shuffle_vector(single, ir.Constant(_VECTOR, ir.Undefined), mask)

            source_data = builder.gep(data(0, source_), [source_at_])
            weights_data = builder.gep(data(3, weights_), [weights_at_])
            target_data = builder.gep(data(7, target_), [target_at_])
            zero, zeros = ir.Constant(_FLOAT, 0.0), ir.Constant(_VECTOR, [0.0] * VECTOR)

            entry = builder.block
            loop = builder.append_basic_block("inputs")
            after = builder.append_basic_block("done")
            builder.branch(loop)
            builder.position_at_end(loop)
            i = builder.phi(_WORD)
            i.add_incoming(ir.Constant(_WORD, 0), entry)
            sums = [[builder.phi(_VECTOR) for _ in range(vector_count)] for _ in range(row_count)]
            factors = []
            for row in range(row_count):
                at = builder.add(builder.mul(source_stride_, ir.Constant(_WORD, row)), i)
                value = builder.load(builder.gep(source_data, [at]))
                # The rectifier of the layer before. Written so that NaN becomes 0.
                factors.append(splat(builder.select(builder.fcmp_ordered(">", value, zero), value, zero)))
            weights_row = builder.gep(weights_data, [builder.mul(i, out_width_)])
            following: list[list[Any]] = [[] for _ in range(row_count)]
            for column in range(vector_count):
                pointer = builder.gep(weights_row, [ir.Constant(_WORD, column * VECTOR)])
                weight = builder.load(builder.bitcast(pointer, _VECTOR.as_pointer()), align=4)
                for row in range(row_count):
                    following[row].append(builder.call(fma, [factors[row], weight, sums[row][column]]))
            next_i = builder.add(i, ir.Constant(_WORD, 1))
            i.add_incoming(next_i, loop)
            for row in range(row_count):
                for column in range(vector_count):
                    sums[row][column].add_incoming(zeros, entry)
                    sums[row][column].add_incoming(following[row][column], loop)
            builder.cbranch(builder.icmp_signed("<", next_i, in_width_), loop, after)
            builder.position_at_end(after)
            for row in range(row_count):
                for column in range(vector_count):
                    at = builder.add(
                        builder.mul(target_stride_, ir.Constant(_WORD, row)), ir.Constant(_WORD, column * VECTOR)
                    )
                    pointer = builder.bitcast(builder.gep(target_data, [at]), _VECTOR.as_pointer())
                    builder.store(following[row][column], pointer, align=4)
            return impl_ret_untracked(context, builder, types.none, context.get_dummy_value())

        signature = types.none(
            source, types.int64, types.int64, weights, types.int64, types.int64, types.int64, target, types.int64,
            types.int64,
        )  # fmt: skip
        return signature, codegen

    return block


_several_wide = _make_block(ROW_BLOCK, 4)
_several_narrow = _make_block(ROW_BLOCK, 1)
_single_wide = _make_block(1, 4)
_single_narrow = _make_block(1, 1)


@kernel
def multiply(source, source_row, row_count, weights, layer, target, target_row):
    """Product of rectified rows and a layer's weights: target = max(source, 0) @ weights[layer]; NaN counts as 0.

    Parameters
    ----------
    source : float32 (S, stride), C-contiguous
        Rows from `source_row` on, of which the first `weights.shape[1]` columns are read.
    weights : float32 (layers, in, out), C-contiguous; `out` a multiple of VECTOR
    target : float32 (T, stride), C-contiguous
        Rows from `target_row` on, of which the first `out` columns are written. Not the rows of `source`.
    """
    in_width = np.int64(weights.shape[1])
    out_width = np.int64(weights.shape[2])
    source_stride = np.int64(source.shape[1])
    target_stride = np.int64(target.shape[1])
    column = np.int64(0)
    while column < out_width:
        is_wide = column + _WIDE <= out_width
        weights_at = np.int64(layer) * in_width * out_width + column
        row = np.int64(0)
        while row < row_count:
            source_at = (source_row + row) * source_stride
            target_at = (target_row + row) * target_stride + column
            if row + ROW_BLOCK <= row_count:
                if is_wide:
                    _several_wide(
                        source, source_at, source_stride, weights, weights_at, in_width, out_width, target, target_at,
                        target_stride,
                    )
                else:
                    _several_narrow(
                        source, source_at, source_stride, weights, weights_at, in_width, out_width, target, target_at,
                        target_stride,
                    )
                row += ROW_BLOCK
            else:
                if is_wide:
                    _single_wide(
                        source, source_at, source_stride, weights, weights_at, in_width, out_width, target, target_at,
                        target_stride,
                    )
                else:
                    _single_narrow(
                        source, source_at, source_stride, weights, weights_at, in_width, out_width, target, target_at,
                        target_stride,
                    )
                row += 1
        column += _WIDE if is_wide else VECTOR
