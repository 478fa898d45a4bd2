# SPDX-License-Identifier: GPL-3.0-or-later
"""Principled BSDF: sheen over coat over (metal, glass, or dielectric specular over diffuse)."""

import math
from typing import NamedTuple

from engine.kernels.bsdf.closures import append_closure, weight_below
from engine.kernels.bsdf.energy import finish_lobe
from engine.kernels.bsdf.fresnel import eta_of_f0, f0_of_eta, f82_b, f82_mean, fresnel_mean, interface_mean_blend
from engine.kernels.bsdf.glossy import (
    Facets,
    Interface,
    append_glass,
    append_microfacet,
    blend_to_white,
    film_of,
    rotate_tangent,
)
from engine.kernels.bsdf.kinds import (
    CLOSURE_NO_REFLECTIVE_CAUSTICS,
    DIFFUSE,
    GLOSSY_DIELECTRIC,
    GLOSSY_F82,
    GLOSSY_SCHLICK,
    MULTI_GGX,
    WEIGHT_CUTOFF,
)
from engine.kernels.bsdf.linked import FACETS_GGX, LEAST_THICKNESS, NO_FILM, change_lobe
from engine.kernels.bsdf.no_lobes import add_emission, add_transparent
from engine.kernels.bsdf.normals import safe_normal, valid_specular_normal
from engine.kernels.bsdf.oren_nayar import add_oren_nayar
from engine.kernels.bsdf.sheen import append_sheen
from engine.kernels.bsdf.stretch import mean_alpha, stretch_facets
from engine.kernels.bsdf.subsurface import RANDOM_WALK_SKIN, SubsurfaceInputs, add_subsurface
from engine.kernels.bsdf.thin_wall import Sheet, add_thin_glass, add_thin_subsurface
from engine.kernels.limits import at_least, clamp_unit
from engine.kernels.memory import read3
from engine.kernels.vector import add, dot, normalize, scale
from engine.runtime.jit import kernel


@kernel
def multiply(a, b):
    """Product of two colours."""
    return a[0] * b[0], a[1] * b[1], a[2] * b[2]


@kernel
def not_negative(color):
    """Colour with negative channels set to 0."""
    return at_least(color[0], 0.0), at_least(color[1], 0.0), at_least(color[2], 0.0)


@kernel
def absorb_in_coat(weight, cos_o, coat_weight, ior, tint):
    """Weight left below a tinted coat.

    The tint is what is absorbed along a path of the coat's thickness at perpendicular incidence, raised to the length
    of the refracted view path (Beer's law).
    """
    path_length = 1.0 / math.sqrt(at_least(1.0 - (1.0 - cos_o * cos_o) / (ior * ior), 1e-6))
    return (
        weight[0] * (1.0 + coat_weight * (tint[0] ** path_length - 1.0)),
        weight[1] * (1.0 + coat_weight * (tint[1] ** path_length - 1.0)),
        weight[2] * (1.0 + coat_weight * (tint[2] ** path_length - 1.0)),
    )


_Vector = tuple[float, float, float]


class PrincipledInputs(NamedTuple):
    """The node's inputs as they come: `add_principled` clamps them as Cycles does.

    Colours and directions are tuples of 3 float32, all others float32; directions are unit, in world space.

    Attributes
    ----------
    distribution : int, GGX or MULTI_GGX
    tangent : direction of anisotropy; anisotropic_rotation [turns]
    coat_normal : on the viewer's side; the smooth shading normal where nothing is linked
    subsurface : its refractive index counts for skin alone
    thin_wall : not 0: a sheet, which light goes through at once
    film_thickness : [nm]
    stretches_glass : not 0: what it refracts is as anisotropic as what it reflects (Blender 5.3)
    """

    distribution: int
    base_color: _Vector
    metallic: float
    roughness: float
    diffuse_roughness: float
    ior: float
    specular_level: float
    specular_tint: _Vector
    anisotropic: float
    anisotropic_rotation: float
    tangent: _Vector
    transmission: float
    coat_weight: float
    coat_roughness: float
    coat_ior: float
    coat_tint: _Vector
    coat_normal: _Vector
    sheen_weight: float
    sheen_roughness: float
    sheen_tint: _Vector
    emission_color: _Vector
    emission_strength: float
    alpha: float
    subsurface: SubsurfaceInputs
    thin_wall: float
    film_thickness: float
    film_ior: float
    tints_by_bounce: int
    stretches_glass: int


