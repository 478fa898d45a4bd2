# SPDX-License-Identifier: GPL-3.0-or-later
"""Attributes that geometry nodes give to instances: what Attribute nodes of the type Instancer read first.

Blender tells each instance by a path of numbers, `persistent_id`: one for each level of instances in instances, the
innermost first. Along that path the geometry of the instancer leads to the point of each level, which has the
attributes. The innermost level that has one counts, as in Cycles.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import bpy
import numpy as np
import numpy.typing as npt

from engine.array_types import Float32Array, Int32Array

from .attributes import read_values

#: What stands in a path behind its last number.
_END = np.iinfo(np.int32).max
#: Deepest path.
PATH_LENGTH = 8

#: Types of objects that may have geometry of several kinds.
_WITH_GEOMETRY = frozenset({
    "MESH", "CURVE", "SURFACE", "FONT", "CURVES", "POINTCLOUD", "VOLUME", "GREASEPENCIL",
})  # fmt: skip

#: Blender's types of two components, which only instances can have as colours.
_INTEGER_PAIRS = ("INT32_2D", "INT16_2D")

Rows = npt.NDArray[np.intp]


def can_read_instances() -> bool:
    """Whether this Blender shows Python what geometry nodes instance."""
    return hasattr(bpy.types.Object, "evaluated_geometry")


class InstanceAttributes:
    """Values of attributes of the instances that one object makes.

    Attributes
    ----------
    values : dict
        By name: float32 (N, 4), RGBA, and bool (N,), which instances have the attribute.
    is_lost : bool (N,)
        Which instances were not followed to the end of their path.
    """

    def __init__(self, instancer: bpy.types.Object, paths: Int32Array, names: Iterable[str], *, is_final: bool) -> None:
        """Follow all paths at once.

        Parameters
        ----------
        instancer : Object
            Evaluated.
        paths : int32 (N, PATH_LENGTH)
            `persistent_id` of its instances, in the dependency graph's order.
        names : iterable of str
        is_final : bool
            Whether objects are shown that final renders show, rather than windows.
        """
        count = len(paths)
        self.values = {name: (np.zeros((count, 4), np.float32), np.zeros(count, bool)) for name in names}
        self.is_lost = np.zeros(count, bool)
        self._is_final = is_final
        self._lengths = (paths != _END).sum(axis=1)
        # Outermost first.
        columns = self._lengths[:, None] - 1 - np.arange(PATH_LENGTH)
        self._paths = np.take_along_axis(paths, np.maximum(columns, 0), axis=1)
        self._follow_object(instancer, np.arange(count), 0)

    def _follow_object(self, owner: bpy.types.Object, rows: Rows, level: int) -> None:
        """Instances that an object makes, numbered at this level of their paths."""
        geometry = owner.evaluated_geometry() if owner.type in _WITH_GEOMETRY else None
        if geometry is not None and geometry.instances_pointcloud() is not None:
            self._follow_geometry(geometry, owner.type, rows, level, is_instance=False)
        elif owner.instance_type == "COLLECTION" and owner.instance_collection is not None:
            objects = owner.instance_collection.all_objects
            for number, inner in self._inner(rows, level):
                self._follow_some(objects[number] if number < len(objects) else None, inner, level + 1)
        else:
            # Instances on vertices, faces and particles; these have no attributes.
            self.is_lost[rows[self._lengths[rows] > level + 2]] = True

    def _follow_some(self, owner: bpy.types.Object | None, rows: Rows, level: int) -> None:
        if owner is None:
            self.is_lost[rows] = True
        else:
            self._follow_object(owner, rows, level)

    def _follow_geometry(self, geometry: Any, type_: str, rows: Rows, level: int, *, is_instance: bool) -> None:
        """Instances of a geometry set; what else is in it has numbers of its own, before all instances."""
        others = _component_count(geometry, type_, is_instance=is_instance)
        if others > 0:
            rows = rows[self._paths[rows, level] >= others]
            level += 1
        rows = rows[self._lengths[rows] > level]
        cloud = geometry.instances_pointcloud()
        if cloud is None or len(rows) == 0:
            return
        points = _points_of(_read_ids(cloud), self._paths[rows, level])
        self.is_lost[rows[points < 0]] = True
        rows, points = rows[points >= 0], points[points >= 0]
        for name, (values, has) in self.values.items():
            colors = _read_colors(cloud, name)
            if colors is not None:
                values[rows] = colors[points]
                has[rows] = True
        references = geometry.instance_references()
        handles = np.zeros(len(cloud.points), np.int32)
        cloud.attributes[".reference_index"].data.foreach_get("value", handles)
        of_rows = handles[points]
        for handle in np.unique(of_rows).tolist():
            some = rows[of_rows == handle]
            some = some[self._lengths[some] > level + 1]
            reference = references[handle] if 0 <= handle < len(references) else None
            if reference is None or len(some) == 0:
                continue
            if isinstance(reference, bpy.types.Object):
                self._follow_object(reference, some, level + 1)
            elif isinstance(reference, bpy.types.Collection):
                self._follow_collection(reference, some, level + 1)
            else:
                self._follow_geometry(reference, type_, some, level + 1, is_instance=True)

    def _follow_collection(self, collection: bpy.types.Collection, rows: Rows, level: int) -> None:
        """Objects of an instanced collection: each has one number for itself, and the next for what it instances."""
        hidden = "hide_render" if self._is_final else "hide_viewport"
        objects = [item for item in collection.all_objects if not getattr(item, hidden)]
        for number, inner in self._inner(rows, level):
            self._follow_some(objects[number // 2] if number // 2 < len(objects) else None, inner, level + 1)

    def _inner(self, rows: Rows, level: int) -> Iterable[tuple[int, Rows]]:
        """Instances whose path goes on behind a level, by the number that they have there."""
        rows = rows[self._lengths[rows] > level + 1]
        numbers = self._paths[rows, level]
        return [(number, rows[numbers == number]) for number in np.unique(numbers).tolist()]


def _component_count(geometry: Any, type_: str, *, is_instance: bool) -> int:
    """How many things beside instances Blender shows as instances of an object: its own geometry is none."""
    own = {
        "mesh": ("MESH",), "volume": ("VOLUME",), "curves": ("CURVE", "FONT", "CURVES"), "pointcloud": ("POINTCLOUD",),
        "grease_pencil": ("GREASEPENCIL",),
    }  # fmt: skip
    return sum(
        getattr(geometry, name) is not None and (is_instance or type_ not in types) for name, types in own.items()
    )


def _read_ids(cloud: bpy.types.PointCloud) -> Int32Array:
    """The numbers that paths have for instances."""
    stored = cloud.attributes.get("id")
    if stored is None or stored.data_type != "INT":
        return np.arange(len(cloud.points), dtype=np.int32)
    ids = np.empty(len(cloud.points), np.int32)
    stored.data.foreach_get("value", ids)
    return ids


def _points_of(ids: Int32Array, numbers: Int32Array) -> Rows:
    """Row of `ids` of each number, -1 where there is none.

    The first of several equal ids keeps its number. Blender draws others for the rest: as instances come in the order
    of the points, so do these.
    """
    known, first = np.unique(ids, return_index=True)
    at = np.minimum(np.searchsorted(known, numbers), len(known) - 1)
    points = np.where(known[at] == numbers, first[at], -1).astype(np.intp)
    repeated = np.setdiff1d(np.arange(len(ids)), first)
    unknown = np.flatnonzero(points < 0)
    drawn, appears = np.unique(numbers[unknown], return_index=True)
    if len(drawn) == len(repeated) and len(drawn) > 0:
        of_drawn = np.empty(len(drawn), np.intp)
        of_drawn[np.argsort(appears)] = repeated
        points[unknown] = of_drawn[np.searchsorted(drawn, numbers[unknown])]
    return points


def _read_colors(cloud: bpy.types.PointCloud, name: str) -> Float32Array | None:
    """An attribute of points as RGBA, float32 (N, 4), as Blender converts its types; None if there is none."""
    stored = cloud.attributes.get(name)
    # Instances have no positions: only this point cloud, which stands for them, does.
    if stored is None or stored.data_type == "QUATERNION" or name == "position":
        return None
    if stored.data_type in _INTEGER_PAIRS:
        pairs = np.empty(2 * len(stored.data), np.int32)
        stored.data.foreach_get("value", pairs)
        values: Float32Array | None = pairs.reshape(-1, 2).astype(np.float32)
    else:
        values = read_values(stored)
    if values is None:
        return None
    width = values.shape[1]
    colors = np.zeros((len(values), 4), np.float32)
    colors[:, 3] = 1.0
    colors[:, : max(width, 3) if width == 1 else width] = values
    return colors
