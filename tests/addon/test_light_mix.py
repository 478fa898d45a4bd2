# SPDX-License-Identifier: GPL-3.0-or-later
"""The light mix in Blender: what renders leave for it, the image that shows it, and what files say of it."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from addon import light_mix, light_mix_passes, light_mix_picture
from benchmarks.images import read_exr
from engine.denoise import library
from tests.helpers.bake_scenes import pixels_of
from tests.helpers.fake_engine import FakeEngine
from tests.helpers.image_editors import image_editor
from tests.helpers.light_groups import grouped, keyframe
from tests.helpers.panel_layout import Layout
from tests.helpers.pass_files import ask_for_passes, render_passes

GROUPS = ["Key", "Glow", "Sky"]


@pytest.fixture(autouse=True)
def _somebody_looks(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Renders keep their groups, as in a window."""
    monkeypatch.setattr(light_mix_passes, "keeps_passes", True)
    yield
    light_mix_picture.forget()


@pytest.fixture
def scene(cube_scene: Any) -> Any:
    """The scene with three groups, to be saved with their passes."""
    grouped(cube_scene)
    ask_for_passes(cube_scene)
    cube_scene.cycles.use_denoising = False
    return cube_scene


@pytest.fixture
def passes(monkeypatch: pytest.MonkeyPatch) -> dict[str, np.ndarray]:
    """What renders of 32 x 16 pixels give: the picture, and the light of three groups, whose sum it is."""
    rng = np.random.default_rng(5)
    pictures = {f"Combined_{group}": rng.random((16, 32, 3), np.float32) for group in GROUPS}
    pictures["Combined"] = np.ones((16, 32, 4), np.float32)
    pictures["Combined"][..., :3] = sum(pictures[f"Combined_{group}"] for group in GROUPS)
    FakeEngine(monkeypatch).pictures = pictures
    return pictures


@pytest.fixture
def rendered(scene: Any, passes: dict[str, np.ndarray]) -> tuple[Any, dict[str, np.ndarray]]:
    """The scene, rendered, and its passes."""
    import bpy

    bpy.ops.render.render()
    return scene, passes


def shown(scene: Any, layer: Any = None) -> np.ndarray:
    """Pixels of the image that shows the mix."""
    image = light_mix_picture.image_of(scene, layer or scene.view_layers[0])
    assert image is not None
    return pixels_of(image)


def test_a_render_gives_each_group_a_factor_of_one_and_makes_no_image(rendered: Any) -> None:
    scene, _ = rendered
    assert light_mix_picture.rendered_groups(scene) == GROUPS
    assert light_mix.factors_of(scene) == dict.fromkeys(GROUPS, light_mix.NEUTRAL)
    assert light_mix_picture.image_of(scene, scene.view_layers[0]) is None


def test_a_change_of_a_factor_changes_the_shown_picture_at_once(rendered: Any) -> None:
    scene, passes = rendered
    mix = scene.neuralguide.light_mix
    mix["Key"].strength, mix["Key"].color = 3.0, (1.0, 0.5, 0.0)
    mix["Sky"].is_on = False
    expected = passes["Combined"].copy()
    expected[..., :3] = passes["Combined_Key"] * np.float32([3.0, 1.5, 0.0]) + passes["Combined_Glow"]
    np.testing.assert_allclose(shown(scene), expected, rtol=1e-4, atol=1e-5)
    image = light_mix_picture.image_of(scene, scene.view_layers[0])
    mix["Key"].property_unset("color")
    mix["Key"].strength = 1.0
    mix["Sky"].is_on = True
    assert np.array_equal(shown(scene), passes["Combined"])
    assert light_mix_picture.image_of(scene, scene.view_layers[0]) == image


def test_the_next_render_is_shown_by_the_mix_that_there_is(rendered: Any) -> None:
    scene, passes = rendered
    scene.neuralguide.light_mix["Glow"].strength = 0.0
    import bpy

    passes["Combined_Glow"] = passes["Combined_Glow"] * np.float32(0.5)
    bpy.ops.render.render()
    np.testing.assert_allclose(
        shown(scene)[..., :3], passes["Combined"][..., :3] - passes["Combined_Glow"], rtol=1e-4, atol=1e-5
    )
    passes["Combined"] = passes["Combined"][:, :16]
    passes |= {name: image[:, :16] for name, image in passes.items()}
    scene.render.resolution_x = 16
    bpy.ops.render.render()
    assert shown(scene).shape == (16, 16, 4)


