# SPDX-License-Identifier: GPL-3.0-or-later
"""Closures of the Glossy, Refraction and Glass BSDF."""

import math
from typing import NamedTuple

from engine.kernels.bsdf.closures import append_closure, store_color
from engine.kernels.bsdf.energy import finish_lobe
from engine.kernels.bsdf.fresnel import f0_of_eta, interface_mean_blend
from engine.kernels.bsdf.kinds import (
    ALPHA_X,
    ALPHA_Y,
    BECKMANN,
    CLOSURE_NO_REFLECTIVE_CAUSTICS,
    CLOSURE_NO_REFRACTIVE_CAUSTICS,
    ENERGY_SCALE,
    ETA,
    F0,
    F0_REAL,
    GLASS,
    GLOSSY,
    MULTI_GGX,
    REFLECTION_TINT,
    REFRACTION,
    TANGENT,
    TRANSMISSION_TINT,
)
from engine.kernels.bsdf.linked import FACETS_GGX, LEAST_THICKNESS, NO_FILM, change_lobe, model_of
from engine.kernels.bsdf.normals import safe_normal, valid_specular_normal
from engine.kernels.constants import TWO_PI
from engine.kernels.limits import at_least, clamp, clamp_unit
from engine.kernels.memory import read3
from engine.kernels.vector import add, cross, dot, normalize, scale
from engine.runtime.jit import kernel

_Vector = tuple[float, float, float]


class Facets(NamedTuple):
    """The microfacets of a surface.

    Attributes
    ----------
    n, tangent : tuple of 3 float32
        Normal and direction of anisotropy; unit, world space. The tangent need not be orthogonal to `n`; if it is
        parallel or zero the lobe becomes isotropic.
    alpha_x, alpha_y : float32
    is_multiple : bool
        Whether light that is scattered repeatedly between them counts.
    """

    n: _Vector
    tangent: _Vector
    alpha_x: float
    alpha_y: float
    is_multiple: bool


class Interface(NamedTuple):
    """Fresnel term of a microfacet lobe, and its tints.

    Attributes
    ----------
    eta : float32
        Refractive index of the far side over the viewer's side.
    f0, reflection, transmission : tuple of 3 float32
        Columns F0, REFLECTION_TINT (or F82_B) and TRANSMISSION_TINT.
    film : tuple of 2 float32
        See `change_lobe`; `add_layer` and `append_glass` look at it.
    """

    eta: float
    f0: _Vector
    reflection: _Vector
    transmission: _Vector
    film: tuple[float, float]


@kernel
def rotate_tangent(tangent, axis, turns):
    """Rotate `tangent` about unit `axis` (Rodrigues), [turns]."""
    if turns == 0.0:
        return tangent
    sine = math.sin(TWO_PI * turns)
    cosine = math.cos(TWO_PI * turns)
    along = scale(axis, dot(axis, tangent) * (1.0 - cosine))
    return add(add(scale(tangent, cosine), scale(cross(axis, tangent), sine)), along)


@kernel
def append_microfacet(closures, lane, kind, weight, facets, interface):
    """Append a microfacet lobe; returns as `append_closure`.

    Parameters
    ----------
    kind : int
    weight : tuple of 3 float32
    facets : Facets
    interface : Interface
    """
    n, tangent, alpha_x, alpha_y, _is_multiple = facets
    i = append_closure(closures, lane, kind, weight, n)
    if i >= 0:
        param = closures.param
        store_color(param, lane, i, F0, interface.f0)
        store_color(param, lane, i, REFLECTION_TINT, interface.reflection)
        store_color(param, lane, i, TRANSMISSION_TINT, interface.transmission)
        alpha_x = clamp_unit(alpha_x)
        alpha_y = clamp_unit(alpha_y)
        if alpha_x != alpha_y:
            bitangent = cross(n, tangent)
            if dot(bitangent, bitangent) > 1e-12:
                tangent = cross(normalize(bitangent), n)
                # In the place of the transmission tint, which only isotropic lobes have.
                for k in range(3):
                    param[lane, i, TANGENT + k] = tangent[k]
            else:
                alpha_x = math.sqrt(alpha_x * alpha_y)
                alpha_y = alpha_x
        param[lane, i, ALPHA_X] = alpha_x
        param[lane, i, ALPHA_Y] = alpha_y
        param[lane, i, ETA] = interface.eta
        param[lane, i, ENERGY_SCALE] = 1.0
        param[lane, i, F0_REAL] = f0_of_eta(interface.eta)
    return i


