# SPDX-License-Identifier: GPL-3.0-or-later
"""A threshold on the denoised picture: the render ends once that errs by less, as estimated.

The film keeps half of the samples apart (`engine.wavefront.accumulate.is_in_half`). Both halves are denoised as the
picture will be, by albedo and normal of all samples. How far they are from each other tells the noise that denoising
leaves. What both get wrong alike they do not tell: it is accounted for by a factor that was measured
(docs/decisions/denoising.md).

The picture is looked at after numbers of samples that grow geometrically, so that what is decided depends on samples
alone, never on threads or the clock.
"""

from __future__ import annotations

import math
import threading

import numpy as np

from engine.denoise import library
from engine.guiding.models.residual import halves_with_relative_residual
from engine.render.denoising import Denoising, failure
from engine.render.film import Film
from engine.scene.description import Notice
from engine.settings import RenderSettings

#: Samples a pixel at the first look, and how many times as many at each that follows.
_FIRST_LOOK = 16
_LOOK_GROWTH = 1.5
#: Squared error of the denoised picture over half the mean squared difference of its halves.
_ERROR_PER_DIFFERENCE = 1.0
#: Of the sRGB curve: where its straight part ends, and its slope at white.
_STRAIGHT, _SLOPE_AT_WHITE = np.float32(0.0031308), np.float32(1.055 / 2.4)
#: Bright enough: what is above has no number to be counted with.
_BRIGHTEST = np.float32(1e18)


def display_values(radiance: np.ndarray) -> np.ndarray:
    """What a screen shows, 0 for black and 1 for white: the sRGB curve.

    Above white it goes on as the logarithm, by the slope that the curve has there. A view transform shows highlights
    as well, and a firefly must not decide by itself.

    Parameters
    ----------
    radiance : float32, scene-linear, after exposure

    Returns
    -------
    float32
    """
    value = np.nan_to_num(np.clip(radiance, np.float32(0.0), _BRIGHTEST))
    curve = np.float32(1.055) * np.minimum(value, np.float32(1.0)) ** np.float32(1.0 / 2.4) - np.float32(0.055)
    curve = np.where(value <= _STRAIGHT, np.float32(12.92) * value, curve)
    shown: np.ndarray = curve + _SLOPE_AT_WHITE * np.log(np.maximum(value, np.float32(1.0)))
    return shown.astype(np.float32)


def half_pictures(film: Film, picture: np.ndarray, exposure: float) -> tuple[np.ndarray, np.ndarray]:
    """The two pictures of the film's halves of the samples, float32 (height, width, 3) each.

    Parameters
    ----------
    film : Film
        With a half.
    picture : float32 (height, width, >= 3)
        Of all samples. Where it has what radiance alone has not (shadows that are caught), both halves have it too. A
        pixel of which one half is empty has it in both.
    exposure : float
        Of `picture`.
    """
    sums, factor = film.sums, np.float32(exposure)
    rest = sums.weight - sums.half_weight
    is_known = (sums.half_weight > 0.0) & (rest > 0.0)
    total = sums.radiance / np.where(is_known, sums.weight, np.float32(1.0))[:, None]
    first = sums.half / np.where(is_known, sums.half_weight, np.float32(1.0))[:, None]
    second = (sums.radiance - sums.half) / np.where(is_known, rest, np.float32(1.0))[:, None]
    seen = picture[..., :3].reshape(-1, 3)
    first, second = (
        np.where(is_known[:, None], seen + factor * (half - total), seen).astype(np.float32) for half in (first, second)
    )
    shape = (film.height, film.width, 3)
    return first.reshape(shape), second.reshape(shape)


class DenoisedThreshold:
    """When the denoised picture of a render is good enough.

    Parameters
    ----------
    settings : RenderSettings
        With a threshold and denoising.
    film : Film
        With a half.
    exposure : float
    thread_count : int
        Those that trace, which wait meanwhile.

    Attributes
    ----------
    due : float
        Samples a pixel from which on it is time to look.
    error : float or None
        As `estimate` found it at the last look; None: there was none.
    looked_at : int
        Samples a pixel at that.
    notices : list of Notice
        Why it looks no more.
    """

    def __init__(self, settings: RenderSettings, film: Film, exposure: float, thread_count: int) -> None:
        self._threshold, self._film, self._exposure = settings.denoised_threshold, film, exposure
        self._denoising = Denoising(settings, thread_count)
        self._is_stopped = threading.Event()
        self.due: float = _FIRST_LOOK
        self.error: float | None = None
        self.looked_at = 0
        self.notices: list[Notice] = []

    @classmethod
    def of(
        cls, settings: RenderSettings, film: Film, exposure: float, thread_count: int
    ) -> DenoisedThreshold | None:
        """That of a render; None where it has none."""
        return cls(settings, film, exposure, thread_count) if settings.denoised_threshold > 0.0 else None

    def is_due(self, samples: int) -> bool:
        """Whether to look at the picture after so many samples a pixel."""
        return samples >= self.due and not self._is_stopped.is_set()

    def stop(self) -> None:
        """End a look that is under way, and look no more."""
        self._is_stopped.set()

    def look(self, samples: int) -> bool:
        """Denoise halves of the picture; whether it is good enough."""
        self.due = math.ceil(_LOOK_GROWTH * samples)
        try:
            error = self.estimate()
        except Exception as problem:  # whatever went wrong: the render goes on
            said = str(problem) if isinstance(problem, library.DenoiserFailed) else failure(problem)
            self.notices.append(Notice("Denoised Noise", said, "it ends no render"))
            self.due = math.inf
            return False
        if error is None:
            return False
        self.error, self.looked_at = error, samples
        return error < self._threshold

    def estimate(self) -> float | None:
        """Root mean square error of the denoised picture's display values, estimated; None: it was stopped."""
        film, exposure = self._film, self._exposure
        images = film.images({"Combined"} | self._denoising.passes, exposure=exposure)
        cached = film.has_residual
        picture = film.cached_image(exposure=exposure) if cached else images["Combined"]
        halves = self._denoising.filtered(
            half_pictures(film, picture, exposure), images, self._is_stopped.is_set
        )
        if halves is None:
            return None
        first, second = halves
        if cached:
            first, second = film.halves_with_residual((first, second), exposure=exposure)
        difference = display_values(first) - display_values(second)
        squared = 0.5 * float(np.square(difference, dtype=np.float64).mean()) if difference.size else 0.0
        return math.sqrt(_ERROR_PER_DIFFERENCE * squared)
