# SPDX-License-Identifier: GPL-3.0-or-later
"""The light mix of saved files in Blender: what an image editor shows of them, and what their metadata keeps."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from addon import light_mix, light_mix_files
from benchmarks.images import read_exr
from tests.helpers.bake_scenes import pixels_of
from tests.helpers.image_editors import image_editor
from tests.helpers.light_groups import KEY, ODD, ROOM_GROUPS, write_frame
from tests.helpers.panel_layout import Layout

bpy = pytest.importorskip("bpy")

#: What the file says of its render.
MIX = {KEY: [0.0, 0.0, 0.0], ODD: [1.0, 0.5, 2.0]}


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """A file of two groups, with a mix."""
    write_frame(tmp_path / "room.exr", 1, mix=MIX)
    return tmp_path / "room.exr"


@pytest.fixture
def space(blender: Any, path: Path) -> Iterator[Any]:
    """An image editor that shows it."""
    yield image_editor(drawn_image(blender.data.images.load(str(path))))
    light_mix_files.forget()


def drawn_image(image: Any) -> Any:
    """An image, read as editors read what they draw: before that, Blender does not know that it has layers."""
    assert tuple(image.size) == (0, 0), "Blender has no pixels of its own of such files"
    return image


def run(space: Any, name: str) -> set[str]:
    """Run an operator in the editor."""
    window = bpy.context.window_manager.windows[0]
    with bpy.context.temp_override(window=window, area=window.screen.areas[0], space_data=space):
        return getattr(bpy.ops.neuralguide, name)()


def drawn(space: Any) -> Layout:
    """What the panel draws in the editor."""
    from addon.light_mix_panel import NEURALGUIDE_PT_light_mix

    context = SimpleNamespace(
        space_data=space, scene=bpy.context.scene, view_layer=bpy.context.view_layer, engine="BLENDER_EEVEE",
        region=None, preferences=bpy.context.preferences,
    )  # fmt: skip
    assert NEURALGUIDE_PT_light_mix.poll(context)
    layout = Layout()
    NEURALGUIDE_PT_light_mix.draw_header(SimpleNamespace(layout=layout), context)
    NEURALGUIDE_PT_light_mix.draw(SimpleNamespace(layout=layout), context)
    return layout


def expected(path: Path, factors: dict[str, Any]) -> np.ndarray:
    """The mix of the file, row 0 at the bottom."""
    lights = {group: read_exr(path, f"Combined_{group}")[0][..., :3] for group in ROOM_GROUPS}
    return (0.5 + sum(light * np.float32(factors[group]) for group, light in lights.items()))[::-1]


def check_shown(space: Any, path: Path, factors: dict[str, Any]) -> None:
    assert space.image.name == "Light Mix of room.exr"
    pixels = pixels_of(space.image)
    np.testing.assert_allclose(pixels[..., :3], expected(path, factors), rtol=1e-5, atol=1e-5)
    assert (pixels[..., 3] == 1.0).all()


def test_a_file_is_shown_by_its_own_mix_and_then_by_each_change(space: Any, path: Path) -> None:
    file = space.image
    assert drawn(space).operators == ["neuralguide.mix_file"]
    assert run(space, "mix_file") == {"FINISHED"}
    assert light_mix.factors_of(file) == {group: pytest.approx(factor) for group, factor in MIX.items()}
    check_shown(space, path, MIX)
    entries = file.neuralguide.light_mix
    assert not entries[KEY].is_on
    entries[KEY].is_on = True
    entries[KEY].strength = 4.0
    check_shown(space, path, MIX | {KEY: [4.0] * 3})
    layout = drawn(space)
    assert layout.operators == ["neuralguide.reset_light_mix", "neuralguide.save_file_mix"]
    assert {KEY, ODD} <= {*layout.texts}
    file.neuralguide.use_light_mix = False
    assert space.image == file
    file.neuralguide.use_light_mix = True
    assert run(space, "reset_light_mix") == {"FINISHED"}
    check_shown(space, path, dict.fromkeys(ROOM_GROUPS, [1.0] * 3))


def test_the_scene_keeps_its_own_factors(space: Any, path: Path) -> None:
    scene = bpy.context.scene
    light_mix.add_missing(scene, [KEY])
    scene.neuralguide.light_mix[KEY].strength = 7.0
    run(space, "mix_file")
    run(space, "reset_light_mix")
    assert light_mix.factors_of(scene) == {KEY: (7.0,) * 3}
    check_shown(space, path, dict.fromkeys(ROOM_GROUPS, [1.0] * 3))


def test_the_mix_is_saved_as_metadata_and_the_picture_stays(space: Any, path: Path) -> None:
    """A sequence can be mixed by it, and opening the file again begins with it."""
    before = {name: read_exr(path, name)[0] for name in ("Combined", f"Combined_{KEY}", "Index")}
    run(space, "mix_file")
    entry = space_file(space).neuralguide.light_mix[KEY]
    entry.is_on, entry.strength = True, 3.0
    assert run(space, "save_file_mix") == {"FINISHED"}
    header = read_exr(path)[1]
    assert json.loads(header[light_mix.FIELD]) == MIX | {KEY: [3.0] * 3}
    assert header["Scene"] == "Room"
    assert all(np.array_equal(read_exr(path, name)[0], image) for name, image in before.items())
    bpy.ops.neuralguide.mix_sequence(filepath=str(path), source="FILES")
    mixed = read_exr(path.parent / "mixed" / path.name)[0][::-1, :, :3]
    np.testing.assert_allclose(mixed, pixels_of(space.image)[..., :3], rtol=1e-5, atol=1e-5)
    space.image = drawn_image(bpy.data.images.load(str(path)))
    run(space, "mix_file")
    assert light_mix.factors_of(space_file(space))[KEY] == (3.0,) * 3


def space_file(space: Any) -> Any:
    image = light_mix_files.shown_file(space.image)
    assert image is not None
    return image


def test_factors_are_kept_in_the_blend_and_count_before_those_of_the_file(
    space: Any, path: Path, tmp_path: Path
) -> None:
    run(space, "mix_file")
    space_file(space).neuralguide.light_mix[ODD].strength = 5.0
    space_file(space).use_fake_user = True
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "f.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "f.blend"))
    space = image_editor(drawn_image(bpy.data.images["room.exr"]))
    assert drawn(space).operators == ["neuralguide.mix_file"]
    run(space, "mix_file")
    check_shown(space, path, {KEY: [0.0] * 3, ODD: [2.5, 1.25, 5.0]})


def test_undoing_brings_factors_and_the_picture_back(space: Any, path: Path) -> None:
    run(space, "mix_file")
    bpy.ops.ed.undo_push(message="before")
    space_file(space).neuralguide.light_mix[KEY].is_on = True
    bpy.ops.ed.undo_push(message="mixed")
    bpy.ops.ed.undo()
    image = bpy.data.images["Light Mix of room.exr"]
    np.testing.assert_allclose(pixels_of(image)[..., :3], expected(path, MIX), rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize(
    ("spoil", "sentence"),
    [
        (lambda path: write_frame(path, 1, ()), "has no light groups"),
        (lambda path: write_frame(path, 1, **{light_mix.APPLIED_FIELD: "{}"}), "is mixed already"),
        (lambda path: write_frame(path, 1, mix="[1]"), "its light mix is none"),
        (lambda path: write_frame(path, 1, mix={KEY: [1, -2, 1]}), "the factor 1, -2, 1 is negative"),
        (lambda path: path.unlink(), "there is no file"),
        (lambda path: path.write_bytes(path.read_bytes()[:400]), "room.exr"),
    ],
)
def test_what_cannot_be_mixed_is_said(spoil: Any, sentence: str, space: Any, path: Path) -> None:
    spoil(path)
    with pytest.raises(RuntimeError, match="Error") as caught:
        run(space, "mix_file")
    assert sentence in str(caught.value)
    assert "Traceback" not in str(caught.value)
    assert space.image.name == "room.exr"


def test_a_sequence_is_sent_to_its_operator(space: Any) -> None:
    space.image.source = "SEQUENCE"
    with pytest.raises(RuntimeError, match="choose Render > Mix Lights of a Sequence of Frames"):
        run(space, "mix_file")


def test_a_file_that_is_gone_cannot_take_the_mix(space: Any, path: Path) -> None:
    run(space, "mix_file")
    path.unlink()
    with pytest.raises(RuntimeError, match="cannot be written: No such file"):
        run(space, "save_file_mix")


def test_long_names_are_no_obstacle(blender: Any, tmp_path: Path) -> None:
    path = tmp_path / f"{'room' * 14}.exr"
    write_frame(path, 1)
    space = image_editor(drawn_image(blender.data.images.load(str(path))))
    run(space, "mix_file")
    space_file(space).neuralguide.light_mix[KEY].strength = 2.0
    factors = {KEY: [2.0] * 3, ODD: [1.0] * 3}
    np.testing.assert_allclose(pixels_of(space.image)[..., :3], expected(path, factors), rtol=1e-5, atol=1e-5)
    light_mix_files.forget()
