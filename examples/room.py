# SPDX-License-Identifier: GPL-3.0-or-later
"""A room as a description: what the other examples render.

A lamp shines at the ceiling, so all light that the camera sees has met a surface before. That is where guiding pays.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from engine.scene.description import Camera, Frame, Light, Link, Material, Mesh, Node, NodeGraph, SceneDescription
from engine.scene.instances import plain_instances

#: Boxes by name: two corners [m], and the number of a material.
BOXES = {
    "Floor": ((-3.0, -3.0, -0.1), (3.0, 3.0, 0.0), 0),
    "Ceiling": ((-3.0, -3.0, 3.0), (3.0, 3.0, 3.1), 0),
    "Left wall": ((-3.1, -3.0, 0.0), (-3.0, 3.0, 3.0), 1),
    "Right wall": ((3.0, -3.0, 0.0), (3.1, 3.0, 3.0), 2),
    "Front wall": ((-3.0, -3.1, 0.0), (3.0, -3.0, 3.0), 0),
    "Back wall": ((-3.0, 3.0, 0.0), (3.0, 3.1, 3.0), 0),
    "Pedestal": ((-0.4, -0.4, 0.0), (0.4, 0.4, 0.5), 0),
    "Tower": ((-0.3, -0.2, 0.5), (0.0, 0.2, 1.3), 1),
    "Block": ((0.05, -0.3, 0.5), (0.35, 0.1, 0.8), 2),
}
#: Materials by name: colours, linear Rec.709.
COLORS = {"White": (0.8, 0.8, 0.8), "Red": (0.7, 0.15, 0.1), "Blue": (0.1, 0.2, 0.6)}


def cube() -> Mesh:
    """A cube from (0, 0, 0) to (1, 1, 1)."""
    vertices = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)], np.float32)
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    triangles = [(a, b, c) for a, b, c, _ in faces] + [(a, c, d) for a, _, c, d in faces]
    return Mesh(
        key="cube", name="Cube", vertices=vertices, triangles=np.array(triangles, np.uint32), corner_normals=None,
        material_slots=np.zeros(len(triangles), np.int32),
    )  # fmt: skip


def placed(low: Sequence[float], high: Sequence[float]) -> npt.NDArray[np.float64]:
    """The matrix (4, 4) that makes the cube a box from `low` to `high`."""
    matrix = np.diag([*np.subtract(high, low), 1.0])
    matrix[:3, 3] = low
    return matrix


def diffuse(name: str, color: tuple[float, float, float]) -> Material:
    """A material of one node, a Diffuse BSDF."""
    node = Node("ShaderNodeBsdfDiffuse", "Diffuse BSDF", {"Color": (*color, 1.0), "Roughness": 0.0})
    return Material(key=name, name=name, graph=NodeGraph([node], surface=Link(0, "BSDF")))


def camera_around(angle: float, distance: float = 2.4, height: float = 1.5) -> Camera:
    """A camera that looks at the pedestal from an angle about the z axis [rad]."""
    eye = np.array([distance * math.sin(angle), -distance * math.cos(angle), height])
    backward = eye - (0.0, 0.0, 0.8)
    backward /= np.linalg.norm(backward)
    right = np.cross((0.0, 0.0, 1.0), backward)
    right /= np.linalg.norm(right)
    matrix = np.eye(4, dtype=np.float32)
    # A camera looks along its own -z, with y up.
    matrix[:3, :4] = np.stack([right, np.cross(backward, right), backward, eye], axis=1)
    return Camera(transform=matrix, lens=24.0)


def frame(width: int = 96, height: int = 64) -> Frame:
    """A picture of so many pixels, all of which are rendered."""
    return Frame(width, height, region=(0, 0, width, height))


def room() -> SceneDescription:
    """The whole scene."""
    upward = np.diag([1.0, -1.0, -1.0, 1.0]).astype(np.float32)  # a lamp shines along its own -z
    upward[2, 3] = 2.2
    lamp = Light(
        key="lamp", name="Lamp", kind="SPOT", transform=upward, color=(1.0, 0.9, 0.75), energy=800.0, radius=0.05,
        spot_angle=math.radians(80.0),
    )  # fmt: skip
    instances = plain_instances(
        [placed(low, high) for low, high, _ in BOXES.values()], materials=[number for *_, number in BOXES.values()]
    )
    instances.name = list(BOXES)
    return SceneDescription(
        camera=camera_around(0.4),
        frame=frame(),
        meshes=[cube()],
        instances=instances,
        materials=[diffuse(name, color) for name, color in COLORS.items()],
        images=[],
        lights=[lamp],
        world=None,
    )
