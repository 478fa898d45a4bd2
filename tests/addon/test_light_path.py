# SPDX-License-Identifier: GPL-3.0-or-later
"""What shaders are told of the ray, beside Cycles: in shadow rays of paths that have scattered, and in media."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from tests.helpers.blender_scenes import empty_scene  # noqa: E402
from tests.helpers.pass_scenes import diffuse, make_material, render_both  # noqa: E402


def counting(tree: Any, output: str, scale: float, least: float) -> Any:
    """A number of Light Path, scaled, and no less than something."""
    path, scaled = tree.nodes.new("ShaderNodeLightPath"), tree.nodes.new("ShaderNodeMath")
    scaled.operation = "MULTIPLY_ADD"
    scaled.inputs[1].default_value, scaled.inputs[2].default_value = scale, least
    tree.links.new(path.outputs[output], scaled.inputs[0])
    return scaled.outputs[0]


def tinted(output: str) -> Any:
    """Lets through as much as a number says."""

    def surface(tree: Any) -> Any:
        clear = tree.nodes.new("ShaderNodeBsdfTransparent")
        tree.links.new(counting(tree, output, 0.3, 0.1), clear.inputs[0])
        return clear.outputs[0]

    return make_material("Tinted", surface)


def refracting(tree: Any) -> Any:
    refraction = tree.nodes.new("ShaderNodeBsdfRefraction")
    refraction.inputs["Roughness"].default_value, refraction.inputs["IOR"].default_value = 0.0, 1.2
    return refraction.outputs[0]


def mirroring(tree: Any) -> Any:
    kind = "ShaderNodeBsdfGlossy" if hasattr(bpy.types, "ShaderNodeBsdfGlossy") else "ShaderNodeBsdfAnisotropic"
    mirror = tree.nodes.new(kind)
    mirror.inputs["Roughness"].default_value = 0.0
    return mirror.outputs[0]


def plane(size: float, location: tuple[float, float, float], material: Any, turn: Any = (0.0, 0.0, 0.0)) -> Any:
    bpy.ops.mesh.primitive_plane_add(size=size, location=location, rotation=turn)
    bpy.context.object.data.materials.append(material)
    return bpy.context.object


def lit_scene() -> Any:
    """A camera above a floor in the sun."""
    scene = empty_scene()
    scene.camera.location, scene.camera.data.lens = (0.0, 0.0, 7.0), 30.0
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = 24, 24, 100
    sun = bpy.data.objects.new("Sun", bpy.data.lights.new("Sun", "SUN"))
    sun.data.energy, sun.rotation_euler = 3.0, (0.5, 0.2, 0.0)
    scene.collection.objects.link(sun)
    plane(6.0, (0.0, 0.0, 0.0), make_material("Floor", diffuse))
    scene.cycles.sample_clamp_indirect = scene.cycles.blur_glossy = 0.0
    return scene


def assert_alike(scene: Any, folder: Path, samples: int = 96) -> None:
    (ours, _), (theirs, _) = render_both(scene, folder, samples)
    name = next(channel for channel in ours if channel.endswith("Combined.R"))
    cells = [image[name].reshape(6, 4, 6, 4).mean(axis=(1, 3)) for image in (ours, theirs)]
    np.testing.assert_allclose(cells[0], cells[1], rtol=0.06, atol=0.03 * cells[1].max())
    assert cells[0].mean() == pytest.approx(cells[1].mean(), rel=0.015)


@pytest.mark.parametrize("output", ["Transmission Depth", "Ray Depth", "Is Transmission Ray"])
def test_behind_glass_shadow_rays_know_the_path(output: str, blender: Any, tmp_path: Path) -> None:
    scene = lit_scene()
    plane(2.0, (0.0, 0.5, 1.0), tinted(output)).visible_camera = False
    plane(4.0, (0.0, 0.0, 3.0), make_material("Glass", refracting)).visible_shadow = False
    assert_alike(scene, tmp_path)


def test_in_a_mirror_shadow_rays_know_the_path(blender: Any, tmp_path: Path) -> None:
    scene = lit_scene()
    plane(6.0, (-3.0, 0.0, 3.0), make_material("Wall", diffuse), (0.0, 1.57, 0.0))
    plane(2.0, (-2.0, 0.5, 3.0), tinted("Glossy Depth"), (0.0, 1.57, 0.0)).visible_camera = False
    plane(2.0, (1.2, 0.0, 3.0), make_material("Mirror", mirroring), (0.0, -0.7, 0.0)).visible_shadow = False
    assert_alike(scene, tmp_path)


@pytest.mark.parametrize("output", ["Diffuse Depth", "Transparent Depth", "Ray Depth", "Is Diffuse Ray"])
def test_media_that_count_are_there_for_rays_that_have_scattered(output: str, blender: Any, tmp_path: Path) -> None:
    """Their bounds are found before any ray is traced."""
    scene = lit_scene()
    bpy.ops.mesh.primitive_cube_add(size=4, location=(0.0, 0.0, 2.2))
    material = make_material("Fog", diffuse)
    tree = material.node_tree
    tree.links.clear()
    fog = tree.nodes.new("ShaderNodeVolumeScatter")
    tree.links.new(counting(tree, output, 0.1, 0.0), fog.inputs["Density"])
    tree.links.new(fog.outputs[0], tree.nodes["Material Output"].inputs["Volume"])
    bpy.context.object.data.materials.append(material)
    scene.cycles.volume_bounces = 1
    assert_alike(scene, tmp_path, 128)


@pytest.mark.parametrize("alpha", [1.0, 0.4])
def test_objects_that_are_held_out_stay_as_transparent_as_they_are(
    alpha: float, blender: Any, tmp_path: Path
) -> None:
    def surface(tree: Any) -> Any:
        mix = tree.nodes.new("ShaderNodeMixShader")
        mix.inputs[0].default_value = alpha
        tree.links.new(tree.nodes.new("ShaderNodeBsdfTransparent").outputs[0], mix.inputs[1])
        tree.links.new(tree.nodes.new("ShaderNodeEmission").outputs[0], mix.inputs[2])
        return mix.outputs[0]

    scene = lit_scene()
    plane(2.0, (0.0, 0.5, 1.0), make_material("Held out", surface)).is_holdout = True
    assert_alike(scene, tmp_path)
