# SPDX-License-Identifier: GPL-3.0-or-later
"""Eight floats that are computed with at once, for kernels where LLVM finds no vectors by itself.

A loop over eight rows is unrolled before LLVM looks for vectors, and then stays what it was. In kernels an `EIGHT` is a
value like a float: it has the arithmetic operators and, for `choose`, comparisons. `absolute`, `root`, `choose` and
`larger` take plain floats as well, so that one kernel serves both. Where NUMBA_DISABLE_JIT is set it is a numpy array.
"""

import operator
from collections.abc import Callable
from typing import Any

import numba
import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.imputils import lower_builtin
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import intrinsic, models, register_model

from engine.runtime.bounds import all_within, several_within
from engine.runtime.bundle import FieldType, array_of
from engine.runtime.jit import kernel

#: How many.
WIDTH = 8

_WORD = ir.IntType(32)
_FLOATS = ir.VectorType(ir.FloatType(), WIDTH)
_SHORTS = ir.VectorType(ir.IntType(16), WIDTH)
_BITS = ir.VectorType(ir.IntType(1), WIDTH)


class EightType(types.Type):
    """Numba's type of eight float32."""


class FlagsType(types.Type):
    """Numba's type of eight booleans."""


EIGHT = EightType("eight")
FLAGS = FlagsType("eight flags")


@register_model(EightType)
class _EightModel(models.PrimitiveModel):
    def __init__(self, dmm: Any, fe_type: Any) -> None:
        super().__init__(dmm, fe_type, _FLOATS)


@register_model(FlagsType)
class _FlagsModel(models.PrimitiveModel):
    def __init__(self, dmm: Any, fe_type: Any) -> None:
        super().__init__(dmm, fe_type, _BITS)


def _is_operand(operand: Any) -> bool:
    return isinstance(operand, (EightType, types.Float))


def _eight(context: Any, builder: Any, operand: Any, value: Any) -> Any:
    """An operand's eight floats: its own, or a number's eight times."""
    if isinstance(operand, EightType):
        return value
    value = context.cast(builder, value, operand, types.float32)
    first = builder.insert_element(ir.Constant(_FLOATS, ir.Undefined), value, ir.Constant(_WORD, 0))
    return builder.shuffle_vector(first, first, ir.Constant(ir.VectorType(_WORD, WIDTH), [0] * WIDTH))


def _register(operation: Any, operand: Any, result: Any, lower: Callable[[Any, Any, Any], Any]) -> None:
    """Let an operator take two of a type, or of EIGHT one and a number."""

    class Template(AbstractTemplate):
        """What the operator returns."""

        def generic(self, args: Any, kws: Any) -> Any:
            fits = _is_operand if operand is EightType else (lambda argument: isinstance(argument, operand))
            if len(args) == 2 and all(map(fits, args)) and any(isinstance(argument, operand) for argument in args):
                return signature(result, *args)
            return None

    infer_global(operation)(Template)

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        if operand is EightType:
            args = [_eight(context, builder, *pair) for pair in zip(sig.args, args, strict=True)]
        return lower(builder, *args)

    lower_builtin(operation, operand, operand)(generate)
    if operand is EightType:
        lower_builtin(operation, operand, types.Float)(generate)
        lower_builtin(operation, types.Float, operand)(generate)


_register(operator.add, EightType, EIGHT, lambda builder, a, b: builder.fadd(a, b))
_register(operator.sub, EightType, EIGHT, lambda builder, a, b: builder.fsub(a, b))
_register(operator.mul, EightType, EIGHT, lambda builder, a, b: builder.fmul(a, b))
_register(operator.truediv, EightType, EIGHT, lambda builder, a, b: builder.fdiv(a, b))
_register(operator.gt, EightType, FLAGS, lambda builder, a, b: builder.fcmp_ordered(">", a, b))
_register(operator.ge, EightType, FLAGS, lambda builder, a, b: builder.fcmp_ordered(">=", a, b))
_register(operator.le, EightType, FLAGS, lambda builder, a, b: builder.fcmp_ordered("<=", a, b))
_register(operator.and_, FlagsType, FLAGS, lambda builder, a, b: builder.and_(a, b))
_register(operator.or_, FlagsType, FLAGS, lambda builder, a, b: builder.or_(a, b))


def _intrinsic_of(context: Any, builder: Any, name: str, value: Any) -> Any:
    suffix = f"v{WIDTH}f32" if value.type == _FLOATS else "f32"
    function = cgutils.get_or_insert_function(
        builder.module, ir.FunctionType(value.type, [value.type]), f"llvm.{name}.{suffix}"
    )
    return builder.call(function, [value])


def _real(typ: Any) -> Any:
    """EIGHT or float32: what a function returns for one of these."""
    return EIGHT if isinstance(typ, EightType) else types.float32


