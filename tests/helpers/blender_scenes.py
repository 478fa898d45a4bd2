# SPDX-License-Identifier: GPL-3.0-or-later
"""Empty Blender files, and what the exporter makes of the current one. Needs bpy."""

from __future__ import annotations

from typing import Any

from engine.scene.description import SceneDescription


def empty_scene() -> Any:
    """The scene of an empty file, with a camera at the origin."""
    import bpy

    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    scene.collection.objects.link(scene.camera)
    return scene


def export(**arguments: Any) -> SceneDescription:
    """The description of the scene at its current frame; `arguments` as those of `export_scene`."""
    import bpy

    from addon.export import export_scene

    return export_scene(bpy.context.evaluated_depsgraph_get(), **arguments)


def render_and_export(scene: Any, frames: int = 1, cache: Any = None, resolution: int = 4) -> Any:
    """What an engine exports in a final render; a list of descriptions for several frames."""
    import bpy

    from addon.export import export_scene

    results: list[Any] = []

    class Engine(bpy.types.RenderEngine):
        bl_idname = "EXPORT_TEST"
        bl_label = "Export test"

        def update(self, data: Any, depsgraph: Any) -> None:
            try:
                results.append(export_scene(depsgraph, engine=self, cache=cache))
            except Exception as error:  # Blender would swallow it.
                results.append(error)

        def render(self, depsgraph: Any) -> None:
            pass

    bpy.utils.register_class(Engine)
    try:
        scene.render.engine = "EXPORT_TEST"
        scene.render.resolution_x = scene.render.resolution_y = resolution
        for frame in range(1, frames + 1):
            scene.frame_set(frame)
            bpy.ops.render.render()
    finally:
        scene.render.engine = "BLENDER_WORKBENCH"
        bpy.utils.unregister_class(Engine)
    for result in results:
        if isinstance(result, Exception):
            raise result
    return results if frames > 1 else results[0]


def export_context() -> Any:
    """What an export of the current scene works with, for parts of it that are tested alone."""
    import bpy

    from addon.export.context import ExportCache, ExportContext

    depsgraph = bpy.context.evaluated_depsgraph_get()
    return ExportContext(depsgraph, depsgraph.scene_eval, depsgraph.view_layer_eval, engine=None, cache=ExportCache())


class Altered:
    """Looks like something of Blender's, but for some attributes: states that a script cannot bring about."""

    def __init__(self, original: Any, **attributes: Any) -> None:
        self._original = original
        vars(self).update(attributes)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._original, name)


def stand_in(panel: Any, layout: Any) -> Any:
    """What `panel.draw` can be called with outside of Blender's windows: all of the panel that is not Blender's."""
    import bpy

    ours = tuple(base for base in panel.__bases__ if base is not bpy.types.Panel)
    return type("StandIn", ours, {"layout": layout})()


def displacing_material() -> Any:
    """A material that moves its surface, by the same everywhere."""
    import bpy

    material = bpy.data.materials.new("Hills")
    if material.node_tree is None:
        material.use_nodes = True
    tree = material.node_tree
    output = next(node for node in tree.nodes if node.type == "OUTPUT_MATERIAL")
    tree.links.new(tree.nodes.new("ShaderNodeDisplacement").outputs[0], output.inputs["Displacement"])
    material.displacement_method = "DISPLACEMENT"
    return material
