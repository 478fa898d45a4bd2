# SPDX-License-Identifier: GPL-3.0-or-later
"""Where light ends on a path: MIS weight, clamping and passes, shared by every stage that finds light."""

import math

import numpy as np

from engine.kernels.clamping import Unguided, clamped_share, clamps, found_alone, weighted_inverse
from engine.kernels.lights import tree_share
from engine.kernels.spectrum import to_rgb
from engine.kernels.vector import load
from engine.runtime.jit import kernel
from engine.state.film import DENOISING_ALBEDO
from engine.state.group_parts import PARTS_MEASURED
from engine.state.lanes import (
    FEATURES_DONE,
    PART_DIFFUSE,
    PART_GLOSSY,
    PART_GROUPS,
    PART_TRANSMISSION,
    RAY_MIS_HAD_TRANSMISSION,
    RAY_TRANSPARENT_BACKGROUND,
    RGB,
    VOLUME_PARTS,
)

#: Light that no lamp, object or world of a light group has sent, or that is not known whose it is.
NO_GROUP = -1


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
def weigh_found(options, lights, paths, lane, emitter, leaves_dim, pdf):
    """What light counts that scattering has found, and how clamping sees it.

    Parameters
    ----------
    emitter : int
        Row of `lights.emitters`.
    leaves_dim : bool
        As in `Receiver`.
    pdf : float32 [sr^-1]
        With which light sampling proposes it; 0: never.

    Returns
    -------
    weight : float32
        MIS weight.
    unguided : Unguided
        That of the contribution with this weight.
    """
    plain_pdf = paths.unguided_pdf[lane]
    factor = paths.unguided[lane]
    weight = power_heuristic(paths.mis_pdf[lane], pdf)
    if not weight > 0.0 or plain_pdf < 0.0:
        return weight, found_alone(factor)
    plain_light_pdf = pdf
    if clamps(options) and pdf > 0.0:
        plain_light_pdf *= tree_share(
            lights, emitter, load(paths.mis_origin, lane), load(paths.mis_normal, lane),
            (paths.flags[lane] & RAY_MIS_HAD_TRANSMISSION) != 0, leaves_dim, load(paths.direction, lane),
        )
    plain_weight = power_heuristic(plain_pdf, plain_light_pdf)
    own = factor * plain_weight / weight
    # By light sampling it would be light / density instead of light / density of scattering.
    other = factor * plain_pdf * weighted_inverse(plain_light_pdf, plain_pdf) / weight
    return weight, Unguided(own, other, plain_weight)


