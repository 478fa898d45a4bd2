# SPDX-License-Identifier: GPL-3.0-or-later
"""A scene made for Cycles has Cycles' picture by the command line, with nothing set but the engine.

Channel means within 0.5% of Cycles', or 4.5 standard errors of what is beyond: less than 1 false alarm in 30,000 scenes
for normal noise, and seeds are fixed. Standard errors have to be small enough for that to say something.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from benchmarks import first_click
from benchmarks.scene_files import SceneSource
from benchmarks.scenes import SCENES

LIMITS = sorted(name for name in SCENES if name.startswith("limits-"))
ALLOWANCE = 0.005
SIGMAS = 4.5
PIXELS = 48 * 36


def compare(name: str, out: Path, seed_count: int) -> Any:
    return first_click.compare_first_clicks(
        SceneSource(f"builtin:{name}"), 2 * SCENES[name].samples, seed_count, out=out, pixels=PIXELS
    )


def is_same(result: Any) -> bool:
    assert result.mean_error < 0.5 * ALLOWANCE, "too noisy to tell"
    return abs(result.mean_difference) <= ALLOWANCE + SIGMAS * result.mean_error and "differs" not in result.verdict


@pytest.mark.slow
def test_many_bounces_are_read_from_cycles_and_without_them_the_picture_is_another(
    tmp_path: Path, monkeypatch: Any
) -> None:
    assert is_same(compare("limits-many", tmp_path, 2))
    save = first_click.save_scene

    def save_with_settings_of_its_own(scene: Any, path: Path, samples: int, seed: int) -> None:
        import addon

        addon.register()
        scene.neuralguide.use_cycles_settings = False
        scene.neuralguide.samples, scene.neuralguide.seed = samples, seed
        save(scene, path, samples, seed)

    monkeypatch.setattr(first_click, "save_scene", save_with_settings_of_its_own)
    own = compare("limits-many", tmp_path, 2)
    assert own.mean_difference < -0.1 and not is_same(own)


@pytest.mark.slow
@pytest.mark.parametrize("name", LIMITS)
def test_nothing_set_but_the_engine_is_cycles_picture(name: str, tmp_path: Path) -> None:
    assert is_same(compare(name, tmp_path, 4))


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
