# SPDX-License-Identifier: GPL-3.0-or-later
"""Passes of data beside Cycles' own, of the same scene in the same process, by way of multilayer EXR files.

Both renderers place their samples by chance, so pixels at edges differ by what 256 well spread samples leave: at most a
tenth of a pass's range was seen between two seeds of Cycles, and much less in the mean of all pixels.
"""

from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path
from typing import Any

import cryptomatte_api
import numpy as np
import pytest

from engine.scene.cryptomatte import matte_id, murmur_hash
from tests.helpers.motion_scenes import keyframe, open_shutter
from tests.helpers.pass_scenes import (
    add_aov,
    busy_scene,
    diffuse,
    make_material,
    render_both,
    render_passes,
)

SAMPLES = 256
LARGEST, RMS, MEAN = 0.12, 0.015, 0.002


def assert_alike(ours: np.ndarray, theirs: np.ndarray, name: str, span: float | None = None) -> None:
    """Whether images differ by chance only, relative to their span of values."""
    span = np.ptp(theirs) if span is None else span
    assert span > 0.0, name
    difference = (ours - theirs) / span
    assert np.abs(difference).max() < LARGEST, name
    assert np.sqrt((difference**2).mean()) < RMS, name
    assert abs(difference.mean()) < MEAN, name


def matte_of(images: dict[str, np.ndarray], layer: str, name: str) -> np.ndarray:
    """How much of each pixel is the name's: all its levels, in whatever order they are."""
    total = np.zeros_like(next(iter(images.values())))
    for index in range(8):
        for which, weight in ("rg", "ba"):
            channel = f"ViewLayer.{layer}{index:02}."
            if channel + which in images:
                total += np.where(images[channel + which] == float(matte_id(name)), images[channel + weight], 0.0)
    return total


def test_passes_are_those_of_cycles(cube_scene: Any, tmp_path: Path) -> None:
    scene, layer = cube_scene, busy_scene(cube_scene)
    layer.use_pass_mist = layer.use_pass_vector = layer.use_pass_uv = True
    kinds = ("object", "material", "asset")
    for kind in kinds:
        setattr(layer, f"use_pass_cryptomatte_{kind}", True)
    for name, kind in (("Place", "COLOR"), ("Amount", "VALUE"), ("Nobody's", "VALUE")):
        aov = layer.aovs.add()
        aov.name, aov.type = name, kind
    (ours, our_text), (theirs, their_text) = render_both(scene, tmp_path, SAMPLES)
    assert set(ours) == set(theirs)
    compared = [
        name for name in sorted(ours) if name.split(".")[1] in ("Mist", "UV", "Vector", "Place", "Amount")
    ]
    assert len(compared) == 1 + 3 + 4 + 4 + 1
    for name in compared:
        assert_alike(ours[name], theirs[name], name)
    assert not ours["ViewLayer.Nobody's.X"].any()
    # A moving camera, and things that move and swell.
    assert max(np.ptp(theirs[f"ViewLayer.Vector.{axis}"]) for axis in "XYZW") > 1.0

    names = {
        "CryptoObject": ("Floor", "Cube", "Ball", "Thin", "Thick", "Hole"),
        "CryptoMaterial": ("Opaque", "Thin", "Thick", "default_surface"),
        "CryptoAsset": ("Floor", "Cube", "Ball", "Hole"),
    }
    for kind, found in names.items():
        for name in found:
            assert_alike(matte_of(ours, kind, name), matte_of(theirs, kind, name), f"{kind} {name}", 1.0)
    assert not matte_of(ours, "CryptoObject", "Hole").any()
    assert matte_of(ours, "CryptoObject", "Cube").max() > 0.99

    for key, text in their_text.items():
        if key.startswith("cryptomatte/") and not key.endswith("/manifest"):
            assert our_text[key] == text
        elif key.startswith("cryptomatte/"):
            manifest, known = json.loads(our_text[key]), json.loads(text)
            assert manifest == {name: known[name] for name in manifest}
            assert all(int(number, 16) == murmur_hash(name) for name, number in known.items())


@pytest.mark.parametrize("kind", ["PANO", "ZOOM"])
def test_vectors_know_panoramas_and_zooms(cube_scene: Any, tmp_path: Path, kind: str) -> None:
    scene, layer = cube_scene, busy_scene(cube_scene)
    layer.use_pass_vector = True
    if kind == "PANO":
        data = scene.camera.data
        data.type = "PANO"
        owner = data if hasattr(data, "panorama_type") else data.cycles
        owner.panorama_type = "EQUIRECTANGULAR"
        owner.latitude_min = owner.longitude_min = -0.5
        owner.latitude_max = owner.longitude_max = 0.4
    else:
        keyframe(scene.camera.data, "lens", {0: 45.0, 1: 50.0, 2: 60.0})
        scene.camera.data.shift_x = 0.1
        scene.frame_set(1)
    (ours, _), (theirs, _) = render_both(scene, tmp_path, SAMPLES)
    for axis in "XYZW":
        name = f"ViewLayer.Vector.{axis}"
        difference = np.abs(ours[name] - theirs[name]) / np.ptp(theirs[name])
        # At the edges of what moves few samples decide.
        assert np.median(difference) < 0.002 and np.quantile(difference, 0.97) < 0.1, axis