@kernel
def blend_to_white(f0, blend):
    """Colour between `f0` and white."""
    return f0[0] + (1.0 - f0[0]) * blend, f0[1] + (1.0 - f0[1]) * blend, f0[2] + (1.0 - f0[2]) * blend


@kernel
def anisotropic_alphas(roughness, anisotropy):
    """Alphas along and across the tangent, of the Glossy and Glass BSDF; the same up to an anisotropy of 1e-4."""
    alpha = roughness * roughness
    anisotropy = clamp(anisotropy, -0.99, 0.99)
    if anisotropy < -1e-4:
        return alpha / (1.0 + anisotropy), alpha * (1.0 + anisotropy)
    if anisotropy > 1e-4:
        return alpha * (1.0 - anisotropy), alpha / (1.0 - anisotropy)
    return alpha, alpha


@kernel
def add_glossy(
    closures, tables, lane, weight, color, wo, n, tangent, distribution, roughness, anisotropy, rotation
):
    """Lobe of the Glossy BSDF: reflection of constant colour.

    Parameters
    ----------
    weight, color : tuple of 3 float32
        Weight without the colour, and the colour.
    wo, n, tangent : tuple of 3 float32
        Direction to the viewer, normal (see `valid_specular_normal`), direction of anisotropy; unit, world space.
    distribution : int
        MULTI_GGX compensates energy.
    roughness : float32 in [0, 1], alpha is its square
    anisotropy : float32 in (-1, 1)
    rotation : float32 [turns]
    """
    weight = (weight[0] * color[0], weight[1] * color[1], weight[2] * color[2])
    alpha_x, alpha_y = anisotropic_alphas(clamp_unit(roughness), anisotropy)
    if alpha_x != alpha_y:
        tangent = rotate_tangent(tangent, n, rotation)
    facets = Facets(n, tangent, alpha_x, alpha_y, distribution == MULTI_GGX)
    i = append_microfacet(closures, lane, GLOSSY, weight, facets, Interface(1.0, color, color, color, NO_FILM))
    if distribution >= BECKMANN:
        change_lobe(closures, tables, lane, i, wo, model_of(distribution), NO_FILM)
    elif i >= 0 and facets.is_multiple:
        fresnel = (at_least(color[0], 0.0), at_least(color[1], 0.0), at_least(color[2], 0.0))
        finish_lobe(closures.param, tables.data, lane, i, GLOSSY, wo, True, fresnel)


@kernel
def add_refraction(closures, tables, lane, weight, color, wo, n, distribution, roughness, ior, is_backfacing):
    """Lobe of the Refraction BSDF: refraction of constant colour, none at total internal reflection.

    Parameters as `add_glossy`; `ior` is the material's refractive index over its surroundings'.
    """
    weight = (weight[0] * color[0], weight[1] * color[1], weight[2] * color[2])
    eta = at_least(ior, 1e-5)
    if is_backfacing:
        eta = 1.0 / eta
    alpha = roughness * roughness
    facets = Facets(n, n, alpha, alpha, False)
    i = append_microfacet(closures, lane, REFRACTION, weight, facets, Interface(eta, color, color, color, NO_FILM))
    if distribution >= BECKMANN:
        change_lobe(closures, tables, lane, i, wo, model_of(distribution), NO_FILM)


@kernel
def append_glass(closures, tables, lane, weight, wo, facets, interface):
    """Append a dielectric interface whose Fresnel term runs from `f0` to 1; caustics switched off drop a tint.

    Parameters
    ----------
    weight : tuple of 3 float32
    wo : tuple of 3 float32
        Direction to the viewer, unit, world space.
    facets : Facets
        Isotropic.
    interface : Interface
        Its `f0` is clamped to [0, 1].

    Returns
    -------
    As `append_closure`.
    """
    reflects = closures.flags[lane] & CLOSURE_NO_REFLECTIVE_CAUSTICS == 0
    refracts = closures.flags[lane] & CLOSURE_NO_REFRACTIVE_CAUSTICS == 0
    if not reflects and not refracts:
        return -1
    eta, f0, reflection, transmission, film = interface
    black = (0.0, 0.0, 0.0)
    if not reflects:
        reflection = black
    if not refracts:
        transmission = black
    f0 = (clamp_unit(f0[0]), clamp_unit(f0[1]), clamp_unit(f0[2]))
    i = append_microfacet(closures, lane, GLASS, weight, facets, Interface(eta, f0, reflection, transmission, film))
    if i < 0:
        return -1
    # Most of the colour is the transmitted light's.
    fresnel = transmission
    if transmission[0] == 0.0 and transmission[1] == 0.0 and transmission[2] == 0.0:
        fresnel = blend_to_white(f0, interface_mean_blend(eta))
        fresnel = (fresnel[0] * reflection[0], fresnel[1] * reflection[1], fresnel[2] * reflection[2])
    finish_lobe(closures.param, tables.data, lane, i, GLASS, wo, facets.is_multiple, fresnel)
    if film[0] > LEAST_THICKNESS:
        change_lobe(closures, tables, lane, i, wo, FACETS_GGX, film)
    return i


