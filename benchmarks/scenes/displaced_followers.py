# SPDX-License-Identifier: GPL-3.0-or-later
"""What follows displacement: edges that tear, tangents, motion."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import bpy
import numpy as np

from benchmarks.scenes.displaced import displaced, grid, noise
from benchmarks.scenes.registry import scene
from benchmarks.scenes.studio import Nodes, Socket, add_object, box, camera, light, lit_stage, resolution, sphere, world

#: The frame rendered; keys lie one frame before and after it.
_FRAME = 10


def _animate(owner: Any, path: str, *values: Sequence[float] | float) -> None:
    """Keys of a property before and after the frame that is rendered."""
    for frame, value in zip((_FRAME - 1, _FRAME + 1), values, strict=True):
        setattr(owner, path, value)
        owner.keyframe_insert(path, frame=frame)


@scene("displaced-sharp")
def sharp() -> None:
    """Boxes whose lids have sharp edges, one with flat sides besides: up to Blender 5.1 Cycles tears them off."""
    resolution()
    camera((2.0, -4.5, 2.5), (0.0, 0.0, 0.2))
    world((0.2, 0.25, 0.35))
    light("SUN", 3.0, (3.0, -1.0, 2.5), angle=0.05)

    def heights(nodes: Nodes) -> Socket:
        return nodes("Displacement", Height=1.0, Midlevel=0.0, Scale=0.15)

    for column, has_flat_sides in enumerate((False, True)):
        data = box(f"Box {column}", displaced(heights), (1.0, 1.0, 1.0))
        is_flat = [has_flat_sides and abs(face.normal.x) > 0.5 for face in data.polygons]
        data.polygons.foreach_set("use_smooth", np.logical_not(is_flat))
        is_upper = [data.vertices[a].co.z > 0.0 and data.vertices[b].co.z > 0.0 for a, b in data.edge_keys]
        marks = data.attributes.get("sharp_edge") or data.attributes.new("sharp_edge", "BOOLEAN", "EDGE")
        marks.data.foreach_set("value", is_upper)
        data.update()
        add_object(f"Box {column}", data, (2.0 * column - 1.0, 0.0, 0.0), (0, 0, 20))


@scene("displaced-tangents")
def tangents() -> None:
    """Brushed metal along a UV map's tangents, and a normal map, on what is displaced."""
    lit_stage()

    def heights(nodes: Nodes) -> Socket:
        return nodes("Displacement", Height=noise(nodes, "Generated", 2.5), Midlevel=0.5, Scale=0.9)

    def brushed(nodes: Nodes) -> Socket:
        along = nodes("Tangent", {"direction_type": "UV_MAP", "uv_map": "UVMap"})
        return nodes("BsdfAnisotropic", Color=(0.8, 0.7, 0.5), Roughness=0.4, Anisotropy=0.9, Tangent=along)

    def mapped(nodes: Nodes) -> Socket:
        normal = nodes("NormalMap", {"uv_map": "UVMap"}, Color=(0.8, 0.4, 0.9))
        return nodes("BsdfDiffuse", Color=(0.6, 0.5, 0.4), Normal=normal)

    for column, surface in enumerate((brushed, mapped)):
        data = grid(f"Sheet {column}", displaced(heights, surface=surface), 1.6, 40)
        add_object(f"Sheet {column}", data, (1.8 * column - 0.9, 0.0, 0.8), (50, 0, 20))


@scene("displaced-motion")
def moves() -> None:
    """A displaced ball that is pressed flat, and a displaced sheet that flies and turns, twice: true, and with bump."""
    lit_stage()

    def heights(nodes: Nodes) -> Socket:
        return nodes("Displacement", Height=noise(nodes, "Generated", 4.0, 2.0), Midlevel=0.5, Scale=0.6)

    ball = add_object("Ball", sphere("Ball", displaced(heights), 0.7, 64, 32), (-0.9, -0.2, 0.8))
    ball.shape_key_add(name="Basis")
    flat = ball.shape_key_add(name="Flat")
    for point in flat.data:
        point.co.z *= 0.4
    _animate(flat, "value", 0.0, 1.0)
    sheet = grid("Sheet", displaced(heights, "BOTH"), 0.9, 16)
    ways = {"Flies": ((0.2, 0.0, 0.5), (1.2, 0.0, 1.1)), "Turns": ((1.5, -0.6, 0.4), (1.5, -0.6, 0.4))}
    for name, (start, end) in ways.items():
        flies = add_object(name, sheet, start, (60, 0, 0))
        _animate(flies, "location", start, end)
        _animate(flies, "rotation_euler", (1.0, 0.0, -0.5), (1.0, 0.0, 0.5))
    now = bpy.context.scene
    now.frame_set(_FRAME)
    now.render.use_motion_blur, now.render.motion_blur_shutter = True, 1.0
