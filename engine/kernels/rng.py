# SPDX-License-Identifier: GPL-3.0-or-later
"""Random numbers as a pure function of (seed, pixel, sample, dimension): scrambled Sobol points in blue-noise order.

The pixels of a block of 8 x 8 have one scrambled sequence, each shifted by digits of its own before it is scrambled.
The shifts (`engine.kernels.pixel_shifts`) are such that whatever power of two of samples there is, the points of a
quad of pixels, and of four quads, are spread about as well as the points of one pixel: neighbours err in opposite
directions. Blocks are independent.

References: Burley 2020, "Practical Hash-based Owen Scrambling": the sample index is shuffled and every coordinate
scrambled by a hash keyed with the pixel and the dimension set; the hash is Vegdahl's 2021 refinement of Laine and
Karras 2011. Direction numbers: Joe and Kuo 2008, first four dimensions. Ahmed and Wonka 2020, "Screen-Space Blue-Noise
Diffusion of Monte Carlo Sampling Error via Hierarchical Ordering of Pixels": why pixels that are close in a
hierarchical order should have points of one net. There each pixel has a section of one sequence, and so many samples
must be known beforehand.
"""

from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic
from numba.np.arrayobj import make_array

from engine.kernels.pixel_shifts import PLACE_BITS, shift_table
from engine.runtime.jit import kernel

# Named sets of four numbers. The camera uses two, each vertex of a path SETS_PER_VERTEX.
SET_FILTER_LENS = 0
SET_TIME = 1
SETS_BEFORE_VERTICES = 2
#: Offsets within a vertex: light (pick, u, v, light roulette), BSDF (u, v, pick, path roulette). The first two numbers
#: of a set are spread best together. Which lobe is picked matters less than the direction, unlike which light
#: (docs/decisions/blue-noise.md).
SET_LIGHT = 0
SET_BSDF = 1
SETS_PER_VERTEX = 2
#: Where on its way to a vertex a path collides with a medium; far from the sets of vertices.
SET_MEDIUM = 1 << 18
#: And where its shadow ray may.
SET_SHADOW_MEDIUM = 1 << 19
#: Light samples on that way: light, distance, candidate, light roulette; then the point on the light.
SET_SEGMENT = SET_MEDIUM + 1
SET_SEGMENT_LIGHT = SET_SHADOW_MEDIUM + 1
#: A path's way below a surface that it has entered.
SET_SUBSURFACE = 1 << 20
#: Rays of nodes in a material, a set for each node.
SET_NODE_RAYS = 1 << 21


#: Bits that number the first samples of a pixel, those for which half of the look-ups do.
_INDEX_BITS = 16
#: Makes of a set's seed another one.
_PLACE_SEED = np.uint32(0x9E3779B1)


def _sobol_tables() -> np.ndarray:
    """Bit-reversed Sobol points by four bits of the index: XOR of eight look-ups gives a point's four coordinates.

    Tables by byte would take half the look-ups, and half of the nearest cache.

    Returns
    -------
    uint32, shape (8 groups of bits * 16, 4 dimensions)
    """
    # (degree, polynomial coefficients, initial numbers); dimension 0 is van der Corput.
    joe_kuo = [(1, 0, [1]), (2, 1, [1, 3]), (3, 1, [1, 3, 1])]
    tables = np.zeros((4, 8, 16), np.uint64)
    for dimension in range(4):
        if dimension == 0:
            directions = [1 << (31 - bit) for bit in range(32)]
        else:
            degree, coefficients, numbers = joe_kuo[dimension - 1]
            directions = [number << (31 - bit) for bit, number in enumerate(numbers)]
            for bit in range(degree, 32):
                value = directions[bit - degree] ^ (directions[bit - degree] >> degree)
                for k in range(1, degree):
                    if (coefficients >> (degree - 1 - k)) & 1:
                        value ^= directions[bit - k]
                directions.append(value)
        for group in range(8):
            for index in range(16):
                value = 0
                for bit in range(4):
                    if index >> bit & 1:
                        value ^= directions[4 * group + bit]
                tables[dimension, group, index] = int(f"{value:032b}"[::-1], 2)
    return np.ascontiguousarray(tables.astype(np.uint32).transpose(1, 2, 0).reshape(-1, 4))


SOBOL = _sobol_tables()
SHIFTS = shift_table()
_PLACE_MASK = np.uint32((1 << PLACE_BITS) - 1)


