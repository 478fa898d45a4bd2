# SPDX-License-Identifier: GPL-3.0-or-later
"""Lobes that few scenes have: their kernels are compiled where one has them, and called by their addresses.

What evaluates, samples and adds lobes is compiled into a dozen stages. These lobes stay out of them: all that stages
hold of one is a call through the address that the lobe carries in its row (`ADDRESS`), so that a scene without them
pays for a comparison. `linked_lobes.py` has the kernels, and puts their addresses into `BsdfTables.linked` when a
program first asks for one.

The kinds LINKED_* say what stages need to know of such a lobe. Which lobe it is stands in the lowest bits of its
address. Columns of `Closures.param`:

=================  ===================================================================================================
ALPHA_X, ALPHA_Y   of facets, as of other microfacet kinds; 1 of lobes that have none
ETA, ENERGY_SCALE  as of other microfacet kinds
FILM_THICKNESS     [nm], 0 without a film; of a toon lobe its cone [radians], of velvet 1 / sigma^2
FILM_IOR           of a toon lobe the smooth rim [radians]
F0, TINT           colours, or n and k of a metal (RGB for good)
WAVES              wavelengths of the path in steps of `WAVE_STEP`, four in two columns; set by `upsample`
TANGENT_ANGLE      direction of anisotropy, from the first of `orthonormal_basis(n)` [radians]
ADDRESS            two halves of 64 bits
=================  ===================================================================================================
"""

from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from engine.kernels.addresses import kernel_call, read_word
from engine.kernels.bsdf.kinds import (
    ASHIKHMIN_SHIRLEY,
    BECKMANN,
    F0,
    LINKED_DIFFUSE,
    LINKED_GLASS,
    LINKED_GLOSSY,
    LINKED_REFRACTION,
    REFLECTION_TINT,
)
from engine.runtime.jit import kernel
from engine.state.lanes import CLOSURE_KIND_PARAMS, CLOSURE_WEIGHT, RAY_DIFFUSE, RAY_GLOSSY

FILM_THICKNESS = CLOSURE_KIND_PARAMS + 5
FILM_IOR = CLOSURE_KIND_PARAMS + 6
TINT = REFLECTION_TINT
WAVES = F0 + 8
TANGENT_ANGLE = WAVES + 2
ADDRESS = TANGENT_ANGLE + 1

#: Bit by kind: whether its kernels are linked.
LINKED_KINDS = np.int64(1 << LINKED_DIFFUSE | 1 << LINKED_GLOSSY | 1 << LINKED_REFRACTION | 1 << LINKED_GLASS)
#: The lowest bits of an address: which lobe.
MODEL_MASK = 63
#: Films below are none, up to 1 nm they fade in (Cycles) [nm].
LEAST_THICKNESS = np.float32(0.1)
NO_FILM = (np.float32(0.0), np.float32(1.0))
#: [nm]
WAVE_STEP = np.float32(1.0 / 64.0)

# Words of `BsdfTables.linked`: addresses of kernels, for lobes in RGB and at wavelengths one after the other; then
# of patterns (`engine/kernels/shader/linked_patterns.py`), and the table of thin films.
EVALUATE = 0
SAMPLE = 2
ALBEDO = 4
CHANGE = 6
ADD = 7
#: Where this very array is.
SELF = 8
PATTERNS = 9
FILM_TABLE = 10

_HALF, _WORD, _REAL = ir.IntType(32), ir.IntType(64), ir.FloatType()
VECTOR = types.UniTuple(types.float32, 3)
#: Direction to the viewer, geometric and smooth normal.
VECTORS = types.UniTuple(VECTOR, 3)
#: Where an instruction begins, and 1 where the surface is seen from behind.
PLACE = types.UniTuple(types.int64, 2)
#: Values of four channels, the last 0 in RGB, and the density.
VALUE = types.UniTuple(types.float32, 5)
#: Direction; `NO_SAMPLE`, `REFLECTED` or `REFRACTED`, and `IS_DELTA`; probability of that; values of a delta lobe.
SAMPLED = types.UniTuple(types.float32, 9)
#: Albedo of reflection, then of refraction.
ALBEDOS = types.UniTuple(types.float32, 8)

