# SPDX-License-Identifier: GPL-3.0-or-later
"""One scene per kind of light: the stage with a sphere and a box, in a nearly black world."""

from __future__ import annotations

import math
from typing import Any

import bpy
import numpy as np

from benchmarks.scenes.registry import scene
from benchmarks.scenes.studio import (
    Nodes,
    Socket,
    add_object,
    aim,
    box,
    diffuse,
    emitter,
    image,
    light,
    material,
    mesh,
    quad,
    show,
    sphere,
    stage,
    world,
    world_nodes,
)


def dim_stage(glossy: bool = False) -> None:
    """The stage with a diffuse or glossy sphere and box, and a faint world.

    Glossy ones are there to show the lamp's reflection: direct light only, since their caustics are noise.
    """
    stage()
    if glossy:
        bpy.context.scene.cycles.max_bounces = 0
    world((0.02, 0.02, 0.03))
    if glossy:
        show(material("glossy", lambda nodes: nodes("BsdfAnisotropic", {"distribution": "GGX"}, Roughness=0.3)))
    else:
        show(diffuse((0.7, 0.6, 0.5)))


@scene("light-point")
def point() -> None:
    """A point light without size."""
    dim_stage()
    light("POINT", 200.0, (-1.0, -1.5, 3.0), shadow_soft_size=0.0)


@scene("light-point-soft")
def point_soft() -> None:
    """A sphere light seen in glossy surfaces."""
    dim_stage(glossy=True)
    light("POINT", 200.0, (-1.0, 0.5, 2.4), shadow_soft_size=0.5)


@scene("light-point-disk")
def point_no_soft_falloff() -> None:
    """A point light with soft falloff off, close to a surface."""
    dim_stage()
    light("POINT", 100.0, (0.0, -1.0, 1.2), shadow_soft_size=0.5, use_soft_falloff=False)


@scene("light-point-unnormalized")
def point_unnormalized() -> None:
    """Lights that grow brighter with their size."""
    dim_stage()
    light("POINT", 20.0, (-1.0, -1.5, 3.0), shadow_soft_size=0.7, normalize=False)
    light("AREA", 10.0, (2.0, -1.5, 3.0), size=1.5, normalize=False)


@scene("light-spot")
def spot() -> None:
    """A spot light with a hard cone."""
    dim_stage()
    light("SPOT", 400.0, (-1.0, -2.5, 3.5), shadow_soft_size=0.0, spot_size=math.radians(35), spot_blend=0.0)


@scene("light-spot-blend")
def spot_blend() -> None:
    """A spot light with a soft edge and a radius."""
    dim_stage()
    light("SPOT", 400.0, (-1.0, -2.5, 3.5), shadow_soft_size=0.3, spot_size=math.radians(50), spot_blend=0.8)


@scene("light-spot-scaled")
def spot_scaled() -> None:
    """A spot light under a scaled transform: an elliptical cone."""
    dim_stage(glossy=True)
    lamp = light("SPOT", 400.0, (-1.0, -2.5, 3.5), shadow_soft_size=0.3, spot_size=math.radians(50), spot_blend=0.5)
    lamp.scale = (1.5, 0.6, 1.0)


@scene("light-sun")
def sun() -> None:
    """A sun without size."""
    dim_stage()
    light("SUN", 3.0, (2.0, -3.0, 4.0), angle=0.0)


@scene("light-sun-soft")
def sun_soft() -> None:
    """A sun as wide as ten degrees, seen in glossy surfaces."""
    dim_stage(glossy=True)
    light("SUN", 3.0, (2.0, -3.0, 4.0), angle=math.radians(10))


@scene("light-area-square")
def area_square() -> None:
    """A square area light in sight."""
    dim_stage(glossy=True)
    light("AREA", 120.0, (0.0, 2.0, 2.2), (0, 0, 0.4), size=1.2)


@scene("light-area-rectangle")
def area_rectangle() -> None:
    """A long rectangle above."""
    dim_stage()
    light("AREA", 120.0, (0.5, -0.5, 2.6), (0, 0, 0), shape="RECTANGLE", size=3.0, size_y=0.3)


@scene("light-area-disk")
def area_disk() -> None:
    """A disk in sight."""
    dim_stage(glossy=True)
    light("AREA", 120.0, (0.0, 2.0, 2.2), (0, 0, 0.4), shape="DISK", size=1.4)


@scene("light-area-ellipse")
def area_ellipse() -> None:
    """An ellipse in sight, under a non-uniform scale."""
    dim_stage(glossy=True)
    lamp = light("AREA", 120.0, (0.0, 2.0, 2.2), (0, 0, 0.4), shape="ELLIPSE", size=1.6, size_y=0.5)
    lamp.scale = (1.2, 1.5, 1.0)


