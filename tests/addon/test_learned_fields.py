# SPDX-License-Identifier: GPL-3.0-or-later
"""What renders have learned, from one to the next, in files and out of them: through Blender's own render loop."""

from __future__ import annotations

import dataclasses
import subprocess
import sys
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from engine.guiding.saved.file import FieldFileError, load_field, save_field
from tests.helpers.fake_engine import FakeEngine
from tests.helpers.learned_fields import learned_field

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def scene(cube_scene: Any, blender: Any) -> Iterator[Any]:
    """The cube on a floor, guided by mixtures; nothing in memory."""
    from addon import learned_fields

    blender.ops.mesh.primitive_plane_add(size=12.0, location=(0.0, 0.0, -1.0))
    ours = cube_scene.neuralguide
    ours.guiding_method, ours.guiding_trial, ours.samples, ours.threads = "VMM", False, 7, 1
    yield cube_scene
    learned_fields.forget()


@pytest.fixture
def told(capsys: pytest.CaptureFixture[str]) -> Callable[[], list[str]]:
    """What users have been told of learned fields since the last call."""
    start = "NeuralGuide: Warning: "

    def lines() -> list[str]:
        lines = [line.removeprefix(start) for line in capsys.readouterr().err.splitlines() if line.startswith(start)]
        return [line for line in lines if line.lower().startswith("learned field: ")]

    return lines


def render(**changes: Any) -> Any:
    """Render the current frame; how it went."""
    import bpy

    from addon import engine

    for name, value in changes.items():
        setattr(bpy.context.scene.neuralguide, name, value)
    bpy.ops.render.render()
    outcome = engine.outcomes[-1]
    assert outcome.status == "FINISHED", outcome.message
    return outcome


def started_from(outcome: Any) -> str:
    return str(outcome.report.guiding.started_from)


def kept() -> Any:
    import bpy

    from addon.learned_fields import kept_field

    return kept_field(bpy.context.scene, bpy.context.view_layer)


def test_the_next_render_starts_from_what_the_last_one_learned(scene: Any, told: Callable[[], list[str]]) -> None:
    """From one F12 to the next, by frames and by views; what changes the light begins anew, and needs no words."""
    import bpy

    assert kept() is None
    assert started_from(render()) == ""
    assert kept().samples == 7.0
    assert started_from(render()).startswith("7 samples a pixel")
    scene.camera.location.x += 1.0
    scene.frame_set(scene.frame_current + 1)
    assert started_from(render(samples=3)).startswith("14 samples a pixel")
    scene.render.resolution_percentage = 50
    assert started_from(render()).startswith("17 samples a pixel")
    scene.objects["Cube"].location.x += 0.5
    assert started_from(render()) == ""
    scene.objects["Sun"].data.energy *= 2.0
    assert started_from(render()) == ""
    assert told() == []
    bpy.ops.wm.read_homefile(use_empty=True)
    assert kept() is None


def test_an_animation_goes_on_from_frame_to_frame(scene: Any, tmp_path: Path) -> None:
    import bpy

    from addon import engine

    scene.frame_start, scene.frame_end = 1, 3
    scene.render.filepath = str(tmp_path / "f_")
    bpy.ops.render.render(animation=True)
    assert [started_from(item)[:2] for item in engine.outcomes] == ["", "7 ", "14"]


@pytest.mark.parametrize("changes", [{"keep_learned": False}, {"deterministic": True}])
def test_a_render_can_learn_anew_each_time(scene: Any, changes: dict[str, Any], monkeypatch: Any) -> None:
    """Then the image is the same each time."""
    from engine.render.session import Session

    images: list[np.ndarray] = []
    real = Session.render

    def watched(session: Session, **options: Any) -> Any:
        result = real(session, **options)
        images.append(result.passes["Combined"])
        return result

    monkeypatch.setattr(Session, "render", watched)
    for _ in range(2):
        assert started_from(render(**changes)) == ""
    np.testing.assert_array_equal(images[0], images[1])
    assert (kept() is None) == (not scene.neuralguide.keep_learned)


def test_a_file_is_saved_and_started_from(scene: Any, tmp_path: Path, told: Callable[[], list[str]]) -> None:
    from addon import learned_fields

    path = tmp_path / "room.ngfield"
    assert started_from(render(field_path=str(path), save_field=True, keep_learned=False)) == ""
    assert load_field(path).samples == 7.0
    # As another process would.
    learned_fields.forget()
    assert started_from(render()).startswith("7 samples a pixel")
    assert load_field(path).samples == 14.0
    before = path.read_bytes()
    learned_fields.forget()
    assert started_from(render(save_field=False, deterministic=True)).startswith("14 samples a pixel")
    assert path.read_bytes() == before
    assert told() == []
    scene.objects["Cube"].location.x += 0.5
    assert started_from(render()) == ""
    assert told() == [
        "Learned field: lights, materials or geometry are not those that it was learned with; the render learns anew"
    ]