NO_SAMPLE = 0
REFLECTED = 1
REFRACTED = 2
IS_DELTA = 4


# Models of lobes that are no facets.
TOON_DIFFUSE = 0
VELVET = 1
TOON_GLOSSY = 2
ASHIKHMIN = 3
#: Facets from here on; their bits: Beckmann's distribution, a Fresnel term (two bits), what they tint (two bits).
FACETS = 32
IS_BECKMANN = 1
#: As `change_lobe` is asked for them.
FACETS_GGX = FACETS
FACETS_BECKMANN = FACETS | IS_BECKMANN
FRESNEL_MASK = 6
WITHOUT_FRESNEL = 0
CONDUCTOR = 2
F82 = 4
SCHLICK = 6
TINTS_MASK = 24
#: Reflects nothing; reflects white; tints both; lets nothing through.
TINTS_REFRACTION = 0
TINTS_NO_REFLECTION = 8
TINTS_BOTH = 16
TINTS_REFLECTION = 24


@intrinsic
def bits_of(typing_context: Any, value: Any) -> Any:
    """The 32 bits of a float32, as a number that is not negative."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.zext(builder.bitcast(arguments[0], _HALF), _WORD)

    return types.int64(types.float32), generate


@intrinsic
def real_of(typing_context: Any, bits: Any) -> Any:
    """The float32 of the lowest 32 bits of a number."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.bitcast(builder.trunc(arguments[0], _HALF), _REAL)

    return types.float32(types.int64), generate


_evaluate = kernel_call(VALUE, None, None, types.int64, types.int64, VECTOR, VECTOR, VECTOR)
_sample = kernel_call(SAMPLED, None, None, types.int64, types.int64, VECTOR, VECTOR, VECTOR)
_albedo = kernel_call(ALBEDOS, None, None, None, types.int64, types.int64, VECTOR)
_change = kernel_call(VECTOR, None, None, types.int64, types.int64, VECTOR, types.int64, types.float32, types.float32)
_add = kernel_call(types.int64, None, None, types.int64, VECTORS, types.float32, None, None, PLACE)


@intrinsic
def _call_evaluate(typing_context: Any, address: Any, param: Any, channels: Any, lane: Any, i: Any, n: Any, wo: Any,
                   wi: Any) -> Any:  # fmt: skip
    return _evaluate((param, channels, lane, i, n, wo, wi))


@intrinsic
def _call_sample(typing_context: Any, address: Any, param: Any, channels: Any, lane: Any, i: Any, n: Any, wo: Any,
                 numbers: Any) -> Any:  # fmt: skip
    return _sample((param, channels, lane, i, n, wo, numbers))


@intrinsic
def _call_albedo(typing_context: Any, address: Any, param: Any, channels: Any, tables: Any, lane: Any, i: Any,
                 wo: Any) -> Any:  # fmt: skip
    return _albedo((param, channels, tables, lane, i, wo))


@intrinsic
def _call_change(typing_context: Any, address: Any, closures: Any, tables: Any, lane: Any, i: Any, wo: Any, model: Any,
                 thickness: Any, ior: Any) -> Any:  # fmt: skip
    return _change((closures, tables, lane, i, wo, model, thickness, ior))


@intrinsic
def _call_add(typing_context: Any, address: Any, closures: Any, tables: Any, lane: Any, view: Any, weight: Any,
              memory: Any, code: Any, place: Any) -> Any:  # fmt: skip
    return _add((closures, tables, lane, view, weight, memory, code, place))


@kernel
def model_of(distribution):
    """What `change_lobe` makes of a distribution of facets."""
    if distribution == ASHIKHMIN_SHIRLEY:
        return ASHIKHMIN
    return FACETS_BECKMANN if distribution == BECKMANN else FACETS_GGX


