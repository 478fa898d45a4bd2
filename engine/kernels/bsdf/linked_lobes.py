# SPDX-License-Identifier: GPL-3.0-or-later
"""The kernels of linked lobes (`linked.py`), and putting them where stages find them.

A new one takes a model, its branch in each kernel here, and its node's entry in `engine/shaders/nodes_linked.py`.
"""

from __future__ import annotations

import math
import threading

import numpy as np
from numba import types

from engine.kernels.addresses import kernel_address
from engine.kernels.bsdf.ashikhmin_shirley import MIRROR_ALPHA, eval_ashikhmin_shirley, sample_ashikhmin_shirley
from engine.kernels.bsdf.closures import append_closure
from engine.kernels.bsdf.conductor import limited
from engine.kernels.bsdf.energy import finish_lobe
from engine.kernels.bsdf.fresnel import f82_b, f82_mean
from engine.kernels.bsdf.glossy import (
    Facets,
    Interface,
    add_glass,
    anisotropic_alphas,
    append_microfacet,
    film_of,
    rotate_tangent,
)
from engine.kernels.bsdf.kinds import (
    ALPHA_X,
    ALPHA_Y,
    CLOSURE_NO_REFLECTIVE_CAUSTICS,
    ENERGY_SCALE,
    ETA,
    GLOSSY_F82,
    LINKED_DIFFUSE,
    LINKED_GLOSSY,
    MULTI_GGX,
)
from engine.kernels.bsdf.linked import (
    ADD,
    ALBEDO,
    ALBEDOS,
    ASHIKHMIN,
    CHANGE,
    CONDUCTOR,
    EVALUATE,
    FACETS,
    FILM_IOR,
    FILM_THICKNESS,
    IS_DELTA,
    MODEL_MASK,
    NO_FILM,
    NO_SAMPLE,
    PLACE,
    REFLECTED,
    SAMPLE,
    SAMPLED,
    SELF,
    TOON_DIFFUSE,
    TOON_GLOSSY,
    VALUE,
    VECTOR,
    VECTORS,
    VELVET,
    address_of,
    bits_of,
    model_of,
)
from engine.kernels.bsdf.linked_facets import (
    albedo_of_facets,
    eval_facets,
    frame_of,
    make_facets,
    mean_of_metal,
    sample_facets,
    set_address,
)
from engine.kernels.bsdf.normals import safe_normal, valid_specular_normal
from engine.kernels.bsdf.portal import add_portal
from engine.kernels.bsdf.stretch import mean_alpha, stretch_facets
from engine.kernels.bsdf.tables import link_kernel, load_tables
from engine.kernels.bsdf.toon import eval_toon, mirrored, sample_toon
from engine.kernels.bsdf.velvet import eval_velvet, sample_velvet
from engine.kernels.constants import HALF_PI
from engine.kernels.limits import clamp, clamp_unit
from engine.kernels.memory import read3
from engine.kernels.vector import dot, scale
from engine.runtime.bundle import FieldType, RowsType
from engine.runtime.jit import kernel
from engine.state.lanes import CLOSURE_KIND_PARAMS, RGB, allocate_closures

_KIND = CLOSURE_KIND_PARAMS - 1

#: What LINKED instructions add, by name, and the number each is asked for by.
ADDED = {
    "TOON_DIFFUSE": TOON_DIFFUSE, "VELVET": VELVET, "TOON_GLOSSY": TOON_GLOSSY, "METAL": 8, "METAL_BY_INDEX": 9,
    "PORTAL": 10, "GLASS": 11,
}  # fmt: skip
_METAL, _METAL_BY_INDEX, _PORTAL, _GLASS = (ADDED[name] for name in ("METAL", "METAL_BY_INDEX", "PORTAL", "GLASS"))
_LEAST_SIZE = np.float32(1e-5)
_LEAST_SIGMA = np.float32(0.01)


