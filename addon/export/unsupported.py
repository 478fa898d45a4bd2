# SPDX-License-Identifier: GPL-3.0-or-later
"""Features of Cycles' scenes that leave no trace in a `SceneDescription`: each is named, none dropped in silence."""

from __future__ import annotations

from pathlib import Path

import bpy

from ..versions import TEXTURE_CACHE, is_since, read_setting
from .context import ExportContext
from .subdivision import diced_modifier

#: Where Cycles has a cache of textures beside their files, whatever the preferences say.
_DEFAULT_CACHE = "blender_tx"


def notice_scene(context: ExportContext) -> None:
    """What scene and view layer ask for."""
    scene = context.scene
    render = scene.render
    if _has_texture_cache(render):
        context.notice(scene.name, "a texture cache is not supported", "textures at full size, and not prefiltered")


def _has_texture_cache(render: bpy.types.RenderSettings) -> bool:
    """Whether Cycles would look textures up in a cache: one that it makes now, or has made before."""
    # Blender 5.3 can leave a cache alone that is there.
    if not is_since(TEXTURE_CACHE) or not read_setting(render, "use_texture_cache"):
        return False
    if read_setting(render, "use_auto_generate_texture_cache"):
        return True
    chosen = bpy.context.preferences.filepaths.texture_cache_directory
    for image in bpy.data.images:
        if image.source in ("FILE", "SEQUENCE", "TILED") and image.users and image.filepath and not image.packed_file:
            folder = Path(bpy.path.abspath(image.filepath, library=image.library)).parent
            # A folder that is absolute is itself, whatever it is put behind.
            if any(any((folder / name).glob("*.tx")) for name in {chosen, _DEFAULT_CACHE} - {""}):
                return True
    return False


def notice_object(context: ExportContext, shown: bpy.types.Object) -> None:
    """What a mesh or light object asks for."""
    if shown.type == "LIGHT":
        return
    modifier = diced_modifier(context.scene, shown.original, in_window=context.window is not None)
    if modifier is not None and shown.original.as_pointer() not in context.diced:
        level = context.subdivision_levels.get(shown.original.as_pointer())
        evenly = f"subdivided evenly, {level} times instead of {modifier.render_levels}"
        context.notice(
            shown.name, "adaptive subdivision is not supported",
            "subdivided as its modifier's render level" if level is None else evenly,
        )  # fmt: skip
