# SPDX-License-Identifier: GPL-3.0-or-later
"""One render, measured and recorded; and many, interleaved."""

from __future__ import annotations

import datetime
import json
import math
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import environment
from benchmarks.images import Float32Array, read_exr, read_sample_counts
from benchmarks.light_paths import light_paths
from benchmarks.rivals import Budget, Rival
from benchmarks.scene_files import SceneSource, hide_lamps, open_scene, restore_defaults


@dataclass
class RenderRecord:
    """The facts of one render, as they go into its JSON file.

    `export_seconds` is everything of `wall_seconds` that is neither tracing nor compiling: Blender's own
    evaluation, export or synchronisation, acceleration structures and handing over the result; the same definition
    for every renderer. `settings` are those the rival was given (`Rival.settings`). Peak memory is the whole
    process's, Blender and open file included. `first_image_seconds` is the time from the call to the first picture
    shown, nan where that is unknown (Cycles). `processor_seconds` are those of all threads of the process, whatever
    else the machine did; processes that train networks are not counted. `light_paths` are the settings that decide
    what the picture converges to, empty in records from before they were noted.
    """

    scene: str
    scene_hash: str
    rival: str
    seed: int
    width: int
    height: int
    samples_asked: int
    seconds_asked: float
    threads: int
    noise_threshold: float = 0.0
    settings: dict[str, Any] = field(default_factory=dict)
    samples: float = 0.0
    wall_seconds: float = 0.0
    processor_seconds: float = math.nan
    export_seconds: float = 0.0
    compile_seconds: float = 0.0
    render_seconds: float = 0.0
    samples_per_second: float = 0.0
    first_image_seconds: float = math.nan
    rays: dict[str, int] = field(default_factory=dict)
    peak_memory_mib: float = math.nan
    details: dict[str, Any] = field(default_factory=dict)
    environment: dict[str, Any] = field(default_factory=dict)
    date: str = ""
    light_paths: dict[str, Any] = field(default_factory=dict)

    def is_same_work(self, other: RenderRecord, is_ours: bool) -> bool:
        """Whether a finished render answers what `other` asks: same scene, size, budget, settings, seed, versions."""
        keys = (
            "scene", "scene_hash", "rival", "seed", "width", "height", "samples_asked", "seconds_asked", "threads",
            "noise_threshold", "settings",
        )  # fmt: skip
        if any(getattr(self, key) != getattr(other, key) for key in keys):
            return False
        mine, theirs = self.environment, other.environment
        if mine.get("versions") != theirs.get("versions"):
            return False
        return not is_ours or mine["sources_hash"] == theirs["sources_hash"]


@dataclass
class Render:
    """A picture, float32 (height, width, 4) with row 0 at the top, and its record."""

    image: Float32Array
    record: RenderRecord


class _SampleWatch:
    """Largest "Sample i/n" Cycles has shown: the only place that tells how far a time limit let it come."""

    def __init__(self) -> None:
        self.largest = 0

    def __call__(self, text: str, *_: Any) -> None:
        _, found, tail = str(text).partition("Sample ")
        if found and tail.partition("/")[0].isdigit():
            self.largest = max(self.largest, int(tail.partition("/")[0]))


def render_once(scene: Any, rival: Rival, budget: Budget, record: RenderRecord, exr: Path) -> Render:
    """Render the open scene, write EXR and JSON.

    With a noise threshold the EXR has the samples of each pixel too (`read_sample_counts`), and the record their mean.

    Raises
    ------
    RuntimeError
        If the renderer failed.
    """
    import bpy

    rival.configure(scene, budget, record.seed, record.threads)
    settings = scene.render.image_settings
    has_counts = budget.noise_threshold > 0.0
    if hasattr(settings, "media_type"):
        settings.media_type = "MULTI_LAYER_IMAGE" if has_counts else "IMAGE"
    settings.file_format = "OPEN_EXR_MULTILAYER" if has_counts else "OPEN_EXR"
    settings.color_mode, settings.color_depth, settings.exr_codec = "RGBA", "32", "ZIP"
    if hasattr(settings, "use_exr_interleave"):
        # Blender 5.0 cannot write a file of several parts whose pixels are not square.
        settings.use_exr_interleave = True
    exr.parent.mkdir(parents=True, exist_ok=True)

    watch = _SampleWatch()
    bpy.app.handlers.render_stats.append(watch)
    environment.reset_peak_memory()
    start, processor_start = time.monotonic(), time.process_time()
    try:
        bpy.ops.render.render(write_still=False)
    finally:
        wall_seconds = time.monotonic() - start
        record.processor_seconds = time.process_time() - processor_start
        bpy.app.handlers.render_stats.remove(watch)
    record.peak_memory_mib = environment.peak_memory_mib()
    bpy.data.images["Render Result"].save_render(str(exr.resolve()), scene=scene)
    image, header = read_exr(exr)
    measured = rival.measure(scene, header, budget, wall_seconds, watch.largest)

    record.wall_seconds = wall_seconds
    record.render_seconds, record.compile_seconds = measured.render_seconds, measured.compile_seconds
    record.export_seconds = max(wall_seconds - measured.render_seconds - measured.compile_seconds, 0.0)
    record.first_image_seconds = measured.first_image - start
    # Cycles' pass has shares of the samples that it went through.
    most = 1.0 if rival.is_ours else float(watch.largest)
    record.samples = most * float(read_sample_counts(exr).mean()) if has_counts else measured.samples
    record.samples_per_second = record.samples * image.shape[0] * image.shape[1] / max(measured.render_seconds, 1e-6)
    record.rays, record.details = measured.rays or {}, measured.details or {}
    record.date = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
    exr.with_suffix(".json").write_text(json.dumps(asdict(record), indent=1) + "\n", encoding="utf-8")
    return Render(image, record)


