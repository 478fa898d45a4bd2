# SPDX-License-Identifier: GPL-3.0-or-later
"""Photons of a render as a tracer's threads trace them: maps, and the trials that decide about them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from engine.array_types import Float32Array, Int32Array
from engine.builder.scene import Scene
from engine.render.batch import Batch
from engine.render.photon_maps import NO_PHOTONS, PhotonMaps
from engine.render.photon_trial import TracePixels, photons_pay, pixel_radius
from engine.render.photon_windows import Windows
from engine.render.scene_header import has_photons
from engine.runtime.jit import BoundKernel, in_python
from engine.settings import RenderSettings
from engine.state.lanes import RGB
from engine.state.photons import MAP_IS_TRIED, MAP_RADIUS, CasterArrays, PhotonMap
from engine.state.unit import PLAIN, Unit
from engine.wavefront.columns import (
    PHOTONS,
    UNIT_PATH_COUNT,
    UNIT_RECORD_THRESHOLD,
    UNIT_SAMPLE_FIRST,
    UNIT_SEED,
    UNIT_SHADER_MODE,
    UNIT_SPLITS_LIGHT,
    UNIT_USE_DENOISING,
    UNIT_USE_FEATURES,
    UNIT_USE_OCCLUSION,
    UNIT_USES_CACHE,
)
from engine.wavefront.trace_photons import trace_photons
from engine.wavefront.trace_rounds import trace_rounds

#: Makes of a render's seed that of a trial: what decides on a picture must not be part of it.
_TRIAL_SEED = 0x2545F491
#: A radius within which there are no photons, but all that may gather some does [m].
_NEXT_TO_NOTHING = 1e-30
#: Entries of a unit's header that count for photons, and those that do not for a trial.
_OF_PHOTONS = [UNIT_SEED, UNIT_SHADER_MODE, UNIT_SAMPLE_FIRST, UNIT_PATH_COUNT, UNIT_SPLITS_LIGHT]
_OF_NO_TRIAL = [
    UNIT_RECORD_THRESHOLD, UNIT_USE_FEATURES, UNIT_USE_DENOISING, UNIT_SPLITS_LIGHT, UNIT_USE_OCCLUSION,
    UNIT_USES_CACHE,
]  # fmt: skip

#: What `trace_rounds` takes for a unit that goes by a map, `photons`.
ArgumentsOf = Callable[..., tuple[Any, ...]]
#: Traces a unit by these; False: it was stopped.
Trace = Callable[..., Any]


def of_photons(arguments: tuple[Any, ...]) -> tuple[Any, ...]:
    """Of what `trace_rounds` takes, that which `trace_photons` does."""
    stages, scene, unit, guidance, _, work, stop = arguments
    return stages, scene, unit, guidance, work, stop


def room_for_photons(casters: CasterArrays) -> dict[str, Any]:
    """What a `Batch` has to know of the casters."""
    return {"piece_count": len(casters.area), "moves": bool(casters.motion[0] > 0.0)}


class PhotonTracing:
    """Photons of a tracer's renders, one after the other; shared by all threads."""

    def __init__(self) -> None:
        self.maps: PhotonMaps | None = None
        self._loop: BoundKernel | None = None

    def take(self, scene: Scene, settings: RenderSettings) -> None:
        """Be ready for a render: with photons if the settings ask for them."""
        self._region, self._seed = scene.description.frame.region, settings.seed
        self.maps = None
        if has_photons(scene, settings):
            x0, y0, x1, y1 = self._region
            # Where Filter Glossy blurs what it may, the picture would depend on the trial.
            is_tried = settings.caustics == "AUTO" and not settings.filter_glossy > 0.0
            windows = Windows(float(scene.casters.motion[0]), settings.channel_count > RGB)
            self.maps = PhotonMaps(
                (x1 - x0) * (y1 - y0), scene.casters, is_tried=is_tried, is_denoised=settings.use_denoising,
                windows=windows,
            )

    def unlink(self) -> None:
        """Forget the compiled loop: stages are others now."""
        self._loop = None

    def link(self, arguments: tuple[Any, ...]) -> None:
        """Compile the loop, for what `trace_rounds` takes in this render."""
        if self.maps is not None:
            self._loop = BoundKernel(trace_photons)
            self._loop.bind(*of_photons(arguments))

    def map_of(self, sample: int, batch: Batch, arguments_of: ArgumentsOf, trace: Trace) -> PhotonMap | None:
        """The map that a sample goes by, made in a thread's memory, or one without photons; None: it was stopped."""
        if self.maps is None:
            return NO_PHOTONS
        loop = self._loop or in_python(trace_photons, trace_rounds)

        def look(begins: PhotonMap) -> tuple[float, Float32Array] | None:
            numbers = begins.numbers.copy()
            numbers[MAP_RADIUS] = _NEXT_TO_NOTHING
            batch.work.photons.seen[:] = 0.0
            shown = begins._replace(numbers=numbers)
            radius = pixel_radius(self._region, self._seed, _trial(batch, shown, arguments_of, trace))
            return None if radius is None else (radius, batch.work.photons.seen.copy())

        return self.maps.map_of(
            sample,
            lambda begins, first, count: _send_off(batch, begins, first, count, arguments_of, loop),
            look,
            lambda shown: photons_pay(
                self._region, self._seed, _trial(batch, shown, arguments_of, trace), has_marks=len(shown.within) > 0
            ),
        )


