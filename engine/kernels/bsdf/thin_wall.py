# SPDX-License-Identifier: GPL-3.0-or-later
"""Thin walls: sheets of glass or of something dense, that have no inside. As in Cycles (from Blender 5.2 on).

Light that has gone through a sheet goes on as if it had been reflected and then mirrored at the sheet. A smooth sheet
of glass is transparent.

References
----------
OpenPBR 1.1, "Thin-walled case": the series of reflections inside a sheet, and how a dense one shares light by its
anisotropy. With a film both sides have their own reflectance.
Kulla and Conty 2017, "Revisiting Physically Based Shading at Imageworks", p. 40: how rough light comes through.
"""

import math
from typing import NamedTuple

from engine.kernels.bsdf.closures import append_closure
from engine.kernels.bsdf.diffuse import MIN_DIFFUSE_ROUGHNESS
from engine.kernels.bsdf.energy import finish_lobe
from engine.kernels.bsdf.fresnel import f0_of_eta, fresnel_dielectric
from engine.kernels.bsdf.glossy import Facets, Interface, append_microfacet, blend_to_white, film_of
from engine.kernels.bsdf.hair import whole_albedo
from engine.kernels.bsdf.kinds import (
    ALPHA_X,
    CLOSURE_NO_REFLECTIVE_CAUSTICS,
    CLOSURE_NO_REFRACTIVE_CAUSTICS,
    DELTA_ALPHA_SQUARED,
    DIFFUSE,
    GLASS,
    GLOSSY,
    THIN_GLASS,
    THIN_TRANSLUCENT,
)
from engine.kernels.bsdf.linked import FACETS_GGX, LEAST_THICKNESS, NO_FILM, change_lobe
from engine.kernels.bsdf.lobe import HairLobe, Lobe
from engine.kernels.bsdf.microfacet import eval_microfacet, sample_microfacet
from engine.kernels.bsdf.no_lobes import add_transparent
from engine.kernels.bsdf.oren_nayar import OREN_MULTIPLE, add_oren_nayar, eval_oren_nayar
from engine.kernels.bsdf.translucent import add_translucent
from engine.kernels.bsdf.warp import sample_cosine
from engine.kernels.limits import clamp_unit
from engine.kernels.vector import dot, negate, scale, subtract
from engine.runtime.jit import kernel
from engine.state.lanes import CLOSURE_N


class Sheet(NamedTuple):
    """A sheet of glass.

    Attributes
    ----------
    alpha, ior : float32
    specular_tint, color : tuple of 3 float32
        `color` is what comes through its inside.
    film : tuple of 2 float32
        Thickness [nm] and refractive index of a thin film on either side.
    is_narrow : bool
        See `thin_alpha`.
    """

    alpha: float
    ior: float
    specular_tint: tuple[float, float, float]
    color: tuple[float, float, float]
    film: tuple[float, float]
    is_narrow: bool


@kernel
def _mirrored(n, wo):
    """Direction to the viewer, mirrored at the sheet."""
    return subtract(wo, scale(n, 2.0 * dot(n, wo)))


@kernel
def sheet_shares(front, back, inside, reflects, refracts):
    """Share of the light that a sheet sends back, and that it lets through: one channel's.

    Parameters
    ----------
    front, back : float32
        Reflectance of the side that is seen, and of the other one from within.
    inside : float32
        What comes through the sheet's inside on one way.
    reflects, refracts : bool
        Whether the sides do.
    """
    r1, t1 = front if reflects else 0.0, 1.0 - front if refracts else 0.0
    r2, t2 = back if reflects else 0.0, 1.0 - back if refracts else 0.0
    again = r2 * inside
    through = inside * t1 * t2 / max(1.0 - again * again, 1e-12)
    return r1 + through * again, through


@kernel
def inside_share(tint, cos_t):
    """What comes through a sheet's inside at a cosine, of `tint` at perpendicular incidence (Beer's law): a channel."""
    return tint ** (-1.0 / cos_t) if cos_t != 0.0 else 0.0


@kernel
def plain_side(reflectance, ior, f0):
    """Reflectance of a side by channel, of that of a real one, `f0` at perpendicular incidence."""
    f0_real = f0_of_eta(ior)
    return blend_to_white(f0, clamp_unit((reflectance - f0_real) / (1.0 - f0_real)))


@kernel
def _filmed_side(closures, tables, lane, n, cosine, eta, f0, film):
    """As `plain_side`, of a side with a thin film: a lobe of glass says it, which is taken away again."""
    white = (1.0, 1.0, 1.0)
    i = append_microfacet(
        closures, lane, GLASS, white, Facets(n, n, 1.0, 1.0, False), Interface(eta, f0, white, white, film)
    )
    side = change_lobe(closures, tables, lane, i, scale(n, cosine), FACETS_GGX, film)
    if i >= 0:
        closures.count[lane] = i
    return side


@kernel
def thin_alpha(alpha, ior, is_narrow):
    """Alpha of light that has come through a sheet whose sides have `alpha`; `is_narrow` as from Blender 5.3 on."""
    below = ior - 0.5
    factor = max(3.4 * (ior - 1.0) * below * below / (ior * ior * ior), 0.0)
    return clamp_unit(alpha * (factor if is_narrow else math.sqrt(factor)))


