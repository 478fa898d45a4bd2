# SPDX-License-Identifier: GPL-3.0-or-later
"""Steadying denoised frames: what a denoiser errs changes from frame to frame, and is averaged along what moves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from engine.denoise.library import Device
from engine.denoise.motion import Places, follow

#: Pixels to each side over which noise is measured, and over which pictures are compared.
_NOISE_REACH, _COMPARED_REACH = 3, 1
#: Variance of a denoised pixel over that of a sampled one around it: what may differ by chance.
_KEPT_NOISE = 0.1
#: How many times that variance two pictures may differ without being taken for different.
_BY_CHANCE = 2.0
#: A sampled pixel counts as no further from the denoised one than so many times the brightness around.
_MOST_NOISE = 5.0
#: Least albedo that albedos are compared by.
_LEAST_ALBEDO = np.float32(0.02)
#: Albedos that differ by more of the larger one are of different surfaces, and so are normals that turn by more.
_MOST_ALBEDO_CHANGE, _LEAST_COSINE = 0.25, 0.9
#: Albedo may change from frame to frame by a texture under pixels; the light is taken along up to this factor.
_MOST_RATIO = 2.0


@dataclass(frozen=True)
class Frame:
    """What is known of a frame; all float32, row 0 at the bottom.

    Attributes
    ----------
    picture : (height, width, 3)
        Denoised.
    albedo, normal : (height, width, 3)
        Denoised too.
    vectors : (height, width, 4) [pixels]
        Blender's pass: x and y to the frame before, and from the frame after.
    noise : (height, width)
        Variance by chance of a pixel of `picture`, mean of its channels.
    """

    picture: np.ndarray
    albedo: np.ndarray
    normal: np.ndarray
    vectors: np.ndarray
    noise: np.ndarray


def _box(image: np.ndarray, reach: int) -> np.ndarray:
    """Mean of the pixels up to `reach` to each side, the border's repeated."""
    for axis in (0, 1):
        widths = [(0, 0)] * image.ndim
        widths[axis] = (reach + 1, reach)
        sums = np.cumsum(np.pad(image, widths, mode="edge"), axis=axis, dtype=np.float64)
        size = 2 * reach + 1
        length = image.shape[axis]
        upper, lower = (np.take(sums, np.arange(start, start + length), axis) for start in (size, 0))
        image = ((upper - lower) / size).astype(np.float32)
    return image


def make_frame(
    picture: np.ndarray, sampled: np.ndarray, albedo: np.ndarray, normal: np.ndarray, vectors: np.ndarray,
    *, threads: int = 0,
) -> Frame:
    """Make ready what is known of a frame.

    Parameters
    ----------
    picture, sampled : float32 (height, width, 3)
        Denoised, and as it was sampled.
    albedo, normal : float32 (height, width, 3)
        As they were sampled.
    vectors : float32 (height, width, 4) [pixels]
    threads : int
        0 = all.

    Raises
    ------
    DenoiserMissing, DenoiserFailed
        As `filter.denoise`.
    """
    features = {"albedo": np.nan_to_num(albedo, posinf=0.0, neginf=0.0), "normal": np.nan_to_num(normal)}
    with Device(threads) as device:
        for name, image in features.items():
            filtered = np.zeros_like(image)
            device.run({name: np.ascontiguousarray(image), "output": filtered}, {"srgb": False}, "HIGH")
            features[name] = filtered
    picture = np.nan_to_num(picture, posinf=0.0, neginf=0.0)
    most = _MOST_NOISE * _box(picture.mean(axis=2), 1)
    apart = np.nan_to_num(sampled - picture, posinf=0.0, neginf=0.0)
    square = np.minimum((apart * apart).mean(axis=2), most * most)
    return Frame(
        picture, features["albedo"], features["normal"], vectors, np.float32(_KEPT_NOISE) * _box(square, _NOISE_REACH)
    )


def _ratio(albedo: np.ndarray, other: np.ndarray) -> np.ndarray:
    """What light of a pixel of `other` is to be multiplied by to be that of one of `albedo`."""
    return np.clip((albedo + _LEAST_ALBEDO) / (other + _LEAST_ALBEDO), 1.0 / _MOST_RATIO, _MOST_RATIO)


def _is_same_surface(frame: Frame, other: Frame, places: Places) -> np.ndarray:
    """Where albedo and normal agree: bool (height, width)."""
    albedo, normal = other.albedo[places], other.normal[places]
    brighter = np.maximum(frame.albedo, albedo).max(axis=2)
    agrees = np.abs(frame.albedo - albedo).max(axis=2) < _MOST_ALBEDO_CHANGE * brighter + _LEAST_ALBEDO
    along = (frame.normal * normal).sum(axis=2)
    longer = np.maximum((frame.normal * frame.normal).sum(axis=2), (normal * normal).sum(axis=2))
    return agrees & (along > _LEAST_COSINE * longer - 0.05)


def _weight(frame: Frame, other: Frame, places: Places, moved: np.ndarray) -> np.ndarray:
    """What another frame's pixels count for beside the frame's own, by how they differ: float32 (height, width)."""
    apart = frame.picture - moved
    square = _box((apart * apart).mean(axis=2), _COMPARED_REACH)
    noise = 0.5 * (frame.noise + other.noise[places])
    change = np.maximum(square - 2.0 * _BY_CHANCE * noise, 0.0)
    return noise / (noise + change + np.float32(1e-12))


def steady(frame_of: Callable[[int], Frame], index: int, count: int, reach: int) -> np.ndarray:
    """A frame's picture, averaged with what the frames around it show of the same.

    A pixel of another frame counts if motion vectors lead to it and back, and if albedo and normal are those of the
    same surface. It counts the less the more the pictures around the two differ than noise explains: so do shadows,
    lamps and reflections that move. With the variance s of a pixel and the square b of such a difference its weight is
    s / (s + b), which is best for the mean's squared error.

    Parameters
    ----------
    frame_of : callable
        Index -> `Frame`; asked for the frames from `index - reach` to `index + reach`, again and again.
    index, count : int
        Of the frame, and how many there are.
    reach : int
        Frames to look at before and after.

    Returns
    -------
    float32 (height, width, 3)
    """
    frame = frame_of(index)
    total = frame.picture.copy()
    weights = np.ones(total.shape[:2], np.float32)
    for direction in (-1, 1):
        last = max(index - reach, 0) if direction < 0 else min(index + reach, count - 1)
        for sighting in follow(lambda number: frame_of(number).vectors, index, last, direction):
            other, places = frame_of(index + sighting.lag), sighting.places
            moved = other.picture[places] * _ratio(frame.albedo, other.albedo[places])
            weight = _weight(frame, other, places, moved)
            weight[~(sighting.is_seen & _is_same_surface(frame, other, places))] = 0.0
            total += weight[..., None] * moved
            weights += weight
    return total / weights[..., None]