@kernel
def hash_combine(a, b):
    """Well-mixed uint32 of two uint32.

    References: Wang 2007 style avalanche with the constants of Mueller's lowbias32 (Wellons 2018).
    """
    x = np.uint32(np.uint32(a) ^ np.uint32(np.uint32(b) * np.uint32(0x9E3779B9) + np.uint32(0x7F4A7C15)))
    x = np.uint32(x ^ (x >> np.uint32(16)))
    x = np.uint32(x * np.uint32(0x7FEB352D))
    x = np.uint32(x ^ (x >> np.uint32(15)))
    x = np.uint32(x * np.uint32(0x846CA68B))
    return np.uint32(x ^ (x >> np.uint32(16)))


@kernel
def pixel_hash(seed, column, row):
    """The stream of a pixel: uint32 of the render's seed and the pixel's place in the full image.

    The upper 26 bits are its block's, the others say where it is in that: one bit of column and row after the other,
    coarse ones first, from the lowest bit up.
    """
    block = hash_combine(hash_combine(np.uint32(seed), np.uint32(0x5BD1E995)), np.uint32(column >> 3))
    block = hash_combine(block, np.uint32(row >> 3))
    place = np.uint32((column & 1) << 5 | (row & 1) << 4 | (column & 2) << 2 | (row & 2) << 1)
    place = np.uint32(place | np.uint32((column & 4) >> 1 | (row & 4) >> 2))
    return np.uint32((block & ~_PLACE_MASK) | place)


@kernel
def reverse_bits(x):
    """uint32 with its bits in opposite order."""
    x = np.uint32(x)
    x = np.uint32((x << np.uint32(16)) | (x >> np.uint32(16)))
    x = np.uint32(((x & np.uint32(0x00FF00FF)) << np.uint32(8)) | ((x & np.uint32(0xFF00FF00)) >> np.uint32(8)))
    x = np.uint32(((x & np.uint32(0x0F0F0F0F)) << np.uint32(4)) | ((x & np.uint32(0xF0F0F0F0)) >> np.uint32(4)))
    x = np.uint32(((x & np.uint32(0x33333333)) << np.uint32(2)) | ((x & np.uint32(0xCCCCCCCC)) >> np.uint32(2)))
    return np.uint32(((x & np.uint32(0x55555555)) << np.uint32(1)) | ((x & np.uint32(0xAAAAAAAA)) >> np.uint32(1)))


@kernel
def laine_karras(x, seed):
    """Owen scramble of a bit-reversed uint32 (Vegdahl's constants)."""
    x = np.uint32(x ^ np.uint32(x * np.uint32(0x3D20ADEA)))
    x = np.uint32(x + seed)
    x = np.uint32(x * np.uint32((seed >> np.uint32(16)) | np.uint32(1)))
    x = np.uint32(x ^ np.uint32(x * np.uint32(0x05526C56)))
    return np.uint32(x ^ np.uint32(x * np.uint32(0x53A22864)))


@kernel
def unit_float(bits):
    """Upper 24 bits of a uint32 as float32 in [0, 1)."""
    return np.float32(np.uint32(bits) >> np.uint32(8)) * 5.9604644775390625e-08


