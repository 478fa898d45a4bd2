# SPDX-License-Identifier: GPL-3.0-or-later
"""What the render engine's hooks do with Blender, seen through a session that returns known pixels."""

from __future__ import annotations

import logging
import re
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest

from engine.scene.description import Notice
from tests.helpers.fake_engine import FakeEngine

WIDTH, HEIGHT = 32, 16


@pytest.fixture
def fake(monkeypatch: Any) -> FakeEngine:
    return FakeEngine(monkeypatch)


def render(scene: Any, tmp_path: Path) -> dict[str, np.ndarray]:
    """Render the frame and read the file: channel groups by name, row 0 at the top as EXR has it."""
    import bpy

    path = tmp_path / "image.exr"
    scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    with OpenEXR.File(str(path)) as file:
        return {name: channel.pixels for part in file.parts for name, channel in part.channels.items()}


def outcomes() -> list[tuple[str, str]]:
    from addon import engine

    return [(item.view_layer, item.status) for item in engine.outcomes]


def test_pixels_stand_where_they_belong(cube_scene: Any, fake: FakeEngine, tmp_path: Path) -> None:
    image = render(cube_scene, tmp_path)["RGBA"]
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH]
    np.testing.assert_array_equal(image[..., 0], x)
    np.testing.assert_array_equal(image[::-1, :, 1], y)
    np.testing.assert_array_equal(image[..., 2], 4)  # the samples that were set
    assert outcomes() == [("ViewLayer", "FINISHED")]


@pytest.mark.parametrize("crop", [False, True])
def test_border_renders_its_part_only(cube_scene: Any, fake: FakeEngine, tmp_path: Path, crop: bool) -> None:
    settings = cube_scene.render
    settings.use_border, settings.use_crop_to_border = True, crop
    settings.border_min_x, settings.border_max_x = 0.25, 0.5
    settings.border_min_y, settings.border_max_y = 0.125, 1.0
    image = render(cube_scene, tmp_path)["RGBA"][::-1]
    y, x = np.mgrid[2:16, 8:16]
    if crop:
        part = image
        assert image.shape[:2] == (14, 8)
    else:
        part = image[2:16, 8:16]
        assert image.shape[:2] == (HEIGHT, WIDTH)
        assert np.count_nonzero(image[..., 3]) == part.shape[0] * part.shape[1]
    np.testing.assert_array_equal(part[..., 0], x)
    np.testing.assert_array_equal(part[..., 1], y)


def test_border_that_rounds_differently_is_adopted(cube_scene: Any, fake: FakeEngine, tmp_path: Path) -> None:
    settings = cube_scene.render
    settings.use_border = settings.use_crop_to_border = True
    settings.border_min_x, settings.border_max_x = 0.29, 0.71
    settings.border_min_y, settings.border_max_y = 0.33, 0.77
    image = render(cube_scene, tmp_path)["RGBA"]
    x0, y0, x1, y1 = fake.sessions[0].region
    assert image.shape[:2] == (y1 - y0, x1 - x0)
    np.testing.assert_array_equal(image[0, :, 0], np.arange(x0, x1))


def test_every_requested_pass_reaches_the_file(cube_scene: Any, fake: FakeEngine, tmp_path: Path) -> None:
    layer = cube_scene.view_layers[0]
    for name in ("z", "normal", "position", "emit", "environment", "object_index", "material_index"):
        setattr(layer, f"use_pass_{name}", True)
    for name in ("albedo", "sample_count", "variance", "candidate_count", "guiding_benefit"):
        setattr(layer.neuralguide, f"use_pass_{name}", True)
    cube_scene.render.image_settings.media_type = "MULTI_LAYER_IMAGE"
    images = render(cube_scene, tmp_path)
    asked = fake.asked_passes[0]
    assert asked == {
        *("Combined", "Depth", "Normal", "Position", "Emission", "Environment", "IndexOB", "IndexMA"),
        *("Albedo", "Sample Count", "Variance", "Candidate Count", "Guiding Benefit"),
    }
    renamed = {"IndexOB": "Object Index", "IndexMA": "Material Index"}
    for index, name in enumerate(sorted(asked - {"Combined"})):
        part = f"ViewLayer.{renamed.get(name, name)}"
        found = [pixels for key, pixels in images.items() if key.startswith(part)]
        assert found, f"{part} is not among {sorted(images)}"
        assert float(found[0].reshape(HEIGHT, WIDTH, -1)[0, 5, 0]) == 5 + 1000 * index


def test_only_requested_passes_are_asked_of_the_session(cube_scene: Any, fake: FakeEngine, tmp_path: Path) -> None:
    cube_scene.view_layers[0].use_pass_z = False
    for is_denoised in (True, False):
        cube_scene.cycles.use_denoising = is_denoised
        render(cube_scene, tmp_path)
    assert fake.asked_passes == [{"Combined", "Noisy Image"}, {"Combined"}]


