# SPDX-License-Identifier: GPL-3.0-or-later
"""Several frames at once, seen from the one that is rendered."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import bpy

from engine.scene.description import SceneDescription

from .context import ExportCache, ExportContext
from .scene import export_scene
from .shutter import Clock


def export_frames(
    depsgraph: bpy.types.Depsgraph,
    frames: Iterable[float],
    *,
    cache: ExportCache,
    engine: bpy.types.RenderEngine | None = None,
    should_cancel: Callable[[], bool] | None = None,
) -> list[SceneDescription]:
    """Describe what `depsgraph` shows at each of `frames`; Blender stands where it stood afterwards, whatever happens.

    Shapes and images that do not change are the same objects in all of them. The other parameters, and what is raised,
    are those of `export_scene`.
    """
    context = ExportContext(
        depsgraph=depsgraph,
        scene=depsgraph.scene_eval,
        view_layer=depsgraph.view_layer_eval,
        engine=engine,
        cache=cache,
        should_cancel=should_cancel,
    )
    clock = Clock(context)
    descriptions = []
    try:
        for frame in frames:
            context.check_cancel()
            clock.go_to(frame)
            # What Blender flags as changed is said of another frame than the one exported last.
            cache.depsgraph = 0
            descriptions.append(export_scene(depsgraph, engine=engine, cache=cache, should_cancel=should_cancel))
    finally:
        clock.restore()
        cache.depsgraph = 0
    return descriptions