@intrinsic
def _scrambled_point(typing_context: Any, table: Any, index: Any, seed: Any, shifts: Any, place: Any) -> Any:
    """The four coordinates of Sobol point `index`, shifted, then Owen-scrambled each by its seed: float32 in [0, 1).

    One vector instruction for all four where a loop would take each in turn: coordinate d is `reverse_bits` of
    `laine_karras` of the table's XOR and the shift under the seed `hash_combine(seed, d + 1)`, and its upper 24 bits
    are kept.
    """

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        word, pointer = ir.IntType(32), ir.IntType(8).as_pointer()
        four = ir.VectorType(word, 4)

        def constant(*values: int) -> Any:
            return ir.Constant(four, list(values * (4 // len(values))))

        def splat(value: Any) -> Any:
            first = builder.insert_element(ir.Constant(four, ir.Undefined), value, ir.Constant(word, 0))
            return builder.shuffle_vector(first, first, ir.Constant(four, [0] * 4))

        def shift_xor(x: Any, bits: int) -> Any:
            return builder.xor(x, builder.lshr(x, constant(bits)))

        def multiply_xor(x: Any, factor: int) -> Any:
            return builder.xor(x, builder.mul(x, constant(factor)))

        def row_of(position: int, row: Any) -> Any:
            """Four words of one of the two tables, by the argument that it is."""
            data = make_array(signature.args[position])(context, builder, arguments[position]).data
            offset = builder.zext(builder.shl(row, ir.Constant(word, 4)), ir.IntType(64))
            address = builder.gep(builder.bitcast(data, pointer), [offset])
            return builder.load(builder.bitcast(address, four.as_pointer()), align=4)

        def look_up(x: Any, groups: range) -> Any:
            for group in groups:
                row = builder.and_(builder.lshr(arguments[1], ir.Constant(word, 4 * group)), ir.Constant(word, 15))
                x = builder.xor(x, row_of(0, builder.add(row, ir.Constant(word, 16 * group))))
            return x

        # Indices within `_INDEX_BITS` are the rule.
        room = cgutils.alloca_once_value(builder, look_up(row_of(3, arguments[4]), range(4)))
        upper = builder.lshr(arguments[1], ir.Constant(word, 16))
        with builder.if_then(builder.icmp_unsigned("!=", upper, ir.Constant(word, 0)), likely=False):
            builder.store(look_up(builder.load(room), range(4, 8)), room)
        x = builder.load(room)

        keys = [((d + 1) * 0x9E3779B9 + 0x7F4A7C15) & 0xFFFFFFFF for d in range(4)]
        seeds = shift_xor(builder.xor(splat(arguments[2]), constant(*keys)), 16)
        seeds = shift_xor(builder.mul(seeds, constant(0x7FEB352D)), 15)
        seeds = shift_xor(builder.mul(seeds, constant(0x846CA68B)), 16)

        x = builder.add(multiply_xor(x, 0x3D20ADEA), seeds)
        x = builder.mul(x, builder.or_(builder.lshr(seeds, constant(16)), constant(1)))
        x = multiply_xor(multiply_xor(x, 0x05526C56), 0x53A22864)
        reverse = cgutils.get_or_insert_function(builder.module, ir.FunctionType(four, [four]), "llvm.bitreverse.v4i32")
        x = builder.lshr(builder.call(reverse, [x]), constant(8))
        unit = builder.sitofp(x, ir.VectorType(ir.FloatType(), 4))
        unit = builder.fmul(unit, ir.Constant(unit.type, [2.0**-24] * 4))
        coordinates = [builder.extract_element(unit, ir.Constant(word, d)) for d in range(4)]
        return cgutils.pack_array(builder, coordinates)

    return types.UniTuple(types.float32, 4)(table, types.uint32, types.uint32, shifts, types.uint32), generate


@kernel
def sample_4d(rng, sample, dimension):
    """Four numbers of one stratified 4D set.

    Parameters
    ----------
    rng : uint32
        `pixel_hash` of the path.
    sample : int32
        Index of the sample within the pixel.
    dimension : int32
        Number of the set; sets are independent of each other.

    Returns
    -------
    4 x float32 in [0, 1)
    """
    seed = hash_combine(np.uint32(rng) >> np.uint32(PLACE_BITS), np.uint32(dimension))
    # An order of the block's pixels of each set's own, or errors of different sets would go together.
    place = np.uint32(laine_karras(np.uint32(rng), np.uint32(seed * _PLACE_SEED)) & _PLACE_MASK)
    index = reverse_bits(laine_karras(reverse_bits(np.uint32(sample)), seed))
    # Shuffled, the first 2^16 samples share their upper bits, which only shift all points by the same digits: the
    # scrambling that follows does as much. Without them half the look-ups are enough.
    if np.uint32(sample) >> np.uint32(_INDEX_BITS) == np.uint32(0):
        index = np.uint32(index & np.uint32((1 << _INDEX_BITS) - 1))
    return _scrambled_point(SOBOL, index, seed, SHIFTS, place)


@kernel
def track_4(rng, sample, dimension, step):
    """Four numbers of one step along a ray, of which there may be any number: stratified for the first.

    Parameters
    ----------
    rng, sample, dimension
        As `sample_4d`.
    step : int32

    Returns
    -------
    4 x float32 in [0, 1)
    """
    if step == 0:
        return sample_4d(rng, sample, dimension)
    seed = hash_combine(hash_combine(rng, np.uint32(sample)), np.uint32(dimension))
    first = np.uint32(4 * step)
    return (
        unit_float(hash_combine(seed, first)),
        unit_float(hash_combine(seed, first + np.uint32(1))),
        unit_float(hash_combine(seed, first + np.uint32(2))),
        unit_float(hash_combine(seed, first + np.uint32(3))),
    )
