# SPDX-License-Identifier: GPL-3.0-or-later
"""Thin walls: sheets of glass or of something dense, that have no inside. As in Cycles (from Blender 5.2 on).

Light that has gone through a sheet goes on as if it had been reflected and then mirrored at the sheet. A smooth sheet
of glass is transparent.

References
----------
OpenPBR 1.1, "Thin-walled case": the series of reflections inside a sheet, and how a dense one shares light by its
anisotropy.
Kulla and Conty 2017, "Revisiting Physically Based Shading at Imageworks", p. 40: how rough light comes through.
"""

import math

from engine.kernels.bsdf.closures import append_closure
from engine.kernels.bsdf.diffuse import MIN_DIFFUSE_ROUGHNESS
from engine.kernels.bsdf.energy import finish_lobe
from engine.kernels.bsdf.fresnel import f0_of_eta, fresnel_dielectric
from engine.kernels.bsdf.glossy import Facets, Interface, append_microfacet
from engine.kernels.bsdf.hair import whole_albedo
from engine.kernels.bsdf.kinds import (
    ALPHA_X,
    CLOSURE_NO_REFLECTIVE_CAUSTICS,
    CLOSURE_NO_REFRACTIVE_CAUSTICS,
    DELTA_ALPHA_SQUARED,
    DIFFUSE,
    GLOSSY,
    THIN_GLASS,
    THIN_TRANSLUCENT,
)
from engine.kernels.bsdf.linked import NO_FILM
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


@kernel
def _mirrored(n, wo):
    """Direction to the viewer, mirrored at the sheet."""
    return subtract(wo, scale(n, 2.0 * dot(n, wo)))


@kernel
def sheet_shares(cosine, ior, f0, tint, reflects, refracts):
    """Share of the light that a sheet sends back, and that it lets through: one channel's.

    Parameters
    ----------
    cosine : float32, of the viewer with the normal
    f0 : float32
        Reflectance of a side at perpendicular incidence.
    tint : float32
        What comes through the sheet's inside at perpendicular incidence (Beer's law for others).
    reflects, refracts : bool
        Whether the sides do.
    """
    reflectance, cos_t = fresnel_dielectric(cosine, ior)
    if cos_t == 0.0:
        return 1.0 if reflects else 0.0, 0.0
    f0_real = f0_of_eta(ior)
    blend = clamp_unit((reflectance - f0_real) / (1.0 - f0_real))
    side = f0 + (1.0 - f0) * blend
    r = side if reflects else 0.0
    t = 1.0 - side if refracts else 0.0
    inside = tint ** (-1.0 / cos_t)
    again = r * inside
    through = inside * t * t / max(1.0 - again * again, 1e-12)
    return r + through * again, through


@kernel
def thin_alpha(alpha, ior):
    """Alpha of light that has come through a sheet whose sides have `alpha`."""
    below = ior - 0.5
    return clamp_unit(alpha * math.sqrt(max(3.4 * (ior - 1.0) * below * below / (ior * ior * ior), 0.0)))


@kernel
def add_thin_glass(closures, tables, lane, weight, wo, n, alpha, ior, specular_tint, color):
    """Append a sheet of glass.

    Parameters
    ----------
    weight, specular_tint, color : tuple of 3 float32
        `color` is what comes through its inside.
    wo, n : tuple of 3 float32
        Direction to the viewer and normal (see `valid_specular_normal`); unit, world space.
    alpha, ior : float32
    """
    reflects = closures.flags[lane] & CLOSURE_NO_REFLECTIVE_CAUSTICS == 0
    refracts = closures.flags[lane] & CLOSURE_NO_REFRACTIVE_CAUSTICS == 0
    f0 = scale(specular_tint, f0_of_eta(ior))
    cosine = dot(n, wo)
    r0, t0 = sheet_shares(cosine, ior, f0[0], color[0], reflects, refracts)
    r1, t1 = sheet_shares(cosine, ior, f0[1], color[1], reflects, refracts)
    r2, t2 = sheet_shares(cosine, ior, f0[2], color[2], reflects, refracts)
    reflected = (weight[0] * r0, weight[1] * r1, weight[2] * r2)
    through = (weight[0] * t0, weight[1] * t1, weight[2] * t2)
    white = (1.0, 1.0, 1.0)
    facets = Facets(n, n, alpha, alpha, True)
    i = append_microfacet(closures, lane, GLOSSY, reflected, facets, Interface(1.0, white, white, white, NO_FILM))
    if i >= 0:
        finish_lobe(closures.param, tables.data, lane, i, GLOSSY, wo, True, specular_tint)
    alpha = thin_alpha(alpha, ior)
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