def test_a_border_is_where_the_render_result_has_it(scene: Any, passes: dict[str, np.ndarray]) -> None:
    import bpy

    render = scene.render
    render.use_border, render.border_min_x, render.border_max_x = True, 0.5, 1.0
    render.border_min_y, render.border_max_y = 0.25, 1.0
    bpy.ops.render.render()
    scene.neuralguide.light_mix["Key"].strength = 2.0
    pixels = shown(scene)
    assert pixels.shape == (16, 32, 4)
    assert not pixels[:, :16].any()
    assert not pixels[:4].any()
    assert pixels[4:, 16:, 3].all()


@pytest.mark.parametrize("somebody_looks", [True, False])
def test_files_keep_what_was_rendered_and_say_the_mix_of_their_frame(
    somebody_looks: bool, scene: Any, passes: dict[str, np.ndarray], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An animated factor is that of the frame."""
    import bpy

    monkeypatch.setattr(light_mix_passes, "keeps_passes", somebody_looks)
    light_mix.add_missing(scene, GROUPS)
    scene.neuralguide.light_mix["Sky"].color = (0.5, 0.25, 1.0)
    keyframe(scene, "Key", {1: 1.0, 3: 5.0})
    scene.render.filepath = str(tmp_path / "f####")
    scene.frame_start, scene.frame_end = 2, 3
    bpy.ops.render.render(animation=True)
    for frame, strength in ((2, 3.0), (3, 5.0)):
        picture, header = read_exr(tmp_path / f"f{frame:04}.exr")
        said = json.loads(header[light_mix.FIELD])
        assert said == {"Key": [strength] * 3, "Glow": [1.0] * 3, "Sky": [0.5, 0.25, 1.0]}
        assert np.array_equal(picture[::-1], passes["Combined"])
        for group in GROUPS:
            light = read_exr(tmp_path / f"f{frame:04}.exr", f"Combined_{group}")[0]
            assert np.array_equal(light[::-1], passes[f"Combined_{group}"])
    assert bool(light_mix_picture.rendered_groups(scene)) == somebody_looks


def test_factors_are_kept_in_the_file(rendered: Any, tmp_path: Path) -> None:
    import bpy

    scene, _ = rendered
    mix = scene.neuralguide.light_mix
    mix["Key"].strength, mix["Glow"].is_on, mix["Sky"].color = 2.5, False, (0.25, 0.5, 1.0)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "f.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "f.blend"))
    scene = bpy.context.scene
    assert light_mix.factors_of(scene) == {"Key": (2.5,) * 3, "Glow": (0.0,) * 3, "Sky": (0.25, 0.5, 1.0)}
    assert light_mix_picture.rendered_groups(scene) == []


def test_a_render_without_groups_leaves_nothing_and_a_mix_of_others_is_left_alone(
    cube_scene: Any, passes: dict[str, np.ndarray]
) -> None:
    """And the panel says so."""
    import bpy

    from addon.light_mix_panel import NEURALGUIDE_PT_light_mix

    light_mix.add_missing(cube_scene, ["Gone"])
    cube_scene.neuralguide.light_mix["Gone"].strength = 4.0
    bpy.ops.render.render()
    assert light_mix_picture.rendered_groups(cube_scene) == []
    assert light_mix_picture.image_of(cube_scene, cube_scene.view_layers[0]) is None
    layout = Layout()
    NEURALGUIDE_PT_light_mix.draw(SimpleNamespace(layout=layout), bpy.context)
    assert "No light groups were rendered" in " ".join(layout.texts)


def test_a_mix_that_cannot_be_made_leaves_the_image_and_the_panel_says_why(rendered: Any) -> None:
    import bpy

    from addon.light_mix_panel import NEURALGUIDE_PT_light_mix

    scene, _ = rendered
    mix = scene.neuralguide.light_mix
    mix["Key"].strength = 2.0
    before = shown(scene)
    mix["Key"].strength = 3e38
    mix["Key"].color = (9.0, 1.0, 1.0)
    layout = Layout()
    NEURALGUIDE_PT_light_mix.draw(SimpleNamespace(layout=layout), bpy.context)
    assert "light group Key: the factor 2.7e+39, 3e+38, 3e+38 is NaN or too large" in " ".join(layout.texts)
    assert np.isfinite(shown(scene)).all()
    mix["Key"].color, mix["Key"].strength = (1.0, 1.0, 1.0), 2.0
    assert np.array_equal(shown(scene), before)
    layout = Layout()
    NEURALGUIDE_PT_light_mix.draw(SimpleNamespace(layout=layout), bpy.context)
    assert "too large" not in " ".join(layout.texts)


def test_reset_forgets_groups_that_the_layer_has_not(rendered: Any) -> None:
    import bpy

    scene, passes = rendered
    light_mix.add_missing(scene, ["Gone"])
    scene.neuralguide.light_mix["Key"].strength = 4.0
    assert bpy.ops.neuralguide.reset_light_mix() == {"FINISHED"}
    assert light_mix.factors_of(scene) == dict.fromkeys(GROUPS, light_mix.NEUTRAL)
    assert np.array_equal(shown(scene), passes["Combined"])


def test_a_transparent_film_has_no_background_in_the_mix(scene: Any, passes: dict[str, np.ndarray]) -> None:
    """The world's group has it beside the pass Environment, and so would the mix."""
    import bpy

    scene.render.film_transparent = True
    passes["Environment"] = np.full((16, 32, 3), 0.5, np.float32)
    passes["Combined_Sky"] = passes["Combined_Sky"] + passes["Environment"]
    bpy.ops.render.render()
    scene.neuralguide.light_mix["Sky"].strength = 3.0
    expected = passes["Combined"][..., :3] + 2.0 * (passes["Combined_Sky"] - passes["Environment"])
    np.testing.assert_allclose(shown(scene)[..., :3], expected, rtol=1e-4, atol=1e-5)


def test_the_render_after_writing_back_shows_what_the_mix_has_shown(scene: Any, tmp_path: Path) -> None:
    """All groups by the same factor, so that lamps are picked by the same chances, and none is left out as too dim."""
    import bpy

    scene.cycles.light_sampling_threshold = 0.0
    render_passes(scene, tmp_path / "before.exr", [])
    for entry in scene.neuralguide.light_mix:
        entry.strength, entry.color = 0.5, (1.0, 0.5, 0.25)
    mix = shown(scene)
    assert bpy.ops.neuralguide.write_light_mix() == {"FINISHED"}
    assert light_mix.factors_of(scene) == dict.fromkeys(GROUPS, light_mix.NEUTRAL)
    assert np.array_equal(shown(scene), mix)
    after = render_passes(scene, tmp_path / "after.exr", ["Combined"])["Combined"][::-1]
    assert after[..., :3].mean() > 1e-3
    np.testing.assert_allclose(after, mix, rtol=1e-3, atol=1e-5)
    assert np.array_equal(shown(scene), after)


@pytest.mark.skipif(bool(library.problem()), reason="no Open Image Denoise here")
def test_a_denoised_picture_is_mixed_by_groups_that_are_denoised(scene: Any, passes: dict[str, np.ndarray]) -> None:
    """Without noise of its groups, and as it was with factors of 1."""
    import bpy

    rng = np.random.default_rng(4)
    scene.cycles.use_denoising = True
    for name, level in (("Combined_Key", 2.0), ("Combined_Glow", 0.5), ("Combined_Sky", 0.0)):
        passes[name] = np.float32(level * rng.gamma(4.0, 0.25, (16, 32, 3)))
    passes["Noisy Image"] = np.ones((16, 32, 4), np.float32)
    passes["Noisy Image"][..., :3] = sum(passes[f"Combined_{group}"] for group in GROUPS)
    passes["Combined"] = np.full((16, 32, 4), 2.5, np.float32)
    passes["Combined"][..., 3] = 1.0
    bpy.ops.render.render()
    key = scene.neuralguide.light_mix["Key"]
    key.is_on = False
    assert shown(scene)[..., :3].mean() == pytest.approx(0.5, rel=0.1)
    assert shown(scene)[..., :3].std() < 0.3 * passes["Combined_Glow"].std()
    key.is_on = True
    assert np.array_equal(shown(scene), passes["Combined"])


def test_image_editors_that_show_the_render_result_show_the_mix(rendered: Any) -> None:
    """And the render again once the mix is switched off; one that shows something else keeps that."""
    import bpy

    scene, _ = rendered
    result = bpy.data.images["Render Result"]
    space = image_editor(result)
    scene.neuralguide.light_mix["Key"].strength = 2.0
    mix = light_mix_picture.image_of(scene, scene.view_layers[0])
    assert space.image == mix
    scene.neuralguide.use_light_mix = False
    assert space.image == result
    scene.neuralguide.use_light_mix = True
    assert space.image == mix
    space.image = other = bpy.data.images.new("Other", 4, 4)
    scene.neuralguide.light_mix["Key"].strength = 3.0
    assert space.image == other


def test_undoing_brings_factors_lamps_and_the_picture_back(rendered: Any) -> None:
    import bpy

    scene, _ = rendered
    space = image_editor(bpy.data.images["Render Result"])
    bpy.ops.ed.undo_push(message="before")
    scene.neuralguide.light_mix["Key"].strength = 2.0
    bpy.ops.ed.undo_push(message="mixed")
    mix = shown(scene)
    bpy.ops.neuralguide.write_light_mix()
    bpy.ops.ed.undo_push(message="written")
    assert bpy.context.scene.objects["Sun"].data.energy == pytest.approx(6.0)
    bpy.ops.ed.undo()
    scene = bpy.context.scene
    assert scene.objects["Sun"].data.energy == pytest.approx(3.0)
    assert light_mix.shown_factors(scene)["Key"] == light_mix.factors_of(scene)["Key"] == (2.0, 2.0, 2.0)
    assert np.array_equal(shown(scene), mix)
    bpy.ops.ed.undo()
    scene = bpy.context.scene
    assert light_mix.factors_of(scene)["Key"] == light_mix.NEUTRAL
    assert light_mix_picture.image_of(scene, scene.view_layers[0]) is None
    assert space.image == bpy.data.images["Render Result"]


@pytest.fixture
def while_it_renders(scene: Any, passes: dict[str, np.ndarray], monkeypatch: pytest.MonkeyPatch) -> Any:
    """Renders, and calls a function after the first picture; what comes then is twice as bright."""
    import bpy

    def render(work: Any) -> None:
        fake = FakeEngine(monkeypatch)
        fake.pictures = dict(passes)

        def during(_fake: FakeEngine) -> None:
            work()
            fake.pictures = {name: image * np.float32(2.0) for name, image in passes.items()}
            fake.pictures["Combined"][..., 3] = 1.0

        fake.during_render = during
        bpy.ops.render.render()

    return render


def test_a_change_while_it_renders_changes_what_there_is_so_far(while_it_renders: Any, scene: Any, passes: Any) -> None:
    """At once, in the editor that shows the render; and the finished picture has the same mix."""
    import bpy

    expected = passes["Combined"][..., :3] - passes["Combined_Key"]
    seen = []

    def work() -> None:
        space = image_editor(bpy.data.images["Render Result"])
        assert light_mix_picture.rendered_groups(scene) == GROUPS
        scene.neuralguide.light_mix["Key"].is_on = False
        seen.append(shown(scene)[..., :3])
        assert space.image == light_mix_picture.image_of(scene, scene.view_layers[0])

    while_it_renders(work)
    np.testing.assert_allclose(seen[0], expected, rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(shown(scene)[..., :3], 2.0 * expected, rtol=1e-4, atol=1e-5)


def test_the_mix_that_there_is_shows_the_first_samples(while_it_renders: Any, scene: Any, passes: Any) -> None:
    light_mix.add_missing(scene, GROUPS)
    scene.neuralguide.light_mix["Sky"].strength = 3.0
    seen: list[np.ndarray] = []
    while_it_renders(lambda: seen.append(shown(scene)[..., :3]))
    expected = passes["Combined"][..., :3] + 2.0 * passes["Combined_Sky"]
    np.testing.assert_allclose(seen[0], expected, rtol=1e-4, atol=1e-5)


def test_what_is_written_back_while_it_renders_is_not_taken_for_rendered(
    while_it_renders: Any, scene: Any, passes: Any
) -> None:
    """The lamps were read before: the finished picture still needs the factor that is in them now."""
    import bpy

    def work() -> None:
        scene.neuralguide.light_mix["Key"].strength = 3.0
        assert bpy.ops.neuralguide.write_light_mix() == {"FINISHED"}

    while_it_renders(work)
    assert light_mix.factors_of(scene)["Key"] == light_mix.NEUTRAL
    expected = 2.0 * (passes["Combined"][..., :3] + 2.0 * passes["Combined_Key"])
    np.testing.assert_allclose(shown(scene)[..., :3], expected, rtol=1e-4, atol=1e-5)
