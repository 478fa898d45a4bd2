# SPDX-License-Identifier: GPL-3.0-or-later
"""Adaptive subdivision: the level of meshes is what the picture can show of it, not the modifier's.

Cycles dices such meshes itself, and does not read the modifier's level: files have levels for which there is no memory.
Meshes that their materials displace are diced here too: Blender gives a level at which they are round, and the engine
divides what is still long in the picture.
Since version 5.0 Blender subdivides a mesh when somebody first asks for it. Before that the level is changed in the
evaluated copy of the modifier, from which nothing comes back into the file.
"""

from __future__ import annotations

import math
from typing import Any

import bpy
import numpy as np

from engine.scene.description import Frame

from ..versions import SETTINGS, is_since, read_setting
from .context import ExportContext, Window, cycles_property
from .dicing import dicing_of, dicing_setting, most_levels, offscreen_scale, rate_of
from .dicing_view import DicingView

#: Faces that any mesh may have.
_FEWEST_FACES = 1 << 16
#: Faces of a mesh for each place that the dicing rate has in the picture: the rest is out of sight, or smaller.
_FACES_PER_PLACE = 2.0
#: Faces of a mesh that is diced besides: flat ones between them are not seen to be flat.
_ROUND_FACES = 1 << 13


def diced_modifier(scene: bpy.types.Scene, shown: bpy.types.Object, *, in_window: bool = False) -> Any:
    """The modifier for which Cycles would dice an object's mesh, of the same copy of the object; None: it would not."""
    if shown.type not in ("MESH", "CURVE", "SURFACE", "FONT") or not shown.modifiers:
        return None
    modifier = shown.modifiers[-1]
    if modifier.type != "SUBSURF" or not (modifier.show_viewport if in_window else modifier.show_render):
        return None
    # As long as Cycles had it, it was an experiment.
    is_offered = is_since(SETTINGS["use_adaptive_subdivision"].since)
    is_offered = is_offered or cycles_property(scene, "feature_set", "SUPPORTED") == "EXPERIMENTAL"
    return modifier if is_offered and read_setting(modifier, "use_adaptive_subdivision", shown) else None


def cap_levels(context: ExportContext, camera_object: bpy.types.Object, frame: Frame) -> None:
    """Lower the levels of meshes that Cycles would dice; nothing must have asked for these meshes yet.

    Parameters
    ----------
    camera_object : Object
        Original.
    """
    context.subdivision_levels.clear()
    context.diced.clear()
    if context.depsgraph.mode != "RENDER" or not is_since(SETTINGS["use_adaptive_subdivision"].since):
        return
    camera = dicing_setting(context, "dicing_camera", None) or camera_object
    view = DicingView.of_camera(context.depsgraph, camera.evaluated_get(context.depsgraph), frame.width, frame.height)
    for item in context.depsgraph.ids:
        if not isinstance(item, bpy.types.Object) or item.type != "MESH":
            continue
        modifier = diced_modifier(context.scene, item)
        if modifier is None:
            continue
        context.check_cancel()
        is_diced = _may_displace(item)
        level = _visible_level(context, item, modifier, view, is_diced)
        if is_diced:
            most = max(most_levels(context) - level, 0)
            context.diced[item.original.as_pointer()] = dicing_of(context, item, modifier, view, most)
        if is_diced or level < modifier.render_levels:
            context.subdivision_levels[item.original.as_pointer()] = level
    apply_levels(context)


def dice_in_window(context: ExportContext, window: Window) -> None:
    """Find how meshes are diced in a window: on from the level that their modifiers have there.

    As in Cycles a mesh stays as it was diced, wherever the window looks, until it is touched or a setting changes.
    """
    context.diced.clear()
    if window.dicing_view is None or not is_since(SETTINGS["use_adaptive_subdivision"].since):
        return
    kept, context.cache.dicings = context.cache.dicings, {}
    view, camera = window.dicing_view, dicing_setting(context, "dicing_camera", None)
    if camera is not None:
        view = DicingView.of_camera(context.depsgraph, camera.evaluated_get(context.depsgraph), view.width, view.height)
    for item in context.depsgraph.ids:
        if not isinstance(item, bpy.types.Object) or item.type != "MESH" or not _may_displace(item):
            continue
        modifier = diced_modifier(context.scene, item, in_window=True)
        if modifier is None:
            continue
        original = item.original
        most = most_levels(context)
        state = (
            most, modifier.levels, modifier.adaptive_space, rate_of(context, modifier), offscreen_scale(context),
            0 if camera is None else camera.original.as_pointer(),
        )  # fmt: skip
        before = kept.get(original.as_pointer())
        reads = original.as_pointer(), original.data.as_pointer()
        if before is None or before[0] != state or not context.are_untouched(reads):
            before = state, dicing_of(context, item, modifier, view, max(most - modifier.levels, 0))
        context.cache.dicings[original.as_pointer()] = before
        context.diced[original.as_pointer()] = before[1]