@kernel
def is_linked(kind):
    """Whether a lobe's kernels are called by its address."""
    return (LINKED_KINDS >> np.int64(kind)) & np.int64(1) != 0


@kernel
def address_of(param, lane, i):
    """What a lobe carries: where `BsdfTables.linked` is, and which lobe it is."""
    return bits_of(param[lane, i, ADDRESS]) | bits_of(param[lane, i, ADDRESS + 1]) << 32


@kernel
def linked_label(param, lane, i, kind):
    """Kind of a ray that a linked lobe scatters. Velvet is glossy for lights and passes, and yet diffuse (Cycles)."""
    is_diffuse = kind == LINKED_DIFFUSE or address_of(param, lane, i) & MODEL_MASK == VELVET
    return RAY_DIFFUSE if is_diffuse else RAY_GLOSSY


@kernel
def _kernel_at(param, channels, lane, i, which):
    """Address of a lobe's kernel."""
    base = address_of(param, lane, i) & ~MODEL_MASK
    return read_word(base, 8 * (which + (1 if len(channels) > 3 else 0)))


@kernel
def eval_linked(param, channels, lane, i, n, wo, wi, factor, out, row):
    """As `Lobe.evaluate`."""
    address = _kernel_at(param, channels, lane, i, EVALUATE)
    value = _call_evaluate(address, param, channels, lane, i, n, wo, wi)
    for c in range(len(channels)):
        out[row, c] += param[lane, i, CLOSURE_WEIGHT + c] * value[c] * factor
    return value[4]


@kernel
def sample_linked(param, channels, lane, i, n, wo, numbers, out, row):
    """Direction from a linked lobe; of a delta lobe out[row] gets its value, weight and energy scale left out.

    Returns
    -------
    wi : tuple of 3 float32
    is_refracted, is_delta : bool
    branch_pmf : float32, probability of having reflected (or refracted) there; 0 = no sample
    """
    address = _kernel_at(param, channels, lane, i, SAMPLE)
    sampled = _call_sample(address, param, channels, lane, i, n, wo, numbers)
    what = int(sampled[3])
    for c in range(len(channels)):
        out[row, c] = sampled[5 + c]
    wi = (sampled[0], sampled[1], sampled[2])
    return wi, what & REFRACTED != 0, what & IS_DELTA != 0, sampled[4] if what != NO_SAMPLE else np.float32(0.0)


@kernel
def albedo_linked(param, channels, tables, lane, i, wo):
    """Estimated albedo of a lobe, weight left out: four channels of reflection, then four of refraction."""
    return _call_albedo(_kernel_at(param, channels, lane, i, ALBEDO), param, channels, tables, lane, i, wo)


@kernel
def change_lobe(closures, tables, lane, i, wo, model, film):
    """Make a microfacet lobe one that is linked: another distribution, a thin film, or a metal's n and k.

    Parameters
    ----------
    i : int, the lobe; -1: nothing happens
    model : int, `FACETS_*` of `linked_lobes`
    film : tuple of 2 float32
        Thickness [nm], and refractive index over that of the viewer's side.

    Returns
    -------
    Estimated albedo of its reflection, weight included, RGB.
    """
    if i < 0:
        return np.float32(0.0), np.float32(0.0), np.float32(0.0)
    return _call_change(tables.linked[CHANGE], closures, tables, lane, i, wo, model, film[0], film[1])


@kernel(forceinline=True)
def run_linked(closures, tables, lane, view, weight, memory, code, pc):
    """Instruction `weight, ... | which`: those of `linked_lobes.ADDED`."""
    vectors = (view.wo, view.ng, view.ns)
    place = (np.int64(pc), np.int64(1) if view.is_backfacing else np.int64(0))
    _call_add(tables.linked[ADD], closures, tables, lane, vectors, weight, memory, code, place)