@kernel
def evaluate_linked(param, channels, lane, i, n, wo, wi):
    """Value by channel, weight left out, and density of a direction [sr^-1]."""
    model = address_of(param, lane, i) & MODEL_MASK
    if model >= FACETS:
        return eval_facets(param, channels, lane, i, bits_of(param[lane, i, _KIND]), n, wo, wi)
    value, pdf = np.float32(0.0), np.float32(0.0)
    if model == TOON_DIFFUSE:
        value, pdf = eval_toon(param[lane, i, FILM_THICKNESS], param[lane, i, FILM_IOR], n, wi)
    elif model == TOON_GLOSSY:
        if dot(n, wo) > 0.0 and dot(n, wi) > 0.0:
            value, pdf = eval_toon(param[lane, i, FILM_THICKNESS], param[lane, i, FILM_IOR], mirrored(n, wo), wi)
    elif model == VELVET:
        value, pdf = eval_velvet(param[lane, i, FILM_THICKNESS], n, wo, wi)
    elif max(param[lane, i, ALPHA_X], param[lane, i, ALPHA_Y]) > 0.0:
        tangent, bitangent = frame_of(param, lane, i, n)
        value, pdf = eval_ashikhmin_shirley(
            param[lane, i, ALPHA_X], param[lane, i, ALPHA_Y], tangent, bitangent, n, wo, wi
        )
    return value, value, value, value, pdf


@kernel
def draw_linked(param, channels, lane, i, n, wo, numbers):
    """Direction, what happened, its probability and values of a delta lobe (`linked.SAMPLED`)."""
    u0, u1, u2 = numbers
    model = address_of(param, lane, i) & MODEL_MASK
    if model >= FACETS:
        return sample_facets(param, channels, lane, i, bits_of(param[lane, i, _KIND]), n, wo, u0, u1, u2)
    one = np.float32(1.0)
    what = REFLECTED
    wi = n
    if model == TOON_DIFFUSE:
        wi = sample_toon(param[lane, i, FILM_THICKNESS], param[lane, i, FILM_IOR], n, u1, u2)
    elif model == VELVET:
        wi = sample_velvet(n, u1, u2)
    elif model == TOON_GLOSSY:
        axis = mirrored(n, wo)
        wi = sample_toon(param[lane, i, FILM_THICKNESS], param[lane, i, FILM_IOR], axis, u1, u2)
    elif max(param[lane, i, ALPHA_X], param[lane, i, ALPHA_Y]) > 0.0:
        tangent, bitangent = frame_of(param, lane, i, n)
        wi = sample_ashikhmin_shirley(
            param[lane, i, ALPHA_X], param[lane, i, ALPHA_Y], tangent, bitangent, n, wo, u1, u2
        )
    else:
        wi = mirrored(n, wo)
        what = REFLECTED | IS_DELTA
    if dot(n, wi) <= 0.0 or (model != TOON_DIFFUSE and model != VELVET and dot(n, wo) <= 0.0):
        what = NO_SAMPLE
    return wi[0], wi[1], wi[2], np.float32(what), one, one, one, one, one


@kernel
def estimate_linked(param, channels, tables, lane, i, wo):
    """Estimated albedo: four channels of reflection, then four of refraction; weight left out."""
    model = address_of(param, lane, i) & MODEL_MASK
    if model >= FACETS:
        kind = bits_of(param[lane, i, _KIND])
        return albedo_of_facets(param, channels, tables.data, lane, i, kind, wo)
    one, zero = np.float32(1.0), np.float32(0.0)
    return one, one, one, one, zero, zero, zero, zero


@kernel
def change_linked(closures, tables, lane, i, wo, model, thickness, ior):
    """See `linked.change_lobe`."""
    if model == ASHIKHMIN:
        param = closures.param
        alpha_x, alpha_y = max(param[lane, i, ALPHA_X], MIRROR_ALPHA), max(param[lane, i, ALPHA_Y], MIRROR_ALPHA)
        if max(alpha_x, alpha_y) <= MIRROR_ALPHA:
            alpha_x = alpha_y = np.float32(0.0)
        param[lane, i, ALPHA_X], param[lane, i, ALPHA_Y] = alpha_x, alpha_y
    return make_facets(closures, tables, lane, i, wo, model, thickness, ior)