def _finished(exr: Path, record: RenderRecord, is_ours: bool) -> Render | None:
    """An earlier run's render that answers `record`, if there is one."""
    try:
        found = RenderRecord(**json.loads(exr.with_suffix(".json").read_text(encoding="utf-8")))
        if found.is_same_work(record, is_ours):
            return Render(read_exr(exr)[0], found)
    except (OSError, ValueError, TypeError, KeyError, RuntimeError):
        pass
    return None


def _render_isolated(source: SceneSource, budget: Budget, record: RenderRecord, exr: Path) -> Render:
    """`render_once` in a process of its own.

    Raises
    ------
    RuntimeError
        If that process failed, with the last line it wrote.
    """
    task = json.dumps({"source": source.text, "budget": asdict(budget), "record": asdict(record)})
    command = [sys.executable, "-m", "benchmarks.isolated", task, str(exr)]
    finished = subprocess.run(command, capture_output=True, text=True, check=False)
    if finished.returncode:
        lines = finished.stderr.strip().splitlines() or [f"exit status {finished.returncode}"]
        raise RuntimeError(lines[-1])
    stored = json.loads(exr.with_suffix(".json").read_text(encoding="utf-8"))
    return Render(read_exr(exr)[0], RenderRecord(**stored))


@dataclass
class Failure:
    """A render that did not come about."""

    rival: str
    message: str


def render_scene(
    source: SceneSource,
    rivals: Sequence[Rival],
    budget: Budget,
    seed_count: int,
    *,
    out: Path,
    pixels: int = 0,
    size: tuple[int, int] | None = None,
    threads: int = 0,
    first_seed: int = 1,
    resume: bool = False,
    isolate: bool = False,
    without_lamps: bool = False,
    at_defaults: bool = False,
    is_usable: Callable[[RenderRecord], bool] = lambda record: True,
    check: Callable[[RenderRecord], None] = lambda record: None,
    say: Callable[[str], None] = print,
) -> tuple[dict[str, list[Render]], list[Failure]]:
    """Render a scene with all rivals, seeds in the outer loop and rivals in the inner one.

    A rival that fails is left out of the remaining seeds, the others go on. One round of the machine's moods thus
    touches all rivals alike. With `isolate` every render has a process of its own, for figures of memory and start-up;
    it opens the scene anew, so `without_lamps` (`hide_lamps`) and `at_defaults` (`restore_defaults`) do not go with it.
    With `resume` finished renders that are `is_usable` are kept. `check` sees what is about to be rendered, and raises
    to refuse it.
    """
    scene = open_scene(source, pixels, size)
    renders: dict[str, list[Render]] = {rival.name: [] for rival in rivals}
    failures: list[Failure] = []
    scene_hash = source.content_hash()
    if without_lamps:
        hide_lamps(scene)
        scene_hash += " without lamps"
    if at_defaults:
        restore_defaults(scene)
        scene_hash += " at defaults"
    for seed in range(first_seed, first_seed + seed_count):
        for rival in rivals:
            if any(failure.rival == rival.name for failure in failures):
                continue
            record = RenderRecord(
                scene=source.name,
                scene_hash=scene_hash,
                rival=rival.name,
                seed=seed,
                width=scene.render.resolution_x,
                height=scene.render.resolution_y,
                samples_asked=0 if budget.seconds else budget.samples,
                seconds_asked=budget.seconds,
                threads=threads or environment.thread_count(),
                noise_threshold=budget.noise_threshold,
                settings=rival.settings,
                environment=environment.describe(),
                light_paths=light_paths(scene, rival.settings),
            )
            check(record)
            exr = out / source.name / f"{rival.name}_{budget}_seed{seed}.exr"
            done = _finished(exr, record, rival.is_ours) if resume else None
            if done is not None and not is_usable(done.record):
                done = None
            if done is None:
                try:
                    if isolate:
                        done = _render_isolated(source, budget, record, exr)
                    else:
                        done = render_once(scene, rival, budget, record, exr)
                except (RuntimeError, ValueError) as error:
                    failures.append(Failure(rival.name, str(error).strip()))
                    say(f"  {source.name}: {rival.name} failed: {str(error).strip()}")
                    continue
            renders[rival.name].append(done)
            r = done.record
            say(
                f"  {source.name} {rival.name} seed {seed}: {r.samples:.0f} spp in {r.render_seconds:.2f} s"
                f" ({r.samples_per_second / 1e6:.3f} Msamples/s), export {r.export_seconds:.2f} s"
                f", peak memory {r.peak_memory_mib:.0f} MiB"
                + (f", first image after {r.first_image_seconds:.2f} s" if rival.is_ours else "")
            )
    return renders, failures


def image_stack(renders: Sequence[Render]) -> list[Float32Array]:
    """The pictures of renders, NaN and infinity kept for the comparison to stumble over."""
    return [np.asarray(render.image, np.float32) for render in renders]
