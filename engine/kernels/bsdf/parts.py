# SPDX-License-Identifier: GPL-3.0-or-later
"""Diffuse, glossy and transmissive lobes of a lane apart, as Cycles' light passes tell them.

Translucent lobes are diffuse. What glass reflects is glossy, what it lets through is transmission.
"""

from engine.kernels.bsdf.closures import read3
from engine.kernels.bsdf.dispersion import set_channel
from engine.kernels.bsdf.energy import albedo_blends, reflected_albedo
from engine.kernels.bsdf.evaluate import BY_LIGHT, eval_lobe_of
from engine.kernels.bsdf.kinds import (
    CLOSURE_DISPERSES,
    FIRST_HAIR,
    FIRST_MICROFACET,
    GLASS,
    HAIR_TRANSMISSION,
    LAST_DIFFUSE,
    LAST_MICROFACET,
    LINKED_GLASS,
    LINKED_REFRACTION,
    REFRACTION,
    THIN_GLASS,
    TRANSPARENT,
)
from engine.kernels.bsdf.linked import albedo_linked, is_linked
from engine.kernels.bsdf.lobes import hair_albedo
from engine.kernels.bsdf.microfacet import lobe_color
from engine.kernels.bsdf.portal import is_portal
from engine.kernels.constants import FLOAT_MIN
from engine.kernels.vector import dot
from engine.runtime.jit import kernel
from engine.state.lanes import CLOSURE_N, CLOSURE_WEIGHT, RGB

# Rows of what is told apart.
DIFFUSE_LOBES = 0
GLOSSY_LOBES = 1
TRANSMISSIVE_LOBES = 2


@kernel
def _eval_parts(closures, lane, wo, wi, visibility, out):
    """Write f |cos| of the lane's non-delta lobes into the rows of `out`, by kind."""
    for row in range(3):
        for c in range(len(closures.channels)):
            out[row, c] = 0.0
    for i in range(closures.count[lane]):
        kind = closures.kind[lane, i]
        row = DIFFUSE_LOBES
        if kind == REFRACTION or kind == LINKED_REFRACTION or kind == HAIR_TRANSMISSION or kind == THIN_GLASS:
            row = TRANSMISSIVE_LOBES
        elif kind == GLASS or kind == LINKED_GLASS:
            is_refracted = dot(read3(closures.param, lane, i, CLOSURE_N), wi) < 0.0
            row = TRANSMISSIVE_LOBES if is_refracted else GLOSSY_LOBES
        elif kind >= FIRST_HAIR:
            row = GLOSSY_LOBES
        eval_lobe_of(closures.kind, closures.param, closures.channels, lane, i, wo, wi, visibility, BY_LIGHT, out, row)


@kernel
def share_lobes(closures, lane, wo, wi, visibility, fallback, value, share):
    """Write the shares of diffuse and of glossy lobes in what a direction brings, into row `lane` of `share`.

    Parameters
    ----------
    visibility : int
        RAY_DIFFUSE, RAY_GLOSSY, RAY_TRANSMIT bits: lobes of another kind do not count.
    fallback : int
        Row of the lobes that have all of a channel that no lobe is found to bring (their `bump_shadowing` may have let
        a sample through that others would not get).
    value : float32 (3, C)
        Scratch.
    share : float32 (L, 2 C)
    """
    count = len(closures.channels)
    disperses = count > RGB and closures.flags[lane] & CLOSURE_DISPERSES != 0
    # The hero comes last, and leaves the lobes as they were.
    for turn in range(count if disperses else 1):
        if disperses:
            set_channel(closures, lane, count - 1 - turn)
        _eval_parts(closures, lane, wo, wi, visibility, value)
        for c in range(count):
            if disperses and c != count - 1 - turn:
                continue
            diffuse, glossy = value[DIFFUSE_LOBES, c], value[GLOSSY_LOBES, c]
            total = diffuse + glossy + value[TRANSMISSIVE_LOBES, c]
            # Lobes may be as narrow as Beckmann's tails: what is less brings no light, and its inverse may be infinite.
            if total > FLOAT_MIN:
                share[lane, c] = diffuse / total
                share[lane, count + c] = glossy / total
            else:
                share[lane, c] = 1.0 if fallback == DIFFUSE_LOBES else 0.0
                share[lane, count + c] = 1.0 if fallback == GLOSSY_LOBES else 0.0


@kernel
def albedo_parts(closures, tables, lane, wo, looks_up_transmission, out):
    """Write the estimated directional albedo of the lane's lobes into the rows of `out`, by kind; `albedo` is the sum.

    Parameters
    ----------
    looks_up_transmission : int
        See `albedo_blends`.
    out : float32 (3, C)
    """
    param = closures.param
    for row in range(3):
        for c in range(len(closures.channels)):
            out[row, c] = 0.0
    for i in range(closures.count[lane]):
        kind = closures.kind[lane, i]
        if kind == TRANSPARENT or is_portal(closures, lane, i):
            continue
        if not FIRST_MICROFACET <= kind <= LAST_MICROFACET:
            row = DIFFUSE_LOBES
            if FIRST_HAIR <= kind <= LAST_DIFFUSE:
                is_transmissive = kind == HAIR_TRANSMISSION or kind == THIN_GLASS
                row = TRANSMISSIVE_LOBES if is_transmissive else GLOSSY_LOBES
                for c in range(len(closures.channels)):
                    out[row, c] += param[lane, i, CLOSURE_WEIGHT + c] * hair_albedo(kind, param, lane, i, wo, c)
                continue
            for c in range(len(closures.channels)):
                out[row, c] += param[lane, i, CLOSURE_WEIGHT + c]
            continue
        if is_linked(kind):
            shares = albedo_linked(param, closures.channels, tables, lane, i, wo)
            for c in range(len(closures.channels)):
                out[GLOSSY_LOBES, c] += param[lane, i, CLOSURE_WEIGHT + c] * shares[c]
                out[TRANSMISSIVE_LOBES, c] += param[lane, i, CLOSURE_WEIGHT + c] * shares[4 + c]
            continue
        reflected, refracted = albedo_blends(param, tables.data, lane, i, kind, wo, looks_up_transmission)
        for c in range(len(closures.channels)):
            weight = param[lane, i, CLOSURE_WEIGHT + c]
            out[GLOSSY_LOBES, c] += weight * reflected_albedo(param, lane, i, kind, reflected, c)
            if kind >= REFRACTION:
                out[TRANSMISSIVE_LOBES, c] += weight * lobe_color(param, lane, i, kind, refracted, True, c)