@kernel
def add_thin_glass(closures, tables, lane, weight, wo, n, sheet):
    """Append a sheet of glass.

    Parameters
    ----------
    weight : tuple of 3 float32
    wo, n : tuple of 3 float32
        Direction to the viewer and normal (see `valid_specular_normal`); unit, world space.
    sheet : Sheet
    """
    alpha, ior, specular_tint, color, film, is_narrow = sheet
    reflects = closures.flags[lane] & CLOSURE_NO_REFLECTIVE_CAUSTICS == 0
    refracts = closures.flags[lane] & CLOSURE_NO_REFRACTIVE_CAUSTICS == 0
    f0 = scale(specular_tint, f0_of_eta(ior))
    cosine = dot(n, wo)
    reflectance, cos_t = fresnel_dielectric(cosine, ior)
    front = plain_side(reflectance, ior, f0)
    back = front
    if film[0] > LEAST_THICKNESS:
        front = _filmed_side(closures, tables, lane, n, cosine, ior, f0, film_of(film[0], film[1], ior, False))
        back = _filmed_side(closures, tables, lane, n, -cos_t, 1.0 / ior, f0, film_of(film[0], film[1], ior, True))
    r0, t0 = sheet_shares(front[0], back[0], inside_share(color[0], cos_t), reflects, refracts)
    r1, t1 = sheet_shares(front[1], back[1], inside_share(color[1], cos_t), reflects, refracts)
    r2, t2 = sheet_shares(front[2], back[2], inside_share(color[2], cos_t), reflects, refracts)
    reflected = (weight[0] * r0, weight[1] * r1, weight[2] * r2)
    through = (weight[0] * t0, weight[1] * t1, weight[2] * t2)
    white = (1.0, 1.0, 1.0)
    facets = Facets(n, n, alpha, alpha, True)
    i = append_microfacet(closures, lane, GLOSSY, reflected, facets, Interface(1.0, white, white, white, NO_FILM))
    if i >= 0:
        finish_lobe(closures.param, tables.data, lane, i, GLOSSY, wo, True, specular_tint)
    alpha = thin_alpha(alpha, ior, is_narrow)
    if not alpha * alpha > DELTA_ALPHA_SQUARED:
        add_transparent(closures, lane, through)
        return
    facets = Facets(n, n, alpha, alpha, True)
    i = append_microfacet(closures, lane, THIN_GLASS, through, facets, Interface(1.0, white, white, white, NO_FILM))
    if i >= 0:
        finish_lobe(closures.param, tables.data, lane, i, GLOSSY, wo, True, white)


@kernel
def add_thin_subsurface(closures, lane, weight, color, n, roughness, tints_by_bounce, anisotropy):
    """Append a sheet of something dense: what it lets through, and what it sends back, are diffuse.

    Parameters
    ----------
    weight, color, n, roughness, tints_by_bounce
        As `add_oren_nayar`.
    anisotropy : float32
        Of the light that it scatters: 1 lets all through, -1 sends all back.
    """
    back = scale(weight, clamp_unit(0.5 * (1.0 - anisotropy)))
    through = scale(weight, clamp_unit(0.5 * (1.0 + anisotropy)))
    if roughness < MIN_DIFFUSE_ROUGHNESS:
        append_closure(closures, lane, DIFFUSE, back, n)
        add_translucent(closures, lane, through, n)
        return
    add_oren_nayar(closures, lane, back, color, n, roughness, tints_by_bounce)
    first = closures.count[lane]
    add_oren_nayar(closures, lane, through, color, n, roughness, tints_by_bounce)
    if closures.count[lane] > first:
        closures.kind[lane, first] = THIN_TRANSLUCENT


@kernel
def eval_thin_translucent(param, channels, lane, i, n, wo, wi, factor, out, row):
    """See `Lobe.evaluate`."""
    return eval_oren_nayar(param, channels, lane, i, negate(n), _mirrored(n, wo), wi, factor, out, row)


@kernel
def sample_thin_translucent(param, lane, i, n, wo, u1, u2):
    """See `Lobe.sample`."""
    return sample_cosine(param, lane, i, negate(n), wo, u1, u2)


@kernel
def eval_thin_glass(param, channels, lane, i, n, wo, wi, factor, out, row):
    """See `HairLobe.evaluate`."""
    return eval_microfacet(param, channels, lane, i, GLOSSY, negate(n), _mirrored(n, wo), wi, factor, out, row)


@kernel
def sample_thin_glass(param, channels, lane, i, wo, u0, u1, u2):
    """See `HairLobe.sample`."""
    n = (param[lane, i, CLOSURE_N], param[lane, i, CLOSURE_N + 1], param[lane, i, CLOSURE_N + 2])
    wi, _, _, _, pmf = sample_microfacet(
        param, channels, lane, i, GLOSSY, negate(n), _mirrored(n, wo), u0, u1, u2
    )
    # What meets the sheet again is lost: no direction, in which no lobe has a density.
    return wi if pmf > 0.0 else scale(wi, 0.0)


@kernel
def thin_glass_roughness(param, lane, i):
    """See `HairLobe.roughness`."""
    return param[lane, i, ALPHA_X]


TRANSLUCENT_LOBE = Lobe(THIN_TRANSLUCENT, eval_thin_translucent, sample_thin_translucent, colors=(OREN_MULTIPLE,))
GLASS_LOBE = HairLobe(THIN_GLASS, eval_thin_glass, sample_thin_glass, thin_glass_roughness, whole_albedo)