def _send_off(
    batch: Batch, begins: PhotonMap, first: int, count: int, arguments_of: ArgumentsOf, loop: Callable[..., Any]
) -> Float32Array | None:
    """Trace photons; what has arrived, or None if it was stopped."""
    unit = Unit(np.zeros((1, 2), np.int32), np.zeros(1, np.int32), first, count, arm=PLAIN)
    arguments = arguments_of(unit, photons=begins)
    _, view, unit_view, _, _, work, stop = arguments
    if stop[0]:
        return None
    batch.begin()
    header = unit_view.header
    kept = header[_OF_PHOTONS]
    header[:] = 0
    header[_OF_PHOTONS] = kept
    # Nothing of a photon is clamped, or left out for being dim.
    options = view.options._replace(
        clamp_direct=np.float32(0.0), clamp_indirect=np.float32(0.0), inverse_light_threshold=np.float32(0.0)
    )
    stages, _, unit_view, guidance, work, stop = of_photons(arguments)
    if not loop(stages, view._replace(options=options, lights=view.casters.lights), unit_view, guidance, work, stop):
        return None
    found: Float32Array = work.photons.found[: work.counts[PHOTONS]].copy()
    return found


def _trial(batch: Batch, photons: PhotonMap, arguments_of: ArgumentsOf, trace: Trace) -> TracePixels:
    """What traces pixels of a trial by a map."""
    header = photons.header.copy()
    header[MAP_IS_TRIED] = 1
    tried, rows = photons._replace(header=header), batch.work.photons.tried.shape[0]

    def trace_pixels(pixels: Int32Array, sample: int) -> tuple[Float32Array, Float32Array] | None:
        values, gathered = [], []
        for first in range(0, len(pixels), rows):
            part = pixels[first : first + rows]
            batch.begin()
            batch.work.photons.tried[:] = 0.0
            unit = Unit(part, np.zeros(len(part), np.int64), sample, 1, arm=PLAIN)
            arguments = arguments_of(unit, photons=tried)
            arguments[2].header[UNIT_SEED] ^= _TRIAL_SEED
            arguments[2].header[_OF_NO_TRIAL] = 0
            if not trace(*arguments):
                return None
            values.append(batch.film.radiance[: len(part)].copy())
            gathered.append(batch.work.photons.tried[: len(part)].copy())
        return np.concatenate(values), np.concatenate(gathered)

    return trace_pixels
