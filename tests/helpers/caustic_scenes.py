# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenes with light that comes over mirrors and through water, which can be worked out or found otherwise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from engine.scene.description import Light, Link, Material, Node, NodeGraph, SceneDescription
from tests.helpers.placed_quads import turned
from tests.helpers.small_scenes import floor_scene, material

#: 50 m of wall, which stands at y = 2 m and faces the origin.
_WALL = np.array([[1, 0, 0, 0], [0, 0, -1, 2], [0, 1, 0, 0], [0, 0, 0, 1]], np.float32)


def lamp_at(x: float, y: float, z: float, size: float = 0.1, energy: float = 100.0) -> Light:
    """A square lamp that shines down [m, W]."""
    place = np.eye(4, dtype=np.float32)
    place[:3, 3] = x, y, z
    return Light(f"lamp {y}", "Lamp", "AREA", place, (1.0, 1.0, 1.0), energy, size_x=size, size_y=size)


def glass(ior: float, roughness: float = 0.0) -> Material:
    """Glass of a refractive index."""
    inputs = {"Color": (1.0, 1.0, 1.0, 1.0), "Roughness": roughness, "IOR": ior}
    node = Node("ShaderNodeBsdfGlass", "Glass", inputs, {"distribution": "GGX"})
    return Material("Glass", "Glass", NodeGraph([node], Link(0, "BSDF")))


def mixed_with_nothing(sharp: Material, *, to_shadows: bool = False) -> Material:
    """A material, half of which is Transparent; or all of it, but to shadow rays alone."""
    clear = Node("ShaderNodeBsdfTransparent", "Clear", {"Color": (1.0, 1.0, 1.0, 1.0)})
    path = Node("ShaderNodeLightPath", "Path")
    chosen = Link(2, "Is Shadow Ray") if to_shadows else 0.5
    both = {"Fac": chosen, "Shader": Link(0, "BSDF"), "Shader_001": Link(1, "BSDF")}
    nodes = [sharp.graph.nodes[0], clear, path, Node("ShaderNodeMixShader", "Mix", both)]
    return replace(sharp, graph=NodeGraph(nodes, Link(3, "Shader")))


def _two(transform: np.ndarray, second: Material, lights: list[Light]) -> SceneDescription:
    """The floor, and something of another material."""
    scene = floor_scene(
        lights=lights, transforms=[np.eye(4), transform], materials=[material(), second], size=(16, 16)
    )
    instances = scene.instances
    instances.material_offset = np.array([0, 1], np.int32)
    instances.materials = np.array([0, 1], np.int32)
    return scene


def mirror_scene(size: float = 0.1, roughness: float = 0.0) -> SceneDescription:
    """A floor beside a mirror, under a small lamp: if that is smooth, the floor is lit as by `mirrored_scene`."""
    mirror = material("Mirror", (1.0, 1.0, 1.0), "ShaderNodeBsdfAnisotropic")
    mirror.graph.nodes[0].inputs["Roughness"] = roughness
    return _two(_WALL, mirror, [lamp_at(0.0, 0.0, 2.0, size)])


def mirrored_scene() -> SceneDescription:
    """The same floor under the lamp and its image, without the mirror."""
    return floor_scene(lights=[lamp_at(0.0, 0.0, 2.0), lamp_at(0.0, 4.0, 2.0)], size=(16, 16))


def water_scene(size: float = 4.0, roughness: float = 0.0) -> SceneDescription:
    """A floor below water, seen from above, under a lamp that is so wide that paths find it."""
    surface = np.eye(4, dtype=np.float32)
    surface[2, 3] = 1.0
    return _two(surface, glass(1.33, roughness), [lamp_at(0.0, 0.0, 3.0, size)])


def prism_scene(size: float = 0.5, dispersion: float = 0.1) -> SceneDescription:
    """A floor below a leaning piece of the surface of glass that disperses strongly: a spectrum along the columns."""
    scene = water_scene(size)
    pane = np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], np.float32)
    scene.meshes.append(replace(scene.meshes[0], key="pane", name="Pane", vertices=pane))
    scene.instances.mesh = np.array([0, 1], np.int32)
    transform = scene.instances.transform.copy()
    transform[1] = turned(0.7, 1, (0.0, 0.0, 1.5))
    scene.instances.transform = transform
    scene.materials[1] = replace(glass(1.5), dispersion=dispersion)
    return scene


def hidden_glass_scene() -> SceneDescription:
    """Glass far below a floor that no light reaches."""
    below = np.eye(4, dtype=np.float32)
    below[2, 3] = -5.0
    return _two(below, glass(1.5), [lamp_at(0.0, 0.0, 3.0)])




#: Corners and triangles of glass that is no closed surface.
_CORNERS = np.array(
    [(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0), (-1, -1, 0.4), (1, -1, 0.4), (1, 1, 0.4), (-1, 1, 0.4)],
    np.float32,
)  # fmt: skip
_BROKEN = {
    # The same faces twice, turned alike, and against each other.
    "coincident": [(0, 1, 2), (0, 2, 3), (0, 1, 2), (0, 2, 3)],
    "turned": [(0, 1, 2), (0, 2, 3), (0, 2, 1), (0, 3, 2)],
    # A box that lacks its lid, and one of its sides.
    "open": [(0, 2, 1), (0, 3, 2), (0, 1, 5), (0, 5, 4), (1, 2, 6), (1, 6, 5), (2, 3, 7), (2, 7, 6)],
    # Three faces at each of two edges.
    "non-manifold": [(0, 1, 2), (0, 2, 3), (0, 2, 6), (0, 6, 4), (0, 1, 5), (0, 5, 4), (1, 2, 6)],
    # Without an area, and with corners that are no numbers.
    "degenerate": [(0, 1, 2), (0, 2, 3), (0, 0, 1), (1, 1, 1), (0, 1, 8)],
}


def broken_glass_scene(kind: str, size: float = 4.0) -> SceneDescription:
    """A floor below glass that is no closed surface, under a lamp that is so wide that paths find it.

    Parameters
    ----------
    kind : str, of `BROKEN_KINDS`
    """
    scene = water_scene(size)
    corners = np.concatenate([1.5 * _CORNERS, np.full((1, 3), np.nan, np.float32)])
    triangles = np.array(_BROKEN[kind], np.uint32)
    glass_mesh = replace(
        scene.meshes[0], key=kind, name=kind, vertices=corners if triangles.max() == 8 else corners[:8],
        triangles=triangles, material_slots=np.zeros(len(triangles), np.int32),
    )  # fmt: skip
    scene.meshes.append(glass_mesh)
    scene.instances.mesh = np.array([0, 1], np.int32)
    return scene


BROKEN_KINDS = tuple(_BROKEN)