def _may_displace(item: bpy.types.Object) -> bool:
    """Whether some material of an object has its way to move vertices set."""
    materials = (slot.material for slot in item.material_slots)
    return any(one is not None and read_setting(one, "displacement_method") != "BUMP" for one in materials)


def apply_levels(context: ExportContext) -> None:
    """Have meshes subdivided as `cap_levels` found; to be called again whenever Blender has gone to another time."""
    if not context.subdivision_levels:
        return
    for item in context.depsgraph.ids:
        if isinstance(item, bpy.types.Object):
            level = context.subdivision_levels.get(item.original.as_pointer())
            if level is not None:
                _read_at_level(context, item, item.modifiers[-1], level)
                item.to_mesh_clear()


def _read_at_level(context: ExportContext, item: bpy.types.Object, modifier: Any, level: int) -> bpy.types.Mesh:
    """The mesh of an evaluated object subdivided `level` times, which becomes its own if nobody has asked for that."""
    found = modifier.render_levels
    try:
        modifier.render_levels = level
        return item.to_mesh(preserve_all_data_layers=True, depsgraph=context.depsgraph)
    finally:
        modifier.render_levels = found


def _visible_level(
    context: ExportContext, item: bpy.types.Object, modifier: Any, view: DicingView, is_diced: bool
) -> int:
    """How many times the picture can show a mesh's faces divided, at the dicing rate; if it is diced, until round."""
    mesh = _read_at_level(context, item, modifier, 0)
    try:
        positions = np.empty(3 * len(mesh.vertices), np.float32)
        mesh.vertices.foreach_get("co", positions)
        edges = np.empty(2 * len(mesh.edges), np.int32)
        mesh.edges.foreach_get("vertices", edges)
        corner_count = len(mesh.loops)
    finally:
        item.to_mesh_clear()
    if corner_count == 0 or len(edges) == 0 or not np.isfinite(positions).all():
        return 1
    ends = positions.reshape(-1, 3)[edges.reshape(-1, 2)].astype(np.float64)
    places = float(view.width * view.height)
    rate = rate_of(context, modifier)
    if modifier.adaptive_space == "OBJECT":
        longest = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).max() / max(rate, 1e-12)
    else:
        longest = _longest_edge(context, ends, np.array(item.matrix_world, np.float64), view) / rate
        places /= max(rate, 1.0) ** 2
    # Each corner becomes a face, and each face four.
    faces = _ROUND_FACES if is_diced else max(_FACES_PER_PLACE * places, _FEWEST_FACES)
    most = 1.0 + math.log(faces / corner_count, 4.0)
    if is_diced and modifier.subdivision_type == "SIMPLE":
        most = 1.0
    needed = math.ceil(math.log2(max(longest, 1.0)))
    # Once at least: without any subdivision the level that Blender has taken note of would stay.
    return max(1, min(needed, math.floor(most), most_levels(context)))


def _longest_edge(context: ExportContext, ends: np.ndarray, to_world: np.ndarray, view: DicingView) -> float:
    """Length of the longest edge [pixels], as if all were seen across; what is out of view counts for less.

    Parameters
    ----------
    ends : float64 (E, 2, 3), in the object's space
    """
    points = np.stack([ends[:, 0], ends.mean(axis=1), ends[:, 1]], axis=1)
    to_camera = view.to_camera @ to_world
    points = points @ to_camera[:3, :3].T + to_camera[:3, 3]
    lengths = np.linalg.norm(points[:, 2] - points[:, 0], axis=1)
    if view.kind == "PANO":
        distance = np.linalg.norm(points, axis=2).min(axis=1)
        return float((lengths / (np.maximum(distance, view.nearest) * view.pixel)).max())
    depth = -points[:, :, 2]
    size = np.full(depth.shape, view.pixel)
    if view.kind != "ORTHO":
        size *= np.maximum(depth, view.nearest)
    # In view is what has its box, in the picture's plane, there; what passes the camera may be.
    seen = points @ view.projection[:2, :3].T + view.projection[:2, 3]
    if view.kind != "ORTHO":
        seen /= np.maximum(depth, view.nearest)[:, :, None]
    is_before = (depth > view.nearest).any(axis=1)
    is_inside = ((seen.min(axis=1) <= 1.0) & (seen.max(axis=1) >= -1.0)).all(axis=1)
    passes = is_before & (depth <= view.nearest).any(axis=1)
    pixels = lengths / size.min(axis=1)
    out_of_view = ~(is_before & is_inside | passes)
    pixels[out_of_view] /= offscreen_scale(context)
    return float(pixels.max())
