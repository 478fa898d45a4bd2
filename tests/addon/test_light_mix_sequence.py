# SPDX-License-Identifier: GPL-3.0-or-later
"""Light groups of files are mixed, by the scene's factors or the files' own, and what cannot be mixed is said."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest

from addon import light_mix
from benchmarks.images import read_exr
from engine.denoise import library
from tests.helpers.light_groups import KEY, ODD, ROOM_GROUPS, keyframe, write_frame

bpy = pytest.importorskip("bpy")


@pytest.fixture
def frames(tmp_path: Path) -> list[Path]:
    """Files of three frames, of which 10 is missing: each is mixed by itself."""
    for number in (8, 9, 11):
        write_frame(tmp_path / f"shot2_{number:04}.exr", number, mix={KEY: [0.0, 0.0, 0.0], ODD: [1.0, 1.0, 2.0]})
    return sorted(tmp_path.glob("*.exr"))


@pytest.fixture
def scene(blender: Any) -> Any:
    """A scene with a factor for each group."""
    light_mix.add_missing(blender.context.scene, ROOM_GROUPS)
    return blender.context.scene


def light(path: Path, name: str) -> np.ndarray:
    return read_exr(path, name)[0][..., :3]


def expected(path: Path, factors: dict[str, Any]) -> np.ndarray:
    """The mix of a file as it was rendered."""
    return 0.5 + sum(light(path, f"Combined_{group}") * np.float32(factor) for group, factor in factors.items())


def mixed_beside(path: Path) -> Path:
    return path.parent / "mixed" / path.name


def test_combined_of_each_frame_is_mixed_by_its_factors_and_all_else_stays(frames: list[Path], scene: Any) -> None:
    """Key's factor is animated: 2 at frame 8, 5 at frame 11. The scene is at its frame again afterwards."""
    scene.neuralguide.light_mix[ODD].color = (1.0, 0.5, 0.0)
    keyframe(scene, KEY, {8: 2.0, 11: 5.0})
    scene.frame_set(3)
    assert bpy.ops.neuralguide.mix_sequence(filepath=str(frames[1])) == {"FINISHED"}
    assert scene.frame_current == 3
    for path, strength in zip(frames, (2.0, 3.0, 5.0), strict=True):
        made = mixed_beside(path)
        factors = {KEY: [strength] * 3, ODD: [1.0, 0.5, 0.0]}
        np.testing.assert_allclose(light(made, "Combined"), expected(path, factors), rtol=1e-5, atol=1e-5)
        assert np.array_equal(read_exr(made)[0][..., 3], read_exr(path)[0][..., 3])
        for name in ("Combined_Key", f"Combined_{ODD}", "Index"):
            assert np.array_equal(read_exr(made, name)[0], read_exr(path, name)[0])
        header = read_exr(made)[1]
        assert header["Scene"] == "Room"
        applied = json.loads(header[light_mix.APPLIED_FIELD])
        assert applied == {group: pytest.approx(factor) for group, factor in factors.items()}
        assert header[light_mix.FIELD] == read_exr(path)[1][light_mix.FIELD]


def test_frames_are_mixed_by_what_they_say_of_their_own_render(frames: list[Path], scene: Any) -> None:
    scene.neuralguide.light_mix[KEY].strength = 7.0
    bpy.ops.neuralguide.mix_sequence(filepath=str(frames[0]), source="FILES", folder="own")
    own = frames[0].parent / "own" / frames[0].name
    by_itself = expected(frames[0], {ODD: [1.0, 1.0, 2.0]})
    np.testing.assert_allclose(light(own, "Combined"), by_itself, rtol=1e-5, atol=1e-5)


