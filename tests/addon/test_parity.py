# SPDX-License-Identifier: GPL-3.0-or-later
"""Cycles in the same process renders the same scene: the pictures agree but for noise.

Per scene, cell means over a 6 x 4 grid and channel means of the whole image are compared. A difference counts as found
if it exceeds an allowance of 1% of the cell (0.5% of the image, the target of the project; the pixel filter and the
sampler's grid are tabulated differently) by more than 4.5 standard errors from both renderers' seeds: with 24 cells and
4 channels that is less than 1 false alarm in 5,000 scenes for normal noise, and seeds are fixed. Scenes with a
documented difference (`BuiltinScene.note`) get its measured size as their allowance.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks import metrics
from benchmarks.rendering import image_stack, render_scene
from benchmarks.rivals import Budget, find_rival
from benchmarks.scene_files import SceneSource
from benchmarks.scenes import SCENES

SIGMAS = 4.5
CELL_ALLOWANCE = 0.01
MEAN_ALLOWANCE = 0.005
PIXELS = 48 * 36

#: Few scenes that touch much: closures, textures, lights, world, camera, instances, alpha.
FAST = [
    "principled-everything",
    "glass-rough",
    "textured",
    "light-spot-blend",
    "light-area-disk",
    "emissive-textured",
    "world-image-sun",
    "camera-depth-of-field-blades",
    "camera-panorama-range",
    "instanced",
    "modifiers",
    "film-transparent",
]

#: Where light is made to be found seldom, unguided samples say nothing in a test's time: the study's lamps are all
#: hidden. Cycles disperses nothing. Furnished rooms take minutes, and so do most media made to fail. Of boundaries in
#: one place Cycles loses some (docs/differences.md).
QUICK = ("forward", "backward", "thin", "huge", "colors")
COMPARABLE = sorted(
    name
    for name, scene in SCENES.items()
    if scene.group not in ("failures", "spectral", "furnished")
    and name not in ("torus-in-glass", "weathered-rooms", "study", "evening-room-fog")
    and (scene.group != "failing_media" or name.removeprefix("fail-fog-") in QUICK)
    or name == "spectral-colors"
)


def check(name: str, out: Path, samples: int, seed_count: int) -> None:
    renders, failures = render_scene(
        SceneSource(f"builtin:{name}"),
        [find_rival("cycles"), find_rival("OFF")],
        Budget(samples),
        seed_count,
        out=out,
        pixels=PIXELS,
        say=lambda _: None,
    )
    assert not failures
    ours, theirs = image_stack(renders["OFF"]), image_stack(renders["cycles"])
    assert ours[0].shape == theirs[0].shape
    assert all(np.isfinite(image).all() for image in ours)

    known = SCENES[name].allowance  # of a difference that is documented in the scene's note
    difference, error = metrics.compare_means(ours, theirs)
    assert (np.abs(difference) <= max(MEAN_ALLOWANCE, known) + SIGMAS * error).all(), (
        f"{name}: channel means differ by {100 * difference} % +- {100 * error} %"
    )
    cells = metrics.compare_cells(ours, theirs, rows=4, columns=6)
    beyond = np.abs(cells.difference) > max(CELL_ALLOWANCE, known) + SIGMAS * cells.standard_error
    assert not beyond.any(), (
        f"{name}: cells (row, column) {np.argwhere(beyond).tolist()} differ by {100 * cells.difference[beyond]} % "
        f"+- {100 * cells.standard_error[beyond]} %"
    )


@pytest.mark.parametrize("name", FAST)
def test_same_picture_as_cycles(name: str, tmp_path: Path) -> None:
    check(name, tmp_path, samples=32, seed_count=4)


@pytest.mark.slow
@pytest.mark.parametrize("name", COMPARABLE)
def test_same_picture_as_cycles_on_every_builtin_scene(name: str, tmp_path: Path) -> None:
    check(name, tmp_path, samples=4 * SCENES[name].samples, seed_count=4)
