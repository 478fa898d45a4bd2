# SPDX-License-Identifier: GPL-3.0-or-later
"""An animation with *Over Time* on is denoised once it is rendered; where it cannot be, frames stay and it is said."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.images import read_exr
from engine.denoise import library

pytestmark = pytest.mark.skipif(bool(library.problem()), reason="no Open Image Denoise here")


@pytest.fixture
def animation(cube_scene: Any, tmp_path: Path) -> Any:
    """The cube, which moves, frames 3 to 5, to be denoised over time."""
    import bpy

    scene = cube_scene
    cube = bpy.data.objects["Cube"]
    for frame, place in ((3, 0.0), (5, 0.5)):
        cube.location.x = place
        cube.keyframe_insert("location", frame=frame)
    scene.frame_start, scene.frame_end = 3, 5
    render = scene.render
    render.image_settings.media_type = "MULTI_LAYER_IMAGE"
    render.filepath = str(tmp_path / "shot_####")
    ours = scene.neuralguide
    ours.use_cycles_settings, ours.samples, ours.guiding_method = False, 1, "OFF"
    ours.use_denoising, ours.denoise_over_time, ours.use_animated_seed = True, True, True
    return scene


def denoised(folder: Path) -> list[str]:
    return sorted(path.name for path in (folder / "denoised").glob("*"))


def test_an_animation_is_denoised_after_its_last_frame(animation: Any, tmp_path: Path, capsys: Any) -> None:
    """Its passes come by themselves; what was rendered stays; one frame alone, or a still, is left as it is."""
    import bpy

    bpy.ops.render.render(animation=True)
    names = [f"shot_{frame:04}.exr" for frame in (3, 4, 5)]
    assert denoised(tmp_path) == names
    for name in names:
        before, after = (read_exr(folder / name)[0] for folder in (tmp_path, tmp_path / "denoised"))
        assert not np.array_equal(before, after)
        assert np.allclose(before.mean(), after.mean(), rtol=0.05)
    assert np.any(read_exr(tmp_path / names[1], "Vector")[0])
    for name in names:
        (tmp_path / "denoised" / name).unlink()
    animation.render.use_overwrite = False
    (tmp_path / names[1]).unlink()
    bpy.ops.render.render(animation=True)
    assert denoised(tmp_path) == names, "frames that were there already belong to it"
    for name in names:
        (tmp_path / "denoised" / name).unlink()
    animation.render.use_overwrite = True
    animation.frame_end = 3
    capsys.readouterr()
    bpy.ops.render.render(animation=True)
    assert "one frame was rendered. Once all are there, Render > Denoise Sequence" in capsys.readouterr().err
    bpy.ops.render.render(write_still=True)
    assert not denoised(tmp_path)
    assert "over time" not in capsys.readouterr().err


def test_the_command_line_does_so_too(animation: Any, tmp_path: Path, monkeypatch: Any, capsys: Any) -> None:
    import bpy

    from addon.__main__ import main

    path = tmp_path / "scene.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    assert main([str(path), "-s", "4", "-a"]) == 0
    assert denoised(tmp_path) == ["shot_0004.exr", "shot_0005.exr"]
    (tmp_path / "denoised" / "shot_0004.exr").unlink()
    (tmp_path / "denoised" / "shot_0005.exr").unlink()
    (tmp_path / "denoised").rmdir()
    (tmp_path / "denoised").write_text("no folder")
    assert main([str(path), "-a"]) == 1
    assert "shot_0003.exr cannot be written" in capsys.readouterr().err
    assert len(list(tmp_path.glob("shot_*"))) == 3


@pytest.mark.parametrize(
    ("spoil", "sentence"),
    [
        (lambda scene: setattr(scene.render.image_settings, "media_type", "IMAGE"), "not saved as OpenEXR MultiLayer"),
        (lambda scene: setattr(scene.render, "use_motion_blur", True), "motion blur leaves no vectors"),
        (lambda scene: setattr(scene.render, "use_multiview", True), "frames are stereo"),
        (lambda scene: setattr(scene, "frame_step", 2), "the frame step is 2"),
    ],
)
def test_what_cannot_be_denoised_over_time_is_said(animation: Any, spoil: Any, sentence: str) -> None:
    from addon.denoise_over_time import counts, needs_passes, notices

    assert counts(animation) and not notices(animation)
    assert needs_passes(animation, animation.view_layers[0])
    spoil(animation)
    (notice,) = notices(animation)
    assert sentence in notice.problem
    assert not counts(animation) and not needs_passes(animation, animation.view_layers[0])
    animation.neuralguide.use_denoising = False
    assert not notices(animation)


def test_a_cancelled_render_is_left_as_it_is(animation: Any, tmp_path: Path, monkeypatch: Any, capsys: Any) -> None:
    """Cancelled once a frame is there: it stays, and a sentence says what to do."""
    import bpy

    from addon import engine

    monkeypatch.setattr(engine, "cancel_hooks", [lambda: animation.frame_current == 5])
    monkeypatch.setattr(engine, "saves_picture", True)
    with pytest.raises(RuntimeError, match="was cancelled"):
        bpy.ops.render.render(animation=True)
    assert "the render was cancelled. Render > Denoise Sequence" in capsys.readouterr().err
    assert (tmp_path / "shot_0003.exr").is_file() and not denoised(tmp_path)
