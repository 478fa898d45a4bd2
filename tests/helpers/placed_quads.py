# SPDX-License-Identifier: GPL-3.0-or-later
"""Where things are, as matrices, and quads that stand there."""

from __future__ import annotations

import math

import numpy as np

from engine.accel.accelerator import build_accelerator
from engine.accel.hierarchies import MeshHierarchies
from engine.accel.masks import MASK_SHADOW_OPAQUE
from engine.builder.geometry import build_geometry
from engine.scene.description import Camera, Frame, Mesh, SceneDescription
from engine.scene.instances import empty_instances, plain_instances

QUAD = np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], np.float32)
QUAD_TRIANGLES = np.array([(0, 1, 2), (0, 2, 3)], np.uint32)


def quad_scene(transforms, visibility=None, vertices=QUAD, triangles=QUAD_TRIANGLES):
    """Description of a quad instanced by each of `transforms`."""
    instances = plain_instances(transforms, materials=-1)
    instances.name = [f"Quad {i}" for i in range(len(transforms))]
    if visibility is not None:
        instances.visibility = np.asarray(visibility, np.uint32)
    assert empty_instances().mesh.size == 0
    mesh = Mesh("quad", "Quad", vertices, triangles, None, np.zeros(len(triangles), np.int32))
    return SceneDescription(Camera(), Frame(4, 4, (0, 0, 4, 4)), [mesh], instances, [], [], [], None)


def at(x, y, z, scale=(1.0, 1.0, 1.0)):
    """Object to world: scaled, moved."""
    matrix = np.diag([*scale, 1.0])
    matrix[:3, 3] = x, y, z
    return matrix


def built(description, notices=None):
    """Arrays of a description, and Embree's scene of them; `notices` is appended to."""
    geometry = build_geometry(description, (), [] if notices is None else notices)
    masks = np.full(len(geometry.instance_table), MASK_SHADOW_OPAQUE, np.uint32)
    return geometry, build_accelerator(geometry, masks, MeshHierarchies(1))


def turned(angle, axis=2, position=(0.0, 0.0, 0.0), scale=(1.0, 1.0, 1.0)):
    """Object to world: scaled, turned about an axis [rad], moved."""
    c, s = math.cos(angle), math.sin(angle)
    matrix = np.eye(4)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    matrix[i, i], matrix[i, j], matrix[j, i], matrix[j, j] = c, -s, s, c
    matrix[:3, :3] = matrix[:3, :3] @ np.diag(scale)
    matrix[:3, 3] = position
    return matrix


def steps(*matrices):
    """Matrices of one object at even times of the shutter, float32 (N, 4, 4)."""
    return np.stack(matrices).astype(np.float32)
