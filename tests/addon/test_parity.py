# SPDX-License-Identifier: GPL-3.0-or-later
"""Cycles in the same process renders the same scene: the pictures agree but for noise.

Per scene, cell means over a 6 x 4 grid and channel means of the whole image are compared. A difference counts as found
if it exceeds an allowance of 1% of the cell (0.5% of the image, the target of the project; the pixel filter and the
sampler's grid are tabulated differently) by more than 4.5 standard errors from both renderers' seeds: with 24 cells and
4 channels that is less than 1 false alarm in 5,000 scenes for normal noise, and seeds are fixed. Scenes with a
documented difference (`BuiltinScene.note`) get its measured size as their allowance.

Scenes are rendered without clamps and denoising, where Cycles and we have the same mean by right; and as Blender's
users render: clamp, noise threshold, Filter Glossy, Light Threshold and denoising as Blender has them, guidance and
accuracy as scenes have them without a setting. CI compares every second scene the one way and every third the other,
and with NEURALGUIDE_ALL_CASES all are compared both ways. What Cycles gives for each is recorded
(tests/helpers/parity); few scenes are rendered by it every time.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks import metrics
from benchmarks.denoised_cells import compare_denoised
from benchmarks.picture_means import PictureMeans
from benchmarks.scenes import SCENES
from tests.helpers.parity import recorded
from tests.helpers.parity.scenes import (
    AT_DEFAULTS,
    CLAMPED,
    CLAMPED_ROOMS,
    COMPARABLE,
    COMPARISONS,
    FAST,
    LINKED,
    LINKED_MEDIA,
    PLAIN,
    STOPPED,
    Comparison,
)
from tests.helpers.some_cases import some_of

#: What Cycles renders every time.
AFRESH = replace(PLAIN, samples=32)
AFRESH_AT_DEFAULTS = replace(AT_DEFAULTS, samples=48)
SIGMAS = 4.5
CELL_ALLOWANCE = 0.01
MEAN_ALLOWANCE = 0.005


def means(comparison: Comparison, scene: str, renderer: str, seeds: int, out: Path) -> PictureMeans:
    return recorded.grid_means(comparison.render(scene, renderer, seeds, out))


def cycles_means(comparison: Comparison, scene: str, out: Path) -> PictureMeans:
    """As recorded, or of Cycles' pictures where no record is of this Blender and this scene."""
    known = recorded.recorded(comparison, scene)
    return means(comparison, scene, "cycles", recorded.SEEDS, out) if known is None else known


def says_enough(ours: PictureMeans, theirs: PictureMeans, times: float = 1.0) -> bool:
    """Whether a difference of 3% in any cell and of 1% in the mean would be found: by the noise, whatever was found.

    With as many times the seeds of ours.
    """
    ours = replace(
        ours, channel_variances=ours.channel_variances / times, cell_variances=ours.cell_variances / times,
        cell_spreads=ours.cell_spreads / times,
    )
    _, error = metrics.compare_channel_means(ours, theirs)
    cells = metrics.compare_cell_means(ours, theirs)
    of_mean, of_cells = (SIGMAS * error).max(), (SIGMAS * cells.standard_error).max()
    return bool(of_mean <= MEAN_ALLOWANCE and of_cells <= 2.0 * CELL_ALLOWANCE)


def assert_same(name: str, ours: PictureMeans, theirs: PictureMeans) -> None:
    """Pictures that are not denoised are the same but for noise."""
    known = SCENES[name].allowance  # of a difference that is documented in the scene's note
    difference, error = metrics.compare_channel_means(ours, theirs)
    assert (np.abs(difference) <= max(MEAN_ALLOWANCE, known) + SIGMAS * error).all(), (
        f"{name}: channel means differ by {100 * difference} % +- {100 * error} %"
    )
    cells = metrics.compare_cell_means(ours, theirs)
    beyond = np.abs(cells.difference) > max(CELL_ALLOWANCE, known) + SIGMAS * cells.standard_error
    assert not beyond.any(), (
        f"{name}: cells (row, column) {np.argwhere(beyond).tolist()} differ by {100 * cells.difference[beyond]} % "
        f"+- {100 * cells.standard_error[beyond]} %"
    )


def assert_same_denoised(name: str, ours: PictureMeans, theirs: PictureMeans) -> None:
    """Denoised pictures are the same but for noise."""
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


@pytest.mark.parametrize("name", FAST)
def test_same_picture_as_cycles(name: str, tmp_path: Path) -> None:
    ours, theirs = (means(AFRESH, name, renderer, 4, tmp_path) for renderer in ("OFF", "cycles"))
    assert_same(name, ours, theirs)


