# SPDX-License-Identifier: GPL-3.0-or-later
"""Attributes of the instances that geometry nodes make, which Attribute nodes of the type Instancer read."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import bpy
import numpy as np

from engine.array_types import Float32Array, Int32Array

from .attributes import read_values
from .object_properties import Value

#: What `persistent_id` has where there is no further level.
_NO_LEVEL = 2**31 - 1


class InstanceAttributes:
    """Of all objects whose geometry nodes instance something, read when they are asked for."""

    def __init__(self) -> None:
        self._levels: dict[int, _Level | None] = {}

    def find(self, instancer: bpy.types.Object, ids: Sequence[int], name: str) -> Value | None:
        """The value of one instance; None where no level of its instances has such an attribute.

        Parameters
        ----------
        instancer : Object
            Evaluated; whose geometry nodes made the instance.
        ids : sequence of int
            `DepsgraphObjectInstance.persistent_id`: the outermost level is the last.
        """
        address = instancer.as_pointer()
        if address not in self._levels:
            self._levels[address] = _level_of(_geometry_of(instancer))
        level, found = self._levels[address], []
        for number in reversed([number for number in ids if number != _NO_LEVEL]):
            row = level.row(number) if level is not None else None
            if level is None or row is None:
                break
            found.append((level, row))
            level = level.below(row)
        # What is nearest to the instance counts.
        for level, row in reversed(found):
            values = level.values(name)
            if values is not None:
                red, green, blue, alpha = values[row].tolist()
                return (red, green, blue, alpha)
        return None


def _geometry_of(instancer: bpy.types.Object) -> Any:
    # Blender 4.5 and later say what geometry nodes made.
    return instancer.evaluated_geometry() if hasattr(instancer, "evaluated_geometry") else None


def _level_of(geometry: Any) -> _Level | None:
    cloud = geometry.instances_pointcloud() if geometry is not None else None
    return None if cloud is None else _Level(geometry, cloud)


class _Level:
    """Instances in one set of geometry: their attributes, and what each of them is an instance of.

    Parameters
    ----------
    geometry : GeometrySet
    cloud : PointCloud
        A point for each instance.
    """

    def __init__(self, geometry: Any, cloud: bpy.types.PointCloud) -> None:
        # Blender frees the cloud with the set.
        self._geometry, self._cloud = geometry, cloud
        self._references = geometry.instance_references()
        self._reference_of = _integers(cloud, ".reference_index")
        ids = _integers(cloud, "id")
        self._row_of = None if ids is None else {number: row for row, number in reversed(list(enumerate(ids.tolist())))}
        self._below: dict[int, _Level | None] = {}
        self._values: dict[str, Float32Array | None] = {}

    def row(self, number: int) -> int | None:
        """The instance of that persistent number: its id, or its index where instances have no ids."""
        if self._row_of is not None:
            return self._row_of.get(number)
        count = 0 if self._reference_of is None else len(self._reference_of)
        return number if 0 <= number < count else None

    def below(self, row: int) -> _Level | None:
        """The instances that an instance is made of, if it is made of such."""
        assert self._reference_of is not None
        reference = int(self._reference_of[row])
        if reference not in self._below:
            inner = self._references[reference] if 0 <= reference < len(self._references) else None
            self._below[reference] = _level_of(inner) if isinstance(inner, bpy.types.GeometrySet) else None
        return self._below[reference]

    def values(self, name: str) -> Float32Array | None:
        """An attribute of all of them as colours, float32 (N, 4)."""
        if name not in self._values:
            stored = self._cloud.attributes.get(name)
            self._values[name] = None if stored is None else _as_colors(stored)
        return self._values[name]


def _as_colors(stored: bpy.types.Attribute) -> Float32Array | None:
    """Values as Blender converts them to colours; None for types that it does not convert."""
    if stored.data_type == "QUATERNION":
        return None
    values = read_values(stored)
    if values is None:
        return None
    colors = np.zeros((len(values), 4), np.float32)
    colors[:, 3] = 1.0
    width = values.shape[1]
    if width == 1:
        colors[:, :3] = values
    else:
        colors[:, :width] = values
    return colors


def _integers(cloud: bpy.types.PointCloud, name: str) -> Int32Array | None:
    stored = cloud.attributes.get(name)
    if stored is None or stored.data_type != "INT":
        return None
    values = np.empty(len(stored.data), np.int32)
    stored.data.foreach_get("value", values)
    return values
