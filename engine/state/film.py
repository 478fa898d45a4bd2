# SPDX-License-Identifier: GPL-3.0-or-later
"""Sums of samples per pixel, as stages write them."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np

from engine.array_types import Float32Array, Int32Array
from engine.runtime.bundle import Bundle
from engine.state.columns import allocate, column
from engine.state.data_passes import NO_DATA, DataLayout
from engine.state.group_parts import FOUND_WIDTH

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


class Merge(Enum):
    """How a column of a unit's sums is added to the film's, and how a film is made of those of its strata.

    `engine.kernels.film_sums` adds, `engine.render.strata` combines; the value says it for docs/columns.md.
    """

    SUM = "added with the samples' weight"
    SQUARED_SUM = "added with its square"
    TOTAL = "added with the samples' weight; strata are added up"
    COUNT = "counted"
    WEIGHT = "the samples' weight for each of `count`"
    SQUARED_WEIGHT = "the square of the weight for each of `count`"
    FIRST = "kept of the first sample"
    MATTES = "added by id with the samples' weight"


class FilmTile(Bundle):
    """Sums over samples of P pixels, C channels a colour; also the shape of the whole film.

    A column is declared here and nowhere else: who allocates, merges, combines strata and sends sums to other processes
    goes by the declaration. The samples of a unit weigh the same.
    """

    radiance: Float32Array = column("sum of samples", "P", "C", merge=Merge.SUM)
    square: Float32Array = column("sum of their squares", "P", "C", merge=Merge.SUM)
    alpha: Float32Array = column("sum of their opacity", "P", merge=Merge.SUM)
    weight: Float32Array = column("sum of the samples' weights; of the film", "P", merge=Merge.WEIGHT)
    weight_squared: Float32Array = column(
        "sum of the squares of the weights; of the film", "P", merge=Merge.SQUARED_WEIGHT
    )
    count: Int32Array = column("samples", "P", merge=Merge.COUNT)
    features: Float32Array = column(
        "sums of what is of the first surface, by FEATURE_*", "P", FEATURE_WIDTH, needs="use_features", merge=Merge.SUM
    )
    points: Float32Array = column(
        "what averaging would make meaningless, by FIRST_*", "P", FIRST_WIDTH, needs="use_features", merge=Merge.FIRST
    )
    residual: Float32Array = column(
        "sums of what the radiance cache lacked, as of all paths, by two halves of those that measure it", "P", "2 C",
        needs="use_residual", merge=Merge.SUM,
    )
    residual_square: Float32Array = column(
        "squares of the addends of `residual`, mean over channels", "P", needs="use_residual", merge=Merge.SQUARED_SUM
    )
    square_gain: Float32Array = column(
        "by how much the squares of samples would be larger without the cache, as of all paths, mean over channels",
        "P", needs="use_residual", merge=Merge.SUM,
    )
    ended: Float32Array = column(
        "sums of what the cache said to paths that measure it, as of all paths, mean over channels", "P",
        needs="use_residual", merge=Merge.SUM,
    )
    half: Float32Array = column(
        "as `radiance`, of about half of the samples (`engine.wavefront.accumulate.is_in_half`)", "P", "C",
        needs="use_half", merge=Merge.SUM, weight="half_weight",
    )
    half_weight: Float32Array = column("as `weight`, of those", "P", needs="use_half", merge=Merge.TOTAL)
    denoising: Float32Array = column(
        "sums of what helps denoisers, by DENOISING_*", "P", DENOISING_WIDTH, needs="use_denoising", merge=Merge.SUM
    )
    # There are as many light groups, AOVs and levels of mattes as the user likes.
    light: Float32Array = column(
        "light taken apart, by LIGHT_*, then parts of three columns, then FOUND_*", "P", "light",
        needs="light_part_count", merge=Merge.SUM, is_dynamic=True,
    )
    caught: Float32Array = column(
        "of shadow catchers, by CAUGHT_*", "P", CAUGHT_WIDTH, needs="has_catchers", merge=Merge.SUM
    )
    data: Float32Array = column(
        "passes of data (`engine.state.data_passes.DataOptions`)", "P", "D", needs="data_width", merge=Merge.SUM,
        is_dynamic=True,
    )
    mattes: Float32Array = column(
        "pairs of Cryptomatte's id and weight, by slot", "P", "M", 2, needs="matte_count", merge=Merge.MATTES,
        is_dynamic=True,
    )


@dataclass(frozen=True)
class FilmLayout:
    """Which sums a film has besides those of radiance, alpha and weights. What it has not takes no memory."""

    use_features: bool = False
    #: Of a radiance cache that converges.
    use_residual: bool = False
    #: For a noise threshold, of pixels or of the denoised picture.
    use_half: bool = False
    use_denoising: bool = False
    #: Parts that light is taken apart into, those of light groups the last; 0: it is not.
    light_part_count: int = 0
    light_groups: tuple[str, ...] = ()
    #: Whether paths measure what the radiance cache lacks by light group.
    measures_groups: bool = False
    use_occlusion: bool = False
    #: Whether there is an Environment pass.
    shows_background: bool = False
    has_catchers: bool = False
    has_media: bool = False
    has_varying_media: bool = False
    #: Of scenes with shadow catchers.
    is_transparent: bool = False
    data: DataLayout = NO_DATA

    @property
    def light_width(self) -> int:
        """Columns of light taken apart."""
        found = FOUND_WIDTH * (len(self.light_groups) + 1) if self.measures_groups else 0
        return LIGHT_PARTS + 3 * self.light_part_count + found

    @property
    def data_width(self) -> int:
        """Columns of passes of data."""
        return self.data.width

    @property
    def matte_count(self) -> int:
        """Slots of Cryptomattes."""
        return self.data.matte_count


PLAIN_LAYOUT = FilmLayout()


def allocate_tile(pixel_count: int, channel_count: int, layout: FilmLayout = PLAIN_LAYOUT) -> FilmTile:
    """Zeroed sums for `pixel_count` pixels."""
    sizes = {
        "P": pixel_count,
        "C": channel_count,
        "2 C": 2 * channel_count,
        "light": layout.light_width,
        "D": layout.data_width,
        "M": layout.matte_count,
    }
    return allocate(FilmTile, sizes, layout)
