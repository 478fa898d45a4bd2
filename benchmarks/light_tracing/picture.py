# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures of an open scene by photons."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks.images import Float32Array
from benchmarks.light_tracing.emitters import make_emitters
from benchmarks.light_tracing.photons import trace_photons
from benchmarks.light_tracing.receivers import find_known
from benchmarks.light_tracing.state import Memory, traced_scene
from engine.builder.scene import SceneCache, build_scene

#: Photons between two looks at how many are left.
_CHUNK = 1 << 16


class LightTracer:
    """A scene for photons.

    Parameters
    ----------
    scene : bpy.types.Scene
        The open one.
    threads : int

    Raises
    ------
    ValueError
        Naming what in it photons are not traced for.
    """

    def __init__(self, scene: Any, threads: int) -> None:
        import bpy

        import addon
        from addon.export import export_scene
        from addon.properties import render_settings

        addon.register()
        settings = render_settings(scene)
        if settings.filter_glossy > 0.0 or max(settings.clamp_direct, settings.clamp_indirect) > 0.0:
            raise ValueError("set Filter Glossy and the clamps to 0: they change what paths converge to, not photons")
        if not (settings.use_caustics_reflective and settings.use_caustics_refractive):
            raise ValueError("switch the scene's caustics on: photons are all of them")
        description = export_scene(bpy.context.evaluated_depsgraph_get())
        if description.has_dispersion:
            raise ValueError("a material disperses: photons have no wavelengths")
        self._built = build_scene(description, replace(settings, threads=threads), SceneCache(), threads=threads)
        self._scene, self._emitters = traced_scene(self._built), make_emitters(self._built)
        self._threads, self._most_bounces = threads, settings.max_bounces
        self._exposure = description.frame.exposure
        self.known = self._find_known()

    def _find_known(self) -> np.ndarray:
        frame = self._built.description.frame
        known = np.zeros((frame.height, frame.width), np.uint8)
        find_known(self._scene, Memory(self._built, 0).lanes, self._emitters, known)
        return known[::-1] != 0

    def picture(self, photons: int, seed: int) -> Float32Array:
        """What the camera sees, by so many photons.

        Returns
        -------
        float32 (height, width, 4)
            Row 0 at the top; NaN where the picture is not known (`known`, bool (height, width), is False), alpha 1.
        """
        memories = [Memory(self._built, seed * self._threads + thread) for thread in range(self._threads)]
        counts = [photons // self._threads + (thread < photons % self._threads) for thread in range(self._threads)]
        share = np.float32(1.0 / photons)

        def trace(memory: Memory, count: int) -> None:
            for chunk in _chunks(count):
                trace_photons(self._scene, memory.lanes, self._emitters, chunk, share, self._most_bounces)

        with ThreadPoolExecutor(self._threads) as pool:
            list(pool.map(trace, memories, counts))
        film = sum(memory.lanes.film for memory in memories) * self._exposure
        image = np.ones((*film.shape[:2], 4), np.float32)
        image[..., :3] = film[::-1]
        image[~self.known, :3] = np.nan
        return image


def _chunks(count: int) -> Iterator[int]:
    while count > 0:
        yield min(count, _CHUNK)
        count -= _CHUNK
