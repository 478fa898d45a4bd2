# SPDX-License-Identifier: GPL-3.0-or-later
"""Denoising a picture by what is known of its surfaces, with the settings that Cycles gives Open Image Denoise."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from engine.denoise.library import QUALITIES, Device

#: What is done with albedo and normal before they are used: nothing, since they have no noise; nothing, although they
#: have; or they are denoised first.
PREFILTERS = ("NONE", "FAST", "ACCURATE")


def denoise(
    color: np.ndarray,
    albedo: np.ndarray | None = None,
    normal: np.ndarray | None = None,
    *,
    quality: str = "HIGH",
    prefilter: str = "ACCURATE",
    threads: int = 0,
    should_cancel: Callable[[], bool] | None = None,
) -> np.ndarray | None:
    """Take the noise out of a picture: `denoise_all` of one.

    Returns
    -------
    float32 (height, width, 3), or None if it was cancelled
    """
    denoised = denoise_all(
        (color,), albedo, normal, quality=quality, prefilter=prefilter, threads=threads, should_cancel=should_cancel
    )
    return None if denoised is None else denoised[0]


def denoise_all(
    colors: Sequence[np.ndarray],
    albedo: np.ndarray | None = None,
    normal: np.ndarray | None = None,
    *,
    quality: str = "HIGH",
    prefilter: str = "ACCURATE",
    threads: int = 0,
    should_cancel: Callable[[], bool] | None = None,
) -> list[np.ndarray] | None:
    """Take the noise out of pictures of the same surfaces; what they share is filtered once.

    Parameters
    ----------
    colors : sequence of float32 (height, width, >= 3)
        Scene-linear radiance, of any exposure. Further channels, such as alpha, are left out.
    albedo : float32 (height, width, >= 3), optional
        In [0, 1]; what is brighter counts as 1.
    normal : float32 (height, width, >= 3), optional
        In any space. Needs an albedo.
    quality : str
        'HIGH', 'BALANCED' or 'FAST'.
    prefilter : str
        'NONE': albedo and normal are free of noise; 'FAST': they may be noisy; 'ACCURATE': they are denoised first.
    threads : int
        0 = all.
    should_cancel : callable, optional
        Asked now and then, in another thread.

    Returns
    -------
    list of float32 (height, width, 3), or None if it was cancelled

    Raises
    ------
    ValueError
        Naming the image or the choice that makes no sense.
    DenoiserMissing
        Where there is no Open Image Denoise (`library.problem` says so beforehand).
    DenoiserFailed
        With its own words.
    """
    if quality not in QUALITIES:
        raise ValueError(f"denoising quality {quality!r}: choose one of {', '.join(QUALITIES)}")
    if prefilter not in PREFILTERS:
        raise ValueError(f"denoising prefilter {prefilter!r}: choose one of {', '.join(PREFILTERS)}")
    if normal is not None and albedo is None:
        raise ValueError("denoising by a normal needs an albedo too")
    shape = colors[0].shape[:2]
    pictures = [_usable("color", color, shape) for color in colors]
    given = {"albedo": albedo, "normal": normal}
    features = {name: _usable(name, image, shape) for name, image in given.items() if image is not None}
    outputs = [np.zeros((*shape, 3), np.float32) for _ in pictures]
    if outputs[0].size == 0:
        return outputs
    with Device(threads) as device:
        if prefilter == "ACCURATE":
            for name, image in features.items():
                filtered = np.empty_like(outputs[0])
                if not device.run({name: image, "output": filtered}, {"srgb": False}, quality, should_cancel):
                    return None
                features[name] = filtered
        flags = {"hdr": True, "srgb": False, "cleanAux": prefilter != "FAST" and bool(features)}
        for picture, output in zip(pictures, outputs, strict=True):
            if not device.run({"color": picture, **features, "output": output}, flags, quality, should_cancel):
                return None
    return outputs


def _usable(name: str, image: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """The image as the library can read it: itself, if its channels lie side by side."""
    if image.ndim != 3 or image.shape[2] < 3 or image.shape[:2] != shape:
        raise ValueError(f"denoising: {name} is {image.shape}, not {(*shape, 3)}")
    if image.dtype != np.float32 or image.strides[2] != image.itemsize or min(image.strides[:2]) < 0:
        return np.ascontiguousarray(image, np.float32)
    return image