@pytest.mark.slow
@pytest.mark.parametrize(("name", "axes"), [("moving-hair", "XYZW"), ("moving-curves", "XZ")])
def test_vectors_of_strands(cube_scene: Any, tmp_path: Path, name: str, axes: str) -> None:
    scene = _open_with_vectors(name)
    (ours, _), (theirs, _) = render_both(scene, tmp_path, SAMPLES)
    for axis in axes:
        found, wanted = ours[f"ViewLayer.Vector.{axis}"], theirs[f"ViewLayer.Vector.{axis}"]
        span = np.ptp(wanted)
        assert span > 0.1, axis
        # Each pixel sees many strands, whose vectors differ: samples decide, so means tell more.
        assert abs(found.mean() - wanted.mean()) < 0.002 * span, axis
        assert np.sqrt(((found - wanted) ** 2).mean()) < 0.03 * span, axis


@pytest.mark.slow
def test_vectors_of_points_are_how_far_they_fly(cube_scene: Any, tmp_path: Path) -> None:
    """In Cycles 5.0 they go to the origin of the object."""
    import bpy

    scene = _open_with_vectors("flying-points")
    scene.camera.data.type, scene.camera.data.ortho_scale = "ORTHO", 6.0
    scene.neuralguide.samples, scene.render.engine = 4, "NEURALGUIDE"
    cloud = next(item for item in scene.objects if item.type == "POINTCLOUD").data
    count = len(cloud.points)
    cloud.attributes["radius"].data.foreach_set("value", np.full(count, 0.5, np.float32))
    speed = 0.1 * scene.render.fps / scene.render.fps_base
    flat = np.tile(np.array([speed, 0.0, 0.0], np.float32), count)
    cloud.attributes["velocity"].data.foreach_set("vector", flat)
    bpy.context.view_layer.update()
    images, _ = render_passes(scene, tmp_path / "vectors.exr")
    # 0.1 m a frame, on 48 pixels of 6 m.
    middle = np.s_[16:20, 20:28]
    for axis in "XZ":
        np.testing.assert_allclose(images[f"ViewLayer.Vector.{axis}"][middle], -0.1 * 48 / 6, rtol=1e-3)
    for axis in "YW":
        np.testing.assert_allclose(images[f"ViewLayer.Vector.{axis}"][middle], 0.0, atol=1e-3)


def _open_with_vectors(name: str) -> Any:
    import bpy

    from benchmarks.scenes import build

    build(name)
    scene = bpy.context.scene
    scene.render.use_motion_blur = False
    scene.render.resolution_x, scene.render.resolution_y = 48, 36
    bpy.context.view_layer.use_pass_vector = True
    return scene


def test_vectors_of_orthographic_cameras_are_plain_shifts(cube_scene: Any, tmp_path: Path) -> None:
    """What stands still shifts by how far the camera goes over its scale; Cycles projects it in perspective."""
    scene, layer = cube_scene, busy_scene(cube_scene)
    layer.use_pass_vector = True
    scene.camera.data.type, scene.camera.data.ortho_scale = "ORTHO", 6.0
    scene.neuralguide.samples = 4
    images, _ = render_passes(scene, tmp_path / "vectors.exr")
    # 0.1 m from the frame before and 0.3 m to the frame after, on 32 pixels.
    np.testing.assert_allclose(images["ViewLayer.Vector.X"][-1], 0.1 * 32 / 6, rtol=1e-3)
    np.testing.assert_allclose(images["ViewLayer.Vector.Z"][-1], 0.3 * 32 / 6, rtol=1e-3)


def test_there_are_no_vectors_with_motion_blur(cube_scene: Any, tmp_path: Path) -> None:
    from addon import engine

    scene, layer = cube_scene, busy_scene(cube_scene)
    layer.use_pass_vector = True
    open_shutter(scene)
    (ours, _), (theirs, _) = render_both(scene, tmp_path, 4)
    for axis in "XYZW":
        assert not ours[f"ViewLayer.Vector.{axis}"].any() and not theirs[f"ViewLayer.Vector.{axis}"].any()
    assert any("Vector" in notice.problem for notice in engine.outcomes[-1].report.notices)


