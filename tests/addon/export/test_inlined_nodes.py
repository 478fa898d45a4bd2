# SPDX-License-Identifier: GPL-3.0-or-later
"""Menus, repeat zones, bundles and closures in materials: what is linked to what once they are resolved."""

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


def _zone(tree: Any, iterations: int, kind: str = "FLOAT") -> tuple[Any, Any]:
    """The ends of a repeat zone with one item, 'Value'."""
    begin, end = tree.nodes.new("GeometryNodeRepeatInput"), tree.nodes.new("GeometryNodeRepeatOutput")
    begin.pair_with_output(end)
    end.repeat_items.clear()
    end.repeat_items.new(kind, "Value")
    begin.inputs["Iterations"].default_value = iterations
    return begin, end


def _math(tree: Any, operation: str, a: Any, b: Any) -> Any:
    node = tree.nodes.new("ShaderNodeMath")
    node.operation = operation
    for socket, value in zip(node.inputs[:2], (a, b), strict=True):
        if isinstance(value, float):
            socket.default_value = value
        else:
            tree.links.new(value, socket)
    return node.outputs[0]


def _value(source: Any, graph: Any) -> float:
    """What a tree of Math nodes comes to."""
    if not isinstance(source, Link):
        return float(source)
    node = graph.nodes[source.node]
    a, b = _value(node.inputs["Value"], graph), _value(node.inputs["Value_001"], graph)
    return a + b if node.properties["operation"] == "ADD" else a * b


@pytest.mark.parametrize(("iterations", "expected"), [(0, 0.5), (1, 1.0), (4, 19.0), (-3, 0.5)])
def test_a_repeat_zone_is_its_nodes_so_often(material: Any, iterations: int, expected: float) -> None:
    """v <- 2 v + i, from 0.5 on."""
    tree = material.node_tree
    begin, end = _zone(tree, iterations)
    begin.inputs["Value"].default_value = 0.5
    outside = _math(tree, "ADD", 1.0, 1.0)
    doubled = _math(tree, "MULTIPLY", begin.outputs["Value"], outside)
    tree.links.new(_math(tree, "ADD", doubled, begin.outputs["Iteration"]), end.inputs["Value"])
    tree.links.new(end.outputs["Value"], _principled(material).inputs["Roughness"])
    source, graph, notices = _exported("Roughness")
    assert _value(source, graph) == pytest.approx(expected) and notices == []
    # What does not depend on the turn is there once.
    assert sum(node.kind == "ShaderNodeMath" for node in graph.nodes) == (2 * max(iterations, 0) + (iterations > 0))


def test_zones_within_zones(material: Any) -> None:
    """The inner one doubles twice, the outer one does that three times."""
    tree = material.node_tree
    (begin, end), (inner, last) = _zone(tree, 3), _zone(tree, 2)
    begin.inputs["Value"].default_value = 1.0
    tree.links.new(begin.outputs["Value"], inner.inputs["Value"])
    tree.links.new(_math(tree, "MULTIPLY", inner.outputs["Value"], 2.0), last.inputs["Value"])
    tree.links.new(last.outputs["Value"], end.inputs["Value"])
    tree.links.new(end.outputs["Value"], _principled(material).inputs["Roughness"])
    source, graph, notices = _exported("Roughness")
    assert _value(source, graph) == 64.0 and notices == []


def test_iterations_that_vary_or_are_too_many_are_named(material: Any) -> None:
    tree = material.node_tree
    begin, end = _zone(tree, 5000)
    tree.links.new(_math(tree, "ADD", begin.outputs["Value"], 1.0), end.inputs["Value"])
    tree.links.new(end.outputs["Value"], _principled(material).inputs["Roughness"])
    _, graph, notices = _exported("Roughness")
    assert sum(node.kind == "ShaderNodeMath" for node in graph.nodes) == 1024
    assert [notice.problem for notice in notices] == ["has 5000 iterations"]
    tree.links.new(tree.nodes.new("ShaderNodeLightPath").outputs["Ray Depth"], begin.inputs["Iterations"])
    _, _, notices = _exported("Metallic")
    assert [notice.problem for notice in notices] == ["has a number of iterations that is not constant"]


def test_bundles_are_separated_by_name(material: Any) -> None:
    tree = material.node_tree
    combined, separated = tree.nodes.new("NodeCombineBundle"), tree.nodes.new("NodeSeparateBundle")
    for kind, name in (("FLOAT", "Rough"), ("FLOAT", "Metal")):
        combined.bundle_items.new(kind, name)
    for kind, name in (("FLOAT", "Metal"), ("FLOAT", "Rough"), ("FLOAT", "Missing")):
        separated.bundle_items.new(kind, name)
    combined.inputs["Rough"].default_value, combined.inputs["Metal"].default_value = 0.25, 0.75
    tree.links.new(combined.outputs[0], separated.inputs[0])
    principled = _principled(material)
    tree.links.new(separated.outputs["Rough"], principled.inputs["Roughness"])
    tree.links.new(separated.outputs["Metal"], principled.inputs["Metallic"])
    roughness, _, notices = _exported("Roughness")
    assert (roughness, _exported("Metallic")[0]) == (0.25, 0.75) and notices == []
    tree.links.new(separated.outputs["Missing"], principled.inputs["IOR"])
    _, _, notices = _exported("IOR")
    assert ["'Missing'" in notice.problem for notice in notices] == [True]


def test_a_closure_is_evaluated_with_each_nodes_inputs(material: Any) -> None:
    tree = material.node_tree
    begin, end = tree.nodes.new("NodeClosureInput"), tree.nodes.new("NodeClosureOutput")
    begin.pair_with_output(end)
    end.input_items.new("FLOAT", "In")
    end.output_items.new("FLOAT", "Out")
    tree.links.new(_math(tree, "MULTIPLY", begin.outputs["In"], 2.0), end.inputs["Out"])
    principled = _principled(material)
    for value, name in ((0.1, "Roughness"), (0.3, "Metallic")):
        node = tree.nodes.new("NodeEvaluateClosure")
        node.input_items.new("FLOAT", "In")
        node.output_items.new("FLOAT", "Out")
        node.inputs["In"].default_value = value
        tree.links.new(end.outputs[0], node.inputs["Closure"])
        tree.links.new(node.outputs["Out"], principled.inputs[name])
    source, graph, notices = _exported("Roughness")
    assert _value(source, graph) == pytest.approx(0.2) and notices == []
    assert _value(*_exported("Metallic")[:2]) == pytest.approx(0.6)
