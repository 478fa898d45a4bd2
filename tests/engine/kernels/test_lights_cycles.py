# SPDX-License-Identifier: GPL-3.0-or-later
"""Light units, shapes and transforms against Cycles: the radiance of a white plane under one light.

Cycles renders the plane in the same process (direct light only, no filter, no thresholds); we integrate samples of our
own over the same square. Both are Monte Carlo: the mean over the plane must agree within 0.5% or 4 standard errors,
each quarter of it within 1.5%.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import tests.helpers.light_probe as probe
from engine.scene.description import World

SIZE = 16
EXTENT = 2.0
TURNED = np.array([[0.8, 0.0, -0.6], [0.0, 1.0, 0.0], [0.6, 0.0, 0.8]]).T
SCALED = TURNED @ np.diag([2.0, 0.5, 1.5])
#: Its z leans against x and y, which are at right angles.
LEANING = np.array([[1.2, 0.0, 0.3], [0.0, 0.9, -0.2], [0.0, 0.0, 1.0]])

LAMPS: dict[str, dict[str, Any]] = {
    "point": {"kind": "POINT", "radius": 0.0},
    "point sphere": {"kind": "POINT", "radius": 0.5, "use_soft_falloff": False},
    "point soft": {"kind": "POINT", "radius": 0.5},
    "point not normalized": {"kind": "POINT", "radius": 0.5, "use_soft_falloff": False, "is_normalized": False},
    "point zero not normalized": {"kind": "POINT", "radius": 0.0, "is_normalized": False},
    "point scaled": {"kind": "POINT", "radius": 0.4, "use_soft_falloff": False, "columns": SCALED.T},
    "spot": {"kind": "SPOT", "radius": 0.0, "spot_angle": 1.2, "spot_blend": 0.4},
    "spot sphere": {"kind": "SPOT", "radius": 0.4, "use_soft_falloff": False, "spot_angle": 0.8, "spot_blend": 0.15},
    "spot soft scaled": {"kind": "SPOT", "radius": 0.3, "spot_angle": 0.9, "spot_blend": 0.3, "columns": SCALED.T},
    "spot sphere scaled": {
        "kind": "SPOT", "radius": 0.3, "use_soft_falloff": False, "spot_angle": 0.9, "spot_blend": 0.3,
        "columns": SCALED.T,
    },
    "spot not normalized": {"kind": "SPOT", "radius": 0.4, "spot_angle": 1.2, "is_normalized": False},
    "sun": {"kind": "SUN", "angle": 0.0, "columns": TURNED.T},
    "sun 5": {"kind": "SUN", "angle": math.radians(5.0), "columns": TURNED.T},
    "sun 60": {"kind": "SUN", "angle": math.radians(60.0), "columns": SCALED.T},
    "sun not normalized": {"kind": "SUN", "angle": math.radians(30.0), "is_normalized": False},
    "square": {"kind": "AREA", "size_x": 1.5},
    "rectangle scaled": {"kind": "AREA", "shape": "RECTANGLE", "size_x": 1.0, "size_y": 0.6, "columns": SCALED.T},
    "rectangle not normalized": {
        "kind": "AREA", "shape": "RECTANGLE", "size_x": 1.0, "size_y": 0.6, "is_normalized": False,
        "columns": SCALED.T,
    },
    "disk": {"kind": "AREA", "shape": "DISK", "size_x": 1.5},
    "ellipse scaled": {"kind": "AREA", "shape": "ELLIPSE", "size_x": 1.0, "size_y": 1.6, "columns": SCALED.T},
    "square spread 90": {"kind": "AREA", "size_x": 1.5, "spread": math.radians(90.0)},
    "square spread 30": {"kind": "AREA", "size_x": 1.5, "spread": math.radians(30.0)},
    "disk spread 90": {"kind": "AREA", "shape": "DISK", "size_x": 1.5, "spread": math.radians(90.0)},
    "disk spread 30": {"kind": "AREA", "shape": "DISK", "size_x": 1.5, "spread": math.radians(30.0)},
    "ellipse spread 60": {
        "kind": "AREA", "shape": "ELLIPSE", "size_x": 1.5, "size_y": 0.8, "spread": math.radians(60.0),
    },
    # Without rays: these meet such a lamp elsewhere than Cycles' light samples, which ours are compared with.
    "rectangle leaning": {
        "kind": "AREA", "shape": "RECTANGLE", "size_x": 1.0, "size_y": 0.6, "columns": LEANING.T, "use_mis": False,
    },
    "ellipse leaning": {
        "kind": "AREA", "shape": "ELLIPSE", "size_x": 1.0, "size_y": 0.6, "columns": LEANING.T, "use_mis": False,
    },
    "rectangle leaning spread 60": {
        "kind": "AREA", "size_x": 1.2, "columns": LEANING.T, "spread": math.radians(60.0), "use_mis": False,
    },
    "ellipse leaning spread 60": {
        "kind": "AREA", "shape": "ELLIPSE", "size_x": 1.5, "size_y": 0.8, "columns": LEANING.T,
        "spread": math.radians(60.0), "use_mis": False,
    },
    "square spread 1": {"kind": "AREA", "size_x": 1.5, "spread": math.radians(1.0)},
}  # fmt: skip
POSITION = (0.3, -0.2, 1.4)


@pytest.fixture(scope="module")
def plane_scene() -> Any:
    """A white plane of 40 m seen from above through a square of EXTENT metres, nothing else."""
    bpy = pytest.importorskip("bpy")
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    mesh = bpy.data.meshes.new("Plane")
    mesh.from_pydata([(-20, -20, 0), (20, -20, 0), (20, 20, 0), (-20, 20, 0)], [], [(0, 1, 2, 3)])
    material = bpy.data.materials.new("White")
    material.use_nodes = True
    nodes = material.node_tree.nodes
    nodes.clear()
    diffuse = nodes.new("ShaderNodeBsdfDiffuse")
    diffuse.inputs["Color"].default_value = (1, 1, 1, 1)
    output = nodes.new("ShaderNodeOutputMaterial")
    material.node_tree.links.new(diffuse.outputs[0], output.inputs["Surface"])
    mesh.materials.append(material)
    scene.collection.objects.link(bpy.data.objects.new("Plane", mesh))
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.data.type = "ORTHO"
    camera.data.ortho_scale = EXTENT
    camera.location = (0, 0, 10)
    scene.collection.objects.link(camera)
    scene.camera = camera
    scene.render.engine = "CYCLES"
    scene.render.resolution_x = scene.render.resolution_y = SIZE
    scene.render.resolution_percentage = 100
    scene.render.threads_mode, scene.render.threads = "FIXED", 2
    if hasattr(scene.render.image_settings, "media_type"):
        scene.render.image_settings.media_type = "IMAGE"
    scene.render.image_settings.file_format = "OPEN_EXR"
    scene.render.image_settings.color_depth = "32"
    cycles = scene.cycles
    cycles.device = "CPU"
    cycles.max_bounces = 0
    cycles.use_adaptive_sampling = cycles.use_denoising = False
    cycles.light_sampling_threshold = 0.0
    cycles.pixel_filter_type = "BOX"
    cycles.seed = 5
    return scene


def _render(scene: Any, path: Path, samples: int = 256) -> np.ndarray:
    import bpy

    scene.cycles.samples = samples
    scene.render.filepath = str(path / "cycles.exr")
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(scene.render.filepath)
    pixels = np.array(image.pixels[:], np.float64).reshape(SIZE, SIZE, 4)[:, :, :3]
    bpy.data.images.remove(image)
    return pixels


def _quarters(image: np.ndarray) -> np.ndarray:
    half = SIZE // 2
    return image.reshape(2, half, 2, half).mean(axis=(1, 3))


def _our_radiance(lights: Any, geometry: Any, radiance: Any = None, per_pixel: int = 800) -> tuple[np.ndarray, float]:
    """Radiance of the plane, (SIZE, SIZE) first channel, and the relative standard error of its mean."""
    generator = np.random.default_rng(11)
    count = SIZE * SIZE * per_pixel
    cells = np.arange(count) // per_pixel
    p = np.zeros((count, 3))
    p[:, 0] = ((cells % SIZE + generator.random(count)) / SIZE - 0.5) * EXTENT
    p[:, 1] = ((cells // SIZE + generator.random(count)) / SIZE - 0.5) * EXTENT
    up = (0.0, 0.0, 1.0)
    samples = probe.draw(lights, geometry, p, up, generator.random((count, 3), np.float32))
    if radiance is not None:
        samples[:, probe.RADIANCE] = radiance(samples[:, probe.WI : probe.WI + 3])
    values = probe.irradiance(samples, up).reshape(-1, per_pixel) / np.pi
    image = values.mean(axis=1)
    error = float(np.sqrt((values.var(axis=1) / per_pixel).sum()) / max(image.sum(), 1e-30))
    return image.reshape(SIZE, SIZE), error


def _check(cycles: np.ndarray, ours: np.ndarray, error: float) -> None:
    assert cycles.mean() > 0.0
    assert ours.mean() == pytest.approx(cycles.mean(), rel=max(0.005, 4.0 * error))
    weight = np.maximum(_quarters(cycles), 0.2 * cycles.mean())
    assert (np.abs(_quarters(ours) - _quarters(cycles)) / weight).max() < 0.015 + 8.0 * error


@pytest.fixture
def added(plane_scene: Any) -> Iterator[list[Any]]:
    """Objects added by a test, removed behind it."""
    import bpy

    objects: list[Any] = []
    yield objects
    for item in objects:
        bpy.data.objects.remove(item)
    plane_scene.world = None


@pytest.mark.parametrize("name", LAMPS)
def test_lamp(plane_scene: Any, added: list[Any], tmp_path: Path, name: str) -> None:
    """Same radiance as Cycles."""
    import bpy
    import mathutils

    settings = dict(LAMPS[name])
    kind = settings.pop("kind")
    light = probe.lamp(kind, POSITION, settings.pop("columns", None), energy=20.0, color=(1.0, 1.0, 1.0), **settings)
    data = bpy.data.lights.new(name, kind)
    data.energy = light.energy
    data.normalize = light.is_normalized
    if kind in ("POINT", "SPOT"):
        data.shadow_soft_size = light.radius
        data.use_soft_falloff = light.use_soft_falloff
    if kind == "SPOT":
        data.spot_size, data.spot_blend = light.spot_angle, light.spot_blend
    if kind == "SUN":
        data.angle = light.angle
    if kind == "AREA":
        data.shape, data.size, data.size_y, data.spread = light.shape, light.size_x, light.size_y, light.spread
    item = bpy.data.objects.new(name, data)
    data.cycles.use_multiple_importance_sampling = light.use_mis
    # Its own transform has no shear.
    item.parent = bpy.data.objects.new("Parent", None)
    item.matrix_parent_inverse = mathutils.Matrix(light.transform.tolist())
    item.visible_camera = False
    plane_scene.collection.objects.link(item)
    plane_scene.collection.objects.link(item.parent)
    added.extend((item, item.parent))
    lights, geometry = probe.build(probe.make_description([light]))
    ours, error = _our_radiance(lights, geometry)
    _check(_render(plane_scene, tmp_path)[:, :, 0], ours, error)


def test_emissive_mesh(plane_scene: Any, added: list[Any], tmp_path: Path) -> None:
    """A turned and unevenly scaled mesh of triangles."""
    import bpy
    import mathutils

    generator = np.random.default_rng(3)
    corners = (generator.random((6, 1, 3)) - 0.5) * 1.5 + (generator.random((6, 3, 3)) - 0.5) * 0.6
    vertices, triangles = corners.reshape(-1, 3), np.arange(18).reshape(-1, 3)
    mesh = bpy.data.meshes.new("Emitter")
    mesh.from_pydata(vertices.tolist(), [], triangles.tolist())
    material = bpy.data.materials.new("Emission")
    material.use_nodes = True
    nodes = material.node_tree.nodes
    nodes.clear()
    emission = nodes.new("ShaderNodeEmission")
    emission.inputs["Strength"].default_value = 7.0
    material.node_tree.links.new(
        emission.outputs[0], nodes.new("ShaderNodeOutputMaterial").inputs["Surface"]
    )
    mesh.materials.append(material)
    item = bpy.data.objects.new("Emitter", mesh)
    transform = probe.matrix((0.2, 0.1, 3.0), SCALED.T)
    item.matrix_world = mathutils.Matrix(transform.tolist())
    item.visible_camera = item.visible_shadow = False
    plane_scene.collection.objects.link(item)
    added.append(item)
    color = 7.0 * np.array(emission.inputs["Color"].default_value[:3])
    lights, geometry = probe.build(*probe.emissive_scene(vertices, triangles, [transform], emission=color))
    ours, error = _our_radiance(lights, geometry)
    _check(_render(plane_scene, tmp_path, 1024)[:, :, 0], ours, error)


def _environment(height: int = 32) -> np.ndarray:
    """A sky with a sun off axis, so that a wrong orientation shows."""
    image = np.full((height, 2 * height, 3), 0.2, np.float32)
    image[:, :height] += 0.5
    image[int(0.8 * height), int(0.3 * 2 * height)] = 400.0
    return image


@pytest.mark.parametrize("axis", ["up", "+x", "+y"])
def test_environment(plane_scene: Any, added: list[Any], tmp_path: Path, axis: str) -> None:
    """An environment image, from planes that face different ways."""
    import bpy

    pixels = _environment()
    height, width = pixels.shape[:2]
    image = bpy.data.images.new("Sky", width, height, float_buffer=True)
    image.colorspace_settings.name = "Linear Rec.709"
    image.pixels.foreach_set(np.concatenate([pixels, np.ones((height, width, 1), np.float32)], 2).ravel())
    world = bpy.data.worlds.new("Sky")
    world.use_nodes = True
    tree = world.node_tree
    tree.nodes.clear()
    texture = tree.nodes.new("ShaderNodeTexEnvironment")
    texture.image, texture.interpolation = image, "Closest"
    shader = tree.nodes.new("ShaderNodeBackground")
    tree.links.new(texture.outputs[0], shader.inputs["Color"])
    tree.links.new(shader.outputs[0], tree.nodes.new("ShaderNodeOutputWorld").inputs["Surface"])
    plane_scene.world = world
    rotation = {"up": (0.0, 0.0, 0.0), "+x": (0.0, 0.5 * math.pi, 0.0), "+y": (-0.5 * math.pi, 0.0, 0.0)}[axis]
    normal = {"up": (0.0, 0.0, 1.0), "+x": (1.0, 0.0, 0.0), "+y": (0.0, 1.0, 0.0)}[axis]
    for name, distance in (("Plane", 0.0), ("Camera", 10.0)):
        item = plane_scene.objects[name]
        item.rotation_euler = rotation
        item.location = [distance * c for c in normal]
    try:
        cycles = _render(plane_scene, tmp_path, 512)[:, :, 0].mean()
    finally:
        for name, distance in (("Plane", 0.0), ("Camera", 10.0)):
            plane_scene.objects[name].rotation_euler = (0.0, 0.0, 0.0)
            plane_scene.objects[name].location = (0.0, 0.0, distance)

    lights, geometry = probe.build(probe.make_description(world=World("w", "Sky", None)), background=pixels)
    samples = probe.draw(lights, geometry, (0, 0, 0), normal, probe.stratified(250_000, 3))
    wi = samples[:, probe.WI : probe.WI + 3].astype(np.float64)
    column = np.floor((0.5 - np.arctan2(wi[:, 1], wi[:, 0]) / (2.0 * np.pi)) * width).astype(int) % width
    row = np.floor((1.0 - np.arccos(np.clip(wi[:, 2], -1, 1)) / np.pi) * height).astype(int).clip(0, height - 1)
    samples[:, probe.RADIANCE] = pixels[row, column, 0]
    values = probe.irradiance(samples, normal) / np.pi
    error = values.std() / np.sqrt(len(values)) / values.mean()
    assert values.mean() == pytest.approx(cycles, rel=max(0.005, 3.0 * error))