def test_all_view_layers_render_with_their_samples(
    cube_scene: Any, fake: FakeEngine, tmp_path: Path, blender: Any
) -> None:
    other = cube_scene.view_layers.new("Other")
    other.samples = 9
    off = cube_scene.view_layers.new("Off")
    off.use = False
    cube_scene.render.image_settings.media_type = "MULTI_LAYER_IMAGE"
    images = render(cube_scene, tmp_path)
    assert [name for name, _ in fake.exported] == ["ViewLayer", "Other"]
    assert float(images["ViewLayer.Combined"][0, 0, 2]) == 4
    assert float(images["Other.Combined"][0, 0, 2]) == 9
    assert outcomes() == [("ViewLayer", "FINISHED"), ("Other", "FINISHED")]


def test_session_and_cache_live_on_with_persistent_data(
    cube_scene: Any, fake: FakeEngine, tmp_path: Path, blender: Any
) -> None:
    cube_scene.render.use_persistent_data = True
    cube_scene.frame_start, cube_scene.frame_end = 1, 3
    cube_scene.render.filepath = str(tmp_path / "frame_####")
    blender.ops.render.render(animation=True)
    assert fake.exported == [("ViewLayer", 1), ("ViewLayer", 2), ("ViewLayer", 3)]
    assert len(fake.sessions) == 1
    assert all(cache is fake.caches[0] for cache in fake.caches)
    assert sorted(path.name for path in tmp_path.iterdir()) == [f"frame_{i:04d}.exr" for i in (1, 2, 3)]


def test_a_value_error_reaches_the_user_word_for_word(cube_scene: Any, fake: FakeEngine, blender: Any) -> None:
    fake.export_error = ValueError("Scene has no camera: add one and make it active")
    with pytest.raises(RuntimeError, match=r"^Error: Scene has no camera: add one and make it active\s*$"):
        blender.ops.render.render()
    assert outcomes() == [("ViewLayer", "FAILED")]


def test_bad_settings_are_refused_by_name(cube_scene: Any, fake: FakeEngine, blender: Any) -> None:
    cube_scene.neuralguide.samples = 0
    with pytest.raises(RuntimeError, match="samples is 0: choose 1 to"):
        blender.ops.render.render()


@pytest.mark.parametrize("where", ["export_error", "render_error"])
def test_an_unexpected_error_shows_no_traceback_but_logs_one(
    cube_scene: Any, fake: FakeEngine, blender: Any, tmp_path: Path, where: str, capfd: Any, monkeypatch: Any
) -> None:
    monkeypatch.setenv("NEURALGUIDE_KERNEL_CACHE", str(tmp_path / "kernels"))
    setattr(fake, where, KeyError("mesh 17"))
    with pytest.raises(RuntimeError) as caught:
        blender.ops.render.render()
    assert "internal error while" in str(caught.value)
    assert "mesh 17" in str(caught.value)
    shown = "".join(capfd.readouterr()) + str(caught.value)
    assert "Traceback" not in shown
    log = tmp_path / "neuralguide.log"
    assert str(log) in str(caught.value)
    assert re.search(r"Traceback(.|\n)*KeyError: 'mesh 17'", log.read_text())


def test_an_error_in_the_middle_keeps_what_was_rendered(cube_scene: Any, fake: FakeEngine, tmp_path: Path) -> None:
    import bpy

    fake.render_error = MemoryError()
    cube_scene.render.filepath = str(tmp_path / "image.exr")
    with pytest.raises(RuntimeError, match="out of memory while rendering"):
        bpy.ops.render.render()
    bpy.data.images["Render Result"].save_render(str(tmp_path / "kept.exr"))
    with OpenEXR.File(str(tmp_path / "kept.exr")) as file:
        assert file.channels()["RGBA"].pixels[0, 7, 0] == 7


def test_cancel_keeps_what_was_rendered(cube_scene: Any, fake: FakeEngine, tmp_path: Path, monkeypatch: Any) -> None:
    import bpy

    from addon import engine

    is_cancelled = False

    def press_escape(_fake: FakeEngine) -> None:
        nonlocal is_cancelled
        assert not fake.sessions[0].should_cancel()
        is_cancelled = True
        assert fake.sessions[0].should_cancel()

    fake.during_render = press_escape
    monkeypatch.setattr(engine, "cancel_hooks", [lambda: is_cancelled])
    bpy.ops.render.render()
    assert outcomes() == [("ViewLayer", "CANCELLED")]
    bpy.data.images["Render Result"].save_render(str(tmp_path / "kept.exr"))
    with OpenEXR.File(str(tmp_path / "kept.exr")) as file:
        assert file.channels()["RGBA"].pixels[0, 7, 0] == 7


def test_cancel_during_export_renders_nothing(cube_scene: Any, fake: FakeEngine, monkeypatch: Any) -> None:
    import bpy

    from addon import engine

    monkeypatch.setattr(engine, "cancel_hooks", [lambda: True])
    bpy.ops.render.render()
    assert outcomes() == [("ViewLayer", "CANCELLED")]
    assert fake.sessions == []


