# SPDX-License-Identifier: GPL-3.0-or-later
"""Freestyle's lines, beside Cycles: Blender has the engine itself draw them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from addon import engine, freestyle, learned_fields  # noqa: E402
from engine.settings import RenderSettings  # noqa: E402
from tests.helpers.pass_scenes import render_both  # noqa: E402

pytestmark = pytest.mark.skipif(not bpy.app.build_options.freestyle, reason="this Blender has no Freestyle")


def line_scene(scene: Any) -> Any:
    """Turn Freestyle on in the scene of a cube: thick lines in red, half there."""
    scene.render.use_freestyle = True
    scene.render.line_thickness = 4.0
    lines = scene.view_layers[0].freestyle_settings
    lineset = lines.linesets[0] if lines.linesets else lines.linesets.new("Lines")
    style = lineset.linestyle = bpy.data.linestyles.new("Style")
    style.color, style.alpha = (0.8, 0.1, 0.05), 0.5
    scene.render.resolution_x, scene.render.resolution_y = 64, 48
    return lines


@pytest.mark.parametrize("in_pass", [False, True])
def test_lines_are_those_of_cycles(in_pass: bool, cube_scene: Any, tmp_path: Path) -> None:
    lines = line_scene(cube_scene)
    lines.as_render_pass = in_pass
    (ours, _), (theirs, _) = render_both(cube_scene, tmp_path, 64)
    assert ("ViewLayer.Freestyle.R" in ours) == ("ViewLayer.Freestyle.R" in theirs) == in_pass
    name = "ViewLayer.Freestyle" if in_pass else "ViewLayer.Combined"
    for channel in "RGBA":
        np.testing.assert_allclose(ours[f"{name}.{channel}"], theirs[f"{name}.{channel}"], atol=0.08)
    red, blue = ours[f"{name}.R"], ours[f"{name}.B"]
    assert (red > blue + 0.2).mean() > 0.02, "there are lines"


def test_a_render_of_lines_is_none_of_the_users(
    cube_scene: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Lines are rendered without guiding and limits, and no field nor report is made of them."""
    line_scene(cube_scene)
    made: list[tuple[str, RenderSettings]] = []
    plan = learned_fields.FieldPlan

    def note(depsgraph: Any, settings: RenderSettings) -> Any:
        made.append((depsgraph.scene.name, settings))
        return plan(depsgraph, settings)

    monkeypatch.setattr(engine, "FieldPlan", note)
    ours = cube_scene.neuralguide
    ours.samples, ours.guiding_method, ours.keep_learned, ours.time_limit = 4, "VMM", True, 100.0
    before = engine.outcome_count()
    bpy.ops.render.render()
    assert [outcome.scene for outcome in engine.outcomes_since(before)] == [cube_scene.name]
    (picture, settings), (strokes, for_strokes) = made
    assert picture == cube_scene.name and strokes != picture
    assert settings.is_guided and not for_strokes.is_guided
    assert (settings.time_limit, for_strokes.time_limit) == (100.0, 0.0)
    assert for_strokes.samples == settings.samples == 4


def test_scenes_of_the_file_are_not_of_strokes(cube_scene: Any) -> None:
    assert not freestyle.is_of_strokes(cube_scene)
    assert not freestyle.is_of_strokes(bpy.context.evaluated_depsgraph_get().scene_eval)
