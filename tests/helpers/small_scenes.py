# SPDX-License-Identifier: GPL-3.0-or-later
"""Small scenes of floors, walls and a lamp, written by hand: what they look like can be worked out on paper."""

from __future__ import annotations

from dataclasses import replace

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
)
from engine.scene.instances import plain_instances
from tests.helpers.placed_quads import steps, turned

_FLOOR = np.array([(-50, -50, 0), (50, -50, 0), (50, 50, 0), (-50, 50, 0)], np.float32)
_TRIANGLES = np.array([(0, 1, 2), (0, 2, 3)], np.uint32)


def looking_down(height=10.0):
    """A camera above the origin [m]."""
    matrix = np.eye(4, dtype=np.float32)
    matrix[2, 3] = height
    return Camera(transform=matrix)


def material(name="Grey", color=(0.5, 0.5, 0.5), kind="ShaderNodeBsdfDiffuse"):
    """A material of one node."""
    node = Node(kind, name, {"Color": (*color, 1.0), "Roughness": 0.0})
    output = "Emission" if kind == "ShaderNodeEmission" else "BSDF"
    return Material(name, name, NodeGraph([node], Link(0, output)))


def floor_scene(*, lights=(), world=None, materials=None, size=(48, 32), transforms=None):
    """A floor of two triangles, once per transform, seen from above."""
    transforms = [np.eye(4)] if transforms is None else transforms
    instances = plain_instances(transforms, name="Floor")
    instances.pass_index[:] = 7
    mesh = Mesh("floor", "Floor", _FLOOR, _TRIANGLES, None, np.zeros(2, np.int32))
    return SceneDescription(
        camera=looking_down(),
        frame=Frame(*size, (0, 0, *size)),
        meshes=[mesh],
        instances=instances,
        materials=[material()] if materials is None else materials,
        images=[],
        lights=list(lights),
        world=world,
    )


def sun(strength=2.0):
    """A sun without an angle, straight above; `strength` in W m^-2."""
    return Light("sun", "Sun", "SUN", np.eye(4, dtype=np.float32), (1.0, 1.0, 1.0), strength, angle=0.0)


def corner_scene(size=(40, 36)):
    """A floor and a wall that light each other, under a sun."""
    wall = np.array([[1, 0, 0, 0], [0, 0, -1, 3], [0, 1, 0, 0], [0, 0, 0, 1]], np.float32)
    return floor_scene(lights=[sun()], transforms=[np.eye(4), wall], size=size)


def pit_scene(size=(32, 32)):
    """A floor between four walls, open to a sun: light that has met five surfaces still counts."""
    walls = [np.array([[0, 0, x, x * 3], [0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 0, 1]], np.float32) for x in (-1, 1)]
    walls += [np.array([[1, 0, 0, 0], [0, 0, y, y * 3], [0, -1, 0, 0], [0, 0, 0, 1]], np.float32) for y in (-1, 1)]
    white = [material(color=(0.9, 0.9, 0.9))]
    return floor_scene(lights=[sun()], materials=white, transforms=[np.eye(4), *walls], size=size)


def emitter_scene(size=(16, 12)):
    """A floor lit by an emissive square that turns and flies by, and changes its shape."""
    glow = material("Glow", (4.0, 3.0, 2.0), "ShaderNodeEmission")
    description = floor_scene(size=size, materials=[material(), glow])
    square = np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], np.float32)
    mesh = replace(description.meshes[0], key="glow", name="Glow", vertices=square)
    mesh.motion_vertices = np.stack([square, square, 1.5 * square])
    motion = steps(*(turned(1.5 * t, 0, (5.0 * t, 0, 4.0), (1.0, 1.0, 1.0)) for t in (-1.0, 0.0, 1.0)))
    flat = description.instances
    for name in ("transform", "material_offset", "visibility", "pass_index", "random", "color", "is_holdout",
                 "dupli_generated", "dupli_uv"):  # fmt: skip
        setattr(flat, name, np.concatenate([getattr(flat, name)] * 2))
    flat.transform = np.stack([np.eye(4, dtype=np.float32), motion[1]])
    flat.mesh, flat.name = np.array([0, 1], np.int32), ["Floor", "Glow"]
    flat.material_offset, flat.materials = np.array([0, 1], np.int32), np.array([0, 1], np.int32)
    flat.motion = {1: motion}
    description.meshes.append(mesh)
    return description