def test_a_notice_is_shown_once_a_job(cube_scene: Any, fake: FakeEngine, tmp_path: Path, capfd: Any) -> None:
    import bpy

    fake.notices = [Notice("Cube / Glass / Wave Texture", "is not supported", "grey is used")]
    cube_scene.frame_start, cube_scene.frame_end = 1, 2
    cube_scene.render.filepath = str(tmp_path / "frame_####")
    bpy.ops.render.render(animation=True)
    shown = "".join(capfd.readouterr())
    assert shown.count("NeuralGuide: Warning: Cube / Glass / Wave Texture: is not supported; grey is used") == 1
    bpy.ops.render.render()
    assert "Wave Texture" in "".join(capfd.readouterr())


def test_settings_it_has_not_are_said_once_a_job_and_stand_in_the_file(
    cube_scene: Any, fake: FakeEngine, tmp_path: Path, capfd: Any
) -> None:
    import bpy

    scene = cube_scene
    scene.cycles.direct_light_sampling_type = "FORWARD_PATH_TRACING"
    scene.cycles.shading_system = True
    scene.render.use_stamp_frame = True
    scene.frame_start, scene.frame_end = 1, 2
    scene.render.filepath = str(tmp_path / "frame_####.exr")
    bpy.ops.render.render(animation=True)
    shown = "".join(capfd.readouterr())
    for words in (
        "Scene: Open Shading Language is not supported", "Scene: sampling light in one way only is not supported",
    ):  # fmt: skip
        assert shown.count(f"NeuralGuide: Warning: {words}") == 1
    for frame in (1, 2):
        with OpenEXR.File(str(tmp_path / f"frame_000{frame}.exr")) as file:
            assert "Open Shading Language" in str(file.header()["neuralguide.ViewLayer.notices"])


def test_passes_it_has_not_are_named(cube_scene: Any, fake: FakeEngine, capfd: Any) -> None:
    import bpy

    cube_scene.view_layers[0].use_pass_subsurface_direct = True
    cube_scene.view_layers[0].use_pass_shadow = True
    bpy.ops.render.render()
    assert "View layer ViewLayer: no passes Shadow, Subsurface Direct" in "".join(capfd.readouterr())


def test_the_file_says_how_it_was_made(cube_scene: Any, fake: FakeEngine, tmp_path: Path) -> None:
    cube_scene.render.use_stamp_frame = True  # without any of these Blender writes no metadata at all
    render(cube_scene, tmp_path)
    with OpenEXR.File(str(tmp_path / "image.exr")) as file:
        header = dict(file.header())
    assert header["neuralguide.ViewLayer.samples"] == "4"
    assert header["neuralguide.ViewLayer.ended_by"] == "All samples taken"
    assert header["neuralguide.ViewLayer.rays"] == "1000"


@pytest.mark.parametrize(
    ("method", "source", "stands_by"),
    [
        ("NPM", "VMM", True),
        ("NEURAL_RIS", "VMM", True),
        ("TABLE_RIS", "NASG", True),
        ("TABLE_RIS", "VMM", False),
        ("VMM", "NASG", False),
        ("AUTO", "VMM", False),
        ("OFF", "NASG", False),
    ],
)
def test_a_worker_stands_by_for_renders_that_train_a_network(
    cube_scene: Any, fake: FakeEngine, tmp_path: Path, monkeypatch: Any, method: str, source: str, stands_by: bool
) -> None:
    from engine.guiding.neural.trainer import standby

    calls: list[str] = []
    monkeypatch.setattr(standby, "stand_by", lambda device: calls.append("stand by"))
    fake.during_render = lambda _fake: calls.append("render")
    ours = cube_scene.neuralguide
    ours.guiding_method, ours.experiment.source_field = method, source
    render(cube_scene, tmp_path)
    # It begins before the render does.
    assert calls == ["stand by", "render"][not stands_by :]


def test_the_worker_goes_with_the_add_on(monkeypatch: Any) -> None:
    import addon
    from engine.guiding.neural.trainer import standby

    calls: list[str] = []
    monkeypatch.setattr(standby, "dismiss", lambda: calls.append("dismiss"))
    addon.register()
    addon.unregister()
    try:
        assert calls == ["dismiss"]
    finally:
        addon.register()


def test_where_kernels_came_from_is_said_once(
    cube_scene: Any, fake: FakeEngine, tmp_path: Path, monkeypatch: Any
) -> None:
    said: list[str] = []
    monkeypatch.setattr(logging.getLogger("neuralguide"), "info", said.append)
    fake.kernels = "kernels: 3 made ahead for x86-64-v3"
    for _ in range(2):
        render(cube_scene, tmp_path)
    assert [line for line in said if line.startswith("kernels")] == ["kernels: 3 made ahead for x86-64-v3"]
