# SPDX-License-Identifier: GPL-3.0-or-later
"""A fuzzed scene's pictures by both renderers, and what ours said meanwhile."""

from __future__ import annotations

import contextlib
import os
import re
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.images import Float32Array, read_exr

#: What no render says, whatever the scene: words of Python, numpy and numba.
ALARMS = re.compile(r"Traceback|\w*Warning\b|\w*Error\b|Exception|not supported between|nan\b")


@dataclass
class Rendered:
    """Pictures, float32 (seeds, height, width, 4), and what came with them.

    Attributes
    ----------
    seconds : float
        Of the slowest of them.
    notices : list of str
        What the engine named; Cycles names nothing.
    alarms : list of str
        Lines of the console that no render should have, and failures.
    """

    images: Float32Array
    seconds: float = 0.0
    notices: list[str] = field(default_factory=list)
    alarms: list[str] = field(default_factory=list)


@contextlib.contextmanager
def heard() -> Iterator[Any]:
    """A file that takes what the process says to its console, Blender's own lines included."""
    sys.stdout.flush()
    sys.stderr.flush()
    kept = [os.dup(number) for number in (1, 2)]
    with tempfile.TemporaryFile("w+b") as file:
        for number in (1, 2):
            os.dup2(file.fileno(), number)
        try:
            yield file
        finally:
            sys.stdout.flush()
            sys.stderr.flush()
            for number, old in zip((1, 2), kept, strict=True):
                os.dup2(old, number)
                os.close(old)


def render(scene: Any, engine: str, samples: int, seeds: range) -> Rendered:
    """Render with as many seeds by 'NEURALGUIDE' or 'CYCLES', on one thread."""
    import bpy

    from addon.engine import outcome_count, outcomes_since

    scene.render.engine = engine
    scene.render.threads_mode, scene.render.threads = "FIXED", 1
    scene.cycles.samples = samples
    settings = scene.render.image_settings
    if hasattr(settings, "media_type"):
        settings.media_type = "IMAGE"
    settings.file_format, settings.color_mode, settings.color_depth = "OPEN_EXR", "RGBA", "32"
    rendered = Rendered(np.zeros(0, np.float32))
    images = []
    with tempfile.TemporaryDirectory() as folder, heard() as file:
        for scene.cycles.seed in seeds:
            before, start = outcome_count(), time.monotonic()
            bpy.ops.render.render()
            rendered.seconds = max(rendered.seconds, time.monotonic() - start)
            path = Path(folder) / "picture.exr"
            bpy.data.images["Render Result"].save_render(str(path), scene=scene)
            images.append(read_exr(path)[0])
            for outcome in outcomes_since(before):
                rendered.notices += [str(notice) for notice in outcome.notices]
                if outcome.status != "FINISHED":
                    rendered.alarms.append(f"{outcome.status}: {outcome.message}")
        file.seek(0)
        lines = file.read().decode(errors="replace").splitlines()
    if engine == "NEURALGUIDE":
        rendered.alarms += [line for line in lines if ALARMS.search(line)]
    rendered.notices = list(dict.fromkeys(rendered.notices))
    rendered.images = np.stack(images)
    return rendered