def test_memory_counts_before_its_own_file_and_a_new_file_before_memory(scene: Any, tmp_path: Path) -> None:
    path = tmp_path / "room.ngfield"
    render(field_path=str(path), save_field=True)
    first = load_field(path)
    assert started_from(render(save_field=False)).startswith("7 samples a pixel")
    # It has gone on learning, and the file has not.
    assert started_from(render()).startswith("14 samples a pixel")
    save_field(path, dataclasses.replace(first, samples=90.0))
    assert started_from(render()).startswith("90 samples a pixel")
    path.unlink()
    # The last three samples were too small a share of all to be learned from once the render was over.
    assert started_from(render(field_path="")).startswith("94 samples a pixel")


@pytest.mark.parametrize(("content", "problem"), [
    (b"not a field at all", "is no learned field of NeuralGuide: choose a file that was made by Save Learned Field"),
    (None, "there is no file"),
])  # fmt: skip
def test_a_bad_file_is_named_and_left_alone(
    scene: Any, tmp_path: Path, told: Callable[[], list[str]], content: bytes | None, problem: str
) -> None:
    path = tmp_path / "room.ngfield"
    if content is not None:
        path.write_bytes(content)
    assert started_from(render(field_path=str(path))) == ""
    (line,) = told()
    assert str(path) in line and problem in line and line.endswith("the render learns anew")
    render(save_field=True, keep_learned=False)
    if content is None:
        assert load_field(path).samples == 7.0 and told() == []
    else:
        assert path.read_bytes() == content
        assert any("so it is not overwritten: choose another file, or remove it" in line for line in told())


def test_a_path_may_be_relative_to_the_file(scene: Any, tmp_path: Path, blender: Any) -> None:
    """Blender would warn, and the folder be another, if the property did not say that it may."""
    blender.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        blender.context.scene.neuralguide.field_path = "//room.ngfield"
    render(save_field=True)
    assert load_field(tmp_path / "room.ngfield").samples == 7.0


def test_what_cannot_be_saved_stays_in_memory(
    scene: Any, tmp_path: Path, told: Callable[[], list[str]]
) -> None:
    render(field_path=str(tmp_path / "nowhere" / "room.ngfield"), save_field=True)
    (line,) = told()
    assert "cannot be written" in line and line.endswith("it stays in memory")
    assert started_from(render(field_path="")).startswith("7 samples a pixel")


def test_the_operators_save_and_load(scene: Any, tmp_path: Path) -> None:
    import bpy

    path = tmp_path / "room.ngfield"
    with pytest.raises(RuntimeError, match="poll"):
        bpy.ops.neuralguide.save_learned_field(filepath=str(path))
    render()
    first = kept().digest
    assert bpy.ops.neuralguide.save_learned_field(filepath=str(path)) == {"FINISHED"}
    assert load_field(path).digest == first and scene.neuralguide.field_path == str(path)
    render()
    assert kept().digest != first
    # Back to what was saved.
    assert bpy.ops.neuralguide.load_learned_field(filepath=str(path)) == {"FINISHED"}
    assert kept() is None
    assert started_from(render()).startswith("7 samples a pixel")
    with pytest.raises(RuntimeError, match="cannot be written"):
        bpy.ops.neuralguide.save_learned_field(filepath=str(tmp_path / "nowhere" / "room.ngfield"))
    path.write_bytes(b"something else")
    with pytest.raises(RuntimeError, match="is no learned field of NeuralGuide"):
        bpy.ops.neuralguide.load_learned_field(filepath=str(path))
    assert kept() is not None


def test_an_unguided_render_has_nothing_to_do_with_fields(scene: Any, tmp_path: Path, monkeypatch: Any) -> None:
    fake = FakeEngine(monkeypatch)
    fake.learned = learned_field()
    path = tmp_path / "room.ngfield"
    render(guiding_method="OFF", field_path=str(path), save_field=True)
    assert fake.started_from == [None] and kept() is None and not path.exists()


def test_the_command_line_starts_from_a_file(scene: Any, tmp_path: Path, blender: Any) -> None:
    """In processes of their own: what the light depends on is told alike in all of them."""
    blend, path = tmp_path / "scene.blend", tmp_path / "room.ngfield"
    blender.ops.wm.save_as_mainfile(filepath=str(blend))

    def command(*options: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, "-m", "addon", str(blend), *options, "-o", str(tmp_path / "x_"), "-f", "1"],
            cwd=ROOT, capture_output=True, text=True, timeout=300,
        )  # fmt: skip

    missing = command("--field", str(path))
    assert missing.returncode == 2
    assert "there is no such file; put --set save_field=on before --field to have it made" in missing.stderr
    made = command("--set", "save_field=on", "--field", str(path))
    assert made.returncode == 0 and "learned field saved to" in made.stdout + made.stderr
    used = command("--field", str(path))
    assert used.returncode == 0
    assert "started from what earlier renders had learned: 7 samples a pixel" in used.stdout + used.stderr
    path.write_bytes(path.read_bytes()[:500])
    with pytest.raises(FieldFileError):
        load_field(path)
    damaged = command("--field", str(path))
    assert damaged.returncode == 2 and "is damaged" in damaged.stderr