@kernel
def film_of(thickness, film_ior, ior, is_backfacing):
    """A film as `change_lobe` takes it, between air and something of refractive index `ior`."""
    film_ior = at_least(film_ior, 1e-5)
    return thickness, film_ior / at_least(ior, 1e-5) if is_backfacing else film_ior


@kernel
def add_glass(closures, tables, lane, weight, color, wo, n, distribution, roughness, ior, is_backfacing):
    """Lobe of the Glass BSDF: reflection and refraction by Fresnel, both tinted.

    Parameters as `add_refraction`; returns as `append_closure`. Beckmann's facets and films are `change_lobe`'s.
    """
    ior = at_least(ior, 1e-5)
    roughness = clamp_unit(roughness)
    tint = (at_least(color[0], 0.0), at_least(color[1], 0.0), at_least(color[2], 0.0))
    f0 = f0_of_eta(ior)
    alpha = roughness * roughness
    facets = Facets(n, n, alpha, alpha, distribution == MULTI_GGX)
    interface = Interface(1.0 / ior if is_backfacing else ior, (f0, f0, f0), tint, tint, NO_FILM)
    return append_glass(closures, tables, lane, weight, wo, facets, interface)


@kernel(forceinline=True)
def run_glossy(closures, tables, lane, view, weight, memory, code, pc):
    """Instruction `weight, normal, color, roughness, anisotropy, rotation, tangent | distribution`."""
    if closures.flags[lane] & CLOSURE_NO_REFLECTIVE_CAUSTICS != 0:
        return
    n = valid_specular_normal(closures, lane, view.ng, view.wo, safe_normal(read3(memory, code[pc + 3]), view.ns))
    add_glossy(
        closures, tables, lane, (weight, weight, weight), read3(memory, code[pc + 4]), view.wo, n,
        read3(memory, code[pc + 8]), code[pc + 9], memory[code[pc + 5]], memory[code[pc + 6]], memory[code[pc + 7]],
    )  # fmt: skip


@kernel(forceinline=True)
def run_refraction(closures, tables, lane, view, weight, memory, code, pc):
    """Instruction `weight, normal, color, roughness, ior | distribution`."""
    if closures.flags[lane] & CLOSURE_NO_REFRACTIVE_CAUSTICS != 0:
        return
    n = valid_specular_normal(closures, lane, view.ng, view.wo, safe_normal(read3(memory, code[pc + 3]), view.ns))
    add_refraction(
        closures, tables, lane, (weight, weight, weight), read3(memory, code[pc + 4]), view.wo, n, code[pc + 7],
        memory[code[pc + 5]], memory[code[pc + 6]], view.is_backfacing,
    )  # fmt: skip


@kernel(forceinline=True)
def run_glass(closures, tables, lane, view, weight, memory, code, pc):
    """Instruction `weight, normal, color, roughness, ior, film thickness, film ior | distribution`."""
    n = valid_specular_normal(closures, lane, view.ng, view.wo, safe_normal(read3(memory, code[pc + 3]), view.ns))
    distribution, ior, thickness = code[pc + 9], memory[code[pc + 6]], memory[code[pc + 7]]
    i = add_glass(
        closures, tables, lane, (weight, weight, weight), read3(memory, code[pc + 4]), view.wo, n, distribution,
        memory[code[pc + 5]], ior, view.is_backfacing,
    )  # fmt: skip
    if distribution >= BECKMANN or thickness > LEAST_THICKNESS:
        film = film_of(thickness, memory[code[pc + 8]], ior, view.is_backfacing)
        change_lobe(closures, tables, lane, i, view.wo, model_of(distribution), film)
