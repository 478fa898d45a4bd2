# SPDX-License-Identifier: GPL-3.0-or-later
"""How far a surface is a mirror, for denoisers: albedo of its specular lobes, roughness, and what is seen behind it.

References: `film_write_denoising_features_surface` of Cycles 5.3 (intern/cycles/kernel/film/denoising_passes.h).
"""

import math

import numpy as np

from engine.kernels.bsdf.evaluate import add_albedo
from engine.kernels.bsdf.kinds import (
    ALPHA_X,
    ALPHA_Y,
    CHIANG,
    FIRST_MICROFACET,
    HAIR_REFLECTION,
    HUANG,
    LAST_MICROFACET,
    LINKED_REFRACTION,
    REFRACTION,
    THIN_GLASS,
    TRANSPARENT,
)
from engine.kernels.bsdf.portal import is_portal
from engine.kernels.vector import add, load, scale, store
from engine.runtime.jit import kernel

#: From this alpha on a lobe is no mirror at all.
_DULL_ALPHA = np.float32(0.15)
#: From this share of lobes that are no mirrors on, nothing is seen behind the surface by reflection.
_DULL_SHARE = np.float32(0.5)


@kernel
def _smooth_step(x):
    """From 0 to 1, level at both."""
    x = min(max(x, np.float32(0.0)), np.float32(1.0))
    return x * x * (np.float32(3.0) - np.float32(2.0) * x)


@kernel
def _alpha(closures, lane, i):
    """Of a lobe: 1 if it has none."""
    kind = closures.kind[lane, i]
    if FIRST_MICROFACET <= kind <= LAST_MICROFACET or kind == THIN_GLASS:
        alpha_squared = closures.param[lane, i, ALPHA_X] * closures.param[lane, i, ALPHA_Y]
        return np.float32(math.sqrt(max(alpha_squared, np.float32(0.0))))
    return np.float32(0.0) if is_portal(closures, lane, i) else np.float32(1.0)


@kernel
def _is_glossy(kind):
    """Whether Cycles counts lobes of a kind among glossy ones, or as glass."""
    if FIRST_MICROFACET <= kind <= LAST_MICROFACET:
        return kind != REFRACTION and kind != LINKED_REFRACTION
    return kind == HAIR_REFLECTION or kind == CHIANG or kind == HUANG


@kernel
def sum_mirrors(closures, tables, lane, wo, looks_up_transmission, weighs_by_roughness, scratch):
    """Sum up what a lane's lobes mirror and let through.

    Parameters
    ----------
    wo : tuple of 3 float32
    looks_up_transmission : int
        See `albedo_blends`.
    weighs_by_roughness : int
        Whether a lobe is specular in so far as it is a mirror; otherwise all glossy lobes and glass are.
    scratch : float32 (L, C)
        Its row `lane` is overwritten.

    Returns
    -------
    specular : tuple of 3 float32
        Albedo of the specular lobes.
    transparent : tuple of 3 float32
        Weight of the transparent ones.
    roughness : float32
        Root of alpha, mean over lobes by their albedo but for transparent ones; 1 of lobes that have no alpha.
    share : float32
        Share of `specular` by which what is mirrored counts: from 1 where all is a mirror to 0.
    """
    specular = transparent = (np.float32(0.0), np.float32(0.0), np.float32(0.0))
    total = dull = roughness = np.float32(0.0)
    for i in range(closures.count[lane]):
        store(scratch, lane, (0.0, 0.0, 0.0))
        add_albedo(closures, tables, lane, i, wo, looks_up_transmission, scratch, lane)
        albedo = load(scratch, lane)
        kind = closures.kind[lane, i]
        if kind == TRANSPARENT:
            transparent = add(transparent, albedo)
            continue
        weight = (albedo[0] + albedo[1] + albedo[2]) / np.float32(3.0)
        alpha = _alpha(closures, lane, i)
        dullness = _smooth_step(alpha / _DULL_ALPHA)
        if weighs_by_roughness != 0:
            specular = add(specular, scale(albedo, np.float32(1.0) - dullness))
        elif _is_glossy(kind):
            specular = add(specular, albedo)
        total += weight
        dull += weight * dullness
        roughness += weight * np.float32(math.sqrt(alpha))
    share = np.float32(1.0)
    if total > 0.0:
        roughness /= total
        share = np.float32(1.0) - _smooth_step(dull / total / _DULL_SHARE)
    return specular, transparent, roughness, share
