# SPDX-License-Identifier: GPL-3.0-or-later
"""Who renders: Cycles without and with path guiding, and NEURALGUIDE by guiding method.

All get the light paths, filter, clamps and roulette rule of the scene's Cycles settings, no adaptive sampling, no
denoising, no persistent data, the same threads.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

#: Samples asked for where only time is to stop a render.
UNLIMITED_SAMPLES = 1 << 20


@dataclass(frozen=True)
class Budget:
    """When a render stops: after `samples` per pixel, or after `seconds` of tracing if that is not 0."""

    samples: int = 64
    seconds: float = 0.0

    def __str__(self) -> str:
        return f"{self.seconds:g}s" if self.seconds else f"{self.samples}spp"


@dataclass(frozen=True)
class Measurement:
    """What a renderer says of itself after a render.

    render_seconds : float
        Tracing alone.
    compile_seconds : float
        Loading or compiling kernels.
    samples : float
        Mean samples per pixel rendered.
    first_image : float
        When the first picture was shown, by `time.monotonic`; nan if the renderer does not tell.
    """

    render_seconds: float
    compile_seconds: float = 0.0
    samples: float = 0.0
    rays: dict[str, int] | None = None
    details: dict[str, Any] | None = None
    first_image: float = math.nan


@dataclass(frozen=True)
class Rival:
    """A renderer by name.

    configure : callable (scene, budget, seed, threads)
    measure : callable (scene, exr header, budget, wall_seconds, largest sample seen) -> Measurement
    """

    name: str
    is_ours: bool
    configure: Callable[[Any, Budget, int, int], None]
    measure: Callable[[Any, dict[str, Any], Budget, float, int], Measurement]


def _configure_common(scene: Any, threads: int) -> None:
    render = scene.render
    render.threads_mode = "FIXED"
    render.threads = threads
    render.use_persistent_data = False
    render.use_compositing = render.use_sequencer = False
    render.use_single_layer = True
    render.use_motion_blur = False
    for layer in scene.view_layers:
        layer.samples = 0


def _configure_cycles(is_guided: bool) -> Callable[[Any, Budget, int, int], None]:
    def configure(scene: Any, budget: Budget, seed: int, threads: int) -> None:
        _configure_common(scene, threads)
        scene.render.engine = "CYCLES"
        cycles = scene.cycles
        cycles.device = "CPU"
        cycles.samples = UNLIMITED_SAMPLES if budget.seconds else budget.samples
        cycles.time_limit = budget.seconds
        cycles.seed, cycles.use_animated_seed = seed, False
        cycles.use_adaptive_sampling = cycles.use_denoising = False
        cycles.use_guiding = is_guided

    return configure


def human_seconds(text: str) -> float:
    """Seconds of Cycles' [HH:]MM:SS.ss.

    Raises
    ------
    ValueError
        If it is none.
    """
    if not re.fullmatch(r"(\d+:){1,2}\d+\.\d+", text):
        raise ValueError(f"not a duration: {text!r}")
    seconds = 0.0
    for part in text.split(":"):
        seconds = 60.0 * seconds + float(part)
    return seconds


def _measure_cycles(
    scene: Any, header: dict[str, Any], budget: Budget, wall_seconds: float, samples_seen: int
) -> Measurement:
    """Cycles stamps its own clock into the file: render_time is tracing without synchronisation and BVH, to 10 ms."""

    def stamp(field: str) -> float:
        for key, value in header.items():
            if str(key).startswith("cycles.") and str(key).endswith(field):
                return human_seconds(str(value))
        raise ValueError(f"Cycles left no {field} in the file's metadata")

    samples = float(samples_seen) if budget.seconds else float(budget.samples)
    details = {"synchronization_seconds": stamp(".synchronization_time")}
    return Measurement(max(stamp(".render_time"), 0.005), samples=samples, details=details)


def _configure_ours(method: str) -> Callable[[Any, Budget, int, int], None]:
    def configure(scene: Any, budget: Budget, seed: int, threads: int) -> None:
        import addon
        from addon.properties import copy_cycles_settings

        addon.register()
        _configure_common(scene, threads)
        copy_cycles_settings(scene)
        scene.render.engine = "NEURALGUIDE"
        ours = scene.neuralguide
        ours.samples = UNLIMITED_SAMPLES if budget.seconds else budget.samples
        ours.time_limit = budget.seconds
        ours.seed, ours.use_animated_seed = seed, False
        ours.guiding_method = method
        ours.threads = threads

    return configure


def _measure_ours(
    scene: Any, header: dict[str, Any], budget: Budget, wall_seconds: float, samples_seen: int
) -> Measurement:
    from addon.engine import outcomes

    outcome = outcomes[-1]
    if outcome.status != "FINISHED":
        raise RuntimeError(f"NEURALGUIDE {outcome.status.lower()}: {outcome.message}")
    report = outcome.report
    details = {
        "build_seconds": report.build_seconds,
        "stage_seconds": dict(report.stage_seconds),
        "reject_count": report.reject_count,
        "notices": [f"{n.subject}: {n.problem}; {n.fallback}" for n in report.notices],
    }
    return Measurement(
        report.render_seconds,
        report.prepare_seconds,
        report.sample_count,
        dict(report.rays),
        details,
        outcome.first_image,
    )


def find_rival(name: str) -> Rival:
    """The rival called `name`: 'cycles', 'cycles-guided', or a guiding method of ours such as 'OFF'.

    Raises
    ------
    ValueError
        Naming those there are.
    """
    if name in ("cycles", "cycles-guided"):
        return Rival(name, False, _configure_cycles(name == "cycles-guided"), _measure_cycles)
    from engine.settings import GUIDING_METHODS

    if name not in GUIDING_METHODS:
        raise ValueError(f"no rival {name!r}; there are: cycles, cycles-guided, {', '.join(GUIDING_METHODS)}")
    return Rival(name, True, _configure_ours(name), _measure_ours)