@kernel
def _add_metal(closures, tables, lane, wo, ng, n, weight, memory, code, pc):
    """The Metallic BSDF: `weight, normal, colour or n, edge tint or k, tangent, roughness, anisotropy, rotation, film
    thickness, film ior | which, distribution`.
    """
    by_index = code[pc + 12] == _METAL_BY_INDEX
    distribution = code[pc + 13]
    first, second = read3(memory, code[pc + 4]), read3(memory, code[pc + 5])
    tangent = read3(memory, code[pc + 6])
    roughness, anisotropy = clamp_unit(memory[code[pc + 7]]), clamp_unit(memory[code[pc + 8]])
    alpha_x = roughness * roughness
    alpha_y = alpha_x
    if anisotropy > 0.0:
        aspect = np.float32((1.0 - anisotropy * 0.9) ** 0.5)
        alpha_x /= aspect
        alpha_y *= aspect
        tangent = rotate_tangent(tangent, n, memory[code[pc + 9]])
    if by_index:
        first, second = limited(first), limited(second)
        mean = mean_of_metal(first, second)
    else:
        first = (clamp_unit(first[0]), clamp_unit(first[1]), clamp_unit(first[2]))
        second = (
            f82_b(first[0], clamp_unit(second[0])),
            f82_b(first[1], clamp_unit(second[1])),
            f82_b(first[2], clamp_unit(second[2])),
        )
        mean = (
            f82_mean(first[0], second[0]), f82_mean(first[1], second[1]), f82_mean(first[2], second[2]),
        )  # fmt: skip
    is_multiple = distribution == MULTI_GGX
    specular_n = valid_specular_normal(closures, lane, ng, wo, n)
    facets = Facets(specular_n, tangent, alpha_x, alpha_y, is_multiple)
    i = append_microfacet(
        closures, lane, GLOSSY_F82, (weight, weight, weight), facets, Interface(1.0, first, second, first, NO_FILM)
    )
    if i < 0:
        return
    if is_multiple:
        finish_lobe(closures.param, tables.data, lane, i, GLOSSY_F82, wo, True, mean)
    model = model_of(distribution)
    if by_index:
        model |= CONDUCTOR
    make_facets(closures, tables, lane, i, wo, model, memory[code[pc + 10]], memory[code[pc + 11]])


@kernel
def _add_glass(closures, tables, lane, view, weight, memory, code, pc, is_backfacing):
    """The Glass BSDF, anisotropic: `weight, normal, colour, ior, tangent, roughness, anisotropy, rotation, film
    thickness, film ior | which, distribution`.
    """
    wo, ng, ns = view
    n = valid_specular_normal(closures, lane, ng, wo, safe_normal(read3(memory, code[pc + 3]), ns))
    color, ior, tangent = read3(memory, code[pc + 4]), memory[code[pc + 5]], read3(memory, code[pc + 6])
    distribution, anisotropy = code[pc + 13], memory[code[pc + 8]]
    alpha_x, alpha_y = anisotropic_alphas(clamp_unit(memory[code[pc + 7]]), anisotropy)
    tangent = rotate_tangent(tangent, n, memory[code[pc + 9]])
    roughness = math.sqrt(mean_alpha(alpha_x, alpha_y))
    weights = (weight, weight, weight)
    i = add_glass(closures, tables, lane, weights, color, wo, n, distribution, roughness, ior, is_backfacing)
    if i >= 0:
        film = film_of(memory[code[pc + 10]], memory[code[pc + 11]], ior, is_backfacing)
        make_facets(closures, tables, lane, i, wo, model_of(distribution), film[0], film[1])
        stretch_facets(closures.param, lane, i, n, tangent, alpha_x, alpha_y)


