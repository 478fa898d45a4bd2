# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures in stereo: each eye sees what Cycles' sees."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from addon.export import export_scene
from tests.helpers.pass_scenes import busy_scene

SAMPLES = 64
SIZE = 64


def _render_eyes(scene: Any, folder: Path) -> dict[str, np.ndarray]:
    """Pictures of the left and of the right eye (H, W, 3), by the engine in use."""
    import bpy

    scene.render.filepath = str(folder / scene.render.engine)
    scene.render.image_settings.file_format = "OPEN_EXR"
    bpy.ops.render.render(write_still=True)
    eyes = {}
    for suffix in ("L", "R"):
        image = bpy.data.images.load(f"{scene.render.filepath}_{suffix}.exr")
        eyes[suffix] = np.array(image.pixels[:], np.float32).reshape(SIZE, SIZE, 4)[..., :3]
        bpy.data.images.remove(image)
    return eyes


def _stereo(scene: Any, **settings: Any) -> None:
    busy_scene(scene)
    render = scene.render
    render.use_multiview, render.image_settings.views_format = True, "INDIVIDUAL"
    render.resolution_x = render.resolution_y = SIZE
    for name, value in settings.items():
        setattr(scene.camera.data.stereo, name, value)


@pytest.mark.parametrize(
    ("kind", "settings"),
    [
        ("PERSP", {"convergence_mode": "OFFAXIS", "convergence_distance": 4.0}),
        ("PERSP", {"convergence_mode": "TOE", "pivot": "LEFT", "convergence_distance": 4.0}),
        ("PERSP", {"convergence_mode": "PARALLEL", "use_spherical_stereo": True}),
        ("PANO", {"convergence_mode": "OFFAXIS", "use_spherical_stereo": True, "convergence_distance": 4.0,
                  "use_pole_merge": True}),
    ],
)  # fmt: skip
def test_each_eye_sees_what_cycles_sees(cube_scene: Any, tmp_path: Path, kind: str, settings: dict[str, Any]) -> None:
    scene = cube_scene
    _stereo(scene, interocular_distance=1.5, **settings)
    scene.camera.data.type = kind
    scene.camera.data.panorama_type = "EQUIRECTANGULAR"
    scene.neuralguide.samples = scene.cycles.samples = SAMPLES
    scene.neuralguide.guiding_method = "OFF"
    scene.cycles.use_adaptive_sampling = scene.cycles.use_denoising = False
    scene.neuralguide.use_denoising = False
    found = {}
    for scene.render.engine in ("NEURALGUIDE", "CYCLES"):
        found[scene.render.engine] = _render_eyes(scene, tmp_path)
    ours, theirs = found["NEURALGUIDE"], found["CYCLES"]
    apart = np.abs(theirs["L"] - theirs["R"]).mean() / theirs["L"].mean()
    assert apart > 0.08
    for eye in ("L", "R"):
        off = np.abs(ours[eye] - theirs[eye]).mean() / theirs[eye].mean()
        assert off < 0.3 * apart, (eye, off, apart)


def test_stereo_gives_no_notice(cube_scene: Any) -> None:
    import bpy

    _stereo(cube_scene)
    assert export_scene(bpy.context.evaluated_depsgraph_get()).notices == []
