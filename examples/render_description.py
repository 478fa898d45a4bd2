# SPDX-License-Identifier: GPL-3.0-or-later
"""Renders a scene without Blender: `python -m examples.render_description`.

`examples/room.py` builds the description. Any program that has meshes, lights and a camera can build one.
"""

from __future__ import annotations

import sys
from pathlib import Path

from engine.render.session import Session
from engine.settings import RenderSettings
from examples.pictures import save_picture
from examples.room import room


def main(folder: Path = Path("out/examples")) -> None:
    """Render the room into room.png."""
    session = Session(RenderSettings(samples=64, guiding_method="AUTO"))
    # Notices name what in the description cannot be shown as it is meant.
    for notice in session.load(room()):
        print(f"{notice.subject}: {notice.problem}; {notice.fallback}")
    result = session.render(on_progress=lambda progress: print(f"\r{progress.fraction:4.0%}", end=""))
    session.close()
    report = result.report
    print(f"\r{report.sample_count:g} samples a pixel in {report.render_seconds:.1f} s")
    save_picture(result.passes["Combined"], folder / "room.png")


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
