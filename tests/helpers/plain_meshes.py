# SPDX-License-Identifier: GPL-3.0-or-later
"""Small meshes in the open scene, and materials that show what a node gives."""

from __future__ import annotations

from typing import Any


def add_mesh(vertices: list, faces: list, name: str = "Object") -> Any:
    import bpy

    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(vertices, [], faces)
    item = bpy.data.objects.new(name, mesh)
    bpy.context.scene.collection.objects.link(item)
    return item


def add_square(name: str = "Square") -> Any:
    return add_mesh([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], [(0, 1, 2, 3)], name)


def add_material(item: Any, *nodes: tuple[str, dict[str, Any]], output: str = "Color") -> Any:
    """A material whose emission shows the output of the last of `nodes`."""
    import bpy

    material = bpy.data.materials.new("Material")
    tree = material.node_tree
    tree.nodes.clear()
    last = None
    for kind, properties in nodes:
        last = tree.nodes.new(kind)
        for key, value in properties.items():
            setattr(last, key, value)
    emission = tree.nodes.new("ShaderNodeEmission")
    result = tree.nodes.new("ShaderNodeOutputMaterial")
    tree.links.new(emission.outputs[0], result.inputs[0])
    if last is not None:
        tree.links.new(last.outputs[output], emission.inputs["Color"])
    item.data.materials.append(material)
    return material
