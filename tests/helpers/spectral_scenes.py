# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenes of squares and prisms, seen from above, whose glass may disperse."""

from __future__ import annotations

from typing import Any

import numpy as np

from engine.scene.description import (
    Camera,
    Frame,
    Light,
    Link,
    Material,
    Mesh,
    Node,
    NodeGraph,
    SceneDescription,
    World,
)
from engine.scene.instances import plain_instances

#: Strong, so that little light shows it: an Abbe number of about 10.
DISPERSION = 0.05
IOR = 1.5


def material(kind: str, dispersion: float = 0.0, **inputs: Any) -> Material:
    """A material of one node; `dispersion` as in `scene.description.Material`."""
    output = {"Emission": "Emission"}.get(kind, "BSDF")
    name = f"ShaderNode{kind}" if kind == "Emission" else f"ShaderNodeBsdf{kind}"
    graph = NodeGraph([Node(name, kind, inputs)], Link(0, output))
    return Material(kind, kind, graph, dispersion=dispersion)


def diffuse(color: tuple[float, float, float]) -> Material:
    """A diffuse material."""
    return material("Diffuse", Color=(*color, 1.0), Roughness=0.0)


def glass(ior: float, roughness: float, dispersion: float, kind: str = "Glass") -> Material:
    """White glass, or another node with a refractive index."""
    created = material(kind, dispersion, Color=(1.0, 1.0, 1.0, 1.0), Roughness=roughness, IOR=ior)
    if kind == "Refraction" and created.graph is not None:
        # Facets that disperse are GGX, so those that do not are here too.
        for node in created.graph.nodes:
            node.properties["distribution"] = "GGX"
    return created


def square(size: float, height: float, shift: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and triangles of a square of half side `size` [m] that faces the camera."""
    corners = np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], np.float32) * size
    return corners + np.array((shift, 0.0, height), np.float32), np.array([(0, 1, 2), (0, 2, 3)], np.uint32)


def wedge() -> tuple[np.ndarray, np.ndarray]:
    """A prism over the whole view, thick on one side; its upper side faces the camera."""
    corners = np.array(
        [(-4, -4, 2), (4, -4, 2), (4, 4, 2), (-4, 4, 2), (-4, -4, 2.2), (4, -4, 5.5), (4, 4, 5.5), (-4, 4, 2.2)],
        np.float32,
    )
    quads = [(3, 2, 1, 0), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)]
    return corners, np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))], np.uint32)


def scene(
    parts: list[tuple[tuple[np.ndarray, np.ndarray], Material]], *, size: tuple[int, int] = (12, 1),
    lights: tuple[Light, ...] = (), world: World | None = None,
) -> SceneDescription:
    """Meshes with a material each, seen from above."""
    camera = np.eye(4, dtype=np.float32)
    camera[2, 3] = 12.0
    return SceneDescription(
        camera=Camera(transform=camera),
        frame=Frame(*size, (0, 0, *size)),
        meshes=[
            Mesh(f"m{k}", f"m{k}", vertices, triangles, None, np.zeros(len(triangles), np.int32))
            for k, ((vertices, triangles), _) in enumerate(parts)
        ],
        instances=plain_instances([np.eye(4)] * len(parts), meshes=range(len(parts)), materials=range(len(parts))),
        materials=[material for _, material in parts],
        images=[],
        lights=list(lights),
        world=world,
    )