@kernel
def add_layer(closures, tables, lane, kind, weight, scale_in, wo, facets, interface, fresnel):
    """Append a reflecting lobe of weight `weight` times `scale_in`; returns what it leaves of `weight` below."""
    i = append_microfacet(closures, lane, kind, scale(weight, scale_in), facets, interface)
    if i < 0:
        return weight
    layer = finish_lobe(closures.param, tables.data, lane, i, kind, wo, facets.is_multiple, fresnel)
    if interface.film[0] > LEAST_THICKNESS:
        layer = change_lobe(closures, tables, lane, i, wo, FACETS_GGX, interface.film)
    return weight_below(layer, weight)


@kernel
def _below(inputs, eta):
    """What is below the interface, whose refractive index skin alone has for itself."""
    ior = inputs.ior if inputs.method == RANDOM_WALK_SKIN else eta
    return SubsurfaceInputs(inputs.method, inputs.weight, inputs.radius, inputs.scale, ior, inputs.anisotropy)


@kernel
def _add_base(closures, lane, weight, base_color, n, specular_n, eta, inputs):
    """Append what lies below the layers: light that comes out elsewhere, and diffuse reflection."""
    clamped_color = (min(base_color[0], 1.0), min(base_color[1], 1.0), min(base_color[2], 1.0))
    share = clamp_unit(inputs.subsurface.weight)
    diffuse_weight = multiply(weight, base_color)
    diffuse_roughness = clamp_unit(inputs.diffuse_roughness)
    if share > WEIGHT_CUTOFF:
        weight_below = scale(multiply(weight, clamped_color), share)
        if inputs.thin_wall != 0.0:
            anisotropy = inputs.subsurface.anisotropy
            by_bounce = inputs.tints_by_bounce
            add_thin_subsurface(
                closures, lane, weight_below, clamped_color, n, diffuse_roughness, by_bounce, anisotropy
            )
        else:
            roughness = clamp_unit(inputs.roughness)
            add_subsurface(
                closures, lane, weight_below, clamped_color, n, specular_n, roughness * roughness,
                _below(inputs.subsurface, eta),
            )
        diffuse_weight = scale(diffuse_weight, 1.0 - share)
    if diffuse_roughness < WEIGHT_CUTOFF:
        append_closure(closures, lane, DIFFUSE, diffuse_weight, n)
    else:
        add_oren_nayar(closures, lane, diffuse_weight, base_color, n, diffuse_roughness, inputs.tints_by_bounce)


@kernel
def _add_transmission(closures, tables, lane, weight, wo, facets, is_backfacing, inputs):
    """Append what light goes through: glass, or a thin wall of it."""
    specular_n = facets.n
    color, specular_tint = not_negative(inputs.base_color), not_negative(inputs.specular_tint)
    color = (min(color[0], 1.0), min(color[1], 1.0), min(color[2], 1.0))
    ior, roughness = at_least(inputs.ior, 1e-5), clamp_unit(inputs.roughness)
    alpha = roughness * roughness
    if inputs.thin_wall != 0.0:
        film = (inputs.film_thickness, inputs.film_ior)
        sheet = Sheet(alpha, ior, specular_tint, color, film, inputs.tints_by_bounce != 0)
        add_thin_glass(closures, tables, lane, weight, wo, specular_n, sheet)
        return
    tint = (math.sqrt(color[0]), math.sqrt(color[1]), math.sqrt(color[2]))
    eta, f0 = 1.0 / ior if is_backfacing else ior, scale(specular_tint, f0_of_eta(ior))
    film = film_of(inputs.film_thickness, inputs.film_ior, ior, is_backfacing)
    stretches = inputs.stretches_glass != 0 and facets.alpha_x != facets.alpha_y
    if stretches:
        alpha = mean_alpha(facets.alpha_x, facets.alpha_y)
    isotropic = Facets(specular_n, specular_n, alpha, alpha, facets.is_multiple)
    i = append_glass(
        closures, tables, lane, weight, wo, isotropic, Interface(eta, f0, (1.0, 1.0, 1.0), tint, film)
    )
    if stretches:
        if not film[0] > LEAST_THICKNESS:
            change_lobe(closures, tables, lane, i, wo, FACETS_GGX, NO_FILM)
        stretch_facets(closures.param, lane, i, specular_n, facets.tangent, facets.alpha_x, facets.alpha_y)


