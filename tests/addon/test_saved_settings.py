# SPDX-License-Identifier: GPL-3.0-or-later
"""Old files keep what they had: settings that have moved, and whose settings counted."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from tests.helpers.motion_scenes import curves_of


def settings_of(scene: Any) -> Any:
    from addon.properties import render_settings

    return render_settings(scene)


def save_as_before(blender: Any, path: Path) -> None:
    """Save as the version did that knew nothing of following Cycles."""
    from addon import saved_settings

    handlers = blender.app.handlers.save_pre
    ours = [handler for handler in handlers if handler.__module__ == saved_settings.__name__]
    assert len(ours) == 1
    handlers.remove(ours[0])
    try:
        blender.ops.wm.save_as_mainfile(filepath=str(path))
    finally:
        handlers.append(ours[0])


def reopen(blender: Any, path: Path) -> Any:
    blender.ops.wm.open_mainfile(filepath=str(path))
    return blender.context.scene


def store(scene: Any, **values: Any) -> None:
    """Give `scene.neuralguide` properties that the add-on does not know there, as older versions have left them."""
    scene.neuralguide.samples = 7  # so that there is a group
    holder = scene.bl_system_properties_get() if hasattr(scene, "bl_system_properties_get") else scene
    for name, value in values.items():
        holder["neuralguide"][name] = value


#: As the version before held them, choices by number; `orca_error` is there no more.
FLAT = {
    "strata": 8, "mixture_u": 2, "guiding_probability": 0.25, "use_nee": 0, "network_size": 1, "orca_error": 1,
    "use_cycles_settings": 1,
}  # fmt: skip


def check_moved(scene: Any) -> None:
    experiment, settings = scene.neuralguide.experiment, settings_of(scene)
    for name, value in {
        "strata": 8, "mixture_u": "PLANES", "guiding_probability": 0.25, "use_nee": False, "network_size": "PAPER",
    }.items():  # fmt: skip
        assert getattr(experiment, name) == getattr(settings, name) == value
    assert not experiment.is_property_set("candidate_count")
    assert scene.neuralguide.use_cycles_settings and settings.samples == 7


def test_settings_for_experiments_move_to_their_group(blender: Any, tmp_path: Path) -> None:
    store(blender.context.scene, **FLAT)
    save_as_before(blender, tmp_path / "old.blend")
    check_moved(reopen(blender, tmp_path / "old.blend"))
    # Saved and opened again it is the same, and what is set then is not undone.
    blender.context.scene.neuralguide.experiment.candidate_count = 3
    blender.ops.wm.save_as_mainfile(filepath=str(tmp_path / "new.blend"))
    scene = reopen(blender, tmp_path / "new.blend")
    assert scene.neuralguide.experiment.candidate_count == 3
    scene.neuralguide.experiment.property_unset("candidate_count")
    check_moved(scene)


@pytest.mark.parametrize(("stored", "name"), [(0, "OFF"), (1, "FAST")])
def test_the_radiance_cache_keeps_what_it_was_as_a_switch(
    stored: int, name: str, blender: Any, tmp_path: Path
) -> None:
    """Switched on it was biased, as `FAST` is."""
    store(blender.context.scene, radiance_cache=stored, use_cycles_settings=1)
    save_as_before(blender, tmp_path / "old.blend")
    scene = reopen(blender, tmp_path / "old.blend")
    assert scene.neuralguide.radiance_cache == settings_of(scene).radiance_cache == name


@pytest.mark.parametrize("is_linked", [False, True])
def test_imported_scenes_have_their_experiments_moved(is_linked: bool, blender: Any, tmp_path: Path) -> None:
    if not hasattr(blender.app.handlers, "blend_import_post"):
        pytest.skip("this Blender does not tell of imported data")
    blender.context.scene.name = "Old"
    store(blender.context.scene, **FLAT)
    save_as_before(blender, tmp_path / "old.blend")
    blender.ops.wm.read_homefile(use_empty=True)
    bring = blender.ops.wm.link if is_linked else blender.ops.wm.append
    bring(directory=str(tmp_path / "old.blend" / "Scene"), filename="Old")
    check_moved(blender.data.scenes["Old"])


def test_animation_of_settings_for_experiments_moves_along(blender: Any, tmp_path: Path) -> None:
    scene = blender.context.scene
    for frame, alpha in ((1, 0.25), (11, 0.75)):
        scene.neuralguide.experiment.defensive_alpha = alpha
        scene.neuralguide.experiment.keyframe_insert("defensive_alpha", frame=frame)
    scene.neuralguide.experiment.driver_add("candidate_count").driver.expression = "frame"
    for curve in [*curves_of(scene), *scene.animation_data.drivers]:
        curve.data_path = curve.data_path.replace(".experiment", "")
    store(scene, defensive_alpha=0.75)
    save_as_before(blender, tmp_path / "old.blend")
    scene = reopen(blender, tmp_path / "old.blend")
    for frame, alpha in ((1, 0.25), (11, 0.75)):
        scene.frame_set(frame)
        assert settings_of(scene).defensive_alpha == pytest.approx(alpha)
        assert settings_of(scene).candidate_count == frame


@pytest.mark.parametrize("name", ["strata", "orca_error"])
def test_an_experiment_alone_tells_a_file_from_before(name: str, blender: Any, tmp_path: Path) -> None:
    """It was saved before scenes could follow Cycles, by a version that had the setting."""
    scene = blender.context.scene
    store(scene, **{name: 1})
    scene.neuralguide.property_unset("samples")
    save_as_before(blender, tmp_path / "old.blend")
    scene = reopen(blender, tmp_path / "old.blend")
    assert not scene.neuralguide.use_cycles_settings and settings_of(scene).samples == 128


@pytest.mark.parametrize("name", ["max_bounces", "guiding_method"])
def test_a_file_from_before_keeps_its_picture(name: str, blender: Any, tmp_path: Path) -> None:
    scene = blender.context.scene
    setattr(scene.neuralguide, name, {"max_bounces": 7, "guiding_method": "VMM"}[name])
    scene.cycles.max_bounces, scene.cycles.diffuse_bounces, scene.cycles.samples = 64, 64, 1000
    save_as_before(blender, tmp_path / "old.blend")
    scene = reopen(blender, tmp_path / "old.blend")
    settings = settings_of(scene)
    assert not scene.neuralguide.use_cycles_settings
    assert (settings.samples, settings.clamp_indirect, settings.diffuse_bounces) == (128, 0.0, 4)
    assert not settings.use_adaptive_sampling
    assert settings.max_bounces == (7 if name == "max_bounces" else 12)
    # Saved and opened again it is the same.
    blender.ops.wm.save_as_mainfile(filepath=str(tmp_path / "new.blend"))
    assert settings_of(reopen(blender, tmp_path / "new.blend")) == settings


def test_a_file_that_said_nothing_of_accuracy_stays_unbiased(blender: Any, tmp_path: Path) -> None:
    """It follows Cycles, has settings of ours, and was saved when all pictures were unbiased."""
    scene = blender.context.scene
    assert settings_of(scene).radiance_cache == "AUTO"
    scene.neuralguide.samples, scene.neuralguide.use_cycles_settings = 7, True
    save_as_before(blender, tmp_path / "old.blend")
    scene = reopen(blender, tmp_path / "old.blend")
    assert scene.neuralguide.use_cycles_settings and settings_of(scene).radiance_cache == "OFF"
    blender.ops.wm.save_as_mainfile(filepath=str(tmp_path / "new.blend"))
    assert settings_of(reopen(blender, tmp_path / "new.blend")).radiance_cache == "OFF"


@pytest.mark.parametrize("name", ["AUTO", "OFF", "CONVERGING"])
def test_a_file_of_today_has_the_accuracy_that_it_was_saved_with(name: str, blender: Any, tmp_path: Path) -> None:
    scene = blender.context.scene
    scene.neuralguide.samples = 7
    if name != "AUTO":
        scene.neuralguide.radiance_cache = name
    blender.ops.wm.save_as_mainfile(filepath=str(tmp_path / "new.blend"))
    assert settings_of(reopen(blender, tmp_path / "new.blend")).radiance_cache == name


def test_a_file_without_settings_of_ours_follows_cycles(blender: Any, tmp_path: Path) -> None:
    scene = blender.context.scene
    scene.render.engine = "NEURALGUIDE"
    scene.cycles.max_bounces = 64
    save_as_before(blender, tmp_path / "old.blend")
    scene = reopen(blender, tmp_path / "old.blend")
    assert scene.neuralguide.use_cycles_settings and not scene.neuralguide.is_property_set("use_cycles_settings")
    assert settings_of(scene).max_bounces == 64


def test_a_file_of_today_keeps_what_a_script_has_set_and_follows_cycles_else(blender: Any, tmp_path: Path) -> None:
    scene = blender.context.scene
    scene.neuralguide.samples = 7
    blender.ops.wm.save_as_mainfile(filepath=str(tmp_path / "new.blend"))
    scene = reopen(blender, tmp_path / "new.blend")
    scene.cycles.max_bounces = 64
    assert (settings_of(scene).samples, settings_of(scene).max_bounces) == (7, 64)


def test_the_add_on_enabled_again_takes_no_scene_for_an_old_one(blender: Any) -> None:
    import addon

    scene = blender.context.scene
    scene.neuralguide.samples = 7
    addon.unregister()
    addon.register()
    assert scene.neuralguide.use_cycles_settings


def test_an_old_file_that_is_open_already_is_seen_when_the_add_on_comes(blender: Any, tmp_path: Path) -> None:
    import addon

    blender.context.scene.neuralguide.samples = 7
    save_as_before(blender, tmp_path / "old.blend")
    addon.unregister()
    blender.ops.wm.open_mainfile(filepath=str(tmp_path / "old.blend"))
    addon.register()
    assert not blender.context.scene.neuralguide.use_cycles_settings


def test_an_appended_scene_of_an_old_file_keeps_its_picture(blender: Any, tmp_path: Path) -> None:
    if not hasattr(blender.app.handlers, "blend_import_post"):
        pytest.skip("this Blender does not tell of imported data")
    blender.context.scene.name = "Old"
    blender.context.scene.neuralguide.max_bounces = 7
    save_as_before(blender, tmp_path / "old.blend")
    blender.ops.wm.read_homefile(use_empty=True)
    blender.context.scene.neuralguide.samples = 5
    blender.ops.wm.append(directory=str(tmp_path / "old.blend" / "Scene"), filename="Old")
    assert not blender.data.scenes["Old"].neuralguide.use_cycles_settings
    assert blender.context.scene.neuralguide.use_cycles_settings