def _place(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    """Where eight floats are, of arguments that begin with array, group and column."""
    array_type = signature.args[0]
    rows = array_of(context, builder, array_type, arguments[0])
    indices = [
        context.cast(builder, index, index_type, types.intp)
        for index, index_type in zip(arguments[1:3], signature.args[1:3], strict=True)
    ]
    indices.append(ir.Constant(indices[0].type, 0))
    if isinstance(array_type, FieldType):
        array_type = array_type.array_type
    indices = all_within(context, builder, rows, indices)
    pointer = cgutils.get_item_pointer(context, builder, array_type, rows, indices)
    return builder.bitcast(pointer, _FLOATS.as_pointer())


def _behind(builder: Any, first: Any, stride: Any = None) -> Any:
    """Index of the last of eight elements."""
    steps = ir.Constant(first.type, WIDTH - 1)
    return builder.add(first, steps if stride is None else builder.mul(stride, steps))


@intrinsic
def _load(typing_context: Any, array: Any, group: Any, column: Any) -> Any:

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.load(_place(context, builder, signature, arguments), align=4)

    return EIGHT(array, group, column), generate


@intrinsic
def _load_from(typing_context: Any, array: Any, row: Any, first: Any) -> Any:

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        array_type = signature.args[0]
        rows = array_of(context, builder, array_type, arguments[0])
        if isinstance(array_type, FieldType):
            array_type = array_type.array_type
        row, first = arguments[1:3]
        first = several_within(context, builder, rows, first, _behind(builder, first))
        pointer = cgutils.get_item_pointer(context, builder, array_type, rows, [row, first])
        return builder.load(builder.bitcast(pointer, _FLOATS.as_pointer()), align=4)

    return EIGHT(array, types.intp, types.intp), generate


def _words_as_floats(builder: Any, words: Any) -> Any:
    return builder.sitofp(builder.zext(words, ir.VectorType(_WORD, WIDTH)), _FLOATS)


@intrinsic
def _words_from(typing_context: Any, array: Any, first: Any) -> Any:

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        words = array_of(context, builder, signature.args[0], arguments[0])
        first = several_within(context, builder, words, arguments[1], _behind(builder, arguments[1]))
        pointer = builder.bitcast(builder.gep(words.data, [first]), _SHORTS.as_pointer())
        return _words_as_floats(builder, builder.load(pointer, align=2))

    return EIGHT(array, types.intp), generate


@intrinsic
def _words_apart(typing_context: Any, array: Any, first: Any, stride: Any) -> Any:

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        array = array_of(context, builder, signature.args[0], arguments[0])
        last = _behind(builder, arguments[1], arguments[2])
        pointer = builder.gep(array.data, [several_within(context, builder, array, arguments[1], last)])
        words = ir.Constant(_SHORTS, ir.Undefined)
        for k in range(WIDTH):
            words = builder.insert_element(words, builder.load(pointer), ir.Constant(_WORD, k))
            pointer = builder.gep(pointer, [arguments[2]]) if k + 1 < WIDTH else pointer
        return _words_as_floats(builder, words)

    return EIGHT(array, types.intp, types.intp), generate


@intrinsic
def _counted_from(typing_context: Any, x: Any) -> Any:

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        steps = ir.Constant(_FLOATS, [float(k) for k in range(WIDTH)])
        return builder.fadd(_eight(context, builder, types.float32, arguments[0]), steps)

    return EIGHT(types.float32), generate


@intrinsic
def _store(typing_context: Any, array: Any, group: Any, column: Any, x: Any) -> Any:

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        pointer = _place(context, builder, signature, arguments)
        builder.store(arguments[3], pointer, align=4)
        return context.get_dummy_value()

    return types.void(array, group, column, EIGHT), generate


@intrinsic
def _absolute(typing_context: Any, x: Any) -> Any:
    real = _real(x)
    return real(real), lambda context, builder, _, args: _intrinsic_of(context, builder, "fabs", args[0])


@intrinsic
def _root(typing_context: Any, x: Any) -> Any:

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        zero = ir.Constant(_FLOATS, [0.0] * WIDTH) if arguments[0].type == _FLOATS else ir.Constant(ir.FloatType(), 0.0)
        is_positive = builder.fcmp_ordered(">", arguments[0], zero)
        return _intrinsic_of(context, builder, "sqrt", builder.select(is_positive, arguments[0], zero))

    real = _real(x)
    return real(real), generate


@intrinsic
def _choose(typing_context: Any, flags: Any, a: Any, b: Any) -> Any:

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        pairs = list(zip(signature.args[1:], arguments[1:], strict=True))
        if is_eight:
            a, b = (_eight(context, builder, *pair) for pair in pairs)
        else:
            a, b = (context.cast(builder, value, typ, types.float32) for typ, value in pairs)
        return builder.select(arguments[0], a, b)

    is_eight = isinstance(flags, FlagsType) or isinstance(a, EightType) or isinstance(b, EightType)
    return (EIGHT if is_eight else types.float32)(flags, a, b), generate


@intrinsic
def _sums_before(typing_context: Any, x: Any) -> Any:

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        zero = ir.Constant(_FLOATS, [0.0] * WIDTH)

        def moved(value: Any, count: int) -> Any:
            places = [k - count if k >= count else WIDTH for k in range(WIDTH)]
            return builder.shuffle_vector(value, zero, ir.Constant(ir.VectorType(_WORD, WIDTH), places))

        total = moved(arguments[0], 1)
        for count in (1, 2, 4):
            total = builder.fadd(total, moved(total, count))
        return total

    return EIGHT(EIGHT), generate


@intrinsic
def _sum_of(typing_context: Any, x: Any) -> Any:

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        total = arguments[0]
        for count in (4, 2, 1):
            places = [(k + count) % WIDTH for k in range(WIDTH)]
            total = builder.fadd(
                total, builder.shuffle_vector(total, total, ir.Constant(ir.VectorType(_WORD, WIDTH), places))
            )
        return builder.extract_element(total, ir.Constant(_WORD, 0))

    return types.float32(EIGHT), generate


@intrinsic
def _at(typing_context: Any, x: Any, k: Any) -> Any:

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.extract_element(arguments[0], arguments[1])

    return types.float32(EIGHT, types.int64), generate


@intrinsic
def _count_of(typing_context: Any, flags: Any) -> Any:

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        bits = builder.zext(builder.bitcast(arguments[0], ir.IntType(WIDTH)), _WORD)
        return builder.zext(builder.ctpop(bits), ir.IntType(64))

    return types.int64(FLAGS), generate


@intrinsic
def _last_of(typing_context: Any, flags: Any) -> Any:

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        bits = builder.zext(builder.bitcast(arguments[0], ir.IntType(WIDTH)), _WORD)
        zeros = builder.ctlz(bits, ir.Constant(ir.IntType(1), 0))
        return builder.sext(builder.sub(ir.Constant(_WORD, 31), zeros), ir.IntType(64))

    return types.int64(FLAGS), generate


def _sums_in_python(x: Any) -> Any:
    return np.concatenate([[np.float32(0.0)], np.cumsum(x[:-1], dtype=np.float32)])


def _last_in_python(flags: Any) -> int:
    return int(np.flatnonzero(flags)[-1]) if np.any(flags) else -1


def _choose_in_python(flags: Any, a: Any, b: Any) -> Any:
    return np.where(flags, a, b) if np.ndim(flags) or np.ndim(a) or np.ndim(b) else np.float32(a if flags else b)


def _store_in_python(array: Any, i: Any, j: Any, x: Any) -> None:
    array[i, j] = x


def _for_kernels(compiled: Any, in_python: Any) -> Any:
    return in_python if numba.config.DISABLE_JIT else compiled


#: `load_eight(array, i, j)`: array[i, j] of a float32 array whose last dimension is eight.
load_eight = _for_kernels(_load, lambda array, i, j: array[i, j])
#: `load_from(array, i, j)`: array[i, j : j + 8] of a float32 array of two dimensions.
load_from = _for_kernels(_load_from, lambda array, i, j: array[i, j : j + WIDTH])
#: `words_from(array, i)`: array[i : i + 8] of a uint16 array, as floats.
words_from = _for_kernels(_words_from, lambda array, i: array[i : i + WIDTH].astype(np.float32))
#: `words_apart(array, i, stride)`: array[i], array[i + stride] and so on, eight of a uint16 array, as floats.
words_apart = _for_kernels(
    _words_apart, lambda array, i, stride: array[i : i + WIDTH * stride : stride][:WIDTH].astype(np.float32)
)
#: `counted_from(x)`: x, x + 1 and so on.
counted_from = _for_kernels(_counted_from, lambda x: x + np.arange(WIDTH, dtype=np.float32))
#: `store_eight(array, i, j, x)`: write it.
store_eight = _for_kernels(_store, _store_in_python)
#: `absolute(x)`: magnitudes of eight floats, or of one.
absolute = _for_kernels(_absolute, np.abs)
#: `root(x)`: square roots of eight floats, or of one; 0 of negative ones.
root = _for_kernels(_root, lambda x: np.sqrt(np.maximum(x, np.float32(0.0))))
#: `choose(flags, a, b)`: a where the flag is set, else b; each eight floats or a number, and so may flag be one.
choose = _for_kernels(_choose, _choose_in_python)
#: `sums_before(x)`: of each float the sum of those before it.
sums_before = _for_kernels(_sums_before, _sums_in_python)
#: `sum_of(x)`: all eight added up.
sum_of = _for_kernels(_sum_of, lambda x: np.sum(x, dtype=np.float32))
#: `at(x, k)`: float k.
at = _for_kernels(_at, lambda x, k: x[k])
#: `count_of(flags)`: how many flags are set.
count_of = _for_kernels(_count_of, lambda flags: int(np.sum(flags)))
#: `last_of(flags)`: which is the last flag that is set, -1 = none.
last_of = _for_kernels(_last_of, _last_in_python)


@kernel
def larger(a, b):
    """The larger one of two numbers; each eight floats or one."""
    return choose(a > b, a, b)
