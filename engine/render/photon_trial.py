# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether photons are worth their time: by a few pixels, before the picture begins, the same whoever tries them.

What photons gather says what paths alone would find of the same light, and how noisy that would be: light that n
photons bring for each path that finds it is n times as much when a path does. So one trial with photons tells both.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from engine.array_types import Float32Array, Int32Array

#: Pixels that are tried, two samples each.
TRIED_PIXELS = 2048
#: Photons take this much of the time of paths, and more where they are gathered; they must save more than that.
_LEAST_GAIN = 1.15
#: Within media, where all segments ask for photons: `volumetric_caustic` takes 1.6 times the time.
_LEAST_GAIN_IN_MEDIA = 1.5
#: Share of pixels whose noise is left out, those with the most: single ones tell nothing of the others.
_TRIMMED = 0.01
#: Errors count relative to a pixel's value, and to this share of the mean.
_DIM = 0.25
#: Light that paths find so seldom that a picture of this many samples has none of it is missing, which is an error of
#: its square: noise that a few fireflies would make counts no more than that.
_SAMPLES = 256

#: Traces the pixels, for which of the two samples: the samples' values float32 (P, 3), and `PhotonLanes.tried` (P, 3);
#: None: it was stopped.
TracePixels = Callable[[Int32Array, int], tuple[Float32Array, Float32Array] | None]


def tried_pixels(region: tuple[int, int, int, int], seed: int) -> Int32Array:
    """Columns and rows of pixels all over a region of the picture: int32 (P, 2)."""
    x0, y0, x1, y1 = region
    count = min(TRIED_PIXELS, (x1 - x0) * (y1 - y0))
    chosen = np.random.default_rng(seed).choice((x1 - x0) * (y1 - y0), count, replace=False)
    return np.stack([x0 + chosen % (x1 - x0), y0 + chosen // (x1 - x0)], axis=1).astype(np.int32)


def gain_of_photons(first: Float32Array, second: Float32Array, gathered: Float32Array) -> float:
    """By how much paths alone would be noisier than paths with photons.

    Parameters
    ----------
    first, second : float32 (P, 3)
        Two samples of each pixel, with photons.
    gathered : float32 (P, 3)
        `PhotonLanes.tried`, mean of both samples.
    """
    noise = 0.5 * ((first.astype(np.float64) - second) ** 2).mean(axis=1)
    value = 0.5 * (first + second).mean(axis=1).astype(np.float64)
    scale = value**2 + (_DIM * value.mean()) ** 2
    if not scale.min() > 0.0:
        return 1.0
    kept = max(int(len(noise) * (1.0 - _TRIMMED)), 1)
    with_photons = np.sort(noise / scale)[:kept].mean()
    light, moment = gathered[:, :2].astype(np.float64).T
    added = (np.minimum(moment, _SAMPLES * light**2) / scale).mean()
    return float((with_photons + added) / with_photons) if with_photons > 0.0 else 1.0


def photons_pay(
    region: tuple[int, int, int, int], seed: int, trace: TracePixels, *, has_marks: bool = False
) -> float | None:
    """`gain_of_photons` of the picture's pixels, 0 where that is not worth photons' time; None: it was stopped.

    Parameters
    ----------
    has_marks : bool, whether photons have left marks within media
    """
    pixels = tried_pixels(region, seed)
    samples = [trace(pixels, sample) for sample in range(2)]
    if samples[0] is None or samples[1] is None:
        return None
    (first, gathered), (second, other) = samples[0], samples[1]
    gain = gain_of_photons(first, second, 0.5 * (gathered + other))
    return gain if gain >= (_LEAST_GAIN_IN_MEDIA if has_marks else _LEAST_GAIN) else 0.0


def pixel_radius(region: tuple[int, int, int, int], seed: int, trace: TracePixels) -> float | None:
    """Median radius of pixels where they gather photons [m], 0 where none does; None: it was stopped."""
    samples = trace(tried_pixels(region, seed), 0)
    if samples is None:
        return None
    radii = samples[1][:, 2]
    return float(np.median(radii[radii > 0.0])) if (radii > 0.0).any() else 0.0