@pytest.mark.parametrize("falloff", ["QUADRATIC", "INVERSE_QUADRATIC"])
def test_mist_falls_off_as_in_cycles(cube_scene: Any, tmp_path: Path, falloff: str) -> None:
    scene, layer = cube_scene, busy_scene(cube_scene)
    layer.use_pass_mist = True
    scene.world.mist_settings.falloff = falloff
    (ours, _), (theirs, _) = render_both(scene, tmp_path, SAMPLES)
    assert_alike(ours["ViewLayer.Mist.Z"], theirs["ViewLayer.Mist.Z"], falloff)


def test_the_alpha_threshold_says_what_passes_of_one_surface_show(cube_scene: Any, tmp_path: Path) -> None:
    """Indices are of the first sample: of a pane that is not opaque enough, only where the path did not go through.

    About 130 pixels see a pane. So many of them show it that both renderers' chances differ by 8 (one standard error);
    24 are allowed.
    """
    scene, layer = cube_scene, busy_scene(cube_scene)
    layer.use_pass_object_index = layer.use_pass_uv = layer.use_pass_normal = True
    for index, name in enumerate(("Thin", "Thick"), 1):
        scene.objects[name].pass_index = index
    shown = []
    for layer.pass_alpha_threshold in (0.0, 0.5, 1.0):
        (ours, _), (theirs, _) = render_both(scene, tmp_path, SAMPLES)
        for name in ("UV.U", "UV.V", "UV.A", "Normal.Z"):
            assert_alike(ours[f"ViewLayer.{name}"], theirs[f"ViewLayer.{name}"], name)
        indices = [image["ViewLayer.Object Index.X"] for image in (ours, theirs)]
        counts = np.array([[np.count_nonzero(image == index) for index in (1, 2)] for image in indices])
        assert (np.abs(counts[0] - counts[1]) < 24).all()
        shown.append(counts[0].tolist())
    (all_thin, all_thick), (some_thin, still_thick), (_, some_thick) = shown
    assert some_thin < 0.5 * all_thin and still_thick == all_thick and some_thick < 0.9 * all_thick


def test_aovs_of_one_name_add_up(cube_scene: Any, tmp_path: Path) -> None:
    """Nodes in a group, in a muted group and beside them, whose other socket is of a kind that the pass is not."""
    import bpy

    scene = cube_scene
    group = bpy.data.node_groups.new("Group", "ShaderNodeTree")
    add_aov(group, "A").inputs["Value"].default_value = 0.25

    def surface(tree: Any) -> Any:
        for is_muted in (False, True):
            node = tree.nodes.new("ShaderNodeGroup")
            node.node_tree, node.mute = group, is_muted
        beside = add_aov(tree, "A")
        beside.inputs["Value"].default_value, beside.inputs["Color"].default_value = 0.5, (9.0, 9.0, 9.0, 1.0)
        # Blender mutes no outputs.
        beside.mute = True
        return diffuse(tree)

    scene.objects["Cube"].data.materials.append(make_material("Sums", surface))
    aov = scene.view_layers[0].aovs.add()
    aov.name, aov.type = "A", "VALUE"
    (ours, _), (theirs, _) = render_both(scene, tmp_path, SAMPLES)
    assert theirs["ViewLayer.A.X"].max() == pytest.approx(0.75)
    assert_alike(ours["ViewLayer.A.X"], theirs["ViewLayer.A.X"], "A")


def test_mattes_follow_filter_depth_of_field_and_motion_blur(cube_scene: Any, tmp_path: Path) -> None:
    scene, layer = cube_scene, busy_scene(cube_scene)
    layer.use_pass_cryptomatte_object = True
    open_shutter(scene, 2.0)
    scene.camera.data.dof.use_dof = True
    scene.camera.data.dof.focus_distance, scene.camera.data.dof.aperture_fstop = 4.0, 0.05
    (ours, _), (theirs, _) = render_both(scene, tmp_path, SAMPLES)
    for name in ("Floor", "Cube", "Ball", "Thin", "Thick"):
        matte = matte_of(theirs, "CryptoObject", name)
        assert ((matte > 0.02) & (matte < 0.98)).mean() > 0.1
        difference = matte_of(ours, "CryptoObject", name) - matte
        assert np.sqrt((difference**2).mean()) < 0.03 and abs(difference.mean()) < 0.004


def test_mattes_do_not_depend_on_threads(cube_scene: Any, tmp_path: Path) -> None:
    scene, layer = cube_scene, busy_scene(cube_scene)
    layer.use_pass_cryptomatte_object = True
    scene.neuralguide.samples, scene.neuralguide.guiding_method = 64, "OFF"
    scene.render.resolution_x, scene.render.resolution_y = 80, 48
    renders = []
    for scene.neuralguide.threads in (1, 2):
        renders.append(render_passes(scene, tmp_path / "mattes.exr")[0])
    for name in renders[0]:
        np.testing.assert_array_equal(renders[0][name], renders[1][name], name)


