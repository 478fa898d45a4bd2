# SPDX-License-Identifier: GPL-3.0-or-later
"""Media that are lit over mirrors, through water and through glass."""

from __future__ import annotations

from engine.scene.description import Light, Link, Material, Node, NodeGraph, SceneDescription, World
from tests.helpers.caustic_scenes import lamp_at, mirror_scene, mirrored_scene, water_scene
from tests.helpers.media_scenes import media_scene, placed
from tests.helpers.small_scenes import looking_down, material


def fill(scene: SceneDescription, density: float, g: float = 0.0, color: tuple = (0.9, 0.9, 0.9)) -> SceneDescription:
    """The scene in an endless fog [m^-1]."""
    inputs = {"Color": (*color, 1.0), "Density": density, "Anisotropy": g}
    fog = Node("ShaderNodeVolumeScatter", "Fog", inputs)
    scene.world = World("fog", "Fog", NodeGraph([fog], None, Link(0, "Volume")))
    return scene


def _from_near(scene: SceneDescription, height: float, lens: float = 400.0) -> SceneDescription:
    """Seen in so small pixels that what photons blur is less than what is tested."""
    scene.camera = looking_down(height)
    scene.camera.lens = lens
    return scene


def water_in_fog(size: float = 4.0, roughness: float = 0.0, **fog: object) -> SceneDescription:
    """Turbid water of a metre below fog, over a dark floor, under a lamp of this width [m]."""
    scene = water_scene(size, roughness)
    scene.materials[0] = material(color=(0.1, 0.1, 0.1))
    return fill(_from_near(scene, 2.0), **({"density": 0.5} | fog))


def _point(scene: SceneDescription) -> SceneDescription:
    """Lamps without a size, over a floor that is nearly black: what is seen is the fog."""
    scene.lights = [Light(lamp.name, "Lamp", "POINT", lamp.transform, lamp.color, lamp.energy) for lamp in scene.lights]
    scene.materials[0] = material(color=(0.02, 0.02, 0.02))
    return scene


def mirror_in_fog(density: float = 0.1) -> SceneDescription:
    """Fog beside a mirror: it is lit as in `mirrored_in_fog`, and no path finds what comes over the mirror."""
    return fill(_point(mirror_scene()), density)


def mirrored_in_fog(density: float = 0.1) -> SceneDescription:
    """The same fog and the lamp with its image, without the mirror."""
    return fill(_point(mirrored_scene()), density)


def milk_in_glass(
    density: float = 4.0, g: float = 0.7, roughness: float = 0.0, size: float = 3.0, boxes: int = 1, x: float = 0.0
) -> SceneDescription:
    """A box whose glass is the boundary of its milk, or several side by side, and a lamp of this width [m]."""
    inputs = {"Color": (1.0, 1.0, 1.0, 1.0), "Roughness": roughness, "IOR": 1.3}
    nodes = [
        Node("ShaderNodeBsdfGlass", "Glass", inputs, {"distribution": "GGX"}),
        Node("ShaderNodeVolumeScatter", "Milk", {"Color": (0.9, 0.95, 1.0, 1.0), "Density": density, "Anisotropy": g}),
    ]  # fmt: skip
    milk = Material("Milk", "Milk", NodeGraph(nodes, Link(0, "BSDF"), Link(1, "Volume")))
    scene = media_scene(
        [milk] * boxes, [placed((0.5, 0.5, 0.5), (float(k), 0.0, 0.0)) for k in range(boxes)],
        lights=[lamp_at(x, 0.0, 3.0, size)], world=(0.0, 0.0, 0.0), size=(16, 16),
    )  # fmt: skip
    return _from_near(scene, 2.5, lens=1500.0)


def milk_in_open_glass() -> SceneDescription:
    """A box of glass and milk that lacks one of its sides."""
    scene = milk_in_glass()
    mesh = scene.meshes[0]
    # The last two of its triangles.
    mesh.triangles, mesh.material_slots = mesh.triangles[:-2], mesh.material_slots[:-2]
    return scene
