# SPDX-License-Identifier: GPL-3.0-or-later
"""Shapes that rooms are made and furnished with: boxes, Blender's primitives, leaves."""

from __future__ import annotations

import math
from collections.abc import Sequence

import bpy
from mathutils import Matrix

Vector = Sequence[float]


def add_object(name: str, data: bpy.types.ID | None, material: bpy.types.Material | None = None) -> bpy.types.Object:
    """An object of the open scene; `material` is added to its data."""
    item = bpy.data.objects.new(name, data)
    bpy.context.scene.collection.objects.link(item)
    if material is not None:
        data.materials.append(material)
    return item


def box(
    name: str, low: Vector, high: Vector, material: bpy.types.Material, bevel: float = 0.0, segments: int = 3
) -> bpy.types.Object:
    """An axis-aligned box, its origin in its middle."""
    half = [(b - a) / 2 for a, b in zip(low, high, strict=True)]
    corners = [(x * half[0], y * half[1], z * half[2]) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(corners, [], faces)
    item = add_object(name, mesh, material)
    item.location = [(a + b) / 2 for a, b in zip(low, high, strict=True)]
    if bevel:
        modifier = item.modifiers.new("Bevel", "BEVEL")
        modifier.width, modifier.segments = bevel, segments
    return item


def hang(item: bpy.types.Object, hinge: Vector, angle: float) -> None:
    """Turn an object about a vertical hinge [radians, counterclockwise from above]."""
    item.data.transform(Matrix.Translation([a - b for a, b in zip(item.location, hinge, strict=True)]))
    item.location = hinge
    item.rotation_euler.z = angle


def smooth(item: bpy.types.Object) -> bpy.types.Object:
    """The object itself, shaded smooth."""
    for polygon in item.data.polygons:
        polygon.use_smooth = True
    return item


def primitive(operator: object, name: str, material: bpy.types.Material, **arguments: object) -> bpy.types.Object:
    """One of Blender's primitives, shaded smooth."""
    operator(**arguments)  # type: ignore[operator]
    item = bpy.context.active_object
    item.name = name
    item.data.materials.append(material)
    return smooth(item)


def suzanne(
    name: str, material: bpy.types.Material, location: Vector, size: float, turn: float, levels: int = 2
) -> bpy.types.Object:
    """Blender's monkey, leaning back a little and turned by so many degrees."""
    item = primitive(bpy.ops.mesh.primitive_monkey_add, name, material, size=size, location=location)
    item.rotation_euler = (math.radians(-14.0), 0.0, math.radians(turn))
    item.modifiers.new("Subdivision", "SUBSURF").render_levels = levels
    return item


def turned(name: str, profile: Sequence[tuple[float, float]], material: bpy.types.Material) -> bpy.types.Object:
    """A body turned on a lathe, its foot at its origin.

    Parameters
    ----------
    profile : sequence of (radius, height)
        From the foot's middle along the outside, and inside down again if it is hollow.
    """
    count = 64
    points = [
        (radius * math.cos(math.tau * k / count), radius * math.sin(math.tau * k / count), height)
        for radius, height in profile
        for k in range(count)
    ]
    faces = [
        (row * count + k, row * count + (k + 1) % count, (row + 1) * count + (k + 1) % count, (row + 1) * count + k)
        for row in range(len(profile) - 1)
        for k in range(count)
    ]
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(points, [], faces)
    item = smooth(add_object(name, mesh, material))
    item.modifiers.new("Subdivision", "SUBSURF").render_levels = 1
    return item


def leaf(name: str, length: float, width: float, material: bpy.types.Material) -> bpy.types.Mesh:
    """A leaf along x that bends down towards its tip, folded along its midrib; z points up."""
    rows, columns = 10, 4
    points = []
    for row in range(rows + 1):
        along = row / rows
        breadth = width * math.sin(math.pi * along**0.75) * (1.0 - 0.3 * along)
        for column in range(columns + 1):
            across = 2.0 * column / columns - 1.0
            points.append((
                length * along * math.cos(0.5 * along), breadth * across / 2.0,
                0.18 * width * abs(across) - length * along * math.sin(0.5 * along * along),
            ))  # fmt: skip
    step = columns + 1
    faces = [
        (row * step + column, row * step + column + 1, (row + 1) * step + column + 1, (row + 1) * step + column)
        for row in range(rows)
        for column in range(columns)
    ]
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(points, [], faces)
    mesh.materials.append(material)
    for polygon in mesh.polygons:
        polygon.use_smooth = True
    return mesh
