# SPDX-License-Identifier: GPL-3.0-or-later
"""Turns a camera around a scene, all frames guided by one learned field: `python -m examples.turntable`.

Light does not depend on the camera. What one render has learned therefore fits every view of the same scene.
"""

from __future__ import annotations

import math
import sys
from dataclasses import replace
from pathlib import Path

from engine.render.session import Session
from engine.settings import RenderSettings
from examples.pictures import save_picture
from examples.room import camera_around, frame, room

SETTINGS = RenderSettings(samples=32, guiding_method="VMM")


def main(folder: Path = Path("out/examples"), *, frame_count: int = 4) -> list[Path]:
    """Render a turntable of so many frames; the files written."""
    session = Session(replace(SETTINGS, samples=128))
    session.load(room())
    learned = session.render(keep=True).learned
    print(f"learned from {learned}" if learned else "nothing was learned: each frame learns anew")

    paths = []
    for number in range(frame_count):
        # Each frame has noise of its own, so that no pattern stands still on the screen.
        session.settings = replace(SETTINGS, seed=number)
        # A view of the loaded scene: nothing is built again.
        session.look(camera_around(2.0 * math.pi * number / frame_count), frame())
        result = session.render(start=learned)
        paths.append(folder / f"turntable_{number:04}.png")
        save_picture(result.passes["Combined"], paths[-1])
    session.close()
    return paths


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
