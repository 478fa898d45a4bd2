# SPDX-License-Identifier: GPL-3.0-or-later
"""Film: sums per pixel, from which the passes are made.

Samples carry the pixel filter in their position (importance sampling), so a sample belongs to one pixel only and tiles
never share one. A unit of work fills a `FilmTile` of its own and is merged whole or not at all: dropping the paths
still in flight of a cancelled unit would favour short paths.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, MutableMapping, Sequence
from typing import TypeAlias

import numpy as np

from engine.guiding.models.residual import (
    cached_noise,
    halves_with_relative_residual,
    with_relative_residual,
    with_residual,
)
from engine.kernels.film_sums import sums_adder
from engine.kernels.mattes import merge_mattes
from engine.render.data_passes import DATA_PASSES, data_images, data_layout, matte_kind
from engine.render.group_residual import groups_behind
from engine.render.light_passes import (
    LIGHT_PASSES,
    OCCLUSION_PASS,
    asks_for_groups,
    group_pass,
    light_images,
    light_part_count,
)
from engine.render.shadow_catchers import CATCHER_PASS, caught_share, with_shadows
from engine.runtime.jit import BoundKernel, Kernel
from engine.scene.passes import PassSettings
from engine.settings import RenderSettings
from engine.state.columns import columns_of, rows_of
from engine.state.film import (
    DENOISING_ALBEDO,
    DENOISING_DEPTH,
    DENOISING_NORMAL,
    FEATURE_ALBEDO,
    FEATURE_CANDIDATES,
    FEATURE_EMISSION,
    FEATURE_ENVIRONMENT,
    FEATURE_GUIDING_BENEFIT,
    FEATURE_NORMAL,
    FIRST_DEPTH,
    FIRST_MATERIAL_INDEX,
    FIRST_OBJECT_INDEX,
    FIRST_POSITION,
    NO_DEPTH,
    PLAIN_LAYOUT,
    FilmLayout,
    FilmTile,
    Merge,
    allocate_tile,
)

PASS_NAMES = (
    "Combined",
    "Noisy Image",
    "Depth",
    "Normal",
    "Position",
    "Albedo",
    "Emission",
    "Environment",
    "IndexOB",
    "IndexMA",
    "Sample Count",
    "Variance",
    "Candidate Count",
    "Guiding Benefit",
    *DATA_PASSES,
    *LIGHT_PASSES,
    CATCHER_PASS,
    "Denoising Albedo",
    "Denoising Normal",
    "Denoising Depth",
)
#: Passes for denoisers, and where they are in their sums: column and width.
_DENOISING_COLUMNS = {
    "Denoising Albedo": (DENOISING_ALBEDO, 3),
    "Denoising Normal": (DENOISING_NORMAL, 3),
    "Denoising Depth": (DENOISING_DEPTH, 1),
}
DENOISING_PASSES = frozenset(_DENOISING_COLUMNS)
#: Passes that need the features; without any, they are neither computed nor stored. Others have sums of their own.
FEATURE_PASSES = frozenset(PASS_NAMES) - {
    "Combined", "Noisy Image", "Sample Count", "Variance", CATCHER_PASS, *LIGHT_PASSES, *DENOISING_PASSES
}  # fmt: skip


def film_layout(
    passes: frozenset[str], settings: RenderSettings, light_groups: Sequence[str] = (),
    pass_settings: PassSettings | None = None, *, has_catchers: bool = False, has_media: bool = False,
    has_varying_media: bool = False,
) -> FilmLayout:
    """What a film needs for these passes and settings, of a scene with these light groups, settings of passes,
    shadow catchers and media.
    """
    data = data_layout(passes, pass_settings or PassSettings())
    measures_groups = settings.measures_cache and asks_for_groups(passes, light_groups)
    part_count = light_part_count(passes, light_groups, has_media=has_media, measures_groups=measures_groups)
    return FilmLayout(
        use_features=bool(passes & FEATURE_PASSES or data.options.is_used),
        use_residual=settings.measures_cache,
        use_half=settings.use_adaptive_sampling or settings.denoised_threshold > 0.0,
        use_denoising=bool(passes & DENOISING_PASSES),
        light_part_count=part_count,
        light_groups=tuple(light_groups) if part_count else (),
        measures_groups=measures_groups,
        use_occlusion=OCCLUSION_PASS in passes,
        shows_background="Environment" in passes,
        has_catchers=has_catchers,
        has_media=has_media,
        has_varying_media=has_varying_media,
        is_transparent=has_catchers and settings.film_transparent,
        data=data,
    )


#: Passes by name.
Images: TypeAlias = MutableMapping[str, np.ndarray]
#: The largest mean whose square, times few numbers, is a number in float32.
_BRIGHTEST = np.float32(1e18)
#: Made of each other, and so together; and what else is made of means of radiance.
_OF_PICTURE = frozenset({"Combined", "Noisy Image", CATCHER_PASS})
_OF_RADIANCE = _OF_PICTURE | {"Variance"}
#: Of which passes are made together: what lies between sums and passes takes more room than either.
_PIXELS_AT_ONCE = 1 << 18


class Film:
    """The image's sums, width x height pixels, row 0 at the bottom."""

    def __init__(
        self, width: int, height: int, layout: FilmLayout = PLAIN_LAYOUT, *, channel_count: int = 3
    ) -> None:
        self.width, self.height, self.layout = width, height, layout
        self.sums = allocate_tile(width * height, channel_count, layout)
        declared = columns_of(type(self.sums))
        has_rows = {name for name, values in self.sums._asdict().items() if len(values)}
        #: Columns that it has by how they are merged.
        self._merged = {
            merge: [name for name in declared if name in has_rows and declared[name].merge == merge] for merge in Merge
        }
        self._adder = sums_adder(type(self.sums))
        #: The same for rows of one type, since numba would look at all arguments' types for each unit.
        self._bound_adder: tuple[object, Callable[..., None]] | None = None

    def merge(self, pixels: np.ndarray, tile: FilmTile, weight: float = 1.0) -> None:
        """Add a finished unit's sums; `pixels` are its pixels' indices. Units of one pixel come in sample order.

        `weight` of each of its samples must not depend on any sample.
        """
        factor = np.float32(weight)
        pixels = np.ascontiguousarray(pixels, np.int64)
        self._keep_first(pixels, tile)
        self._add_sums(pixels, tile, factor)
        for name in self._merged[Merge.MATTES]:
            self._merge_mattes(
                name, pixels, getattr(tile, name), np.arange(len(pixels)), np.full(len(pixels), factor)
            )

    def _add_sums(self, pixels: np.ndarray, tile: FilmTile, factor: np.float32) -> None:
        """Add all that is a sum."""
        adder = self._adder
        if isinstance(adder, Kernel):
            if self._bound_adder is None or self._bound_adder[0] is not tile._numba_type_:
                self._bound_adder = tile._numba_type_, BoundKernel(adder)
            adder = self._bound_adder[1]
        adder(self.sums, pixels, tile, factor)

    def _keep_first(self, pixels: np.ndarray, tile: FilmTile) -> None:
        """What a unit says of the first sample, for pixels that have none yet; call it before `count` is merged."""
        for name in self._merged[Merge.FIRST]:
            first = self.sums.count[pixels] == 0
            getattr(self.sums, name)[pixels[first]] = getattr(tile, name)[: len(pixels)][first]

    def _merge_mattes(
        self, name: str, pixels: np.ndarray, mattes: np.ndarray, rows: np.ndarray, factors: np.ndarray
    ) -> None:
        """Add rows of mattes to those of pixels, each with its factor; slot by slot."""
        target, slots = getattr(self.sums, name), self.layout.data.options.matte_slots
        merge_mattes(target, pixels.astype(np.int64), mattes, rows, slots, factors.astype(np.float32))

    @property
    def nbytes(self) -> int:
        """Memory of the sums."""
        return sum(array.nbytes for array in self.sums)

    @property
    def has_residual(self) -> bool:
        """Whether paths ended in the radiance cache, and some measured what that lacks."""
        return len(self.sums.residual) > 0

    def cached_image(self, *, exposure: float) -> np.ndarray:
        """What paths brought that ended in the radiance cache, without what that lacks: float32 (height, width, 3)."""
        scale = np.float32(exposure) * self._scale()
        return (self.sums.radiance[:, :3] * scale).reshape(self.height, self.width, 3)

    def with_residual(self, denoised: np.ndarray, *, exposure: float) -> np.ndarray:
        """The denoised `cached_image` with what is known of what it lacks: float32 (height, width, 3)."""
        scale = np.float32(exposure) * self._scale()
        shape = (self.height, self.width)
        whole = with_relative_residual(
            denoised.reshape(-1, 3), self.sums.residual * scale, self.sums.residual_square * scale[:, 0] ** 2,
            self.sums.ended * scale[:, 0], shape, cached_noise(self.sums, shape),
        )
        return whole.astype(np.float32).reshape(*shape, 3)

    def halves_with_residual(
        self, denoised: tuple[np.ndarray, np.ndarray], cell: tuple[slice, slice], *, exposure: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """As `with_residual`, of two denoised halves of a part of `cached_image`, each with half of the measuring
        paths. Bands are those of the part alone.
        """

        def of_cell(values: np.ndarray) -> np.ndarray:
            part = values.reshape(self.height, self.width, -1)[cell]
            return np.ascontiguousarray(part).reshape(-1, part.shape[2])

        scale = of_cell(np.float32(exposure) * self._scale())
        first, second = halves_with_relative_residual(
            (denoised[0].reshape(-1, 3), denoised[1].reshape(-1, 3)), of_cell(self.sums.residual) * scale,
            of_cell(self.sums.residual_square)[:, 0] * scale[:, 0] ** 2, (len(denoised[0]), denoised[0].shape[1]),
        )
        return first.reshape(denoised[0].shape), second.reshape(denoised[1].shape)

    def _scale(self) -> np.ndarray:
        """What makes means of sums: float32 (P, 1), 0 where there is no sample."""
        has_samples = self.sums.count > 0
        weight = np.where(has_samples, self.sums.weight, 1.0).astype(np.float32)
        return np.where(has_samples, 1.0 / weight, 0.0).astype(np.float32)[:, None]

    def passes(self, names: set[str] | frozenset[str], *, exposure: float) -> dict[str, np.ndarray]:
        """Images by pass name.

        Parameters
        ----------
        names : set of str
            From PASS_NAMES, and passes of light groups, mattes and AOVs; `'Combined'` is always made.
        exposure : float
            Factor on radiance.

        Returns
        -------
        dict of float32 (height, width, channels), row 0 at the bottom, scene-linear
            Combined has premultiplied alpha; Noisy Image is the same, for whoever denoises Combined later. Variance is
            that of the pixel's mean, per channel, after exposure.
            Candidate Count is the mean number of candidates at the first surface, 0 where it was not guided; Guiding
            Benefit the second moment of its light with BSDF sampling over that with guiding, as estimated, 1 where it
            was not guided. Both count all samples, those of iterations that knew nothing too. Passes for denoisers are
            as Cycles has them (`engine.wavefront.write_denoising`).
        """
        return self.images({*names, "Combined"}, exposure=exposure)

    def images(self, names: set[str] | frozenset[str], *, exposure: float) -> dict[str, np.ndarray]:
        """As `passes`, of these names alone. Whether Combined has the shadows depends on the pass of shadow catchers:
        ask for both together.
        """
        if "Noisy Image" in names:
            names = {*names, "Combined"}
        rows = self.height if self.has_residual else max(_PIXELS_AT_ONCE // max(self.width, 1), 1)
        images: dict[str, np.ndarray] = {}
        for first in range(0, self.height, rows):
            last = min(first + rows, self.height)
            sums = rows_of(self.sums, first * self.width, last * self.width)
            for name, image in self._images(sums, (last - first, self.width), names, exposure).items():
                if name not in images:
                    images[name] = np.empty((self.height, *image.shape[1:]), np.float32)
                images[name][first:last] = image
        if "Noisy Image" in names:
            images["Noisy Image"] = images["Combined"]
        return images

    def _picture(
        self, sums: FilmTile, whole: np.ndarray, weight: np.ndarray, scale: np.ndarray, shape: tuple[int, int],
        names: set[str] | frozenset[str], exposure: float,
    ) -> dict[str, np.ndarray]:
        """Combined and the pass of shadow catchers, of means of radiance."""
        images: dict[str, np.ndarray] = {}
        # Without a transparent film only holdouts have an alpha below one.
        alpha = np.where(sums.count > 0, sums.alpha / weight, 0.0)
        color = whole
        if CATCHER_PASS in names:
            images[CATCHER_PASS] = np.ones((*shape, 3), np.float32)
        if len(sums.caught):
            caught = sums.caught * scale
            if CATCHER_PASS in names:
                images[CATCHER_PASS] = caught_share(caught, alpha).reshape(*shape, 3)
            color, alpha = with_shadows(
                whole, alpha, caught, is_transparent=self.layout.is_transparent, has_pass=CATCHER_PASS in names
            )
        if "Combined" in names:
            combined = np.empty((*shape, 4), np.float32)
            combined[..., :3] = (color * exposure).reshape(*shape, 3)
            combined[..., 3] = np.clip(alpha, 0.0, 1.0).reshape(shape)
            images["Combined"] = combined
        return images

    def _behind(
        self, sums: FilmTile, scale: np.ndarray, residual: np.ndarray | None, shape: tuple[int, int],
        names: set[str] | frozenset[str],
    ) -> np.ndarray | None:
        """Light of each group that its part lacks, None where none does."""
        layout = self.layout
        if residual is None or not layout.measures_groups or not asks_for_groups(names, layout.light_groups):
            return None
        spread = sums.weight_squared * scale[:, 0] ** 2
        return groups_behind(
            sums.light, len(layout.light_groups), layout.light_part_count, scale, spread, residual, shape
        )

    def _images(
        self, sums: FilmTile, shape: tuple[int, int], names: set[str] | frozenset[str], exposure: float
    ) -> dict[str, np.ndarray]:
        """`passes` of some rows, but for the noisy image."""
        count = sums.count.astype(np.float32)
        # At least one sample's weight, where there is a sample: dividing sums of ones keeps a one exact.
        weight = np.where(count > 0, sums.weight, 1.0).astype(np.float32)
        scale = np.where(count > 0, 1.0 / weight, 0.0).astype(np.float32)[:, None]
        images: dict[str, np.ndarray] = {}
        mean = whole = np.zeros((0, 3), np.float32)
        if not names.isdisjoint(_OF_RADIANCE) or len(sums.residual):
            mean = whole = sums.radiance[:, :3] * scale
        # Variances below are of the cached samples, about their own mean.
        if len(sums.residual):
            whole = with_residual(
                mean, sums.residual * scale, sums.residual_square * scale[:, 0] ** 2, sums.ended * scale[:, 0], shape,
                cached_noise(sums, shape),
            )
        if not names.isdisjoint(_OF_PICTURE):
            images |= self._picture(sums, whole, weight, scale, shape, names, exposure)
        if "Sample Count" in names:
            images["Sample Count"] = count.reshape(*shape, 1)
        if "Variance" in names:
            # Within what squares have room for in float32.
            square = np.minimum(sums.square[:, :3] * scale, _BRIGHTEST * _BRIGHTEST)
            darker = np.clip(mean, -_BRIGHTEST, _BRIGHTEST)
            # Variance of a weighted mean: that of a sample (n / (n - 1) for the mean taken from them) times sum w^2 /
            # (sum w)^2, which is 1 / n for equal weights.
            of_sample = np.maximum(square - darker * darker, 0.0) * (count / np.maximum(count - 1.0, 1.0))[:, None]
            spread = of_sample * (sums.weight_squared / (weight * weight))[:, None]
            images["Variance"] = (spread * exposure * exposure).astype(np.float32).reshape(*shape, 3)
        for name, (column, width) in _DENOISING_COLUMNS.items():
            if name in names and len(sums.denoising):
                image = sums.denoising[:, column : column + width] * scale
                images[name] = image.reshape(*shape, width)
        if len(sums.light):
            residual = whole - mean if len(sums.residual) else None
            behind = self._behind(sums, scale, residual, shape, names)
            images |= {
                name: image.reshape(*shape, 3)
                for name, image in light_images(
                    names, self.layout, sums.light, scale, residual, exposure, behind
                ).items()
            }
        if self.layout.use_features:
            for name, column, factor in (
                ("Normal", FEATURE_NORMAL, 1.0),
                ("Albedo", FEATURE_ALBEDO, 1.0),
                ("Emission", FEATURE_EMISSION, exposure),
                ("Environment", FEATURE_ENVIRONMENT, exposure),
            ):
                if name in names:
                    means = sums.features[:, column : column + 3] * scale
                    images[name] = np.ascontiguousarray(means * factor).reshape(*shape, 3)
            if "Candidate Count" in names:
                images["Candidate Count"] = (sums.features[:, FEATURE_CANDIDATES] * scale[:, 0]).reshape(*shape, 1)
            if "Guiding Benefit" in names:
                benefit = 1.0 + sums.features[:, FEATURE_GUIDING_BENEFIT] * scale[:, 0]
                images["Guiding Benefit"] = benefit.reshape(*shape, 1)
            points = sums.points
            for name, column, width in (
                ("Depth", FIRST_DEPTH, 1),
                ("Position", FIRST_POSITION, 3),
                ("IndexOB", FIRST_OBJECT_INDEX, 1),
                ("IndexMA", FIRST_MATERIAL_INDEX, 1),
            ):
                if name in names:
                    image = np.ascontiguousarray(points[:, column : column + width]).reshape(*shape, width)
                    images[name] = image.astype(np.float32)
            if "Depth" in names:
                images["Depth"][images["Depth"] == 0.0] = NO_DEPTH
        images |= data_images(self.layout.data, sums.data, sums.mattes, scale, shape, names)
        return images


class PassImages(MutableMapping[str, np.ndarray]):
    """Passes of a film by name, each made anew when it is looked up, and kept until another is: all of them together
    take as much room as the film.

    Parameters
    ----------
    film : Film
    names : set of str
        Passes that the film has.
    exposure : float
        Factor on radiance.
    lock : lock
        Held while the film is read.
    """

    def __init__(self, film: Film, names: frozenset[str], exposure: float, lock: threading.Lock) -> None:
        self._film, self._names, self._exposure, self._lock = film, names, exposure, lock
        #: What has been put in place of the film's own.
        self._given: dict[str, np.ndarray] = {}
        self._kept: dict[str, np.ndarray] = {}

    def __getitem__(self, name: str) -> np.ndarray:
        if name in self._given:
            return self._given[name]
        if name not in self._names:
            raise KeyError(name)
        if name not in self._kept:
            self._kept = {}
            with self._lock:
                self._kept = self._film.images(self._together(name), exposure=self._exposure)
        return self._kept[name]

    def _together(self, name: str) -> frozenset[str]:
        """Names of what is made with it."""
        if name in _OF_PICTURE:
            return self._names & _OF_PICTURE
        layout = self._film.layout
        groups = frozenset(map(group_pass, layout.light_groups)) if layout.measures_groups else frozenset()
        if name in groups:
            return self._names & groups
        kind = matte_kind(name)
        return frozenset(other for other in self._names if other == name or (kind and matte_kind(other) == kind))

    def __setitem__(self, name: str, image: np.ndarray) -> None:
        self._given[name] = image
        self._names |= {name}

    def __delitem__(self, name: str) -> None:
        if name not in self._names:
            raise KeyError(name)
        self._names -= {name}
        self._given.pop(name, None)

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)
