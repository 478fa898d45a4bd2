# SPDX-License-Identifier: GPL-3.0-or-later
"""Asking for memory before it is needed: neither a scene nor a batch fits into the nearest caches, and a miss can cost
as much as a stage.
"""

from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from engine.runtime.bundle import RowsType, array_of, start_of_rows
from engine.runtime.jit import kernel

_READ, _KEEP, _DATA = 0, 3, 1
#: Bytes of a cache line.
LINE_BYTES = 64
#: How many lanes ahead a stage asks for what it will read of one.
_LANES_AHEAD = 4


@intrinsic
def prefetch_byte(typing_context: Any, array: Any, row: Any, offset: Any) -> Any:
    """Have the processor fetch the cache line of a byte of a row of a C-contiguous array or of a field of lanes.

    Rows out of range do no harm.
    """

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        pointer, flag = ir.IntType(8).as_pointer(), ir.IntType(32)
        if isinstance(array, RowsType):
            start, stride = start_of_rows(builder, arguments[0]), ir.Constant(ir.IntType(64), array.strides[0])
        else:
            fields = array_of(context, builder, signature.args[0], arguments[0])
            start, stride = fields.data, builder.extract_value(fields.strides, 0)
        offset = builder.add(builder.mul(arguments[1], stride), arguments[2])
        address = builder.gep(builder.bitcast(start, pointer), [offset])
        function = cgutils.get_or_insert_function(
            builder.module, ir.FunctionType(ir.VoidType(), [pointer, flag, flag, flag]), "llvm.prefetch.p0"
        )
        builder.call(function, [address, *(ir.Constant(flag, value) for value in (_READ, _KEEP, _DATA))])
        return context.get_dummy_value()

    return types.void(array, types.intp, types.intp), generate


@kernel
def prefetch_line(array, row, line):
    """Fetch the cache line, by number, of a row that begins at one."""
    prefetch_byte(array, row, line * LINE_BYTES)


@kernel
def prefetch(array, row):
    """Fetch the start of a row."""
    prefetch_line(array, row, 0)


@kernel
def prefetch_lines(array, row, line_count):
    """Fetch the first lines of a row."""
    for line in range(line_count):
        prefetch_line(array, row, line)


@kernel
def lane_ahead(lanes, k, lane_count):
    """The lane whose turn comes a little after that of `lanes[k]`."""
    return np.int64(lanes[min(k + _LANES_AHEAD, lane_count - 1)])


# What follows knows where the cache lines of `engine.state.lanes` begin.


@kernel
def ask_for_ray(paths, lane):
    """A path's ray, its hit and flags."""
    prefetch(paths.origin, lane)


@kernel
def ask_for_throughput(paths, lane):
    """A path's throughput, radiance and random numbers."""
    prefetch(paths.throughput, lane)


@kernel
def ask_for_history(paths, lane):
    """A path's last scattering, footprint and depths."""
    prefetch(paths.mis_origin, lane)


@kernel
def ask_for_point(points, lane):
    """A point to shade."""
    prefetch(points.real, lane)
    prefetch(points.integer, lane)


@kernel
def ask_for_closures(closures, lane):
    """Emission and the like, and the first line of the first lobe."""
    prefetch(closures.count, lane)
    prefetch(closures.kind, lane)


@kernel
def ask_for_media(media, lane):
    """The first media that a path is in."""
    prefetch(media.instance, lane)
    prefetch(media.medium, lane)
