# SPDX-License-Identifier: GPL-3.0-or-later
"""Motion blur through Blender's own render loop: the engine moves the time, and frames follow each other as ever."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.helpers.fake_engine import FakeEngine
from tests.helpers.motion_scenes import keyframe, open_shutter


@pytest.fixture
def exported(monkeypatch: Any) -> list[Any]:
    """Descriptions that the real exporter gave to a session that renders nothing."""
    import addon.export

    real = sys.modules["addon.export"]
    FakeEngine(monkeypatch)
    monkeypatch.setitem(sys.modules, "addon.export", real)
    descriptions: list[Any] = []
    export_scene = addon.export.export_scene

    def export(*arguments: Any, **options: Any) -> Any:
        descriptions.append(export_scene(*arguments, **options))
        return descriptions[-1]

    monkeypatch.setattr(real, "export_scene", export)
    return descriptions


@pytest.fixture
def moving_scene(cube_scene: Any) -> Any:
    """A cube that a driver moves by a metre a frame, and that gets taller by a shape key."""
    cube = cube_scene.objects["Cube"]
    cube.driver_add("location", 0).driver.expression = "max(frame, 0) if frame == frame else 0"
    cube.shape_key_add(name="Basis")
    tall = cube.shape_key_add(name="Tall")
    for point in tall.data:
        point.co.z *= 3.0
    keyframe(tall, "value", {0: 0.0, 20: 1.0})
    open_shutter(cube_scene, 0.5)
    cube_scene.frame_start, cube_scene.frame_end = 5, 7
    return cube_scene


def outcomes() -> list[str]:
    from addon import engine

    return [item.status for item in engine.outcomes]


@pytest.mark.parametrize("is_persistent", [False, True])
@pytest.mark.parametrize("position", ["START", "CENTER"])
def test_an_animation(
    moving_scene: Any, exported: list[Any], tmp_path: Path, position: str, is_persistent: bool
) -> None:
    import bpy

    moving_scene.render.use_persistent_data = is_persistent
    open_shutter(moving_scene, 0.5, position)
    moving_scene.render.filepath = str(tmp_path / "image")
    bpy.ops.render.render(animation=True)
    assert outcomes() == ["FINISHED"] * 3
    offset = 0.25 if position == "START" else 0.0
    for frame, description in zip((5, 6, 7), exported, strict=True):
        assert description.frame_current == frame
        times = frame + offset + np.array([-0.25, 0.0, 0.25])
        assert description.shutter == (times[0], times[2])
        np.testing.assert_allclose(description.instances.motion[0][:, 0, 3], times, rtol=1e-6)
        heights = description.meshes[0].motion_vertices[:, :, 2].max(axis=1)
        np.testing.assert_allclose(heights, 1.0 + times / 10.0, rtol=1e-5)
    assert len({description.meshes[0].key for description in exported}) == 3


def test_persistent_data_is_looked_at_again_after_motion_blur(
    moving_scene: Any, exported: list[Any], tmp_path: Path
) -> None:
    import bpy

    moving_scene.render.use_persistent_data = True
    moving_scene.render.filepath = str(tmp_path / "image.exr")
    heights = []
    for is_blurred in (False, True, False, False):
        moving_scene.render.use_motion_blur = is_blurred
        moving_scene.frame_set(moving_scene.frame_current + 1)
        bpy.ops.render.render()
        heights.append(float(exported[-1].meshes[0].vertices[:, 2].max()))
        assert (exported[-1].meshes[0].motion_vertices is not None) == is_blurred
    first = moving_scene.frame_current - 3
    np.testing.assert_allclose(heights, [1.0 + (first + i) / 10.0 for i in range(4)], rtol=1e-5)


def test_cancelling_leaves_the_frame(
    moving_scene: Any, exported: list[Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import bpy

    from addon import engine

    moving_scene.frame_set(6)
    moving_scene.render.filepath = str(tmp_path / "image.exr")
    times: list[float] = []

    def stop() -> bool:
        times.append(moving_scene.frame_current + moving_scene.frame_subframe)
        return times[-1] != 6.0

    monkeypatch.setattr(engine, "cancel_hooks", [stop])
    bpy.ops.render.render()
    assert outcomes() == ["CANCELLED"] and times[-1] == 5.75 and exported == []
    assert (moving_scene.frame_current, moving_scene.frame_subframe) == (6, 0.0)
