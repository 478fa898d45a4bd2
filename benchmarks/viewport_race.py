# SPDX-License-Identifier: GPL-3.0-or-later
"""A viewport beside Cycles' at equal seconds after a move of the camera.

Ours is the process that windows have, and what it shows by then: it has looked at the scene from elsewhere before, as
in a window that was turned. Cycles' viewport does not run without a window, so its part is played by its final render
of so many seconds, without a noise threshold. That spares Cycles the coarse pictures, the drawing, and the time in
which it takes note of the move; the seconds that it took, denoising left out, stand beside its error.
"""

from __future__ import annotations

import argparse
import os
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import metrics
from benchmarks.images import Float32Array, write_exr
from benchmarks.reference import load_reference
from benchmarks.rendering import RenderRecord, render_once
from benchmarks.rivals import DENOISED, Budget, find_rival
from benchmarks.scene_files import SceneSource, open_scene
from benchmarks.tables import table
from benchmarks.viewport import Window, export
from engine.viewport.protocol import ViewImage
from engine.viewport.view import Update

#: Seconds after the move.
TIMES = (0.5, 2.0, 8.0)
#: From where the view is turned to what is compared [rad], and how long it has looked there [s].
_TURN = 0.4


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("scene", nargs="?", default="builtin:evening-room", help="default: %(default)s")
    parser.add_argument("--references", type=Path, required=True, help="folder of NAME.exr, which set the size")
    parser.add_argument("--before", type=float, default=5.0, help="seconds before the move (default: %(default)s)")
    parser.add_argument("--denoise", action="store_true", help="both")
    parser.add_argument("--out", type=Path, default=Path("out/viewport-race"), help="default: %(default)s")


def as_shown(image: ViewImage, width: int, height: int) -> Float32Array:
    """A picture as it fills the window, row 0 at the top."""
    pixels = image.pixels.repeat(image.divider, axis=0).repeat(image.divider, axis=1)
    return np.ascontiguousarray(pixels[:height, :width][::-1])


def our_pictures(scene: Any, width: int, height: int, *, before: float, denoises: bool) -> list[Float32Array]:
    """What a window shows at `TIMES` after a move."""
    description, settings = export(scene)
    window = Window(description, width, height)
    process = window.process
    process.start()
    settings = replace(settings, use_denoising=denoises)
    window.first_picture(Update(view=window.view(_TURN), scene=description, settings=settings, is_paused=False))
    window.settle(before)
    process.send(Update(view=window.view()))
    started = time.perf_counter()
    newest: ViewImage | None = None
    pictures = []
    for moment in TIMES:
        while time.perf_counter() - started < moment:
            process.poll()
            image = process.read_image()
            if image is not None and image.update >= process.sent:
                newest = image
            time.sleep(0.002)
        if newest is None:
            raise RuntimeError(f"nothing is shown {moment} s after the move: {process.status}")
        pictures.append(as_shown(newest, width, height))
    process.close()
    return pictures


def _thread_count() -> int:
    """Threads that both have."""
    return len(os.sched_getaffinity(0))


def main(arguments: argparse.Namespace) -> int:
    """Run the command: render, compare, print and save."""
    import addon

    addon.register()
    source = SceneSource(arguments.scene)
    reference = load_reference(arguments.references, source.name)
    if reference is None:
        print(f"error: no {arguments.references / source.name}.exr")
        return 1
    height, width = reference.image.shape[:2]
    scene = open_scene(source, size=(width, height))
    ours = our_pictures(scene, width, height, before=arguments.before, denoises=arguments.denoise)
    rival = find_rival("cycles" + (DENOISED if arguments.denoise else ""))
    rows = []
    arguments.out.mkdir(parents=True, exist_ok=True)
    for seconds, mine in zip(TIMES, ours, strict=True):
        record = RenderRecord(
            source.name, source.content_hash(), rival.name, 1, width, height, 0, seconds, _thread_count()
        )
        theirs = render_once(
            scene, rival, Budget(seconds=seconds), record, arguments.out / f"{source.name}-cycles-{seconds:g}s.exr"
        )
        write_exr(arguments.out / f"{source.name}-viewport-{seconds:g}s.exr", mine)
        errors = [metrics.flip(image, reference.image) for image in (mine, theirs.image)]
        rows.append([f"{seconds:g}", f"{errors[0]:.4f}", f"{errors[1]:.4f}", f"{record.render_seconds:.2f}"])
    text = table(["seconds", "FLIP, viewport", "FLIP, Cycles", "seconds that Cycles took"], rows)
    print(text)
    (arguments.out / f"{source.name}.md").write_text(text + "\n", encoding="utf-8")
    return 0
