# SPDX-License-Identifier: GPL-3.0-or-later
"""`rng.sample_4d` for eight paths at once: the same numbers, bit for bit.

A set's numbers follow from hashes whose steps wait for each other. Eight paths side by side wait once.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic
from numba.np.arrayobj import make_array

from engine.kernels.pixel_shifts import PLACE_BITS
from engine.kernels.rng import SHIFTS, SOBOL
from engine.runtime.bundle import FieldType, array_of
from engine.runtime.jit import kernel
from engine.state.lanes import DRAW_DIMENSION, DRAW_RNG, DRAW_SAMPLE, DRAW_WIDTH

_WORD = ir.IntType(32)
_WORDS = ir.VectorType(_WORD, DRAW_WIDTH)
_FLOATS = ir.VectorType(ir.FloatType(), DRAW_WIDTH)
_POINT = ir.VectorType(_WORD, 4)
#: As `rng._INDEX_BITS`.
_INDEX_BITS = 16


class _Hashes:
    """The functions of `rng` on eight words: each writes the instructions that the kernel there is compiled to."""

    def __init__(self, builder: Any) -> None:
        self.builder = builder

    def splat(self, value: int) -> Any:
        """Eight times the same word."""
        return ir.Constant(_WORDS, [value & 0xFFFFFFFF] * DRAW_WIDTH)

    def _xor_shifted(self, x: Any, bits: int) -> Any:
        return self.builder.xor(x, self.builder.lshr(x, self.splat(bits)))

    def _xor_times(self, x: Any, factor: int) -> Any:
        return self.builder.xor(x, self.times(x, factor))

    def times(self, x: Any, factor: int) -> Any:
        """Each word times a number."""
        return self.builder.mul(x, self.splat(factor))

    def mix(self, x: Any) -> Any:
        """What `rng.hash_combine` does once both words are in one."""
        x = self.times(self._xor_shifted(x, 16), 0x7FEB352D)
        return self._xor_shifted(self.times(self._xor_shifted(x, 15), 0x846CA68B), 16)

    def hash_combine(self, a: Any, b: Any) -> Any:
        """`rng.hash_combine`."""
        return self.mix(self.builder.xor(a, self.builder.add(self.times(b, 0x9E3779B9), self.splat(0x7F4A7C15))))

    def laine_karras(self, x: Any, seed: Any) -> Any:
        """`rng.laine_karras`."""
        x = self.builder.add(self._xor_times(x, 0x3D20ADEA), seed)
        odd = self.builder.or_(self.builder.lshr(seed, self.splat(16)), self.splat(1))
        return self._xor_times(self._xor_times(self.builder.mul(x, odd), 0x05526C56), 0x53A22864)

    def reverse(self, x: Any) -> Any:
        """`rng.reverse_bits`."""
        kind = ir.FunctionType(_WORDS, [_WORDS])
        function = cgutils.get_or_insert_function(self.builder.module, kind, f"llvm.bitreverse.v{DRAW_WIDTH}i32")
        return self.builder.call(function, [x])


def _rows_of(context: Any, builder: Any, typ: Any, value: Any, row: int, vector: Any) -> Any:
    """Pointer to the eight elements of a row of a bundle's array, or of an array; of three dimensions it is the last
    but one's."""
    array = array_of(context, builder, typ, value)
    array_type = typ.array_type if isinstance(typ, FieldType) else typ
    zero = ir.Constant(ir.IntType(64), 0)
    indices = [zero] * (array_type.ndim - 2) + [ir.Constant(ir.IntType(64), row), zero]
    pointer = cgutils.get_item_pointer(context, builder, array_type, array, indices)
    return builder.bitcast(pointer, vector.as_pointer())


