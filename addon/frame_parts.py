# SPDX-License-Identifier: GPL-3.0-or-later
"""How many pictures a frame has, and what each is called."""

from __future__ import annotations

import bpy


def layer_count(scene: bpy.types.Scene) -> int:
    """View layers that a render of the scene has."""
    return 1 if scene.render.use_single_layer else sum(layer.use for layer in scene.view_layers)


def part_count(scene: bpy.types.Scene) -> int:
    """Pictures of a frame: one for each view layer, in stereo one for each view of it."""
    views = sum(view.use for view in scene.render.views) if scene.render.use_multiview else 1
    return layer_count(scene) * max(views, 1)


def is_only_picture(scene: bpy.types.Scene) -> bool:
    """Whether what is exported serves one picture only: Blender makes a new engine for the next frame."""
    return part_count(scene) == 1 and not scene.render.use_multiview and not scene.render.use_persistent_data


def place(depsgraph: bpy.types.Depsgraph, view: str = "") -> str:
    """Scene, view layer and, in stereo, view, as Cycles names them."""
    return ", ".join(name for name in (depsgraph.scene.name, depsgraph.view_layer_eval.name, view) if name)


def total_fraction(scene: bpy.types.Scene, layers_done: int, fraction: float) -> float:
    """Progress over all view layers of a frame, of so many and a part of the next."""
    return min((layers_done + fraction) / max(layer_count(scene), 1), 1.0)
