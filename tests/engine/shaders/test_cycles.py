# SPDX-License-Identifier: GPL-3.0-or-later
"""Inputs, images, bump and normal maps against Cycles: a node's output emitted by a turned and scaled smooth sphere."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("bpy")

from tests.helpers.node_runner import run_node

pytestmark = pytest.mark.slow

SIZE = 48
Source = Callable[[Any], Any]


def node(kind: str, output: Any = 0, links: dict | None = None, values: dict | None = None, **settings: Any) -> Source:
    """Function that adds a node to a tree and returns an output of it."""

    def add(tree: Any) -> Any:
        new = tree.nodes.new(kind)
        for name, value in settings.items():
            setattr(new, name, value() if callable(value) else value)
        for name, source in (links or {}).items():
            tree.links.new(source(tree), new.inputs[name])
        for name, value in (values or {}).items():
            new.inputs[name].default_value = value
        return new.outputs[output]

    return add


def coordinate(name: str) -> Source:
    return node("ShaderNodeTexCoord", name)


def image() -> Any:
    import bpy

    return bpy.data.images["noise"]


def texture(output: str = "Color", vector: Source | None = None, **settings: Any) -> Source:
    links = {"Vector": vector} if vector else {}
    return node("ShaderNodeTexImage", output, links, image=image, **settings)


def noise(name: str) -> Source:
    return node("ShaderNodeTexNoise", 0, {"Vector": coordinate(name)}, {"Scale": 2.0, "Detail": 0.0})


def bump(height: Source, **settings: Any) -> Source:
    return node("ShaderNodeBump", 0, {"Height": height}, {"Distance": 0.3, "Strength": 0.8}, **settings)


WIDE_UV = node(
    "ShaderNodeMapping", 0, {"Vector": coordinate("UV")}, {"Scale": (2.5, 2.5, 1.0), "Location": (-0.6, -0.7, 0.0)}
)
SMOOTH_IMAGE = texture(interpolation="Cubic")
CASES: dict[str, Source] = {
    **{
        f"coordinate {name}": coordinate(name)
        for name in ("Generated", "Normal", "UV", "Object", "Camera", "Window", "Reflection")
    },
    **{
        f"geometry {name}": node("ShaderNodeNewGeometry", name)
        for name in ("Position", "Normal", "Tangent", "True Normal", "Incoming")
    },
    **{
        f"image {interpolation} {extension}": texture(vector=WIDE_UV, interpolation=interpolation, extension=extension)
        for interpolation, extension in (
            ("Linear", "REPEAT"),
            ("Linear", "CLIP"),
            ("Closest", "MIRROR"),
            ("Cubic", "EXTEND"),
            ("Smart", "REPEAT"),
        )
    },
    **{
        f"image {projection}": texture(vector=coordinate("Generated"), projection=projection, projection_blend=0.3)
        for projection in ("BOX", "SPHERE", "TUBE")
    },
    "image alpha": texture("Alpha"),
    **{
        f"normal map {space}": node("ShaderNodeNormalMap", 0, {"Color": SMOOTH_IMAGE}, space=space)
        for space in ("TANGENT", "OBJECT", "WORLD", "BLENDER_OBJECT", "BLENDER_WORLD")
    },
    **{f"bump {name}": bump(noise(name)) for name in ("Object", "Generated", "UV", "Normal")},
    "bump inverted": bump(noise("Object"), invert=True),
    "bump image": bump(SMOOTH_IMAGE),
    **{f"tangent {axis}": node("ShaderNodeTangent", direction_type="RADIAL", axis=axis) for axis in ("X", "Y", "Z")},
    "tangent uv": node("ShaderNodeTangent", direction_type="UV_MAP"),
    "fresnel": node("ShaderNodeFresnel"),
    "layer weight fresnel": node("ShaderNodeLayerWeight", "Fresnel", values={"Blend": 0.3}),
    "layer weight facing": node("ShaderNodeLayerWeight", "Facing", values={"Blend": 0.3}),
    **{
        f"object info {name}": node("ShaderNodeObjectInfo", name)
        for name in ("Location", "Color", "Alpha", "Object Index", "Random")
    },
    **{f"camera data {index}": node("ShaderNodeCameraData", index) for index in range(3)},
    **{
        f"transform {kind} {source} {target}": node(
            "ShaderNodeVectorTransform",
            0,
            {"Vector": node("ShaderNodeNewGeometry", "Normal")},
            vector_type=kind,
            convert_from=source,
            convert_to=target,
        )
        for kind in ("VECTOR", "POINT", "NORMAL")
        for source, target in (("WORLD", "OBJECT"), ("OBJECT", "CAMERA"), ("CAMERA", "OBJECT"))
    },
    "light path length": node("ShaderNodeLightPath", "Ray Length"),
}


@pytest.fixture
def sphere(blender: Any) -> Any:
    """The scene: a sphere of 16 x 8 smooth faces in front of a camera, rendered at pixel centres."""
    bpy = blender
    scene = bpy.context.scene
    bpy.ops.mesh.primitive_uv_sphere_add(segments=16, ring_count=8, radius=1.0)
    ball = bpy.context.object
    bpy.ops.object.shade_smooth()
    ball.rotation_euler, ball.scale, ball.location = (0.3, 0.5, 0.7), (1.0, 1.3, 0.8), (0.2, 0.1, 0.3)
    ball.color, ball.pass_index = (0.2, 0.5, 0.7, 0.5), 3
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.location, camera.rotation_euler = (0.0, -4.0, 1.5), (1.25, 0.0, 0.0)
    scene.collection.objects.link(camera)
    scene.camera = camera
    pixels = np.random.default_rng(1).random((8, 16, 4)).astype(np.float32)
    pixels[..., 3] = 0.3 + 0.7 * pixels[..., 3]
    picture = bpy.data.images.new("noise", 16, 8, alpha=True)
    picture.pixels.foreach_set(pixels.ravel())
    picture.pack()
    render = scene.render
    render.resolution_x = render.resolution_y = SIZE
    render.resolution_percentage = 100
    if hasattr(render.image_settings, "media_type"):
        render.image_settings.media_type = "IMAGE"
    render.image_settings.file_format = "OPEN_EXR"
    render.image_settings.color_depth = "32"
    scene.cycles.samples = scene.neuralguide.samples = 1
    scene.cycles.use_adaptive_sampling = scene.cycles.use_denoising = False
    scene.cycles.pixel_filter_type = "BOX"
    # Cycles puts its first sample into the centre of the pixel; a narrow filter puts ours there.
    scene.neuralguide.pixel_filter = "BLACKMAN_HARRIS"
    scene.cycles.filter_width = 0.01
    if hasattr(scene.neuralguide, "filter_width"):
        scene.neuralguide.filter_width = 0.01
    return ball


def render(bpy: Any, engine: str, folder: Path) -> np.ndarray:
    scene = bpy.context.scene
    scene.render.engine = engine
    scene.render.filepath = str(folder / f"{engine}.exr")
    bpy.ops.render.render(write_still=True)
    picture = bpy.data.images.load(scene.render.filepath)
    values = np.array(picture.pixels[:], np.float32).reshape(SIZE, SIZE, 4)
    bpy.data.images.remove(picture)
    return values[..., :3]


def test_nodes_agree_with_cycles(blender: Any, sphere: Any, tmp_path: Path) -> None:
    compare(blender, sphere, tmp_path, CASES)


def test_nodes_that_are_new_in_blender_5_2_agree_with_cycles(blender: Any, sphere: Any, tmp_path: Path) -> None:
    if blender.app.version < (5, 2):
        pytest.skip("Blender 5.2 has these nodes and settings")
    blender.context.scene.frame_set(3)
    cases = {
        f"normal map directx {space}": node(
            "ShaderNodeNormalMap", 0, {"Color": SMOOTH_IMAGE}, space=space, convention="DIRECTX"
        )
        for space in ("TANGENT", "OBJECT")
    }
    cases |= {f"scene time {name}": node("GeometryNodeInputSceneTime", name) for name in ("Seconds", "Frame")}
    cases["input vector"] = node("FunctionNodeInputVector", vector=(0.3, 0.6, 0.1))
    cases["input integer"] = node("FunctionNodeInputInt", integer=3)
    cases["input boolean"] = node("FunctionNodeInputBool", boolean=True)
    compare(blender, sphere, tmp_path, cases)


def compare(bpy: Any, sphere: Any, tmp_path: Path, cases: dict[str, Source]) -> None:
    """19 of 20 pixels of the ball agree to 0.5% of the largest value; the rest may see an edge from the other side.

    Both renderers jitter the ray by up to a hundredth of a pixel.
    """
    failures = []
    for name, source in cases.items():
        material = bpy.data.materials.new(name)
        if material.node_tree is None:
            material.use_nodes = True
        tree = material.node_tree
        tree.nodes.clear()
        emission = tree.nodes.new("ShaderNodeEmission")
        tree.links.new(source(tree), emission.inputs[0])
        tree.links.new(emission.outputs[0], tree.nodes.new("ShaderNodeOutputMaterial").inputs[0])
        sphere.data.materials.clear()
        sphere.data.materials.append(material)
        ours, cycles = (render(bpy, engine, tmp_path) for engine in ("NEURALGUIDE", "CYCLES"))
        on_ball = cycles.any(axis=2) | ours.any(axis=2)
        assert on_ball.any(), name
        error = np.abs(ours - cycles).max(axis=2)[on_ball] / np.abs(cycles).max()
        if not np.quantile(error, 0.95) < 5e-3:
            failures.append(f"{name}: {np.quantile(error, 0.95):.1e}")
    assert not failures, failures


def no_number(tree: Any) -> Any:
    """What comes of octaves that cancel each other: their sum is divided by 0."""
    values = {"Distortion": 1.0, "Detail": 1.0, "Detail Roughness": -1.0}
    return node("ShaderNodeTexWave", 1, {"Vector": coordinate("Object")}, values)(tree)


@pytest.mark.parametrize("output", [0, 1])
def test_waves_whose_octaves_cancel_are_no_number(output: int) -> None:
    values = {"Distortion": 1.0, "Detail": 1.0, "Detail Roughness": -1.0, "Vector": np.full((2, 3), 0.3, np.float32)}
    assert np.isnan(run_node("ShaderNodeTexWave", ("Color", "Fac")[output], values)).all()


def test_what_is_no_number_is_limited_as_in_cycles(blender: Any, sphere: Any, tmp_path: Path) -> None:
    colors = {"A_Color": (0.2, 0.3, 0.4, 1.0), "B_Color": (0.7, 0.6, 0.5, 1.0)}

    def mix(tree: Any) -> Any:
        new = tree.nodes.new("ShaderNodeMix")
        new.data_type = "RGBA"
        tree.links.new(no_number(tree), new.inputs[0])
        for socket in new.inputs:
            if socket.identifier in colors:
                socket.default_value = colors[socket.identifier]
        return next(socket for socket in new.outputs if socket.identifier == "Result_Color")

    cases = {
        "clamp": node("ShaderNodeClamp", 0, {0: no_number}, {1: 0.3}),
        "map range": node("ShaderNodeMapRange", 0, {0: no_number}, {3: 0.3}),
        "mix": mix,
        **{
            f"{operation} {place}": node("ShaderNodeMath", 0, {place: no_number}, {1 - place: 0.5}, operation=operation)
            for operation in ("MINIMUM", "MAXIMUM") for place in (0, 1)
        },
    }  # fmt: skip
    for operation in ("MINIMUM", "MAXIMUM"):
        for place in (0, 1):
            vector = node(
                "ShaderNodeVectorMath", 0, {place: no_number}, {1 - place: (0.5, 0.4, 0.3)}, operation=operation
            )
            # What is no number would be black, as nothing is.
            limited = node("ShaderNodeVectorMath", 0, {0: vector}, {1: (0.1, 0.2, 0.25)}, operation="MAXIMUM")
            cases[f"vector {operation} {place}"] = limited
    compare(blender, sphere, tmp_path, cases)


def test_surfaces_take_roughness_that_is_no_number_for_none(blender: Any, sphere: Any, tmp_path: Path) -> None:
    scene = blender.context.scene
    scene.world = blender.data.worlds.new("White")
    if scene.world.node_tree is None:
        scene.world.use_nodes = True
    scene.world.node_tree.nodes["Background"].inputs[0].default_value = (1.0, 1.0, 1.0, 1.0)
    scene.cycles.samples = scene.neuralguide.samples = 16
    for kind in ("Diffuse", "Glossy", "Principled"):
        material = blender.data.materials.new(kind)
        if material.node_tree is None:
            material.use_nodes = True
        tree = material.node_tree
        tree.nodes.clear()
        surface = node(f"ShaderNodeBsdf{kind}", 0, {"Roughness": no_number})(tree)
        tree.links.new(surface, tree.nodes.new("ShaderNodeOutputMaterial").inputs[0])
        sphere.data.materials.clear()
        sphere.data.materials.append(material)
        ours, cycles = (render(blender, engine, tmp_path).mean() for engine in ("NEURALGUIDE", "CYCLES"))
        # A white surface would differ by a fifth of the ball's share.
        assert ours == pytest.approx(cycles, rel=3e-3), kind
