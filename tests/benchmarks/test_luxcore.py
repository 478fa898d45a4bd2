# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenes as LuxCore gets them, what it would not show alike, and what is said where it is not there.

No test renders with LuxCore, which is no part of the project.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.luxcore.__main__ import ENGINES, SCENES, configuration, main, render_luxcore
from benchmarks.luxcore.export import export_scene
from benchmarks.luxcore.properties import LuxScene
from benchmarks.scene_files import SceneSource, open_scene
from benchmarks.scenes import studio


def _export(text: str, size: tuple[int, int] = (64, 48)) -> LuxScene:
    return export_scene(open_scene(SceneSource(text), size=size))


@pytest.mark.parametrize("text", SCENES)
def test_default_scenes_are_shown_alike(blender: Any, text: str) -> None:
    exported = _export(text)
    kinds = {value for name, value in exported.properties.items() if name.endswith(".type")}
    assert {"perspective", "matte", "glass"} <= kinds
    assert ("distant" in kinds) != any(name.endswith("emission.gain") for name in exported.properties)
    assert 0.0 < exported.footprint < 0.1


def test_geometry_and_lamps_are_where_they_are_in_blender(blender: Any) -> None:
    exported = _export("builtin:caustic-glass-matte")
    scene = blender.context.scene
    ball = scene.objects["Ball"]
    name = next(name for name, (points, *_) in exported.meshes.items() if len(points) == 3 * _triangles(ball))
    points, triangles, normals = exported.meshes[name]
    outwards = points - np.array(ball.location)
    np.testing.assert_allclose(np.linalg.norm(outwards, axis=1), 0.028, rtol=1e-5)
    np.testing.assert_allclose(normals, outwards / 0.028, atol=0.01)
    assert triangles.tolist() == np.arange(len(points)).reshape(-1, 3).tolist()
    properties = exported.properties
    sun = next(name.removesuffix(".type") for name, value in properties.items() if value == "distant")
    towards = np.array((0.7, -1.0, -0.95))
    np.testing.assert_allclose(properties[f"{sun}.direction"], towards / np.linalg.norm(towards), atol=1e-5)
    # Radiance times the sun's solid angle is what falls on a surface that faces it.
    light = scene.objects["Sun"].data
    solid = math.pi * math.sin(math.radians(properties[f"{sun}.theta"])) ** 2
    expected = light.energy * np.array(light.color)
    np.testing.assert_allclose(np.array(properties[f"{sun}.gain"]) * solid, expected, rtol=1e-5)
    assert properties["scene.camera.fieldofview"] == pytest.approx(math.degrees(2.0 * math.atan(18.0 / 50.0)))
    # A row lower: see `benchmarks.luxcore.camera`.
    assert properties["scene.camera.screenwindow"] == [-1.0, 1.0, -0.78125, 0.71875]


def test_a_lamp_is_a_sphere_of_its_power(blender: Any) -> None:
    exported = _export("builtin:caustic-ball-matte")
    item = blender.context.scene.objects["Point"]
    lamp = next(name for name in exported.properties if name.endswith("emission.gain")).split(".")[2]
    points, _, normals = exported.meshes[lamp]
    np.testing.assert_allclose(np.linalg.norm(points - np.array(item.location), axis=1), 0.1, rtol=1e-5)
    corners = points.reshape(-1, 3, 3)
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (np.einsum("nk,nk->n", across, normals.reshape(-1, 3, 3).mean(axis=1)) > 0.0).all()
    area = 0.5 * np.linalg.norm(across, axis=1).sum()
    assert area == pytest.approx(4.0 * math.pi * 0.1**2, rel=0.01)
    power = np.array(exported.properties[f"scene.materials.{lamp}.emission.gain"]) * math.pi * area
    np.testing.assert_allclose(power, item.data.energy * np.array(item.data.color), rtol=1e-5)


def test_a_uniform_world_is_a_light(blender: Any) -> None:
    scene = open_scene(SceneSource("builtin:caustic-ball-matte"))
    assert not any(value == "constantinfinite" for value in export_scene(scene).properties.values())
    studio.world((0.5, 0.25, 0.125), 2.0)
    properties = export_scene(scene).properties
    assert properties["scene.lights.world.type"] == "constantinfinite"
    assert properties["scene.lights.world.gain"] == pytest.approx([1.0, 0.5, 0.25])


def _triangles(item: Any) -> int:
    item.data.calc_loop_triangles()
    return len(item.data.loop_triangles)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("builtin:caustic-glass", "the material .* it has Principled BSDF; LuxCore would not show it alike"),
        ("builtin:light-area-square", "the material 'glossy': its metal is rough; LuxCore would not show it alike"),
        ("builtin:glass-rough", "the lamp 'Area' is no sun"),
        ("builtin:world-image", "the world 'World.*' is neither uniform nor a plain picture: its"),
        ("builtin:film-box-filter", "pixel filter is not Blackman-Harris"),
        ("builtin:camera-depth-of-field", "the camera has more than a lens"),
    ],
)
def test_what_luxcore_would_not_show_alike_is_named(blender: Any, text: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        _export(text)


def test_every_way_of_luxcore_has_the_scene_s_bounces_and_clamps_nothing(blender: Any) -> None:
    exported = _export("builtin:caustic-ball-matte")
    for engine in ENGINES:
        config = configuration(engine, exported, 7, 2, 16, 20.0)
        assert (config["film.width"], config["film.height"]) == (64, 48)
        assert config["path.pathdepth.total"] == config["path.maxdepth"] == config["light.maxdepth"] == 17
        assert config["path.clamping.variance.maxvalue"] == 0.0 and config["renderengine.seed"] == 7
    photons = configuration("luxcore-photons", exported, 1, 2, 16, 20.0)
    assert photons["path.photongi.caustic.lookup.radius"] == pytest.approx(1.5 * exported.footprint)


def test_where_it_is_not_installed_the_message_says_how(tmp_path: Path) -> None:
    scene = LuxScene({}, {}, 1.0)
    with pytest.raises(ValueError, match=r"pip install --no-deps --target .*nowhere pyluxcore"):
        render_luxcore(scene, {}, 1.0, tmp_path / "nowhere")
    broken = tmp_path / "broken"
    (broken / "pyluxcore").mkdir(parents=True)
    (broken / "pyluxcore" / "__init__.py").write_text("raise ImportError('made for another Python')\n", "utf-8")
    with pytest.raises(RuntimeError, match="LuxCore failed: ImportError: made for another Python"):
        render_luxcore(scene, {}, 1.0, broken)


def test_a_scene_without_a_reference_is_named(blender: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([SCENES[0], "--references", str(tmp_path)]) == 2
    assert "no reference of caustic-glass-matte" in capsys.readouterr().err
