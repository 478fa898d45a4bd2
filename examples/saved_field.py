# SPDX-License-Identifier: GPL-3.0-or-later
"""Saves what a render has learned, and starts another one from it: `python -m examples.saved_field`."""

from __future__ import annotations

import sys
from pathlib import Path

from engine.guiding.saved.file import load_field, save_field
from engine.guiding.saved.learned import LearnedField
from engine.render.report import RenderResult
from engine.render.session import Session
from engine.settings import RenderSettings
from examples.pictures import noise
from examples.room import room

#: Learning reads the clock unless it is told not to.
LEARNING = RenderSettings(samples=127, guiding_method="VMM", guiding_trial=False, deterministic=True)
SHORT = RenderSettings(samples=15, guiding_method="VMM", guiding_trial=False, deterministic=True)


def render(settings: RenderSettings, start: LearnedField | None = None) -> RenderResult:
    """Render the room, from what another render has learned if that is given, and keep what is learned."""
    session = Session(settings)
    session.load(room())
    result = session.render(passes=("Combined", "Variance"), start=start, keep=True)
    session.close()
    return result


def main(folder: Path = Path("out/examples")) -> tuple[float, float]:
    """Render once to learn, then for a few samples with and without that; the noise of these two."""
    path = folder / "room.ngfield"
    folder.mkdir(parents=True, exist_ok=True)
    learned = render(LEARNING).learned
    assert learned is not None, "nothing was learned"
    save_field(path, learned)
    print(f"wrote {path}: {learned}")

    # From here on nothing but the file is needed: on this machine, or on another.
    with_field = noise(render(SHORT, load_field(path)).passes)
    without = noise(render(SHORT).passes)
    print(f"noise of {SHORT.samples} samples a pixel: {without:.3f}, from the field {with_field:.3f}")
    return with_field, without


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
