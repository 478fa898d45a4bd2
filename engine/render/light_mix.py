# SPDX-License-Identifier: GPL-3.0-or-later
"""Light groups mixed after a render: each group's light times a factor, in the finished picture.

Light is added up, so a picture whose lamps were brighter by a factor is the picture and the factor's rest of their
light:

    mix = picture + sum over groups of (factor - 1) x light of the group.

Light of no group stays as it is, and with factors of 1 the picture is the same to the bit.

A denoised picture is not the sum of its groups, which have noise. It is multiplied by the ratio of two sums of groups
that are denoised each: with factors, and without. So nothing is subtracted from what has other errors, and with factors
of 1 it too is the same (docs/decisions/light-mixing.md).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
import numpy.typing as npt

from engine.denoise.filter import denoise_all
from engine.state.lanes import RGB

Float32Array = npt.NDArray[np.float32]

#: What is added to both sums of a ratio, as a part of the mean light: where there is no light it is 1.
_LEAST_LIGHT = np.float32(1e-3)


def checked_factors(factors: Mapping[str, Sequence[float]]) -> dict[str, Float32Array]:
    """Factors by group, each for red, green and blue, where they make sense.

    Parameters
    ----------
    factors : mapping of sequence of float
        Three a group, none of them negative.

    Returns
    -------
    dict of float32 (3,)

    Raises
    ------
    ValueError
        Naming the group whose factor is no such thing.
    """
    checked = {}
    for group, factor in factors.items():
        try:
            values = np.asarray(factor, np.float64)
        except (TypeError, ValueError):
            values = np.empty(0)
        if values.shape != (RGB,):
            raise ValueError(f"light group {group}: the factor {factor} is not three numbers: red, green and blue")
        with np.errstate(over="ignore"):
            single = values.astype(np.float32)
        if not np.isfinite(single).all():
            raise ValueError(f"light group {group}: the factor {_listed(values)} is NaN or too large")
        if (single < 0.0).any():
            raise ValueError(f"light group {group}: the factor {_listed(values)} is negative, and light is not")
        checked[group] = single
    return checked


def _listed(values: npt.NDArray[np.float64]) -> str:
    return ", ".join(f"{value:g}" for value in values)


def changes(factors: Mapping[str, Sequence[float] | Float32Array]) -> list[str]:
    """Groups whose factor is not 1 in all channels, in their order."""
    return [group for group, factor in factors.items() if any(value != 1.0 for value in factor)]


def missing_groups(factors: Mapping[str, Sequence[float] | Float32Array], rendered: Iterable[str]) -> list[str]:
    """Groups that the mix changes and that were not rendered, in the order of `factors`."""
    known = set(rendered)
    return [group for group in changes(factors) if group not in known]


def mixed(
    picture: Float32Array, groups: Mapping[str, Float32Array], factors: Mapping[str, Sequence[float]]
) -> Float32Array:
    """A picture with the light of each group times its factor.

    Parameters
    ----------
    picture : float32 (height, width, C), C >= 3
        Scene-linear radiance; further channels, such as alpha, stay. It is not changed.
    groups : mapping of float32 (height, width, >= 3)
        Light of each group, as it is in the picture. Where it is NaN or infinite the picture stays as it is.
    factors : mapping of sequence of float
        Three by group; a group without keeps its light.

    Returns
    -------
    float32 (height, width, C)

    Raises
    ------
    ValueError
        If a factor makes no sense (`checked_factors`), a group that it changes was not rendered, or a group's light has
        another size than the picture. The message names the group.
    """
    checked = checked_factors(factors)
    missing = missing_groups(checked, groups)
    if missing:
        known = f"there are {', '.join(groups)}" if groups else "none were"
        raise ValueError(f"light group {', '.join(missing)} was not rendered, and is in the mix: {known}")
    result = np.array(picture, np.float32)
    for group in changes(checked):
        light = groups[group]
        if light.shape[:2] != picture.shape[:2]:
            sizes = [f"{image.shape[1]} x {image.shape[0]}" for image in (light, picture)]
            raise ValueError(f"light group {group} has {sizes[0]} pixels, and the picture {sizes[1]}")
        with np.errstate(over="ignore", invalid="ignore"):
            added = (checked[group] - np.float32(1.0)) * light[..., :RGB]
        added[~np.isfinite(added)] = 0.0
        result[..., :RGB] += added
    return result


def mixed_denoised(
    picture: Float32Array, plain: Float32Array, groups: Mapping[str, Float32Array],
    factors: Mapping[str, Sequence[float]],
) -> Float32Array:
    """A denoised picture with the light of each group times its factor.

    Parameters
    ----------
    picture : float32 (height, width, C), C >= 3
        Denoised as a whole; channels after the third stay.
    plain : float32 (height, width, 3)
        The sum of what follows and of the light of no group, which is denoised by itself too.
    groups : mapping of float32 (height, width, 3)
        Light of each group, denoised by itself (`denoised_parts`).
    factors : mapping of sequence of float

    Returns
    -------
    float32 (height, width, C)

    Raises
    ------
    ValueError
        As `mixed` does.
    """
    mix = mixed(plain, groups, factors)
    result = np.array(picture, np.float32)
    if not changes(factors):
        return result
    with np.errstate(over="ignore", invalid="ignore"):
        finite = plain[np.isfinite(plain)]
        least = max(_LEAST_LIGHT * np.float32(np.abs(finite).mean() if finite.size else 0.0), np.float32(1e-12))
        ratio = (np.maximum(mix, 0.0) + least) / (np.maximum(plain, 0.0) + least)
        relit = result[..., :RGB] * ratio
    result[..., :RGB] = np.where(np.isfinite(relit), relit, result[..., :RGB])
    return result


def denoised_parts(
    sampled: Float32Array, groups: Mapping[str, Float32Array], albedo: Float32Array | None = None,
    normal: Float32Array | None = None, *, threads: int = 0,
) -> tuple[Float32Array, dict[str, Float32Array]]:
    """What `mixed_denoised` takes: the sum of all light, each group and what is in none denoised by itself, and the
    groups.

    Parameters
    ----------
    sampled : float32 (height, width, >= 3)
        The picture before it was denoised.
    groups : mapping of float32 (height, width, 3)
        As they are in it.
    albedo, normal : float32 (height, width, >= 3), optional
        As `engine.denoise.filter.denoise_all` takes them.
    threads : int
        0 = all.

    Raises
    ------
    DenoiserMissing, DenoiserFailed
        As that does.
    """
    rest = sampled[..., :RGB] - sum(groups.values(), np.zeros_like(sampled[..., :RGB]))
    pictures = [*groups.values(), np.maximum(rest, 0.0)]
    filtered = denoise_all(pictures, albedo, normal if albedo is not None else None, threads=threads)
    assert filtered is not None  # nothing cancels it
    *denoised, of_none = filtered
    return sum(denoised, of_none), dict(zip(groups, denoised, strict=True))


def without_background(light: Float32Array, environment: Float32Array) -> Float32Array:
    """The world's light in a picture whose film is transparent: such a picture leaves out the background, which the
    world's light group has where there is a pass Environment.

    Parameters
    ----------
    light : float32 (height, width, >= 3)
        Light of the world's group.
    environment : float32 (height, width, >= 3)
        The pass Environment.

    Returns
    -------
    float32 (height, width, 3)
    """
    difference: Float32Array = light[..., :RGB] - environment[..., :RGB]
    return difference