@pytest.mark.parametrize("name", ["glass-rough", "textured"])
def test_same_picture_as_cycles_at_blender_defaults(name: str, tmp_path: Path) -> None:
    ours, theirs = (means(AFRESH_AT_DEFAULTS, name, renderer, 3, tmp_path) for renderer in ("AUTO-AUTO", "cycles"))
    assert_same_denoised(name, ours, theirs)


@pytest.mark.slow
@pytest.mark.one_of_many
@pytest.mark.parametrize("name", some_of(COMPARABLE, 2))
def test_same_picture_as_cycles_in_many_scenes(name: str, tmp_path: Path) -> None:
    """By two seeds of ours, and by four where two do not say enough and four will."""
    theirs = cycles_means(PLAIN, name, tmp_path)
    images = PLAIN.render(name, "OFF", 2, tmp_path)
    ours = recorded.grid_means(images)
    if not says_enough(ours, theirs) and says_enough(ours, theirs, 2.0):
        images += PLAIN.render(name, "OFF", 2, tmp_path, first_seed=3)
        ours = recorded.grid_means(images)
    assert_same(name, ours, theirs)


@pytest.mark.slow
@pytest.mark.one_of_many
@pytest.mark.parametrize("name", some_of(COMPARABLE, 3))
def test_same_picture_as_cycles_at_blender_defaults_in_many_scenes(name: str, tmp_path: Path) -> None:
    ours = means(AT_DEFAULTS, name, "AUTO-AUTO", 2, tmp_path)
    assert_same_denoised(name, ours, cycles_means(AT_DEFAULTS, name, tmp_path))


@pytest.mark.slow
@pytest.mark.parametrize("name", CLAMPED)
def test_the_clamp_takes_what_it_takes_in_cycles(name: str, tmp_path: Path) -> None:
    theirs = cycles_means(CLAMPED_ROOMS, name, tmp_path)
    # Of three seeds a mean has ten times the noise with a cache, which `tests/engine/render/test_clamping.py` tests.
    for renderer in ("OFF", "AUTO"):
        assert_same(name, means(CLAMPED_ROOMS, name, renderer, 3, tmp_path), theirs)


@pytest.mark.slow
@pytest.mark.parametrize("name", LINKED_MEDIA)
def test_media_get_and_dim_linked_light_as_in_cycles(name: str, tmp_path: Path) -> None:
    assert_same(name, means(LINKED, name, "OFF", 3, tmp_path), cycles_means(LINKED, name, tmp_path))


@pytest.mark.slow
@pytest.mark.parametrize("name", FAST)
def test_same_picture_as_cycles_where_the_noise_threshold_stops_pixels(name: str, tmp_path: Path) -> None:
    ours = means(STOPPED, name, "AUTO-AUTO", 3, tmp_path)
    assert_same(name, ours, cycles_means(STOPPED, name, tmp_path))


@pytest.mark.parametrize("comparison", COMPARISONS, ids=lambda comparison: comparison.name)
def test_what_is_recorded_of_cycles_is_of_today(comparison: Comparison) -> None:
    """Else the tests above render Cycles too, and take twice as long: `python -m tests.helpers.parity`."""
    records = recorded.read(comparison)
    lock = (Path(__file__).parents[2] / "requirements-3.11.lock").read_text("utf-8")
    assert f"bpy=={records['blender']}" in lock.split()
    scenes = records["scenes"]
    assert set(scenes) == set(comparison.scenes)
    assert [name for name in scenes if not recorded.is_current(comparison, name, scenes[name])] == []


def test_a_record_counts_for_its_scene_its_samples_and_its_blender(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recorded, "blender_version", lambda: recorded.read(PLAIN)["blender"])
    known = recorded.recorded(PLAIN, "textured")
    assert known is not None and known.seeds >= 2
    assert known.cells.shape == known.cell_variances.shape == (recorded.ROWS, recorded.COLUMNS)
    assert recorded.recorded(replace(PLAIN, sample_factor=3), "textured") is None
    monkeypatch.setattr(recorded, "scene_hash", lambda name: "another")
    assert recorded.recorded(PLAIN, "textured") is None
    monkeypatch.undo()
    monkeypatch.setattr(recorded, "blender_version", lambda: "4.2.0")
    assert recorded.recorded(PLAIN, "textured") is None


def test_words_about_a_scene_leave_its_record_current_and_its_code_does_not() -> None:
    code = 'def build():\n    """One."""\n    return "# two"  # three\n'
    same = '"""Four."""\n\n# Five\ndef build():\n    """Six.\n\n    Seven.\n    """\n    return "# two"\n'
    assert recorded.code_of(code) == recorded.code_of(same)
    assert recorded.code_of(code) != recorded.code_of(code.replace("# two", "# 2"))
