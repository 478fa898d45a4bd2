# SPDX-License-Identifier: GPL-3.0-or-later
"""Steadying denoised frames: what a denoiser errs changes from frame to frame, and is averaged along what moves.

Why pictures are averaged after they are denoised, and with which weights: docs/decisions/denoising.md.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from engine.denoise.library import Device
from engine.denoise.motion import Places, Sighting, follow
from engine.denoise.patches import most_alike
from engine.denoise.windows import window_means, window_sums

#: Pixels to each side over which noise is measured, and over which pictures are compared: for edges, shadows, light.
_NOISE_REACH, _COMPARED_REACHES = 3, (0, 2, 6, 15)
#: Variance of a denoised pixel over that of the sampled ones around it.
_KEPT_NOISE = np.float32(0.1)
#: Square of the standard deviations by which windows may differ by chance.
_BY_CHANCE = 12.0
#: Least brightness that differences are relative to, over the mean of the picture.
_LEAST_BRIGHTNESS = np.float32(0.01)
#: Part of a pixel's brightness by which pixels that look alike may differ, noise or not.
_SLACK = np.float32(0.01)
#: A sampled pixel counts as no further from the denoised one than so many times the brightness around.
_MOST_NOISE = 5.0
#: Motion within so many pixels around may differ by less than so much, where all is one thing [pixels].
_EDGE_REACH, _MOST_SPREAD = 1, 0.5
#: Least albedo that albedos are compared by.
_LEAST_ALBEDO = np.float32(0.02)
#: Albedos that differ by more of the larger one are of different surfaces, and so are normals that turn by more.
_MOST_ALBEDO_CHANGE, _LEAST_COSINE, _NORMAL_SLACK = 0.25, 0.9, 0.05
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
    noise : (height, width, 3)
        Variance of a pixel as it was sampled.
    """

    picture: np.ndarray
    albedo: np.ndarray
    normal: np.ndarray
    vectors: np.ndarray
    noise: np.ndarray

    @cached_property
    def sharpness(self) -> np.ndarray:
        """What `patches.most_alike` multiplies squared differences by: float32 (height, width)."""
        bright = np.maximum(self.picture.mean(axis=2), _LEAST_BRIGHTNESS * self.picture.mean())
        kept = 2.0 * _KEPT_NOISE * self.noise.sum(axis=2) + 3.0 * np.square(_SLACK * bright)
        return np.asarray(1.0 / np.maximum(kept, 1e-12), np.float32)

    @cached_property
    def moves_as_one(self) -> np.ndarray:
        """Where a pixel and those around it move alike, bool (height, width): else it may show two things at once."""
        vectors = np.nan_to_num(self.vectors, nan=0.0, posinf=0.0, neginf=0.0)
        height, width = vectors.shape[:2]
        padded = np.pad(vectors, ((_EDGE_REACH, _EDGE_REACH), (_EDGE_REACH, _EDGE_REACH), (0, 0)), mode="edge")
        shifted = [
            padded[row : row + height, column : column + width]
            for row in range(2 * _EDGE_REACH + 1)
            for column in range(2 * _EDGE_REACH + 1)
        ]
        spread = np.maximum.reduce(shifted) - np.minimum.reduce(shifted)
        return np.asarray(spread.max(axis=2) < _MOST_SPREAD)


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
        As they were sampled, normals in any space.
    vectors : float32 (height, width, 4) [pixels]
    threads : int
        0 = all.

    Returns
    -------
    Frame
        What is no number is 0 there.

    Raises
    ------
    DenoiserMissing, DenoiserFailed
        As `filter.denoise`.
    """
    features = {"albedo": _finite(albedo), "normal": _finite(normal)}
    with Device(threads) as device:
        for name, image in features.items():
            features[name] = np.zeros_like(image)
            device.run({name: image, "output": features[name]}, {"srgb": False}, "HIGH")
    picture = _finite(picture)
    most = _MOST_NOISE * window_means(picture, 1)
    # Fireflies would hide that anything changes.
    apart = np.minimum(np.abs(_finite(sampled) - picture), most)
    noise = window_means(apart * apart, _NOISE_REACH)
    return Frame(picture, features["albedo"], features["normal"], vectors, noise)


def _finite(image: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(np.nan_to_num(image[..., :3], nan=0.0, posinf=0.0, neginf=0.0), np.float32)


def _albedo_ratio(albedo: np.ndarray, other: np.ndarray) -> np.ndarray:
    """What light of pixels of albedo `other` is to be multiplied by to be that of `albedo`."""
    return np.clip((albedo + _LEAST_ALBEDO) / (other + _LEAST_ALBEDO), 1.0 / _MOST_RATIO, _MOST_RATIO)


def _is_same_surface(frame: Frame, other: Frame, places: Places) -> np.ndarray:
    """Where albedo and normal agree: bool (height, width)."""
    albedo, normal = other.albedo[places], other.normal[places]
    brighter = np.maximum(frame.albedo, albedo).max(axis=2)
    agrees = np.abs(frame.albedo - albedo).max(axis=2) < _MOST_ALBEDO_CHANGE * brighter + _LEAST_ALBEDO
    along = (frame.normal * normal).sum(axis=2)
    longer = np.maximum((frame.normal * frame.normal).sum(axis=2), (normal * normal).sum(axis=2))
    return np.asarray(agrees & (along > _LEAST_COSINE * longer - _NORMAL_SLACK))


def _change(frame: Frame, moved: np.ndarray, noise: np.ndarray, is_same: np.ndarray) -> np.ndarray:
    """Square of what pictures differ by and chance does not explain, over the variance of a denoised pixel.

    Means over windows are compared, of each size and channel; the largest counts: float64 (height, width). Pixels are
    taken over the root of their brightness, so that something bright that moves does not count for all around it.

    Parameters
    ----------
    moved : float32 (height, width, 3)
        The other picture, its pixels where this one has them.
    noise : float32 (height, width, 3)
        Variance of a pixel of both as they were sampled, in sum.
    is_same : bool (height, width)
        Pixels that can be compared.
    """
    chosen = is_same[..., None].astype(np.float32)
    most = max(_COMPARED_REACHES)
    both = np.maximum(0.5 * (frame.picture + moved).mean(axis=2, keepdims=True), 0.0)
    per_brightness = 1.0 / np.maximum(both + _LEAST_BRIGHTNESS * frame.picture.mean(), np.float32(1e-12))
    noise = noise * per_brightness
    apart = (frame.picture - moved) * np.sqrt(per_brightness)
    sums, counts, variances = (window_sums(image, most) for image in (apart * chosen, chosen, noise * chosen))
    largest = np.zeros(is_same.shape)
    kept = _KEPT_NOISE * noise + np.float32(1e-12)
    for reach in _COMPARED_REACHES:
        count = np.maximum(counts(reach), 1.0)
        # Means over windows err as those of the sampled pixels, which a denoiser keeps, and no more than its own.
        chance = np.minimum(variances(reach) / (count * count), kept)
        square = np.maximum(np.square(sums(reach) / count) - _BY_CHANCE * chance, 0.0)
        np.maximum(largest, (square / kept).max(axis=2), out=largest)
    return largest


def _what_it_shows(
    frame: Frame, other: Frame, sighting: Sighting, places: Places, count: int
) -> tuple[np.ndarray, np.ndarray]:
    """What pixels of another frame say of those of a frame, float32 (height, width, 3), and how much they count.

    Parameters
    ----------
    places : (rows, columns)
        Of the pixels there.
    count : int
        Of other frames, which tend to differ by the same.
    """
    is_same = sighting.is_seen & frame.moves_as_one & other.moves_as_one[places]
    is_same &= _is_same_surface(frame, other, places)
    moved = other.picture[places] * _albedo_ratio(frame.albedo, other.albedo[places])
    change = _change(frame, moved, frame.noise + other.noise[places], is_same)
    return moved, np.where(is_same, 1.0 / (1.0 + count * change), 0.0).astype(np.float32)


def steady(frame_of: Callable[[int], Frame], index: int, count: int, reach: int, *, threads: int = 0) -> np.ndarray:
    """A frame's picture, averaged with what the frames around it show of the same.

    A pixel of another frame counts if motion vectors lead to it and back, if all around both moves alike, and if albedo
    and normal are those of the same surface. It counts the less the more the pictures around the two differ than noise
    explains: so do shadows, lamps and reflections that move. With s the variance of a pixel, b what they differ by, and
    n other frames that are likely to differ by the same, its weight is 1 / (1 + n b^2 / s), for the least squared error
    of the mean. Two pixels of each frame are looked at: where the surface is, and near it where it looks most alike, as
    reflections do that move by themselves. They share the larger of their weights.

    Parameters
    ----------
    frame_of : callable
        Index -> `Frame`; asked for the frames from `index - reach` to `index + reach`, again and again.
    index, count : int
        Of the frame, and how many there are.
    reach : int
        Frames to look at before and after.
    threads : int
        0 = all.

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
            moved, weight = _what_it_shows(frame, other, sighting, places, 2 * reach)
            places = most_alike(frame.picture, frame.sharpness, other.picture, places, threads=threads)
            alike, its_weight = _what_it_shows(frame, other, sighting, places, 2 * reach)
            larger = np.maximum(weight, its_weight)
            shared = larger / np.maximum(weight + its_weight, np.float32(1e-30))
            total += (shared * weight)[..., None] * moved + (shared * its_weight)[..., None] * alike
            weights += larger
    return total / weights[..., None]