def test_other_programs_read_the_mattes(cube_scene: Any, tmp_path: Path) -> None:
    """`cryptomatte-api` knows all names, and pulls the mattes that the channels hold."""
    scene, layer = cube_scene, busy_scene(cube_scene)
    layer.use_pass_cryptomatte_object = layer.use_pass_cryptomatte_material = True
    layer.pass_cryptomatte_depth = 7
    scene.neuralguide.samples = 16
    images, _ = render_passes(scene, tmp_path / "mattes.exr")
    assert "ViewLayer.CryptoObject03.r" in images and "ViewLayer.CryptoObject04.r" not in images
    read = {matte.metadata().name(): matte for matte in cryptomatte_api.Cryptomatte.load(str(tmp_path / "mattes.exr"))}
    assert set(read) == {"ViewLayer.CryptoObject", "ViewLayer.CryptoMaterial"}
    assert all(matte.num_levels() == 8 for matte in read.values())
    masks = read["ViewLayer.CryptoObject"].masks()
    assert {"Floor", "Cube", "Ball", "Thin", "Thick"} <= set(masks)
    for name, mask in masks.items():
        np.testing.assert_allclose(mask, matte_of(images, "CryptoObject", name), atol=2e-3)
    assert masks["Cube"].max() > 0.9
    # Largest first, as the specification wants it.
    weights = [images[f"ViewLayer.CryptoObject{index:02}.{weight}"] for index in range(4) for weight in "ga"]
    assert all((before >= after).all() for before, after in pairwise(weights))


def test_the_compositor_pulls_a_matte(cube_scene: Any, tmp_path: Path) -> None:
    """Blender's own Cryptomatte node, fed by the render, gives an object's matte."""
    import bpy
    import OpenEXR

    scene, layer = cube_scene, busy_scene(cube_scene)
    layer.use_pass_cryptomatte_object = True
    scene.neuralguide.samples, scene.neuralguide.guiding_method = 16, "OFF"
    expected = matte_of(render_passes(scene, tmp_path / "mattes.exr")[0], "CryptoObject", "Cube")
    tree = _compositor(scene)
    layers, node = tree.nodes.new("CompositorNodeRLayers"), tree.nodes.new("CompositorNodeCryptomatteV2")
    node.source, node.scene, node.layer_name = "RENDER", scene, "ViewLayer.CryptoObject"
    node.matte_id = "Cube"
    tree.links.new(layers.outputs["Image"], node.inputs["Image"])
    tree.links.new(node.outputs["Matte"], _compositor_result(tree))
    scene.render.use_compositing = True
    settings = scene.render.image_settings
    if hasattr(settings, "media_type"):
        settings.media_type = "IMAGE"
    settings.file_format = "OPEN_EXR"
    scene.render.filepath = str(tmp_path / "matte.exr")
    bpy.ops.render.render(write_still=True)
    with OpenEXR.File(scene.render.filepath, separate_channels=True) as file:
        matte = np.array(file.channels()["R"].pixels)
    assert expected.max() > 0.9
    np.testing.assert_allclose(matte, expected, atol=2e-3)


def _compositor(scene: Any) -> Any:
    """An empty node tree of the compositor: a group of its own since Blender 5.0."""
    import bpy

    if hasattr(scene, "compositing_node_group"):
        tree = scene.compositing_node_group = bpy.data.node_groups.new("Compositor", "CompositorNodeTree")
        return tree
    scene.use_nodes = True
    scene.node_tree.nodes.clear()
    return scene.node_tree


def _compositor_result(tree: Any) -> Any:
    """The socket that becomes the picture."""
    if hasattr(tree, "interface") and hasattr(tree.interface, "new_socket"):
        tree.interface.new_socket("Image", in_out="OUTPUT", socket_type="NodeSocketColor")
        return tree.nodes.new("NodeGroupOutput").inputs[0]
    return tree.nodes.new("CompositorNodeComposite").inputs["Image"]


def test_names_are_hashed_by_murmur_hash() -> None:
    """Published values of MurmurHash3_32 with the seed 0, and the specification's own example."""
    assert [murmur_hash(text) for text in ("", "hello", "hello, world")] == [0, 0x248BFA47, 0x149BBB7F]
    assert float(matte_id("hello")) == float(np.uint32(0x248BFA47).view(np.float32))
    # Exponents that would make a denormal, an infinity or a NaN become the nearest that do not.
    ids = np.array([matte_id(f"name {number}") for number in range(4096)])
    assert np.isfinite(ids).all() and (np.abs(ids) >= np.finfo(np.float32).tiny).all()
