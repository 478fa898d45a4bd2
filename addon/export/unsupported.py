# SPDX-License-Identifier: GPL-3.0-or-later
"""Features of Cycles' scenes that leave no trace in a `SceneDescription`: each is named, none dropped in silence."""

from __future__ import annotations

import bpy

from engine.scene.description import NodeGraph

from .context import ExportContext, cycles_property


def notice_scene(context: ExportContext) -> None:
    """What scene and view layer ask for."""
    scene = context.scene
    render = scene.render
    if render.use_simplify and cycles_property(scene, "texture_limit_render", "OFF") != "OFF":
        context.notice(scene.name, "a limit on texture sizes is not supported", "textures at full size")


def notice_object(context: ExportContext, shown: bpy.types.Object) -> None:
    """What a mesh or light object asks for."""
    linking = getattr(shown, "light_linking", None)
    if linking is not None and linking.receiver_collection is not None:
        context.notice(shown.name, "light linking is not supported", "its light falls on everything")
    if linking is not None and linking.blocker_collection is not None:
        context.notice(shown.name, "shadow linking is not supported", "everything casts shadows in its light")
    if shown.type == "LIGHT":
        if cycles_property(shown.data, "is_caustics_light", False):
            context.notice(shown.name, "shadow caustics are not supported", "caustics as paths happen to find them")
        return
    offset = getattr(shown, "shadow_terminator_shading_offset", None)  # from Blender 5.0
    if offset is None:
        offset = cycles_property(shown, "shadow_terminator_offset", 0.0)
    if offset > 0.0:
        context.notice(shown.name, "a shading offset of the shadow terminator is not supported", "no offset")
    if _is_culled(context.scene, shown):
        context.notice(shown.name, "culling by camera or distance is not supported", "it is always there")
    if _is_diced(context.scene, shown):
        context.notice(shown.name, "adaptive subdivision is not supported", "subdivided as its modifier's render level")


def notice_material(
    context: ExportContext, material: bpy.types.Material, graph: NodeGraph | None, subject: str
) -> None:
    """What a material asks for beyond its nodes; `subject` names it and an object that has it."""
    if graph is None or graph.displacement is None:
        return
    method = getattr(material, "displacement_method", None)  # from Blender 4.1
    if method is None:
        method = cycles_property(material, "displacement_method", "BUMP")
    if method != "BUMP":
        context.notice(subject, "displacement of the geometry is not supported", "its bump alone")


def _is_culled(scene: bpy.types.Scene, shown: bpy.types.Object) -> bool:
    if not scene.render.use_simplify:
        return False
    return any(
        cycles_property(scene, name, False) and cycles_property(shown, name, False)
        for name in ("use_camera_cull", "use_distance_cull")
    )


def _is_diced(scene: bpy.types.Scene, shown: bpy.types.Object) -> bool:
    modifiers = shown.original.modifiers
    if not modifiers or modifiers[-1].type != "SUBSURF" or not modifiers[-1].show_render:
        return False
    own = getattr(modifiers[-1], "use_adaptive_subdivision", None)  # from Blender 5.0
    if own is not None:
        return bool(own)
    is_experimental = cycles_property(scene, "feature_set", "SUPPORTED") == "EXPERIMENTAL"
    return is_experimental and bool(cycles_property(shown, "use_adaptive_subdivision", False))
