# SPDX-License-Identifier: GPL-3.0-or-later
"""Short digests of what descriptions say, to tell whether anything has changed."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Collection
from typing import Any

import numpy as np

from engine.scene.description import SceneDescription


def content_digest(value: Any, left_out: Collection[str] = ()) -> str:
    """A digest of plain data: dataclasses, containers, arrays, and whatever has a `repr` of its own.

    Parameters
    ----------
    left_out : collection of str
        Fields of dataclasses that do not count.
    """
    digest = hashlib.blake2b(digest_size=16)

    def add(item: Any) -> None:
        if isinstance(item, np.ndarray):
            digest.update(repr((item.shape, item.dtype.str)).encode())
            digest.update(np.ascontiguousarray(item).data)
        elif dataclasses.is_dataclass(item):
            add({field.name: getattr(item, field.name) for field in dataclasses.fields(item)
                 if field.name not in left_out})
        elif isinstance(item, dict):
            digest.update(b"{")
            for name, part in item.items():
                digest.update(repr(name).encode())
                add(part)
            digest.update(b"}")
        elif isinstance(item, (list, tuple)):
            digest.update(b"(")
            for part in item:
                add(part)
            digest.update(b")")
        else:
            digest.update(repr(item).encode())
            digest.update(b";")

    add(value)
    return digest.hexdigest()


def light_digest(description: SceneDescription) -> str:
    """A digest of all that light depends on: shapes, materials, lights and the world, but not the pixels of images."""
    shapes = [
        (mesh.vertices, mesh.triangles, mesh.material_slots, mesh.motion_vertices) for mesh in description.meshes
    ]
    instances = description.instances
    placed = (instances.mesh, instances.transform, instances.materials, instances.visibility, instances.motion)
    images = [image.name for image in description.images]
    others = (description.materials, description.lights, description.world)
    # Keys may be numbers that start anew with every export; users of materials are for messages; groups only sort
    # light.
    return content_digest((shapes, placed, images, others), ("key", "user", "light_group"))


def camera_digest(description: SceneDescription) -> str:
    """A digest of where the camera is and what it sees."""
    return content_digest(description.camera)
