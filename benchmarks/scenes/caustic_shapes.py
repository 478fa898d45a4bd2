# SPDX-License-Identifier: GPL-3.0-or-later
"""Closed, smooth bodies of glass and metal, whose normals are good enough to focus light: turned, wavy and cut ones."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

from benchmarks.scenes.studio import mesh, sort_faces

Profile = Sequence[tuple[float, float]]

#: Where a corner's rounding ends an edge gets one more point, so that its plane part keeps its own normal.
_SUPPORT = 1.35
#: Longest share of an edge that the rounding of one of its corners takes.
_MOST_OF_EDGE = 0.35


def rounded(corners: Profile, radius: float, steps: int = 6, is_closed: bool = False) -> list[tuple[float, float]]:
    """Corners of a line replaced by arcs (quadratic Bézier curves), its ends as they are.

    Parameters
    ----------
    corners : (x, y) [m]
    radius : float
        Distance from a corner at which its arc begins [m]; less on short edges.
    is_closed : bool
        Whether the last corner is followed by the first.
    """
    count = len(corners)
    points: list[tuple[float, float]] = []
    for i, (x, y) in enumerate(corners):
        if not is_closed and i in (0, count - 1):
            points.append((x, y))
            continue
        ends = []
        for other_x, other_y in (corners[i - 1], corners[(i + 1) % count]):
            length = math.hypot(other_x - x, other_y - y)
            reach = min(radius, _MOST_OF_EDGE * length)
            ends.append(((other_x - x) / length * reach, (other_y - y) / length * reach))
        (ax, ay), (bx, by) = ends
        points.append((x + _SUPPORT * ax, y + _SUPPORT * ay))
        for k in range(steps + 1):
            t = k / steps
            points.append((x + (1.0 - t) ** 2 * ax + t * t * bx, y + (1.0 - t) ** 2 * ay + t * t * by))
        points.append((x + _SUPPORT * bx, y + _SUPPORT * by))
    return points


def _smooth(data: Any) -> Any:
    data.polygons.foreach_set("use_smooth", [True] * len(data.polygons))
    return data


def turned(
    name: str, profile: Profile, surface: Any, segments: int = 128, is_closed: bool = False,
    swell: Callable[[float], float] = lambda angle: 1.0,
) -> Any:  # fmt: skip
    """A mesh turned about the z axis.

    Parameters
    ----------
    profile : (radius, height) [m]
        From the foot's middle along the outside and, if it is hollow, inside down again; a radius of 0 is a pole. Of a
        ring (`is_closed`): counterclockwise as seen with the axis at the left.
    swell : callable
        Factor on radii by the angle about the axis [rad].
    """
    vertices: list[tuple[float, float, float]] = []
    rows: list[list[int]] = []
    turns = [math.tau * k / segments for k in range(segments)]
    for radius, height in profile:
        if radius == 0.0:
            rows.append([len(vertices)] * segments)
            vertices.append((0.0, 0.0, height))
            continue
        rows.append(list(range(len(vertices), len(vertices) + segments)))
        vertices += [
            (radius * swell(turn) * math.cos(turn), radius * swell(turn) * math.sin(turn), height) for turn in turns
        ]
    pairs = list(zip(rows, rows[1:] + rows[:1], strict=True))
    faces = []
    for low, high in pairs if is_closed else pairs[:-1]:
        for k in range(segments):
            after = (k + 1) % segments
            corners = dict.fromkeys((low[k], low[after], high[after], high[k]))
            if len(corners) > 2:
                faces.append(tuple(corners))
    return _smooth(mesh(name, vertices, faces, surface))


def wavy(
    name: str, surface: Any, size: tuple[float, float], cells: int, height: Callable[[float, float], float]
) -> Any:
    """An open sheet over the xy plane, facing +z, of a height [m] by place [m]."""
    along = [k / cells - 0.5 for k in range(cells + 1)]
    vertices = [(u * size[0], v * size[1], height(u * size[0], v * size[1])) for v in along for u in along]
    step = cells + 1
    faces = [
        (row * step + k, row * step + k + 1, (row + 1) * step + k + 1, (row + 1) * step + k)
        for row in range(cells)
        for k in range(cells)
    ]
    return _smooth(mesh(name, vertices, faces, surface))


def cut_stone(name: str, surface: Any, radius: float, sides: int = 8) -> Any:
    """A jewel cut like a brilliant, its point at the origin, with flat faces.

    Proportions are Tolkowsky's (1919), "Diamond Design": table 53%, crown 16.2% and pavilion 43.1% of the width.
    """
    import bmesh
    import bpy

    width = 2.0 * radius
    girdle, top = 0.431 * width, (0.431 + 0.162 + 0.01) * width
    rings = (
        (0.53 * radius, top, sides, 0.5), (0.8 * radius, 0.5 * (girdle + top), sides, 0.0),
        (radius, girdle + 0.01 * width, 2 * sides, 0.0), (radius, girdle, 2 * sides, 0.0),
        (0.55 * radius, 0.52 * girdle, sides, 0.5),
    )  # fmt: skip
    grid = bmesh.new()
    grid.verts.new((0.0, 0.0, 0.0))
    for distance, height, count, shift in rings:
        for k in range(count):
            turn = math.tau * (k + shift) / count
            grid.verts.new((distance * math.cos(turn), distance * math.sin(turn), height))
    found = bmesh.ops.convex_hull(grid, input=grid.verts)
    inner = [item for item in found["geom_interior"] if isinstance(item, bmesh.types.BMVert)]
    bmesh.ops.delete(grid, geom=inner, context="VERTS")
    created = bpy.data.meshes.new(name)
    grid.to_mesh(created)
    grid.free()
    sort_faces(created)
    created.materials.append(surface)
    return created
