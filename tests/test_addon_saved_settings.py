# SPDX-License-Identifier: GPL-3.0-or-later
"""Files saved before scenes could follow Cycles keep their pictures; others follow it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest


def settings_of(scene: Any) -> Any:
    from addon.properties import render_settings

    return render_settings(scene)


def save_as_before(blender: Any, path: Path) -> None:
    """Save as the version did that knew nothing of following Cycles."""
    from addon import saved_settings

    handlers = blender.app.handlers.save_pre
    handlers.remove(saved_settings._mark)
    try:
        blender.ops.wm.save_as_mainfile(filepath=str(path))
    finally:
        handlers.append(saved_settings._mark)


def reopen(blender: Any, path: Path) -> Any:
    blender.ops.wm.open_mainfile(filepath=str(path))
    return blender.context.scene


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
    assert settings.max_bounces == (7 if name == "max_bounces" else 12)
    # Saved and opened again it is the same.
    blender.ops.wm.save_as_mainfile(filepath=str(tmp_path / "new.blend"))
    assert settings_of(reopen(blender, tmp_path / "new.blend")) == settings


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
