# SPDX-License-Identifier: GPL-3.0-or-later
"""Menu Switches in materials: what the menu has chosen, also in a group whose menu is chosen outside."""

from __future__ import annotations

from typing import Any

import pytest

pytest.importorskip("bpy")

import bpy

from engine.scene.description import Link
from tests.helpers.blender_scenes import empty_scene, export


@pytest.fixture
def material() -> Any:
    if not hasattr(bpy.types, "GeometryNodeMenuSwitch"):
        pytest.skip("Blender 5.0 has menus in materials")
    empty_scene()
    bpy.ops.mesh.primitive_plane_add()
    created = bpy.data.materials.new("Menu")
    if created.node_tree is None:
        created.use_nodes = True
    bpy.context.object.data.materials.append(created)
    return created


def _switch(tree: Any, kind: str, chosen: str) -> Any:
    try:
        node = tree.nodes.new("GeometryNodeMenuSwitch")
    except RuntimeError:
        pytest.skip("Blender 5.0 has menus in materials")
    node.data_type = kind
    node.inputs[0].default_value = chosen
    return node


def _principled(material: Any) -> Any:
    return next(node for node in material.node_tree.nodes if node.bl_idname == "ShaderNodeBsdfPrincipled")


def _exported(name: str) -> Any:
    """The first input of this name, and what was reported."""
    description = export()
    (graph,) = [material.graph for material in description.materials if material.name == "Menu"]
    node = next(node for node in graph.nodes if name in node.inputs)
    return node.inputs[name], graph, description.notices


@pytest.mark.parametrize(("chosen", "expected"), [("A", (0.1, 0.2, 0.3)), ("B", (0.7, 0.8, 0.9))])
def test_the_chosen_color_is_what_counts(material: Any, chosen: str, expected: tuple[float, ...]) -> None:
    tree = material.node_tree
    node = _switch(tree, "RGBA", chosen)
    node.inputs[1].default_value, node.inputs[2].default_value = (0.1, 0.2, 0.3, 1.0), (0.7, 0.8, 0.9, 1.0)
    principled = _principled(material)
    tree.links.new(node.outputs[0], principled.inputs["Base Color"])
    # Its other outputs say which is chosen.
    tree.links.new(node.outputs[2], principled.inputs["Metallic"])
    color, _, notices = _exported("Base Color")
    assert color[:3] == pytest.approx(expected) and notices == []
    assert _exported("Metallic")[0] == (chosen == "B")


def test_a_menu_of_shaders_is_followed_to_the_chosen_one(material: Any) -> None:
    tree = material.node_tree
    node = _switch(tree, "SHADER", "B")
    emission = tree.nodes.new("ShaderNodeEmission")
    tree.links.new(_principled(material).outputs[0], node.inputs[1])
    tree.links.new(emission.outputs[0], node.inputs[2])
    output = next(item for item in tree.nodes if item.bl_idname == "ShaderNodeOutputMaterial")
    tree.links.new(node.outputs[0], output.inputs["Surface"])
    _, graph, notices = _exported("Strength")
    assert notices == [] and isinstance(graph.surface, Link)
    assert graph.nodes[graph.surface.node].kind == "ShaderNodeEmission"


def test_a_group_is_told_its_menu_from_outside(material: Any) -> None:
    group = bpy.data.node_groups.new("Choice", "ShaderNodeTree")
    menu = group.interface.new_socket("Menu", in_out="INPUT", socket_type="NodeSocketMenu")
    group.interface.new_socket("Color", in_out="OUTPUT", socket_type="NodeSocketColor")
    node = _switch(group, "RGBA", "A")
    node.inputs[1].default_value, node.inputs[2].default_value = (0.1, 0.1, 0.1, 1.0), (0.6, 0.6, 0.6, 1.0)
    begin, end = group.nodes.new("NodeGroupInput"), group.nodes.new("NodeGroupOutput")
    group.links.new(begin.outputs[0], node.inputs[0])
    group.links.new(node.outputs[0], end.inputs[0])
    tree = material.node_tree
    outer = tree.nodes.new("ShaderNodeGroup")
    outer.node_tree = group
    outer.inputs[menu.identifier].default_value = "B"
    tree.links.new(outer.outputs[0], _principled(material).inputs["Base Color"])
    color, _, notices = _exported("Base Color")
    assert color[:3] == pytest.approx((0.6, 0.6, 0.6)) and notices == []