@kernel
def add_linked(closures, tables, lane, view, weight, memory, code, place):
    """Append the lobe of an instruction LINKED: `weight, normal, colour, colour, tangent, 5 numbers | which, ...`."""
    pc, is_backfacing = place
    which = code[pc + 12]
    wo, ng, ns = view
    if which == _PORTAL:
        entrance = (read3(memory, code[pc + 5]), read3(memory, code[pc + 6]))
        add_portal(closures, lane, view, scale(read3(memory, code[pc + 4]), weight), entrance)
        return np.int64(0)
    if which == _GLASS:
        _add_glass(closures, tables, lane, view, weight, memory, code, pc, is_backfacing != 0)
        return np.int64(0)
    n = safe_normal(read3(memory, code[pc + 3]), ns)
    is_velvet = which == VELVET
    is_glossy = which != TOON_DIFFUSE
    if is_glossy and not is_velvet and closures.flags[lane] & CLOSURE_NO_REFLECTIVE_CAUSTICS != 0:
        return np.int64(0)
    if which == _METAL or which == _METAL_BY_INDEX:
        _add_metal(closures, tables, lane, wo, ng, n, weight, memory, code, pc)
        return np.int64(0)
    kind = LINKED_GLOSSY if is_glossy else LINKED_DIFFUSE
    i = append_closure(closures, lane, kind, scale(read3(memory, code[pc + 4]), weight), n)
    if i < 0:
        return np.int64(0)
    param = closures.param
    first, second = memory[code[pc + 7]], memory[code[pc + 8]]
    if is_velvet:
        sigma = clamp(first, _LEAST_SIGMA, 1.0)
        first, second = 1.0 / (sigma * sigma), np.float32(0.0)
    else:
        first, second = clamp(first, _LEAST_SIZE, 1.0) * HALF_PI, clamp_unit(second) * HALF_PI
    param[lane, i, FILM_THICKNESS], param[lane, i, FILM_IOR] = first, second
    param[lane, i, ALPHA_X], param[lane, i, ALPHA_Y] = 1.0, 1.0
    param[lane, i, ETA], param[lane, i, ENERGY_SCALE] = 1.0, 1.0
    set_address(param, lane, i, tables.linked[SELF] | which)
    return np.int64(0)


_linking = threading.Lock()
_linked: set[int] = set()


def link_used(channel_count: int) -> None:
    """`link_lobes` for this spectrum too, if a program of this process has asked for such lobes."""
    if _linked:
        link_lobes(channel_count)


def link_lobes(channel_count: int = RGB) -> None:
    """Load or compile the kernels of linked lobes, and have all tables know them.

    Parameters
    ----------
    channel_count : int
        Of the spectrum that paths have.
    """
    with _linking:
        if channel_count not in _linked:
            _link(channel_count)
            _linked.add(channel_count)


def _link(channel_count: int) -> None:
    rgb = allocate_closures(1)._numba_type_
    closures = allocate_closures(1, channel_count)._numba_type_
    param, channels, tables = closures.field_type("param"), closures.field_type("channels"), load_tables()._numba_type_
    number, integer = types.float32, types.int64
    memory, code = RowsType(number, (), (4,)), FieldType(types.int32, ())
    column = 0 if channel_count == RGB else 1
    wanted = [
        (EVALUATE + column, VALUE, evaluate_linked, (param, channels, integer, integer, VECTOR, VECTOR, VECTOR)),
        (
            SAMPLE + column, SAMPLED, draw_linked,
            (param, channels, integer, integer, VECTOR, VECTOR, VECTOR),
        ),
        (ALBEDO + column, ALBEDOS, estimate_linked, (param, channels, tables, integer, integer, VECTOR)),
    ]  # fmt: skip
    if channel_count == RGB:
        wanted += [
            (CHANGE, VECTOR, change_linked, (rgb, tables, integer, integer, VECTOR, integer, number, number)),
            (ADD, integer, add_linked, (rgb, tables, integer, VECTORS, number, memory, code, PLACE)),
        ]
    for word, returned, function, argument_types in wanted:
        link_kernel(word, kernel_address(function, returned, *argument_types))