@kernel
def add_principled(closures, tables, lane, weight, wo, ng, n, is_backfacing, inputs):
    """Append the lobes of the Principled BSDF (version 2, as in Blender 4 and 5).

    Parameters
    ----------
    weight : tuple of 3 float32
    wo, ng, n : tuple of 3 float32
        Unit, world space, normals on the viewer's side.
    is_backfacing : bool
    inputs : PrincipledInputs
    """
    base_color = not_negative(inputs.base_color)
    clamped_color = (min(base_color[0], 1.0), min(base_color[1], 1.0), min(base_color[2], 1.0))
    specular_tint = not_negative(inputs.specular_tint)
    ior = at_least(inputs.ior, 1e-5)
    roughness = clamp_unit(inputs.roughness)
    metallic = clamp_unit(inputs.metallic)
    transmission = clamp_unit(inputs.transmission)
    alpha = clamp_unit(inputs.alpha)
    is_multiple = inputs.distribution == MULTI_GGX
    specular_n = valid_specular_normal(closures, lane, ng, wo, n)
    alpha_x = alpha_y = roughness * roughness
    tangent = inputs.tangent
    anisotropic = clamp_unit(inputs.anisotropic)
    if anisotropic > 0.0:
        aspect = math.sqrt(1.0 - anisotropic * 0.9)
        alpha_x /= aspect
        alpha_y *= aspect
        tangent = rotate_tangent(tangent, n, inputs.anisotropic_rotation)
    facets = Facets(specular_n, tangent, alpha_x, alpha_y, is_multiple)
    film = (inputs.film_thickness, at_least(inputs.film_ior, 1e-5))
    reflects = closures.flags[lane] & CLOSURE_NO_REFLECTIVE_CAUSTICS == 0

    if alpha < 1.0:
        add_transparent(closures, lane, scale(weight, 1.0 - alpha))
        weight = scale(weight, alpha)

    coat_weight = at_least(inputs.coat_weight, 0.0)
    if inputs.sheen_weight > WEIGHT_CUTOFF:
        blend = min(coat_weight, 1.0)
        sheen_n = normalize(add(scale(n, 1.0 - blend), scale(inputs.coat_normal, blend)))
        sheen_color = scale(multiply(weight, not_negative(inputs.sheen_tint)), inputs.sheen_weight)
        sheen_roughness = clamp_unit(inputs.sheen_roughness)
        weight = append_sheen(closures, tables, lane, sheen_color, weight, wo, sheen_n, sheen_roughness)

    if coat_weight > WEIGHT_CUTOFF:
        coat_n = valid_specular_normal(closures, lane, ng, wo, inputs.coat_normal)
        coat_ior = at_least(inputs.coat_ior, 1.0)
        if reflects:
            coat_alpha = clamp_unit(inputs.coat_roughness)
            coat_alpha *= coat_alpha
            mean = fresnel_mean(coat_ior)
            mean_color = (mean, mean, mean)
            weight = add_layer(
                closures, tables, lane, GLOSSY_DIELECTRIC, weight, coat_weight, wo,
                Facets(coat_n, n, coat_alpha, coat_alpha, True),
                Interface(coat_ior, mean_color, mean_color, mean_color, NO_FILM),
                mean_color,
            )  # fmt: skip
        coat_tint = inputs.coat_tint
        if coat_tint[0] != 1.0 or coat_tint[1] != 1.0 or coat_tint[2] != 1.0:
            weight = absorb_in_coat(weight, dot(wo, coat_n), coat_weight, coat_ior, not_negative(coat_tint))

    add_emission(closures, lane, scale(multiply(inputs.emission_color, weight), inputs.emission_strength))

    if metallic > WEIGHT_CUTOFF:
        if reflects:
            f0 = clamped_color
            b = (
                f82_b(f0[0], min(specular_tint[0], 1.0)),
                f82_b(f0[1], min(specular_tint[1], 1.0)),
                f82_b(f0[2], min(specular_tint[2], 1.0)),
            )
            fresnel = (f82_mean(f0[0], b[0]), f82_mean(f0[1], b[1]), f82_mean(f0[2], b[2]))
            interface = Interface(1.0, f0, b, f0, film)
            add_layer(closures, tables, lane, GLOSSY_F82, weight, metallic, wo, facets, interface, fresnel)
        weight = scale(weight, 1.0 - metallic)

    f0_real = f0_of_eta(ior)
    if transmission > WEIGHT_CUTOFF:
        _add_transmission(closures, tables, lane, scale(weight, transmission), wo, facets, is_backfacing, inputs)
        weight = scale(weight, 1.0 - transmission)

    eta = ior
    specular_level = at_least(inputs.specular_level, 0.0)
    if specular_level != 0.5:
        f0_real *= 2.0 * specular_level
        eta = eta_of_f0(f0_real)
        if ior < 1.0:
            eta = 1.0 / eta
    if reflects and (eta != 1.0 or film[0] > LEAST_THICKNESS):
        f0 = scale(specular_tint, f0_real)
        f0 = (clamp_unit(f0[0]), clamp_unit(f0[1]), clamp_unit(f0[2]))
        fresnel = blend_to_white(f0, interface_mean_blend(eta))
        interface = Interface(eta, f0, f0, f0, film)
        weight = add_layer(closures, tables, lane, GLOSSY_SCHLICK, weight, 1.0, wo, facets, interface, fresnel)

    _add_base(closures, lane, weight, base_color, n, specular_n, eta, inputs)


