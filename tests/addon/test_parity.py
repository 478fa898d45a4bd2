# SPDX-License-Identifier: GPL-3.0-or-later
"""Cycles in the same process renders the same scene: the pictures agree but for noise.

Per scene, cell means over a 6 x 4 grid and channel means of the whole image are compared. A difference counts as found
if it exceeds an allowance of 1% of the cell (0.5% of the image, the target of the project; the pixel filter and the
sampler's grid are tabulated differently) by more than 4.5 standard errors from both renderers' seeds: with 24 cells and
4 channels that is less than 1 false alarm in 5,000 scenes for normal noise, and seeds are fixed. Scenes with a
documented difference (`BuiltinScene.note`) get its measured size as their allowance.

Scenes are rendered without clamps and denoising, where Cycles and we have the same mean by right; and as Blender's
users render: clamp, noise threshold, Filter Glossy, Light Threshold and denoising as Blender has them, guided by
`AUTO`.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from benchmarks import metrics
from benchmarks.denoised_cells import compare_denoised
from benchmarks.images import Float32Array
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
    if scene.group not in ("failures", "spectral", "furnished", "clamped")
    and name not in ("torus-in-glass", "weathered-rooms", "study", "evening-room-fog")
    and (scene.group != "failing_media" or name.removeprefix("fail-fog-") in QUICK)
    or name == "spectral-colors"
)


#: Rooms of whose light the clamp takes much: two thousand pixels are so noisy that denoising moves light between cells.
CLAMPED = sorted(name for name, scene in SCENES.items() if scene.group == "clamped")
NOISE_THRESHOLD = 0.01


def pictures(
    name: str, out: Path, budget: Budget, seed_count: int, rivals: Sequence[str] = ("cycles", "OFF"), *,
    at_defaults: bool = False, resume: bool = False,
) -> list[list[Float32Array]]:
    """By rival, one a seed."""
    renders, failures = render_scene(
        SceneSource(f"builtin:{name}"), [find_rival(rival) for rival in rivals], budget, seed_count, out=out,
        pixels=PIXELS, at_defaults=at_defaults, resume=resume, say=lambda _: None,
    )  # fmt: skip
    assert not failures
    stacks = [image_stack(renders[rival]) for rival in rivals]
    for stack in stacks:
        assert stack[0].shape == stacks[0][0].shape
        assert all(np.isfinite(image).all() for image in stack)
    return stacks


def says_enough(ours: list[Float32Array], theirs: list[Float32Array]) -> bool:
    """Whether a difference of 3% in any cell and of 1% in the mean would be found: by the noise, whatever was found."""
    _, error = metrics.compare_means(ours, theirs)
    cells = metrics.compare_cells(ours, theirs, rows=4, columns=6)
    of_mean, of_cells = (SIGMAS * error).max(), (SIGMAS * cells.standard_error).max()
    return bool(of_mean <= MEAN_ALLOWANCE and of_cells <= 2.0 * CELL_ALLOWANCE)


def check(name: str, out: Path, samples: int, seed_count: int, first_count: int = 0) -> None:
    """Compare pictures of so many seeds; of `first_count` only where these say enough."""
    theirs, ours = pictures(name, out, Budget(samples), first_count or seed_count)
    if first_count and not says_enough(ours, theirs):
        theirs, ours = pictures(name, out, Budget(samples), seed_count, resume=True)
    assert_same(name, ours, theirs)


def assert_same(name: str, ours: list[Float32Array], theirs: list[Float32Array]) -> None:
    """Pictures that are not denoised are the same but for noise."""
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
    check(name, tmp_path, samples=4 * SCENES[name].samples, seed_count=4, first_count=2)


def check_at_defaults(name: str, out: Path, samples: int) -> None:
    budget = Budget(samples, noise_threshold=NOISE_THRESHOLD)
    theirs, ours = pictures(name, out, budget, 3, ("cycles+oidn", "AUTO+oidn"), at_defaults=True)
    known = SCENES[name].allowance
    compared = compare_denoised(ours, theirs)
    of_cells, of_mean = compared.limits(SIGMAS)
    assert abs(compared.mean_difference) <= max(MEAN_ALLOWANCE, known) + of_mean, (
        f"{name}: means differ by {100 * compared.mean_difference:.2f} % +- {100 * compared.mean_error:.2f} %"
    )
    beyond = np.abs(compared.difference) > max(CELL_ALLOWANCE, known) + of_cells
    assert not beyond.any(), (
        f"{name}: cells (row, column) {np.argwhere(beyond).tolist()} differ by {100 * compared.difference[beyond]} % "
        f"+- {100 * compared.standard_error[beyond]} %"
    )


@pytest.mark.parametrize("name", ["glass-rough", "textured"])
def test_same_picture_as_cycles_at_blender_defaults(name: str, tmp_path: Path) -> None:
    check_at_defaults(name, tmp_path, samples=48)


@pytest.mark.slow
@pytest.mark.parametrize("name", COMPARABLE)
def test_same_picture_as_cycles_at_blender_defaults_in_every_scene(name: str, tmp_path: Path) -> None:
    check_at_defaults(name, tmp_path, samples=64)


@pytest.mark.slow
@pytest.mark.parametrize("name", CLAMPED)
def test_the_clamp_takes_what_it_takes_in_cycles(name: str, tmp_path: Path) -> None:
    rivals = ("cycles", "OFF", "AUTO")
    theirs, *all_ours = pictures(name, tmp_path, Budget(SCENES[name].samples), 3, rivals, at_defaults=True)
    for ours in all_ours:
        assert_same(name, ours, theirs)


@pytest.mark.slow
@pytest.mark.parametrize("name", FAST)
def test_same_picture_as_cycles_where_the_noise_threshold_stops_pixels(name: str, tmp_path: Path) -> None:
    """From 160 samples on, by Cycles' rule."""
    check_at_defaults(name, tmp_path, samples=320)