@pytest.mark.skipif(bool(library.problem()), reason="no Open Image Denoise here")
@pytest.mark.parametrize("has_features", [True, False])
def test_a_denoised_picture_is_mixed_by_groups_that_are_denoised(
    has_features: bool, scene: Any, tmp_path: Path
) -> None:
    """Two walls of light with noise: the mix has hardly any, and Noisy Image is the sum of what was sampled."""
    rng = np.random.default_rng(2)
    size = (32, 48)
    lights = {group: np.float32(level * rng.gamma(4.0, 0.25, (3, *size))) for group, level in ((KEY, 2.0), (ODD, 0.5))}
    passes = {"Combined": np.full((3, *size), 2.5, np.float32), "Noisy Image": sum(lights.values())}
    passes |= {f"Combined_{group}": planes for group, planes in lights.items()}
    letters = dict.fromkeys(passes, "RGB")
    if has_features:
        passes |= {"Denoising Albedo": np.full((3, *size), 0.5, np.float32), "Denoising Normal": np.ones((3, *size))}
        letters |= {"Denoising Albedo": "RGB", "Denoising Normal": "XYZ"}
    channels = {
        f"ViewLayer.{name}.{letter}": np.float32(plane)
        for name, planes in passes.items() for letter, plane in zip(letters[name], planes, strict=True)
    }  # fmt: skip
    path = tmp_path / "room_0001.exr"
    with OpenEXR.File({"type": OpenEXR.scanlineimage}, channels) as file:
        file.write(str(path))
    scene.neuralguide.light_mix[KEY].is_on = False
    assert bpy.ops.neuralguide.mix_sequence(filepath=str(path)) == {"FINISHED"}
    picture = light(mixed_beside(path), "Combined")
    assert picture.mean() == pytest.approx(0.5, rel=0.05)
    assert picture.std() < 0.2 * lights[ODD].std()
    noisy = light(mixed_beside(path), "Noisy Image")
    np.testing.assert_allclose(np.moveaxis(noisy, 2, 0), lights[ODD], rtol=1e-4, atol=1e-5)


def test_a_file_without_a_number_is_mixed_alone(frames: list[Path], scene: Any, tmp_path: Path) -> None:
    write_frame(tmp_path / "still.exr", 1)
    scene.neuralguide.light_mix[KEY].is_on = False
    bpy.ops.neuralguide.mix_sequence(filepath=str(tmp_path / "still.exr"))
    assert [path.name for path in (tmp_path / "mixed").iterdir()] == ["still.exr"]


def test_the_command_line_does_the_same(frames: list[Path], scene: Any, tmp_path: Path, capsys: Any) -> None:
    from addon.__main__ import main

    scene.neuralguide.light_mix[KEY].strength = 0.25
    blend = tmp_path / "shot.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(blend))
    assert main([str(blend), "--mix-sequence", str(frames[0])]) == 0
    made = light(mixed_beside(frames[2]), "Combined")
    np.testing.assert_allclose(made, expected(frames[2], {KEY: [0.25] * 3, ODD: [1.0] * 3}), rtol=1e-5, atol=1e-5)
    assert main([str(blend), "--mix-sequence", str(tmp_path / "none.exr")]) == 2
    assert "there is no file" in capsys.readouterr().err


def forget_groups(frames: list[Path]) -> None:
    write_frame(frames[0], 0, ())


def forget_key(frames: list[Path]) -> None:
    write_frame(frames[0], 0, (ODD,))


def mix_before(frames: list[Path]) -> None:
    write_frame(frames[0], 0, **{light_mix.APPLIED_FIELD: "{}"})


@pytest.mark.parametrize(
    ("spoil", "source", "sentence"),
    [
        (forget_groups, "SCENE", "has no light groups: put lamps into groups"),
        (forget_key, "SCENE", f"was rendered without light group Key, which is in the mix: there are {ODD}. Set its"),
        (mix_before, "SCENE", "is mixed already"),
        (lambda frames: write_frame(frames[0], 0), "FILES", "says no light mix"),
        (lambda frames: write_frame(frames[0], 0, mix="[1]"), "FILES", "its light mix is none"),
        (lambda frames: write_frame(frames[0], 0, mix="{"), "FILES", "its light mix is none"),
        (lambda frames: write_frame(frames[0], 0, mix={KEY: [1, -2, 1]}), "FILES", "the factor 1, -2, 1 is"),
        (lambda frames: write_frame(frames[0], 0, mix={KEY: [1]}), "FILES", "is not three numbers"),
        (lambda frames: frames[0].unlink(), "SCENE", "there is no file"),
        (lambda frames: os.truncate(frames[0], 300), "SCENE", "shot2_0008.exr"),
        (lambda frames: (frames[0].parent / "mixed").write_text("x"), "SCENE", "shot2_0008.exr cannot be written"),
    ],
)
def test_what_cannot_be_mixed_is_said(
    spoil: Any, source: str, sentence: str, frames: list[Path], scene: Any
) -> None:
    scene.neuralguide.light_mix[KEY].strength = 2.0
    spoil(frames)
    with pytest.raises(RuntimeError, match="Error") as caught:
        bpy.ops.neuralguide.mix_sequence(filepath=str(frames[0]), source=source)
    assert sentence in str(caught.value)
    assert "Traceback" not in str(caught.value)


def test_the_folder_of_the_frames_is_refused(frames: list[Path], scene: Any) -> None:
    with pytest.raises(RuntimeError, match="choose another folder"):
        bpy.ops.neuralguide.mix_sequence(filepath=str(frames[0]), folder=str(frames[0].parent))