@scene("light-area-spread", samples=128)
def area_spread() -> None:
    """An area light that shines forward only."""
    dim_stage()
    light("AREA", 120.0, (-1.5, -1.5, 3.0), (0, 0, 0), size=1.0, spread=math.radians(50))


@scene("light-area-spread-narrow", samples=256)
def area_spread_narrow() -> None:
    """A nearly collimated area light."""
    dim_stage()
    light("AREA", 60.0, (-0.5, -0.5, 3.0), (0, 0, 0), size=1.2, spread=math.radians(5))


@scene("light-temperature")
def temperature() -> None:
    """Light colour by temperature, and exposure."""
    dim_stage()
    light("AREA", 80.0, (-2.0, -1.5, 3.0), (0, 0, 0), size=1.0, use_temperature=True, temperature=2700.0)
    cold = light("POINT", 40.0, (2.0, -1.5, 3.0), use_temperature=True, temperature=12000.0, color=(1.0, 0.8, 0.8))
    cold.data.exposure = 1.5


@scene("light-nodes")
def light_nodes() -> None:
    """A light whose node tree colours it by falloff."""
    dim_stage()
    lamp = light("POINT", 100.0, (0.0, -1.5, 2.5), shadow_soft_size=0.2)
    lamp.data.use_nodes = True
    nodes = Nodes(lamp.data.node_tree)
    emission = nodes("Emission", Color=(0.4, 0.9, 0.6), Strength=2.0)
    nodes.node("OutputLight", Surface=emission)


@scene("light-visibility")
def visibility() -> None:
    """Lights hidden from the camera, from glossy rays, and one that casts no shadow."""
    dim_stage(glossy=True)
    hidden = light("AREA", 100.0, (0.0, 2.0, 2.2), (0, 0, 0.4), size=1.2)
    hidden.visible_camera = False
    dull = light("AREA", 60.0, (-2.0, -1.0, 2.0), (0, 0, 0.4), size=1.0)
    dull.visible_glossy = False
    light("POINT", 60.0, (1.5, -2.0, 3.0), shadow_soft_size=0.1, use_shadow=False)


@scene("emissive-mesh")
def emissive_mesh() -> None:
    """An emissive box and a one-sided looking emissive quad."""
    dim_stage()
    add_object("Lamp", box("Lamp", emitter((1.0, 0.7, 0.4), 8.0), (0.5, 0.5, 0.5)), (0.0, 1.2, 1.6), (20, 30, 0))
    panel = add_object("Panel", quad("Panel", emitter((0.5, 0.7, 1.0), 6.0), 1.0, 0.6), (-1.8, -1.5, 2.2))
    aim(panel, (0, 0, 0))


@scene("emissive-sphere")
def emissive_sphere() -> None:
    """A tessellated sphere as a light."""
    dim_stage()
    add_object("Lamp", sphere("Lamp", emitter((1.0, 0.9, 0.7), 12.0), 0.3, 24, 12), (0.2, 0.8, 2.0))


@scene("emissive-textured")
def emissive_textured() -> None:
    """A screen: emission from an asymmetrical image."""
    dim_stage()
    rows, columns = np.mgrid[0:8, 0:12]
    pixels = np.ones((8, 12, 4), np.float32)
    pixels[..., 0] = columns / 11.0
    pixels[..., 1] = rows / 7.0
    pixels[..., 2] = (rows + columns) % 2
    screen = image("Screen", pixels)

    def surface(nodes: Nodes) -> Socket:
        texture = nodes.node("TexImage", {"image": screen, "interpolation": "Closest"})
        return nodes("Emission", Color=texture.outputs[0], Strength=4.0)

    panel = add_object("Screen", quad("Screen", material("screen", surface), 2.4, 1.6), (0.0, 1.6, 1.4))
    panel.rotation_euler = (math.radians(80), 0, 0)


@scene("emissive-one-sided")
def emissive_one_sided() -> None:
    """A panel that emits from its front only, by Geometry's Backfacing."""
    dim_stage()

    def surface(nodes: Nodes) -> Socket:
        back = nodes("NewGeometry", output="Backfacing")
        dark = nodes("BsdfDiffuse", Color=(0.2, 0.2, 0.2))
        return nodes("MixShader", inputs={0: back, 1: nodes("Emission", Strength=6.0), 2: dark})

    add_object("Panel", quad("Panel", material("panel", surface), 1.4, 1.4), (0.0, 0.3, 2.2), (150, 10, 0))


@scene("world-color")
def world_color() -> None:
    """A uniform coloured world and nothing else."""
    dim_stage(glossy=True)
    world((0.3, 0.5, 0.9), 1.5)