def _points(context: Any, builder: Any, signature: Any, arguments: Any, index: Any, place: Any) -> Sequence[Any]:
    """Four words of each of eight points, shifted: by coordinate, eight words each."""
    pointer = ir.IntType(8).as_pointer()
    tables = [
        builder.bitcast(make_array(typ)(context, builder, value).data, pointer)
        for typ, value in zip(signature.args[:2], arguments[:2], strict=True)
    ]

    def row_of(table: Any, row: Any) -> Any:
        offset = builder.zext(builder.shl(row, ir.Constant(_WORD, 4)), ir.IntType(64))
        return builder.load(builder.bitcast(builder.gep(table, [offset]), _POINT.as_pointer()), align=4)

    def look_up(x: Any, number: Any, groups: range) -> Any:
        for group in groups:
            row = builder.and_(builder.lshr(number, ir.Constant(_WORD, 4 * group)), ir.Constant(_WORD, 15))
            x = builder.xor(x, row_of(tables[0], builder.add(row, ir.Constant(_WORD, 16 * group))))
        return x

    lanes = [ir.Constant(_WORD, k) for k in range(DRAW_WIDTH)]
    numbers = [builder.extract_element(index, lane) for lane in lanes]
    rooms = [
        cgutils.alloca_once_value(
            builder, look_up(row_of(tables[1], builder.extract_element(place, lane)), number, range(4))
        )
        for lane, number in zip(lanes, numbers, strict=True)
    ]
    # Indices within `_INDEX_BITS` are the rule.
    upper = builder.lshr(index, ir.Constant(_WORDS, [_INDEX_BITS] * DRAW_WIDTH))
    any_upper = builder.bitcast(
        builder.icmp_unsigned("!=", upper, ir.Constant(_WORDS, [0] * DRAW_WIDTH)), ir.IntType(DRAW_WIDTH)
    )
    with builder.if_then(builder.icmp_unsigned("!=", any_upper, ir.Constant(any_upper.type, 0)), likely=False):
        for room, number in zip(rooms, numbers, strict=True):
            builder.store(look_up(builder.load(room), number, range(4, 8)), room)
    points = [builder.load(room) for room in rooms]
    coordinates = []
    for axis in range(4):
        words = ir.Constant(_WORDS, ir.Undefined)
        for lane, point in zip(lanes, points, strict=True):
            words = builder.insert_element(words, builder.extract_element(point, ir.Constant(_WORD, axis)), lane)
        coordinates.append(words)
    return coordinates


@intrinsic
def _sample(typing_context: Any, sobol: Any, shifts: Any, hashes: Any, real: Any) -> Any:

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        rng, sample, dimension = (
            builder.load(_rows_of(context, builder, signature.args[2], arguments[2], row, _WORDS), align=4)
            for row in range(3)
        )
        on = _Hashes(builder)
        seed = on.hash_combine(builder.lshr(rng, on.splat(PLACE_BITS)), dimension)
        place = builder.and_(on.laine_karras(rng, on.times(seed, 0x9E3779B1)), on.splat((1 << PLACE_BITS) - 1))
        index = on.reverse(on.laine_karras(on.reverse(sample), seed))
        is_early = builder.icmp_unsigned("==", builder.lshr(sample, on.splat(_INDEX_BITS)), on.splat(0))
        index = builder.select(is_early, builder.and_(index, on.splat((1 << _INDEX_BITS) - 1)), index)
        coordinates = _points(context, builder, signature, arguments, index, place)
        for axis, x in enumerate(coordinates):
            key = on.mix(builder.xor(seed, on.splat((axis + 1) * 0x9E3779B9 + 0x7F4A7C15)))
            bits = builder.lshr(on.reverse(on.laine_karras(x, key)), on.splat(8))
            unit = builder.fmul(builder.sitofp(bits, _FLOATS), ir.Constant(_FLOATS, [2.0**-24] * DRAW_WIDTH))
            builder.store(unit, _rows_of(context, builder, signature.args[3], arguments[3], axis, _FLOATS), align=4)
        return context.get_dummy_value()

    return types.void(sobol, shifts, hashes, real), generate


@kernel
def sample_eight(draws):
    """`rng.sample_4d` of the eight paths in `draws.hashes`, into the first four columns of `draws.real`."""
    _sample(SOBOL, SHIFTS, draws.hashes, draws.real)


@kernel
def put_path(draws, k, paths, lane, set_number):
    """Have `sample_eight` draw a set of a path's next vertex (SET_*) at place `k`."""
    draws.hashes[DRAW_RNG, k] = paths.rng[lane]
    draws.hashes[DRAW_SAMPLE, k] = np.uint32(paths.sample[lane])
    draws.hashes[DRAW_DIMENSION, k] = np.uint32(paths.dimension[lane] + set_number)
