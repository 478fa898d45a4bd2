# SPDX-License-Identifier: GPL-3.0-or-later
"""Whose the light is that paths ended with in the radiance cache: cells know no light groups.

Paths that measure the cache find the light of each group behind the place where the others end. That is right on
average, and as noisy as few paths make it. How much light there is in all is known much better: the picture has it.
So measuring paths say the groups' shares of it, smooth where they are not sure of more, as `known_residual` has it, and
the picture says what is shared out. The groups' light, with that of no group, is always the picture's; with ever more
samples the shares are kept whole, and each group's light becomes what measuring paths find on average.
"""

from __future__ import annotations

import numpy as np

from engine.guiding.models.residual import known_residual
from engine.state.film import LIGHT_PARTS
from engine.state.group_parts import FOUND_SECOND, FOUND_SQUARE, FOUND_WIDTH
from engine.state.lanes import PART_GROUPS, RGB

#: What is added to the light that shares are of, as a part of its mean.
_LEAST_SHARE = np.float32(0.01)
_TINY = np.float32(1e-12)


def groups_behind(
    light: np.ndarray, group_count: int, part_count: int, scale: np.ndarray, spread: np.ndarray,
    residual: np.ndarray, shape: tuple[int, int],
) -> np.ndarray:
    """Light of each group behind the ends of paths: what cells said and what they are known to lack, shared out.

    Parameters
    ----------
    light : float32 (P, L)
        `FilmTile.light` of a film that measures groups (`FilmLayout.measures_groups`).
    group_count, part_count : int
    scale : float32 (P, 1)
        What makes means of sums.
    spread : float32 (P,)
        Sum of the squares of the samples' weights over the square of their sum.
    residual : float32 (P, 3)
        What the picture has more than the cached image.
    shape : (int, int)
        Rows and columns of the image.

    Returns
    -------
    float32 (G + 1, P, 3)
        That of no group comes last. Their sum is what cells said plus `residual`.
    """

    def part(index: int) -> np.ndarray:
        first = LIGHT_PARTS + RGB * index
        means: np.ndarray = light[:, first : first + RGB] * scale
        return means

    whole = part(PART_GROUPS + group_count) + residual
    reference = np.maximum(np.abs(whole) + _LEAST_SHARE * np.abs(whole).mean(), _TINY)
    found = [part(PART_GROUPS + group_count + 1 + group) for group in range(group_count + 1)]
    totals = np.array([np.abs(one).sum(axis=0, dtype=np.float64) for one in found])
    apart = LIGHT_PARTS + RGB * part_count
    shares = np.empty((group_count + 1, *whole.shape), np.float32)
    for group, both in enumerate(found):
        first = apart + FOUND_WIDTH * group
        second = light[:, first + FOUND_SECOND : first + FOUND_SECOND + RGB] * scale
        variance = light[:, first + FOUND_SQUARE] * scale[:, 0] * spread
        halves = np.concatenate((both - second, second), axis=1) / np.tile(reference, 2)
        shares[group] = known_residual(halves, variance / (reference * reference).mean(axis=1), shape)
    if not any((one < 0.0).any() for one in found):
        shares = np.maximum(shares, np.float32(0.0))
    return _fill(shares * reference, whole, totals)


def _fill(known: np.ndarray, whole: np.ndarray, totals: np.ndarray) -> np.ndarray:
    """Light by group, scaled or completed so that it sums to `whole`.

    Parameters
    ----------
    known : float32 (G, P, 3)
    whole : float32 (P, 3)
    totals : float (G, 3)
        Light of each group in the whole image, nowhere negative.
    """
    weights = np.abs(known)
    sums = weights.sum(axis=0)
    # Where nothing tells whose it is, it is shared out as in the whole image, and where nothing was found at all it is
    # of no group.
    default = np.zeros_like(totals)
    default[-1] = 1.0
    all_groups = totals.sum(axis=0)
    default = np.where(all_groups > 0.0, totals / np.where(all_groups > 0.0, all_groups, 1.0), default)
    has_some = sums > 0.0
    weights = np.where(has_some, weights / np.where(has_some, sums, np.float32(1.0)), default[:, None])
    return np.asarray(known + weights * (whole - known.sum(axis=0)), np.float32)
