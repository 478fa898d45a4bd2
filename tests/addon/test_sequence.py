# SPDX-License-Identifier: GPL-3.0-or-later
"""An animation rendered from one field: through Blender's own render loop, with the real exporter and engine."""

from __future__ import annotations

import copy
import gc
import weakref
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest

from tests.helpers.motion_scenes import keyframe, open_shutter
from tests.helpers.training import refuse_workers, require_torch


@pytest.fixture
def lamp_scene(cube_scene: Any) -> Any:
    """The cube on a floor, lit by a glowing ball that flies over it from frame 3 to 5; guided by a neural mixture."""
    import bpy

    bpy.data.objects.remove(bpy.data.objects["Sun"])
    bpy.ops.mesh.primitive_plane_add(size=12.0, location=(0.0, 0.0, -1.0))
    bpy.ops.mesh.primitive_uv_sphere_add(segments=8, ring_count=6, radius=0.2)
    ball = bpy.context.object
    ball.name = "Ball"
    glow = bpy.data.materials.new("Glow")
    glow.node_tree.nodes.clear()
    emission = glow.node_tree.nodes.new("ShaderNodeEmission")
    emission.inputs["Strength"].default_value = 40.0
    output = glow.node_tree.nodes.new("ShaderNodeOutputMaterial")
    glow.node_tree.links.new(emission.outputs[0], output.inputs["Surface"])
    ball.data.materials.append(glow)
    keyframe(ball, "location", {3: (-2.0, -1.0, 1.8), 5: (2.0, -1.0, 1.8)})
    scene = cube_scene
    scene.frame_start, scene.frame_end = 3, 5
    scene.frame_set(4)
    ours = scene.neuralguide
    ours.guiding_method, ours.experiment.mixture_u, ours.guiding_trial = "NPM", "PLANES", False
    ours.samples, ours.max_bounces, ours.threads, ours.deterministic = 7, 2, 2, True
    ours.sequence_field, ours.sequence_samples = True, 12
    return scene


@pytest.fixture
def trained(monkeypatch: Any) -> list[Any]:
    """What fields were trained on: the frames, by training. Trainings after the first one give what that gave."""
    from engine.render import sequence

    real = sequence.train_sequence
    calls: list[Any] = []
    fields: list[Any] = []

    def train(settings: Any, descriptions: Any, span: Any, **options: Any) -> Any:
        calls.append(([item.frame_current for item in descriptions], span))
        if not fields:
            fields.append(real(settings, descriptions, span, **options))
        return fields[0]

    monkeypatch.setattr(sequence, "train_sequence", train)
    return calls


def failing_training(monkeypatch: Any) -> list[Any]:
    """Have every training fail; the calls."""
    from engine.render import sequence

    calls: list[Any] = []

    def fail(*_arguments: Any, **_options: Any) -> None:
        calls.append(None)
        raise sequence.TrainingFailed("no torch")

    monkeypatch.setattr(sequence, "train_sequence", fail)
    return calls


def outcomes() -> list[Any]:
    from addon import engine

    return list(engine.outcomes)


def animate(scene: Any, folder: Path) -> dict[str, np.ndarray]:
    """Render the animation: the files' pixels by name."""
    import bpy

    scene.render.filepath = str(folder / "f_##")
    bpy.ops.render.render(animation=True)
    return {path.name: read(path) for path in sorted(folder.iterdir())}


def read(path: Path) -> np.ndarray:
    with OpenEXR.File(str(path)) as file:
        return np.array(file.channels()["RGBA"].pixels)


@pytest.fixture
def problems(capsys: pytest.CaptureFixture[str]) -> Callable[[], list[str]]:
    """What users have been told of the sequence's field since the last call."""
    start = "NeuralGuide: Warning: Sequence Field: "

    def told() -> list[str]:
        lines = capsys.readouterr().err.splitlines()
        return [line.removeprefix(start).rpartition("; ")[0] for line in lines if line.startswith(start)]

    return told


@pytest.mark.slow  # test_the_command_line_has_one_field_for_all_frames asks for less
def test_an_animation_is_trained_for_once(
    lamp_scene: Any, trained: list[Any], problems: Callable[[], list[str]], tmp_path: Path, monkeypatch: Any
) -> None:
    """Files are written, reports name the field, frames rendered later use it, and an edit has it trained anew."""
    require_torch()
    import bpy

    images = animate(lamp_scene, tmp_path)
    assert list(images) == ["f_03.exr", "f_04.exr", "f_05.exr"]
    assert all(image[..., :3].mean() > 0.01 for image in images.values())
    assert trained == [([3.0, 4.0, 5.0], (3.0, 5.0))]
    assert [item.status for item in outcomes()] == ["FINISHED"] * 3
    for item in outcomes():
        assert "trained once for times 3 to 5, on 3 frames" in item.report.guiding.source
        assert item.report.guiding.source_seconds == 0.0
    assert problems() == []

    # The same frame alone, in a job of its own.
    lamp_scene.frame_set(4)
    lamp_scene.render.filepath = str(tmp_path / "alone.exr")
    bpy.ops.render.render(write_still=True)
    assert len(trained) == 1 and lamp_scene.frame_current == 4
    np.testing.assert_array_equal(read(tmp_path / "alone.exr"), images["f_04.exr"])

    lamp_scene.objects["Cube"].location.x += 0.5
    bpy.ops.render.render()
    assert len(trained) == 2
    lamp_scene.neuralguide.max_bounces += 1
    bpy.ops.render.render()
    assert len(trained) == 3

    assert problems() == []
    # Frames that learn by themselves are not what is tested: do without the seconds that a worker takes to start.
    refuse_workers(monkeypatch)
    lamp_scene.frame_set(9)
    bpy.ops.render.render()
    assert len(trained) == 3
    assert problems() == ["frame 9 is outside of the animation, frames 3 to 5"]


