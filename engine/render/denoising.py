# SPDX-License-Identifier: GPL-3.0-or-later
"""Denoising the picture of a render that is over: what the film must hold for it, and when it is given up."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, wait

import numpy as np

from engine.denoise import library
from engine.denoise.filter import denoise_all
from engine.denoise.fireflies import without_fireflies
from engine.denoise.mix import added_noise, mixed
from engine.render.film import Film, Images
from engine.scene.description import Notice
from engine.settings import RenderSettings

#: How often the caller's thread looks for a cancel [s].
_POLL_SECONDS = 0.05
#: Mean samples of a pixel below which no fireflies are cut: variances say little yet, and much of the light is in them.
_LEAST_SAMPLES = 8
#: The same below which the picture is not mixed with what was sampled: noise is more than the denoiser's error nearly
#: everywhere, and the mix hardly differs.
LEAST_MIXED = 128
_FALLBACK = "the picture is as it was sampled"
#: What helps the denoiser, by `RenderSettings.denoising_input_passes`: the filter's name, and the film's pass.
_INPUTS = {
    "RGB": {},
    "RGB_ALBEDO": {"albedo": "Denoising Albedo"},
    "RGB_ALBEDO_NORMAL": {"albedo": "Denoising Albedo", "normal": "Denoising Normal"},
}


class Denoising:
    """Denoising of one render.

    Parameters
    ----------
    settings : RenderSettings
    threads : int
        Those that trace.

    Attributes
    ----------
    passes : frozenset of str
        What the film is to hold for it; none where nothing is denoised.
    seconds : float
        How long it took.
    notices : list of Notice
        Why it was not done, though it was asked for.
    """

    def __init__(self, settings: RenderSettings, threads: int) -> None:
        self._settings = settings
        self._threads = threads
        self.seconds = 0.0
        self.notices: list[Notice] = []
        self._inputs: dict[str, str] = {}
        problem = library.problem() if settings.use_denoising else ""
        if problem:
            self.notices.append(Notice("Denoising", problem, _FALLBACK))
        self.is_on = settings.use_denoising and not problem
        if self.is_on:
            self._inputs = _INPUTS[settings.denoising_input_passes]
        self.passes = frozenset((*self._inputs.values(), "Variance", "Sample Count") if self.is_on else ())

    def run(
        self, images: Images, should_cancel: Callable[[], bool] | None, film: Film | None = None,
        exposure: float = 1.0,
    ) -> bool:
        """Replace Combined by the denoised picture; alpha stays.

        A render that ends paths in the radiance cache has their light denoised, and what it lacks is added then: that
        is known in bands, whose noise a denoiser takes for detail.

        Parameters
        ----------
        images : mapping
            As `Film.passes` returns them, of `passes` and more.
        should_cancel : callable, optional
            Called in this thread only, often.
        film : Film, optional
            That they were made from; without it Combined is denoised as it is, and not mixed with what was sampled.
        exposure : float
            That they were made with.

        Returns
        -------
        bool
            False: it was cancelled, and the picture is as it was.
        """
        start = time.perf_counter()
        try:
            denoised = self._denoised(images, should_cancel, film, exposure)
        except Exception as error:  # whatever went wrong: there is a picture, and it must not be lost
            self.notices.append(Notice("Denoising", failure(error), _FALLBACK))
            return True
        if denoised is None:
            return False
        images["Combined"] = denoised
        self.seconds = time.perf_counter() - start
        return True

    def _denoised(
        self, images: Images, should_cancel: Callable[[], bool] | None, film: Film | None, exposure: float
    ) -> np.ndarray | None:
        """The denoised picture; None where it was cancelled."""
        cached = film if film is not None and film.has_residual else None
        is_cancelled = threading.Event()
        noisy = images["Combined"]
        color = noisy if cached is None else cached.cached_image(exposure=exposure)
        # In a thread, so that the caller's can look for a cancel: the filter takes seconds for large pictures.
        with ThreadPoolExecutor(1, thread_name_prefix="denoise") as pool:
            mixes = film is not None and variance_is_all(film)
            future = pool.submit(self.filtered, (color,), images, is_cancelled.is_set, mixes=mixes)
            while not wait((future,), _POLL_SECONDS).done:
                if should_cancel is not None and should_cancel():
                    is_cancelled.set()
        pictures = future.result()
        if pictures is None:
            return None
        denoised = pictures[0]
        if cached is not None:
            denoised = cached.with_residual(denoised, exposure=exposure)
        return np.concatenate((denoised, noisy[..., 3:]), axis=2)

    def filtered(
        self, colors: Sequence[np.ndarray], images: Images, should_cancel: Callable[[], bool], *, mixes: bool
    ) -> list[np.ndarray] | None:
        """Denoised pictures of equal parts of a render's samples, all of them together `images`; None: cancelled.

        Parameters
        ----------
        colors : sequence of float32 (height, width, >= 3)
        images : mapping
            `passes` of all samples.
        should_cancel : callable
            Asked in whatever thread.
        mixes : bool
            Whether they are mixed with `colors` where there are samples enough: `variance_is_all`.
        """
        inputs = {name: images[pass_name] for name, pass_name in self._inputs.items()}
        samples = float(images["Sample Count"].mean()) / len(colors)
        variance = np.float32(len(colors)) * images["Variance"]
        cut, added = list(colors), []
        if samples >= _LEAST_SAMPLES:
            cut = [without_fireflies(color, variance, inputs.get("albedo")) for color in colors]
        if mixes and samples >= LEAST_MIXED:
            added = [added_noise(color[..., :3], variance) for color in cut]
        denoised = denoise_all(
            [*cut, *(color[..., :3] + noise for color, noise in zip(cut, added))],
            **inputs,
            quality=self._settings.denoising_quality,
            prefilter=self._settings.denoising_prefilter,
            threads=self._threads,
            should_cancel=should_cancel,
        )
        if denoised is None or not added:
            return denoised
        of_each = zip(denoised[: len(cut)], colors, added, denoised[len(cut) :], strict=True)
        return [mixed(picture, color, variance, noise, again) for picture, color, noise, again in of_each]


def variance_is_all(film: Film) -> bool:
    """Whether the pass Variance has all noise of the film's picture: it knows nothing of shadows that are caught."""
    return not film.layout.has_catchers


def failure(error: Exception) -> str:
    """What went wrong, for users."""
    if isinstance(error, library.DenoiserFailed):
        return str(error)
    return "out of memory" if isinstance(error, MemoryError) else f"failed: {type(error).__name__}: {error}"