@kernel
def measured_group_count(channels, passes):
    """How many light groups paths measure the radiance cache by, where they do: int.

    Their parts: one for each group, that of cells, what was found of each group and of none, and those of media.
    """
    return (passes.parts.shape[1] // len(channels) - PART_GROUPS - VOLUME_PARTS - 2) // 2


@kernel
def found_part(channels, passes):
    """First part of what measuring paths find behind their end, by light group, then of none: int."""
    return PART_GROUPS + measured_group_count(channels, passes) + 1


@kernel
def _add_parts(channels, passes, lane, contribution, row, depth, factor, group):
    """Add `factor` times row `row` of `contribution` to the path's parts; see `add_radiance`.

    What the camera sees of a light is in the Emission and Environment passes, and in its group only.
    """
    count = len(channels)
    if passes.is_open[lane] == PARTS_MEASURED:
        found = found_part(channels, passes) + (group if group != NO_GROUP else measured_group_count(channels, passes))
        for c in range(count):
            passes.parts[lane, found * count + c] += factor * contribution[row, c]
    if passes.is_open[lane] != 1:
        return
    if depth >= 0:
        step = count if depth > 0 else 0
        of_volume = passes.parts.shape[1] - VOLUME_PARTS * count
        for c in range(count):
            value = factor * contribution[row, c]
            if passes.is_volume[lane] != 0:
                passes.parts[lane, of_volume + step + c] += value
                continue
            diffuse = passes.share[lane, c] * value
            glossy = passes.share[lane, count + c] * value
            passes.parts[lane, PART_DIFFUSE * count + step + c] += diffuse
            passes.parts[lane, PART_GLOSSY * count + step + c] += glossy
            passes.parts[lane, PART_TRANSMISSION * count + step + c] += value - diffuse - glossy
    if group != NO_GROUP:
        for c in range(count):
            passes.parts[lane, (PART_GROUPS + group) * count + c] += factor * contribution[row, c]


@kernel
def add_radiance(paths, passes, lane, contribution, row, depth, weight, group):
    """Add row `row` of `contribution` (float32 (N, C)) to the path and its parts, `weight` times.

    Parameters
    ----------
    passes : LightPassLanes
    depth : int
        Scatterings before the light's last one: 0 is direct light, -1 what the camera sees.
    weight : float32
        What clamping leaves of it included.
    group : int
        Light group, or NO_GROUP.
    """
    for c in range(len(paths.channels)):
        paths.radiance[lane, c] += weight * contribution[row, c]
    if passes.parts.shape[0] > 0:
        _add_parts(paths.channels, passes, lane, contribution, row, depth, weight, group)


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
def add_sampled(options, paths, passes, lane, shadows, row):
    """Add the light sample of a shadow ray, row `row` of `shadows`, that nothing has blocked."""
    group = NO_GROUP
    if passes.parts.shape[0] > 0:
        group = passes.group[lane]
    depth = np.int64(paths.depth[lane])
    unguided = Unguided(shadows.own[row], shadows.other[row], shadows.share[row])
    left = clamped_share(options, paths.channels, shadows.radiance, row, depth, unguided)
    add_radiance(paths, passes, lane, shadows.radiance, row, depth, left * shadows.weight[row], group)


@kernel
def _show_found(spectrum, paths, lane, contribution, share, film, feature):
    """Add `share` times row `lane` of `contribution` to column `feature` of the film's features."""
    color = to_rgb(spectrum, paths, lane, contribution, lane)
    for c in range(RGB):
        film.features[paths.pixel[lane], feature + c] += share * color[c]


@kernel
def add_found(options, spectrum, paths, passes, lane, contribution, unguided, group, film, feature, use_features):
    """Add light that the path's last scattering, or the camera, has found: row `lane` of `contribution`, MIS weight
    included.

    Parameters
    ----------
    unguided : Unguided
        That of the contribution (`weigh_found`).
    group : int
        Light group, or NO_GROUP.
    feature : int
        Column FEATURE_* of the film's pass, which gets the light that only transparent surfaces lie before, if
        `use_features`.

    Returns
    -------
    float32
        The share that clamping leaves.
    """
    depth = paths.depth[lane] - 1
    share = clamped_share(options, paths.channels, contribution, lane, depth, unguided)
    add_radiance(paths, passes, lane, contribution, lane, depth, share, group)
    if use_features and paths.flags[lane] & RAY_TRANSPARENT_BACKGROUND:
        _show_found(spectrum, paths, lane, contribution, share, film, feature)
    return share


@kernel
def show_left_out(options, spectrum, paths, passes, lane, emission, group, film, feature):
    """Show what a transparent film leaves out of the picture in its pass, and in its light group, as Cycles does.

    Parameters
    ----------
    emission : float32 (L, C)
        Radiance by lane, replaced by the contribution.
    group, feature : see `add_found`

    Returns
    -------
    float32
        The share of the contribution that clamping leaves.
    """
    for c in range(len(paths.channels)):
        emission[lane, c] *= paths.throughput[lane, c]
    share = clamped_share(options, paths.channels, emission, lane, -1, found_alone(paths.unguided[lane]))
    _show_found(spectrum, paths, lane, emission, share, film, feature)
    if passes.parts.shape[0] > 0:
        _add_parts(paths.channels, passes, lane, emission, lane, -1, share, group)
    return share


@kernel
def add_emission(
    options, spectrum, paths, passes, lane, emission, mis_weight, unguided, group, film, feature, use_features
):
    """Add what the surface or the background along the path's ray emits, and show it in its pass.

    Parameters
    ----------
    emission : float32 (L, C)
        Radiance by lane, replaced by the contribution.
    mis_weight, unguided : float32 and Unguided, as `weigh_found` says
    group, feature, use_features : see `add_found`

    Returns
    -------
    float32
        The share of the contribution that clamping leaves.
    """
    for c in range(len(paths.channels)):
        emission[lane, c] *= paths.throughput[lane, c] * mis_weight
    return add_found(options, spectrum, paths, passes, lane, emission, unguided, group, film, feature, use_features)