@kernel(forceinline=True)
def run_principled(closures, tables, lane, view, weight, memory, code, pc):
    """Instruction `weight, normal, coat normal, tangent, base color, metallic, roughness, diffuse roughness, ior,
    specular level, specular tint, anisotropic, rotation, transmission, coat weight, coat roughness, coat ior, coat
    tint, sheen weight, sheen roughness, sheen tint, emission color, emission strength, alpha, subsurface weight,
    radius, scale, ior, anisotropy, thin wall, film thickness, film ior | distribution, subsurface method,
    whether facets tint by bounce, whether glass is anisotropic`.
    """
    n = safe_normal(read3(memory, code[pc + 3]), view.ns)
    inputs = PrincipledInputs(
        distribution=code[pc + 34],
        base_color=read3(memory, code[pc + 6]),
        metallic=memory[code[pc + 7]],
        roughness=memory[code[pc + 8]],
        diffuse_roughness=memory[code[pc + 9]],
        ior=memory[code[pc + 10]],
        specular_level=memory[code[pc + 11]],
        specular_tint=read3(memory, code[pc + 12]),
        anisotropic=memory[code[pc + 13]],
        anisotropic_rotation=memory[code[pc + 14]],
        tangent=read3(memory, code[pc + 5]),
        transmission=memory[code[pc + 15]],
        coat_weight=memory[code[pc + 16]],
        coat_roughness=memory[code[pc + 17]],
        coat_ior=memory[code[pc + 18]],
        coat_tint=read3(memory, code[pc + 19]),
        coat_normal=safe_normal(read3(memory, code[pc + 4]), view.ns),
        sheen_weight=memory[code[pc + 20]],
        sheen_roughness=memory[code[pc + 21]],
        sheen_tint=read3(memory, code[pc + 22]),
        emission_color=read3(memory, code[pc + 23]),
        emission_strength=memory[code[pc + 24]],
        alpha=memory[code[pc + 25]],
        subsurface=SubsurfaceInputs(
            method=code[pc + 35],
            weight=memory[code[pc + 26]],
            radius=read3(memory, code[pc + 27]),
            scale=memory[code[pc + 28]],
            ior=memory[code[pc + 29]],
            anisotropy=memory[code[pc + 30]],
        ),
        thin_wall=memory[code[pc + 31]],
        film_thickness=memory[code[pc + 32]],
        film_ior=memory[code[pc + 33]],
        tints_by_bounce=code[pc + 36],
        stretches_glass=code[pc + 37],
    )
    weights = (weight, weight, weight)
    add_principled(closures, tables, lane, weights, view.wo, view.ng, n, view.is_backfacing, inputs)
