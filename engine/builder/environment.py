# SPDX-License-Identifier: GPL-3.0-or-later
"""The map by which the background is sampled as a light.

References: Karlik, Sik, Vevoda, Skrivan and Krivanek 2019, "MIS Compensation: Optimizing Sampling Techniques in
Multiple Importance Sampling".
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from engine.array_types import Float32Array, Int32Array
from engine.state.lights import DISC_AXIS, DISC_ONE_MINUS_COS, DISC_WIDTH, MAP_GUIDE_SIZE, LightArrays


@dataclass(frozen=True)
class EnvironmentMap:
    """Sampling tables of a background.

    Attributes
    ----------
    marginal : float32 (H + 1, 2)
        Cumulative probability of rows and z at their lower bound.
    conditional : float32 (H, W + 1)
        Cumulative probability within rows.
    guide : int32 (H + 1, MAP_GUIDE_SIZE + 1)
        `LightArrays.map_guide`: shortens the search for a number's column and row.
    mean : float
        Mean radiance over the sphere and the channels; 0: there is nothing to sample.
    compensated : EnvironmentMap or None
        Tables of what is brighter than the mean, for surfaces that find the rest by scattering; None: the same.
    discs : float32 (K, DISC_WIDTH)
        What the tables leave out, to be sampled apart.
    disc_radiance : float32 (K,) [W m^-2 sr^-1]
        Its mean over each disc and the channels.
    """

    marginal: Float32Array
    conditional: Float32Array
    guide: Int32Array
    mean: float
    compensated: EnvironmentMap | None = None
    discs: Float32Array = field(default_factory=lambda: np.zeros((0, DISC_WIDTH), np.float32))
    disc_radiance: Float32Array = field(default_factory=lambda: np.zeros(0, np.float32))


def _bilinear_mass(values: np.ndarray) -> np.ndarray:
    """Mean over each cell of the bilinear interpolation between cell centres.

    A sun one texel wide leaks into its neighbours when the image is interpolated; a map of texel centres would sample
    that light hardly ever and make fireflies of it.
    """
    west, east = np.roll(values, 1, axis=1), np.roll(values, -1, axis=1)
    mixed = 0.125 * west + 0.75 * values + 0.125 * east
    padded = np.concatenate([mixed[:1], mixed, mixed[-1:]])
    return 0.125 * padded[:-2] + 0.75 * mixed + 0.125 * padded[2:]


def empty_map() -> EnvironmentMap:
    """A map of nothing: tables without rows."""
    return _with_guide(np.zeros((1, 2), np.float32), np.zeros((0, 1), np.float32), 0.0)


def sampled_whole(lights: LightArrays) -> LightArrays:
    """Lights of whose background light samples go to the dim parts too, since scattering does not find all of it."""
    none = empty_map()
    return lights._replace(
        compensated_marginal=none.marginal, compensated_conditional=none.conditional, compensated_guide=none.guide
    )


def _cumulative(weights: np.ndarray) -> np.ndarray:
    """Cumulative probabilities along the last axis, 0 first and 1 last; uniform where all weights are 0."""
    total = np.cumsum(weights, axis=-1, dtype=np.float64)
    sums = total[..., -1:]
    count = weights.shape[-1]
    uniform = np.arange(1, count + 1) / count
    with np.errstate(invalid="ignore", divide="ignore"):
        normalized = np.where(sums > 0.0, total / sums, uniform)
    result = np.zeros((*weights.shape[:-1], count + 1), np.float32)
    result[..., 1:] = normalized
    result[..., -1] = 1.0
    return result


def _with_guide(marginal: Float32Array, conditional: Float32Array, mean: float) -> EnvironmentMap:
    steps = np.arange(MAP_GUIDE_SIZE + 1, dtype=np.float32) / np.float32(MAP_GUIDE_SIZE)
    guide = np.zeros((len(conditional) + 1, MAP_GUIDE_SIZE + 1), np.int32)
    for line, cumulative in enumerate((*conditional, marginal[:, 0])):
        last = np.searchsorted(cumulative, steps, side="right") - 1
        guide[line] = np.clip(last, 0, max(len(cumulative) - 2, 0))
    return EnvironmentMap(marginal, conditional, guide, mean)


def build_environment_map(radiance: Float32Array) -> EnvironmentMap:
    """Sampling tables of a background.

    Parameters
    ----------
    radiance : float32 (H, W, 3) [W m^-2 sr^-1]
        Evaluated at cell centres: latitude rises from row 0 (z = -1), longitude as `1/2 - atan2(y, x) / 2 pi`.

    Raises
    ------
    ValueError
        For a grid of another shape.
    """
    radiance = np.asarray(radiance)
    if radiance.ndim != 3 or radiance.shape[2] < 3 or 0 in radiance.shape:
        raise ValueError(f"background map has shape {radiance.shape}: pass (height, width, 3)")
    values = np.zeros(radiance.shape[:2])
    for channel in range(3):
        values += np.abs(np.nan_to_num(radiance[:, :, channel], nan=0.0, posinf=0.0, neginf=0.0))
    values = _bilinear_mass(values / 3.0)
    environment = _tables(values)
    above = np.maximum(values - environment.mean, 0.0)
    # Rounding alone makes a background of one colour brighter than its mean.
    if not above.max(initial=0.0) > 1e-3 * environment.mean:
        return environment
    return replace(environment, compensated=_tables(above))


def without_discs(radiance: Float32Array, discs: Float32Array) -> Float32Array:
    """A grid as `build_environment_map` takes it, black at centres of cells that lie in discs, (K, DISC_WIDTH)."""
    height, width = radiance.shape[:2]
    latitude = np.pi * ((np.arange(height) + 0.5) / height - 0.5)
    longitude = np.pi * (1.0 - 2.0 * (np.arange(width) + 0.5) / width)
    result = radiance.copy() if len(discs) else radiance
    for disc in discs:
        x, y, z = disc[DISC_AXIS : DISC_AXIS + 3]
        cosine = np.outer(np.cos(latitude), x * np.cos(longitude) + y * np.sin(longitude))
        result[cosine + (z * np.sin(latitude))[:, None] >= 1.0 - disc[DISC_ONE_MINUS_COS]] = 0.0
    return result


def _tables(values: np.ndarray) -> EnvironmentMap:
    """Tables of a density in proportion to `values`, (H, W)."""
    height = len(values)
    bounds = -np.cos(np.pi * np.arange(height + 1) / height)
    row_mass = values.mean(axis=1) * np.diff(bounds)
    mean = float(row_mass.sum() / 2.0)
    if not mean > 0.0:
        return empty_map()
    marginal = np.stack([_cumulative(row_mass), bounds.astype(np.float32)], axis=1)
    return _with_guide(np.ascontiguousarray(marginal, np.float32), _cumulative(values), mean)