def test_without_the_option_nothing_is_different(
    lamp_scene: Any, trained: list[Any], problems: Callable[[], list[str]], tmp_path: Path
) -> None:
    """And with it nothing is where it can do nothing."""
    lamp_scene.neuralguide.guiding_method = "VMM"
    images = {}
    for is_on in (False, True):
        folder = tmp_path / str(is_on)
        folder.mkdir()
        lamp_scene.neuralguide.sequence_field = is_on
        images[is_on] = animate(lamp_scene, folder)
        assert is_on or problems() == []
    for name, image in images[False].items():
        np.testing.assert_array_equal(image, images[True][name])
    assert trained == []
    assert problems() == ["VMM is no neural mixture (choose one of NPM, NPM_PRODUCT, NASG)"]


def test_a_still_scene_is_told_apart(
    lamp_scene: Any, trained: list[Any], problems: Callable[[], list[str]], monkeypatch: Any
) -> None:
    import bpy

    refuse_workers(monkeypatch)
    lamp_scene.objects["Ball"].animation_data_clear()
    bpy.ops.render.render()
    assert trained == [] and problems() == ["nothing is animated"]
    lamp_scene.frame_start = lamp_scene.frame_end
    bpy.ops.render.render()
    assert trained == [] and problems() == ["the animation has one frame only"]


def test_what_does_not_work_is_said_and_tried_once_a_job(
    lamp_scene: Any, problems: Callable[[], list[str]], tmp_path: Path, monkeypatch: Any
) -> None:
    import bpy

    refuse_workers(monkeypatch)
    calls = failing_training(monkeypatch)
    lamp_scene.neuralguide.experiment.mixture_u = "NONE"
    animate(lamp_scene, tmp_path)
    assert sorted(problems()) == [
        "no torch",
        "the network does not see the time: choose experiment.mixture_u, for example Planes",
    ]
    assert len(calls) == 1
    assert [item.status for item in outcomes()] == ["FINISHED"] * 3
    # Somebody may have installed it meanwhile.
    bpy.ops.render.render()
    assert len(calls) == 2


@pytest.mark.parametrize("is_blurred", [False, True])
def test_a_cancel_leaves_the_frame(lamp_scene: Any, tmp_path: Path, monkeypatch: Any, is_blurred: bool) -> None:
    """While frames are exported to be trained on, and while the field is trained; the next render trains anew."""
    import bpy

    from addon import engine

    if is_blurred:
        open_shutter(lamp_scene, 0.5)
    for is_late in (False, True):
        times: list[float] = []
        lamp_scene.frame_set(4)

        def stop(is_late: bool = is_late, times: list[float] = times) -> bool:
            times.append(lamp_scene.frame_current + lamp_scene.frame_subframe)
            # The last frame that is exported.
            return 5.0 in times and (not is_late or times[-1] == 4.0)

        monkeypatch.setattr(engine, "cancel_hooks", [stop])
        bpy.ops.render.render()
        assert [item.status for item in outcomes()] == ["CANCELLED", "FINISHED", "CANCELLED"][: 1 + 2 * is_late]
        assert (lamp_scene.frame_current, lamp_scene.frame_subframe) == (4, 0.0)
        with monkeypatch.context() as patch:
            patch.setattr(engine, "cancel_hooks", [])
            refuse_workers(patch)
            calls = failing_training(patch)
            bpy.ops.render.render()
            assert len(calls) == 1


def test_the_command_line_has_one_field_for_all_frames(
    lamp_scene: Any, blender: Any, trained: list[Any], tmp_path: Path, monkeypatch: Any
) -> None:
    """It renders frames one by one, each as an animation of one frame; opening a file frees what was learned."""
    require_torch()
    from addon import engine, sequence
    from addon.__main__ import main
    from engine.render import sequence as training

    monkeypatch.setattr(engine, "cancel_hooks", [])
    train = training.train_sequence
    fields: list[weakref.ref[Any]] = []

    def train_another(*arguments: Any, **options: Any) -> Any:
        field = copy.copy(train(*arguments, **options))
        fields.append(weakref.ref(field))
        return field

    monkeypatch.setattr(training, "train_sequence", train_another)
    open_shutter(lamp_scene, 0.5)
    path = tmp_path / "scene.blend"
    blender.ops.wm.save_as_mainfile(filepath=str(path))
    assert main(["-b", str(path), "-o", str(tmp_path / "c_##"), "-s", "3", "-e", "4", "-a", "-f", "4"]) == 0
    assert sorted(file.name for file in tmp_path.glob("c_*")) == ["c_03.exr", "c_04.exr"]
    assert trained == [([3.0, 4.0], (2.75, 4.25))]
    assert sequence.frame_range is None
    gc.collect()
    assert [field() is None for field in fields] == [False]
    blender.ops.wm.read_homefile(use_empty=True)
    gc.collect()
    assert [field() is None for field in fields] == [True]
