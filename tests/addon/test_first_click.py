# SPDX-License-Identifier: GPL-3.0-or-later
"""A scene made for Cycles has Cycles' picture by the command line, with nothing set but the engine.

Channel means within 0.5% of Cycles', or 4.5 standard errors of what is beyond, and cells within 2%: less than 1 false
alarm in 1,000 scenes for normal noise, and seeds are fixed. Standard errors have to be small enough for that to say
something. What Cycles gave is recorded (tests/helpers/parity); one scene is rendered by its command line every time.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks import first_click, metrics
from benchmarks.picture_means import PictureMeans
from benchmarks.scene_files import SceneSource
from benchmarks.scenes import SCENES
from tests.helpers.parity import recorded
from tests.helpers.parity.scenes import PIXELS, PLAIN

LIMITS = sorted(name for name in SCENES if name.startswith("limits-"))
#: Rendered by Cycles' command line too.
AFRESH = "limits-few"
ALLOWANCE = 0.005
CELL_ALLOWANCE = 0.02
SIGMAS = 4.5


def click(name: str, out: Path, seed_count: int) -> tuple[PictureMeans, PictureMeans]:
    """Our picture and Cycles', of as many seeds, or recorded."""
    known = None if name == AFRESH else recorded.recorded(PLAIN, name)
    engines = first_click.ENGINES if known is None else ("NEURALGUIDE",)
    images = first_click.click_pictures(
        SceneSource(f"builtin:{name}"), 2 * SCENES[name].samples, seed_count, out=out, engines=engines, pixels=PIXELS
    )
    theirs = recorded.grid_means(images["CYCLES"]) if known is None else known
    return recorded.grid_means(images["NEURALGUIDE"]), theirs


def is_same(ours: PictureMeans, theirs: PictureMeans) -> bool:
    difference, error = metrics.compare_channel_means(ours, theirs)
    assert (error < 0.5 * ALLOWANCE).all(), "too noisy to tell"
    cells = metrics.compare_cell_means(ours, theirs)
    return bool(
        (np.abs(difference) <= ALLOWANCE + SIGMAS * error).all()
        and (np.abs(cells.difference) <= CELL_ALLOWANCE + SIGMAS * cells.standard_error).all()
    )


@pytest.mark.slow
@pytest.mark.one_of_many
@pytest.mark.parametrize("name", LIMITS)
def test_nothing_set_but_the_engine_is_cycles_picture(name: str, tmp_path: Path) -> None:
    assert is_same(*click(name, tmp_path, 4))


@pytest.mark.slow
def test_many_bounces_are_read_from_cycles_and_without_them_the_picture_is_another(
    tmp_path: Path, monkeypatch: Any
) -> None:
    """With them it is Cycles': the test above."""
    save = first_click.save_scene

    def save_with_settings_of_its_own(scene: Any, path: Path, samples: int, seed: int) -> None:
        import addon

        addon.register()
        scene.neuralguide.use_cycles_settings = False
        scene.neuralguide.samples, scene.neuralguide.seed = samples, seed
        save(scene, path, samples, seed)

    monkeypatch.setattr(first_click, "save_scene", save_with_settings_of_its_own)
    ours, theirs = click("limits-many", tmp_path, 2)
    difference, _ = metrics.compare_channel_means(ours, theirs)
    assert difference.min() < -0.1 and not is_same(ours, theirs)


def test_a_render_that_fails_is_named(tmp_path: Path, monkeypatch: Any, capsys: Any) -> None:
    def save_without_camera(scene: Any, path: Path, samples: int, seed: int) -> None:
        import bpy

        scene.camera = None
        bpy.ops.wm.save_as_mainfile(filepath=str(path), copy=True)

    monkeypatch.setattr(first_click, "save_scene", save_without_camera)
    assert first_click.first_click([SceneSource("builtin:limits-film")], 1, 2, out=tmp_path) == 1
    assert "limits-film: NeuralGuide:" in capsys.readouterr().out
    with pytest.raises(ValueError, match="at least 2 seeds"):
        first_click.first_click([], 1, 1, out=tmp_path)
