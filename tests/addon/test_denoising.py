# SPDX-License-Identifier: GPL-3.0-or-later
"""Denoising in Blender: the filter is Cycles', and scenes, layers and panels say what is denoised."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import OpenEXR
import pytest

from engine.denoise import library
from engine.denoise.filter import denoise


def read_passes(path: Path) -> dict[str, np.ndarray]:
    """Images of a multilayer file by pass, row 0 at the bottom."""
    with OpenEXR.File(str(path), separate_channels=False) as file:
        found = {
            name.partition(".")[2]: np.ascontiguousarray(channel.pixels[::-1], np.float32)
            for part in file.parts for name, channel in part.channels.items()
        }  # fmt: skip
    found["Denoising Normal"] = np.stack([found[f"Denoising Normal.{axis}"] for axis in "XYZ"], axis=-1)
    return found


@pytest.mark.skipif(bool(library.problem()), reason="no Open Image Denoise here")
@pytest.mark.parametrize("prefilter", ["NONE", "FAST", "ACCURATE"])
def test_of_cycles_own_passes_the_filter_makes_cycles_picture(prefilter: str, cube_scene: Any, tmp_path: Path) -> None:
    import bpy

    scene = cube_scene
    scene.render.engine = "CYCLES"
    scene.render.resolution_x, scene.render.resolution_y = 64, 48
    scene.render.image_settings.media_type = "MULTI_LAYER_IMAGE"
    scene.render.filepath = str(tmp_path / "cycles.exr")
    cycles = scene.cycles
    cycles.samples, cycles.use_adaptive_sampling, cycles.use_denoising = 2, False, True
    cycles.denoising_prefilter = prefilter
    scene.view_layers[0].cycles.denoising_store_passes = True
    bpy.ops.render.render(write_still=True)
    found = read_passes(tmp_path / "cycles.exr")
    noisy = found["Noisy Image"]
    ours = denoise(noisy, found["Denoising Albedo"], found["Denoising Normal"], prefilter=prefilter)
    assert np.abs(noisy[..., :3] - found["Combined"][..., :3]).max() > 0.01
    np.testing.assert_allclose(ours, found["Combined"][..., :3], atol=1e-5)


@pytest.mark.parametrize(
    ("of_scene", "of_layer", "follows", "expected"),
    [(True, True, True, True), (True, False, True, False), (False, True, True, False), (True, False, False, True)],
)
def test_a_layer_is_denoised_where_it_and_the_scene_are(
    of_scene: bool, of_layer: bool, follows: bool, expected: bool, blender: Any
) -> None:
    from addon.shared_settings import layer_is_denoised

    scene = blender.context.scene
    scene.neuralguide.use_cycles_settings = follows
    layer = SimpleNamespace(cycles=SimpleNamespace(use_denoising=of_layer))
    assert layer_is_denoised(scene, layer, of_scene) is expected


def test_passes_have_cycles_names(blender: Any) -> None:
    from addon.passes import requested_passes

    scene = blender.context.scene
    layer = scene.view_layers[0]
    layer.cycles.denoising_store_passes = True
    found = {item.blender_name: (item.channels, item.kind) for item in requested_passes(scene, layer)}
    expected = {
        "Noisy Image": ("RGBA", "COLOR"), "Denoising Normal": ("XYZ", "VECTOR"), "Denoising Albedo": ("RGB", "COLOR"),
        "Denoising Depth": ("Z", "VALUE"),
    }  # fmt: skip
    assert expected.items() <= found.items()
    scene.cycles.use_denoising = layer.cycles.denoising_store_passes = False
    assert not expected.keys() & {item.blender_name for item in requested_passes(scene, layer)}


@pytest.mark.skipif(bool(library.problem()), reason="no Open Image Denoise here")
def test_the_compositor_s_node_denoises_our_passes(cube_scene: Any, blender: Any, tmp_path: Path) -> None:
    """By Noisy Image, Denoising Albedo and Denoising Normal it makes the picture that Combined is."""
    scene = cube_scene
    if not hasattr(scene, "compositing_node_group"):
        pytest.skip("the compositor's trees are elsewhere before Blender 5.0")
    scene.cycles.use_denoising, scene.cycles.use_adaptive_sampling = True, False
    scene.view_layers[0].cycles.denoising_store_passes = True
    tree = blender.data.node_groups.new("Denoise", "CompositorNodeTree")
    tree.interface.new_socket("Image", in_out="OUTPUT", socket_type="NodeSocketColor")
    scene.compositing_node_group = tree
    layers, node, output = (
        tree.nodes.new(kind) for kind in ("CompositorNodeRLayers", "CompositorNodeDenoise", "NodeGroupOutput")
    )
    layers.scene = scene
    for source, target in (("Noisy Image", "Image"), ("Denoising Albedo", "Albedo"), ("Denoising Normal", "Normal")):
        tree.links.new(layers.outputs[source], node.inputs[target])
    tree.links.new(node.outputs["Image"], output.inputs[0])

    def render(name: str) -> np.ndarray:
        scene.render.filepath = str(tmp_path / name)
        blender.ops.render.render(write_still=True)
        with OpenEXR.File(scene.render.filepath) as file:
            return np.array(file.channels()["RGBA"].pixels)[..., :3]

    composited = render("composited.exr")
    scene.render.use_compositing = False
    combined = render("combined.exr")
    np.testing.assert_allclose(composited, combined, atol=2e-3)
