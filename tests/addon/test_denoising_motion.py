# SPDX-License-Identifier: GPL-3.0-or-later
"""Passes of motion for denoisers beside Cycles' own, which Blender has from 5.3 on.

Cycles makes them of all samples, and both renderers place theirs by chance: pixels at edges differ by that alone.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.helpers.motion_scenes import keyframe
from tests.helpers.pass_scenes import add_object, busy_scene, make_material, render_both, see_through

SAMPLES = 256
BACKWARD = [f"ViewLayer.Denoising Backward Motion.{axis}" for axis in "XYZ"]
SPECULAR = [f"ViewLayer.Denoising Specular Motion.{axis}" for axis in "XYZ"]


@pytest.fixture
def scene(cube_scene: Any) -> Any:
    """The cube, with a view layer that asks for motion."""
    if not hasattr(cube_scene.view_layers[0].cycles, "denoising_store_motion_passes"):
        pytest.skip("passes of motion for denoisers came with Blender 5.3")
    return cube_scene


def ask_for_motion(layer: Any) -> None:
    """Switch the passes on, as Blender does."""
    layer.cycles.denoising_store_passes = layer.cycles.denoising_store_motion_passes = True


def assert_alike(ours: np.ndarray, theirs: np.ndarray, name: str, largest: float = 0.12, rms: float = 0.015) -> None:
    """Whether images differ by chance only, relative to their span of values."""
    span = np.ptp(theirs)
    assert span > 0.0, name
    difference = (ours - theirs) / span
    assert np.abs(difference).max() < largest, name
    assert np.sqrt((difference**2).mean()) < rms, name
    assert abs(difference.mean()) < 0.002, name


def shiny(color: tuple[float, float, float], roughness: float, dull_share: float = 0.0) -> Any:
    """A surface that mirrors, in part diffuse."""

    def surface(tree: Any) -> Any:
        mix, glossy = tree.nodes.new("ShaderNodeMixShader"), tree.nodes.new("ShaderNodeBsdfAnisotropic")
        glossy.inputs["Color"].default_value = (*color, 1.0)
        glossy.inputs["Roughness"].default_value = roughness
        mix.inputs[0].default_value = dull_share
        tree.links.new(glossy.outputs[0], mix.inputs[1])
        tree.links.new(tree.nodes.new("ShaderNodeBsdfDiffuse").outputs[0], mix.inputs[2])
        return mix.outputs[0]

    return surface


def mirror_scene(scene: Any, floor: Any) -> Any:
    """A cube that moves over a floor, mirrored in it, seen by a camera that moves, under a sky; the view layer."""
    import bpy

    for item in list(scene.objects):
        if item.type == "MESH":
            bpy.data.objects.remove(item)
    add_object("Floor", "plane", make_material("Floor", floor), size=12)
    cube = add_object("Cube", "cube", size=1.6)
    pane = add_object("Pane", "plane", make_material("Pane", see_through(0.5)), location=(1.6, 0.0, 1.5),
                      rotation=(1.3, 0.0, 0.0), size=1.5)
    keyframe(cube, "location", {0: (-1.6, 0.0, 1.5), 1: (-1.2, 0.0, 1.5), 2: (-1.1, 0.2, 1.6)})
    keyframe(pane, "location", {0: (1.6, 0.0, 1.5), 1: (1.6, 0.3, 1.7)})
    keyframe(scene.camera, "location", {0: (-0.3, -7.3, 3.2), 1: (0.0, -7.0, 3.2), 2: (0.3, -6.8, 3.2)})
    keyframe(scene.camera, "rotation_euler", {0: (1.18, 0.0, -0.03), 2: (1.22, 0.0, 0.03)})
    scene.frame_set(1)
    layer = scene.view_layers[0]
    ask_for_motion(layer)
    return layer


def test_backward_motion_is_that_of_cycles(scene: Any, tmp_path: Path) -> None:
    """Of a moving camera, of what moves and swells, through panes, beside a holdout, and the sky."""
    layer = busy_scene(scene)
    keyframe(scene.camera, "rotation_euler", {0: (1.32, 0.02, -0.05), 2: (1.38, -0.02, 0.05)})
    scene.frame_set(1)
    ask_for_motion(layer)
    layer.use_pass_vector = True
    (ours, _), (theirs, _) = render_both(scene, tmp_path, SAMPLES)
    for name in (*BACKWARD, *SPECULAR):
        assert name in ours and name in theirs, name
    for name in BACKWARD:
        assert_alike(ours[name], theirs[name], name)
    # The sky goes by as the camera turns, which Vector has not in this Blender.
    assert not theirs["ViewLayer.Vector.X"][0].any() and np.abs(ours[BACKWARD[0]][0]).min() > 0.5
    # Nothing here mirrors but the panes, which pass for it as they let light through: few of their samples scatter.
    name = SPECULAR[0]
    assert_alike(ours[name], theirs[name], name, 0.25, 0.05)


@pytest.mark.parametrize("floor", [
    shiny((1.0, 1.0, 1.0), 0.0),
    shiny((0.6, 0.5, 0.4), 0.1),
    shiny((0.9, 0.9, 0.9), 0.0, dull_share=0.3),
], ids=["mirror", "brushed", "varnish"])  # fmt: skip
def test_specular_motion_is_that_of_cycles(scene: Any, tmp_path: Path, floor: Any) -> None:
    """Of what a floor mirrors, which stands still itself."""
    mirror_scene(scene, floor)
    (ours, _), (theirs, _) = render_both(scene, tmp_path, SAMPLES)
    for name in (*BACKWARD, *SPECULAR[:2]):
        assert_alike(ours[name], theirs[name], name)
    assert not ours[SPECULAR[2]].any() and not theirs[SPECULAR[2]].any()
    # The mirror image goes another way than the mirror.
    assert np.abs(ours[SPECULAR[0]]).max() > 0.5


@pytest.mark.parametrize("kind", ["PANO", "ORTHO", "ZOOM"])
def test_motion_of_other_cameras(scene: Any, tmp_path: Path, kind: str) -> None:
    """Before panoramas Cycles' depth is along the camera's upward axis."""
    mirror_scene(scene, shiny((1.0, 1.0, 1.0), 0.0))
    data = scene.camera.data
    if kind == "ZOOM":
        keyframe(data, "lens", {0: 45.0, 1: 50.0, 2: 60.0})
        scene.frame_set(1)
    elif kind == "ORTHO":
        data.type, data.ortho_scale = "ORTHO", 6.0
    else:
        data.type, data.panorama_type = "PANO", "EQUIRECTANGULAR"
        data.latitude_min = data.longitude_min = -0.5
        data.latitude_max = data.longitude_max = 0.4
    (ours, _), (theirs, _) = render_both(scene, tmp_path, SAMPLES)
    for name in (*BACKWARD, *SPECULAR[:2]):
        assert_alike(ours[name], theirs[name], name)


def test_motion_blur_leaves_no_such_passes(scene: Any, tmp_path: Path) -> None:
    from addon import engine
    from addon.passes import requested_passes

    layer = mirror_scene(scene, shiny((1.0, 1.0, 1.0), 0.0))
    scene.render.use_motion_blur = True
    (ours, _), (theirs, _) = render_both(scene, tmp_path, 1)
    for images in (ours, theirs):
        assert "ViewLayer.Denoising Depth.Z" in images and not images.keys() & {*BACKWARD, *SPECULAR}
    assert any("motion for denoisers" in notice.problem for notice in engine.outcomes[-1].report.notices)
    scene.render.use_motion_blur = False
    layer.cycles.denoising_store_passes = False
    assert not any("Motion" in item.name for item in requested_passes(scene, layer))
