# SPDX-License-Identifier: GPL-3.0-or-later
"""Where light ends on a path: MIS weight, clamping and passes, shared by every stage that finds light."""

import math

import numpy as np

from engine.kernels.spectrum import to_rgb
from engine.runtime.jit import kernel
from engine.state.film import DENOISING_ALBEDO
from engine.state.lanes import FEATURES_DONE, RAY_TRANSPARENT_BACKGROUND, RGB


@kernel
def power_heuristic(pdf, other_pdf):
    """MIS weight of a technique of density `pdf` against one of `other_pdf` (same measure).

    References: Veach 1997, Eq. (9.13), beta = 2. Written so that squares do not overflow.
    """
    if pdf <= 0.0:
        return 0.0 * pdf
    ratio = other_pdf / pdf
    return 1.0 / (1.0 + ratio * ratio)


@kernel
def add_radiance(options, paths, lane, contribution, row, depth, weight):
    """Add row `row` of `contribution` (float32 (N, C)) to the path, clamped as Cycles does, `weight` times.

    `depth` counts scatterings before the light's last one: 0 is direct light. The limits are on the sum of channels,
    as many times the user's setting as there are; 0 = none. They are on the contribution before it is weighted, so that
    they take the same share of the light however seldom it is sampled. Returns the share that clamping leaves.
    """
    limit = options.clamp_indirect if depth > 0 else options.clamp_direct
    factor = limit * 0.0 + 1.0
    if limit > 0.0:
        total = 0.0 * limit
        for c in range(len(paths.channels)):
            total += abs(contribution[row, c])
        limit *= np.float32(len(paths.channels))
        if total > limit:
            factor = limit / total
    for c in range(len(paths.channels)):
        paths.radiance[lane, c] += factor * weight * contribution[row, c]
    return factor


@kernel
def add_found(options, paths, lane, contribution):
    """Add light that the path's last scattering has found: row `lane` of `contribution`, MIS weight included.

    Returns the share that clamping leaves.
    """
    return add_radiance(options, paths, lane, contribution, lane, paths.depth[lane] - 1, 1.0)


@kernel
def add_seen(spectrum, paths, features, lane, contribution, share, film):
    """Show denoisers light that is seen directly, or over specular surfaces: it counts as albedo, as in Cycles.

    Parameters
    ----------
    features : FeatureLanes
    contribution : float32 (L, C)
        Row `lane`, `share` times, was added to the path.
    film : FilmTile, which has the features
    """
    if features.throughput[lane, 0] == FEATURES_DONE:
        return
    color = to_rgb(spectrum, paths, lane, contribution, lane)
    for c in range(RGB):
        value = share * color[c] * features.throughput[lane, c]
        if math.isfinite(value):
            film.denoising[paths.pixel[lane], DENOISING_ALBEDO + c] += value


@kernel
def add_sampled(options, paths, lane, shadows, row):
    """Add the light sample of a shadow ray, row `row` of `shadows`, that nothing has blocked."""
    add_radiance(options, paths, lane, shadows.radiance, row, paths.depth[lane], shadows.weight[row])


@kernel
def add_emission(options, spectrum, paths, lane, emission, mis_weight, film, feature, use_features):
    """Add what the surface or the background along the path's ray emits, and show it in its pass.

    Parameters
    ----------
    emission : float32 (L, C)
        Radiance by lane, replaced by the contribution.
    feature : int
        Column FEATURE_* of the film's pass, which gets the light that only transparent surfaces lie before, if
        `use_features`.

    Returns
    -------
    float32
        The share of the contribution that clamping leaves.
    """
    for c in range(len(paths.channels)):
        emission[lane, c] *= paths.throughput[lane, c] * mis_weight
    share = add_found(options, paths, lane, emission)
    if use_features and paths.flags[lane] & RAY_TRANSPARENT_BACKGROUND:
        color = to_rgb(spectrum, paths, lane, emission, lane)
        for c in range(RGB):
            film.features[paths.pixel[lane], feature + c] += color[c]
    return share