def _sky(width: int, sun_radiance: float) -> np.ndarray:
    """Lat-long float sky, brighter to one side, darker below, with a small sun."""
    height = width // 2
    v, u = np.mgrid[0:height, 0:width]
    longitude, latitude = 2 * np.pi * (u + 0.5) / width, np.pi * (v + 0.5) / height - np.pi / 2
    pixels = np.ones((height, width, 4), np.float32)
    pixels[..., 0] = 0.5 + 0.4 * np.cos(longitude - 1.0) * np.cos(latitude)
    pixels[..., 1] = 0.4 + 0.3 * np.sin(longitude) * np.cos(latitude)
    pixels[..., 2] = 0.5 + 0.4 * np.sin(latitude)
    sun = (np.cos(latitude) * np.cos(longitude - 2.2) > 0.85) & (latitude > 0.35) & (latitude < 0.5)
    pixels[sun, :3] += sun_radiance * np.array([1.0, 0.9, 0.7], np.float32)
    return pixels


def sky_image(width: int, sun_radiance: float) -> Any:
    """The sky as a packed image."""
    return image("Sky", _sky(width, sun_radiance), is_float=True, colorspace="Linear Rec.709")


def _world_image(sun_radiance: float, rotation: float = 0.6, mirror: bool = False) -> None:
    sky = sky_image(64, sun_radiance)

    def surface(nodes: Nodes) -> Socket:
        direction = nodes("TexCoord", output="Generated")
        turned = nodes("Mapping", Vector=direction, Rotation=(0.1, 0.2, rotation))
        properties = {"image": sky, "projection": "MIRROR_BALL" if mirror else "EQUIRECTANGULAR"}
        return nodes("Background", Color=nodes("TexEnvironment", properties, Vector=turned), Strength=1.0)

    world_nodes(surface)


@scene("world-image")
def world_image() -> None:
    """A smooth environment image, rotated, seen by camera and mirror."""
    dim_stage(glossy=True)
    _world_image(0.0)


@scene("world-image-sun")
def world_image_sun() -> None:
    """An environment image with a small bright sun: importance sampling or noise."""
    dim_stage()
    _world_image(60.0)


@scene("world-mirror-ball")
def world_mirror_ball() -> None:
    """An environment image in mirror ball projection."""
    dim_stage(glossy=True)
    _world_image(0.0, mirror=True)


@scene("world-camera-only")
def world_light_path() -> None:
    """One world for the camera, another for light, told apart by Light Path."""
    dim_stage(glossy=True)

    def surface(nodes: Nodes) -> Socket:
        is_camera = nodes("LightPath", output="Is Camera Ray")
        lit, seen = nodes("Background", Color=(0.7, 0.6, 0.5)), nodes("Background", Color=(0.1, 0.3, 0.1))
        return nodes("MixShader", inputs={0: is_camera, 1: lit, 2: seen})

    world_nodes(surface)


@scene("many-lights", samples=128)
def many_lights() -> None:
    """Ten thousand emitters: 5,000 quads of one mesh, two triangles each, of random brightness and direction."""
    stage()
    world((0.0, 0.0, 0.0))
    show(diffuse((0.7, 0.6, 0.5)))
    generator = np.random.default_rng(7)
    count, half = 5000, 0.02
    centres = generator.uniform((-4, -2, 0.3), (4, 4, 3.5), (count, 3))
    normals = generator.normal(size=(count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    helper = np.where(np.abs(normals[:, :1]) < 0.9, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    t = np.cross(normals, helper)
    t *= half / np.linalg.norm(t, axis=1, keepdims=True)
    b = np.cross(normals, t)
    corners = np.stack([centres - t - b, centres + t - b, centres + t + b, centres - t + b], axis=1).reshape(-1, 3)
    faces = np.arange(4 * count).reshape(-1, 4)
    lamps = mesh("Lamps", corners.tolist(), faces.tolist())
    for color, strength in (((1.0, 0.6, 0.3), 6.0), ((0.4, 0.6, 1.0), 3.0), ((0.7, 1.0, 0.5), 1.0)):
        lamps.materials.append(emitter(color, strength))
    lamps.polygons.foreach_set("material_index", generator.integers(0, 3, count).astype(np.int32))
    add_object("Lamps", lamps)


@scene("many-lamps", samples=128)
def many_lamps() -> None:
    """Two hundred point and spot lamps near a floor."""
    stage()
    world((0.0, 0.0, 0.0))
    show(diffuse((0.7, 0.6, 0.5)))
    generator = np.random.default_rng(8)
    for index in range(200):
        x, y, z = generator.uniform((-4, -2, 0.3), (4, 4, 2.5))
        if index % 2:
            light("POINT", float(generator.uniform(0.5, 4.0)), (x, y, z), shadow_soft_size=0.02)
        else:
            light("SPOT", float(generator.uniform(2.0, 10.0)), (x, y, z), (x + 0.3, y, 0.0), shadow_soft_size=0.02)
