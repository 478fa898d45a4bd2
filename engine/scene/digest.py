# SPDX-License-Identifier: GPL-3.0-or-later
"""Short digests of what descriptions say, to tell whether anything has changed."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Collection, Sequence
from functools import cached_property
from typing import Any

import numpy as np

from engine.scene.description import SceneDescription

#: From so many items on, a list of one dataclass is read field by field.
_MANY = 256
#: Types whose values an array tells apart, and that array's.
_NUMBERS = {float: np.float64, bool: np.bool_}


def content_digest(value: Any, left_out: Collection[str] = ()) -> str:
    """A digest of plain data: dataclasses, containers, arrays, and whatever has a `repr` of its own.

    Parameters
    ----------
    left_out : collection of str
        Fields of dataclasses that do not count.
    """
    digest = hashlib.blake2b(digest_size=16)

    def add_column(column: Sequence[Any]) -> None:
        """Many values of one field at once, where they are of one kind; else each by itself."""
        kinds = set(map(type, column))
        digest.update(repr((len(column), sorted(kind.__name__ for kind in kinds))).encode())
        kind = kinds.pop() if len(kinds) == 1 else None
        if kind in _NUMBERS:
            digest.update(np.array(column, _NUMBERS[kind]).data)
        elif kind in (int, str, type(None)):
            digest.update(repr(column).encode())
        elif kind is tuple and len({len(item) for item in column}) == 1:
            for part in zip(*column, strict=True):
                add_column(part)
        elif kind is np.ndarray and len({(item.shape, item.dtype) for item in column}) == 1:
            add(np.concatenate([item[None] for item in column]))
        else:
            # What many share, as the nodes of lights do, is read once.
            numbers: dict[int, int] = {}
            places = [numbers.setdefault(id(item), len(numbers)) for item in column]
            digest.update(np.array(places, np.int64).data)
            seen = {number: item for number, item in zip(places, column, strict=True)}
            for number in range(len(numbers)):
                add(seen[number])

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
        elif isinstance(item, list) and len(item) >= _MANY and _is_of_one_dataclass(item):
            for field in dataclasses.fields(item[0]):
                if field.name not in left_out:
                    digest.update(repr(field.name).encode())
                    add_column([getattr(part, field.name) for part in item])
        elif isinstance(item, (list, tuple)):
            digest.update(b"(")
            for part in item:
                add(part)
            digest.update(b")")
        elif isinstance(item, frozenset) and len(item) > 1:
            # The order of sets of texts is another one in each process.
            digest.update(f"frozenset({{{', '.join(sorted(map(repr, item)))}}});".encode())
        else:
            digest.update(repr(item).encode())
            digest.update(b";")

    add(value)
    return digest.hexdigest()


def _is_of_one_dataclass(items: Sequence[Any]) -> bool:
    return len(set(map(type, items))) == 1 and dataclasses.is_dataclass(items[0])


def light_digest(description: SceneDescription) -> str:
    """A digest of all that light depends on: shapes, materials, lights and the world, but not the pixels of images."""
    shapes = [
        (mesh.vertices, mesh.triangles, mesh.material_slots, mesh.motion_vertices, *filter(None, [mesh.rounds]))
        for mesh in description.meshes
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


class SceneDigest:
    """A digest of all that a picture depends on besides the settings: the pixels of images, the camera and the frame.

    Where two descriptions have the same, the same settings make the same picture of them. It is worked out when it is
    first asked for, which takes two seconds for each gigabyte, and most renders are over before anybody asks. Whoever
    asks may do so while the scene is rendered, but nobody may change the description.

    Parameters
    ----------
    description : SceneDescription
    context : tuple
        Plain data that counts as well.
    keeps_meshes : bool
        Whether the description keeps its meshes (`Session.load`); else they are read at once.
    """

    def __init__(
        self, description: SceneDescription, context: tuple[Any, ...] = (), *, keeps_meshes: bool = True
    ) -> None:
        self._description, self._context = description, context
        self._meshes = "" if keeps_meshes else self._digest(description.meshes)

    @cached_property
    def value(self) -> str:
        """The digest."""
        meshes = self._meshes or self._digest(self._description.meshes)
        return content_digest((self._context, meshes, self._digest(self._description, "meshes")))

    @staticmethod
    def _digest(value: Any, *left_out: str) -> str:
        # Keys may be numbers that start anew with every export; users are for messages, and folders where pixels lie.
        return content_digest(value, ("key", "user", "folder", "notices", *left_out))


def scene_digest(description: SceneDescription) -> str:
    """The digest of a `SceneDigest`."""
    return SceneDigest(description).value
