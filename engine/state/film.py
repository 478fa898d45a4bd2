# SPDX-License-Identifier: GPL-3.0-or-later
"""Sums of samples per pixel, as stages write them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from engine.runtime.bundle import Bundle
from engine.state.data_passes import NO_DATA, DataLayout

# Columns of the feature sums, written at the first surface that is not transparent.
FEATURE_NORMAL = 0
FEATURE_ALBEDO = 3
FEATURE_EMISSION = 6
FEATURE_ENVIRONMENT = 9
FEATURE_CANDIDATES = 12
FEATURE_GUIDING_BENEFIT = 13  # less one
FEATURE_WIDTH = 14

# Columns of the sums for denoisers (`engine.wavefront.write_denoising`).
DENOISING_ALBEDO = 0
DENOISING_NORMAL = 3
DENOISING_DEPTH = 6
DENOISING_WIDTH = 7

# Columns of the single-sample features: those that averaging would make meaningless.
FIRST_DEPTH = 0
FIRST_POSITION = 1
FIRST_OBJECT_INDEX = 4
FIRST_MATERIAL_INDEX = 5
FIRST_WIDTH = 6

# Columns of FilmTile.light, RGB each: what the first surface that is not transparent reflects and lets through, then
# parts of the radiance (`engine.state.lanes.LightPassLanes`), those of light groups last.
LIGHT_DIFFUSE_COLOR = 0
LIGHT_GLOSSY_COLOR = 3
LIGHT_TRANSMISSION_COLOR = 6
LIGHT_OCCLUSION = 9  # share of the hemisphere that nothing hides
LIGHT_PARTS = 12

# Columns of FilmTile.caught: light of shadow catchers, and what they would have alone; background, behind and beside
# them; by how much they raise alpha; samples that have met one.
CAUGHT_LIGHT = 0
CAUGHT_ALONE = 3
CAUGHT_BACKGROUND = 6
CAUGHT_COVER = 9
CAUGHT_COUNT = 10
CAUGHT_WIDTH = 11

#: Depth where nothing was hit, as Cycles writes it.
NO_DEPTH = np.float32(1e10)


class FilmTile(Bundle):
    """Sums over samples, P pixels; also the shape of the whole film.

    radiance, square : float32 (P, C), sum of samples and of their squares
    alpha : float32 (P,)
    weight, weight_squared : float32 (P,), sums of the samples' weights and of their squares (of the film; a unit's
        samples weigh the same)
    count : int32 (P,)
    features : float32 (P or 0, FEATURE_WIDTH)
    points : float32 (P or 0, FIRST_WIDTH), first sample only
    residual : float32 (P or 0, 2 C), sums of what the radiance cache lacked, as of all paths, by two halves of those
        that measure it
    residual_square : float32 (P or 0,), squares of the addends of `residual`, mean over channels
    square_gain : float32 (P or 0,), by how much the squares of samples would be larger without the cache, as of all
        paths, mean over channels
    ended : float32 (P or 0,), sums of what the cache said to paths that measure it, as of all paths, mean over channels
    half : float32 (P or 0, C), as `radiance`, of about half of the samples (`engine.wavefront.accumulate.is_in_half`)
    half_weight : float32 (P or 0,), as `weight`, of those
    denoising : float32 (P or 0, DENOISING_WIDTH), what helps denoisers
    light : float32 (P or 0, LIGHT_PARTS + 3 * parts), light taken apart
    caught : float32 (P or 0, CAUGHT_WIDTH), of shadow catchers
    data : float32 (P or 0, D), passes of data; mattes : float32 (P or 0, M, 2), pairs of Cryptomatte's id and weight
        (`engine.state.data_passes.DataOptions`)
    """

    #: There are as many light groups, AOVs and levels of mattes as the user likes.
    _dynamic = frozenset({"light", "data", "mattes"})

    radiance: np.ndarray
    square: np.ndarray
    alpha: np.ndarray
    weight: np.ndarray
    weight_squared: np.ndarray
    count: np.ndarray
    features: np.ndarray
    points: np.ndarray
    residual: np.ndarray
    residual_square: np.ndarray
    square_gain: np.ndarray
    ended: np.ndarray
    half: np.ndarray
    half_weight: np.ndarray
    denoising: np.ndarray
    light: np.ndarray
    caught: np.ndarray
    data: np.ndarray
    mattes: np.ndarray


@dataclass(frozen=True)
class FilmLayout:
    """Which sums a film has besides those of radiance, alpha and weights. What it has not takes no memory."""

    use_features: bool = False
    #: Of a radiance cache that converges.
    use_residual: bool = False
    #: For a noise threshold.
    use_half: bool = False
    use_denoising: bool = False
    #: Parts that light is taken apart into, those of light groups the last; 0: it is not.
    light_part_count: int = 0
    light_groups: tuple[str, ...] = ()
    use_occlusion: bool = False
    #: Whether there is an Environment pass.
    shows_background: bool = False
    has_catchers: bool = False
    has_media: bool = False
    has_varying_media: bool = False
    #: Of scenes with shadow catchers.
    is_transparent: bool = False
    data: DataLayout = NO_DATA


PLAIN_LAYOUT = FilmLayout()


def allocate_tile(pixel_count: int, channel_count: int, layout: FilmLayout = PLAIN_LAYOUT) -> FilmTile:
    """Zeroed sums for `pixel_count` pixels."""
    feature_count = pixel_count if layout.use_features else 0
    residual_count = pixel_count if layout.use_residual else 0
    half_count = pixel_count if layout.use_half else 0
    light_count = pixel_count if layout.light_part_count else 0
    data = layout.data
    return FilmTile(
        np.zeros((pixel_count, channel_count), np.float32),
        np.zeros((pixel_count, channel_count), np.float32),
        np.zeros(pixel_count, np.float32),
        np.zeros(pixel_count, np.float32),
        np.zeros(pixel_count, np.float32),
        np.zeros(pixel_count, np.int32),
        np.zeros((feature_count, FEATURE_WIDTH), np.float32),
        np.zeros((feature_count, FIRST_WIDTH), np.float32),
        np.zeros((residual_count, 2 * channel_count), np.float32),
        np.zeros(residual_count, np.float32),
        np.zeros(residual_count, np.float32),
        np.zeros(residual_count, np.float32),
        np.zeros((half_count, channel_count), np.float32),
        np.zeros(half_count, np.float32),
        np.zeros((pixel_count if layout.use_denoising else 0, DENOISING_WIDTH), np.float32),
        np.zeros((light_count, LIGHT_PARTS + 3 * layout.light_part_count), np.float32),
        np.zeros((pixel_count if layout.has_catchers else 0, CAUGHT_WIDTH), np.float32),
        np.zeros((pixel_count if data.width else 0, data.width), np.float32),
        np.zeros((pixel_count if data.matte_count else 0, data.matte_count, 2), np.float32),
    )


def rows_of(sums: FilmTile, first: int, last: int) -> FilmTile:
    """Some rows of sums."""
    return FilmTile(*(column[first:last] for column in sums))
