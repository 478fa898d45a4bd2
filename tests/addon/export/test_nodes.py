# SPDX-License-Identifier: GPL-3.0-or-later
"""Node trees as the engine gets them: groups, reroutes, muted nodes, tables, odd links."""

from __future__ import annotations

from functools import partial
from typing import Any
from unittest.mock import ANY

import numpy as np
import pytest

from engine.scene import description
from engine.scene.description import Material, Node
from tests.helpers.blender_scenes import Altered, empty_scene, export, export_context

#: Whatever the linked socket's own value is.
Link = partial(description.Link, otherwise=ANY)


@pytest.fixture
def tree() -> Any:
    """The node tree of the only material of the only object, empty but for an output."""
    import bpy

    empty_scene()
    bpy.ops.mesh.primitive_plane_add()
    material = bpy.data.materials.new("Material")
    bpy.context.object.data.materials.append(material)
    material.node_tree.nodes.clear()
    material.node_tree.nodes.new("ShaderNodeOutputMaterial")
    return material.node_tree


def only_material() -> Material:
    return export().materials[0]


def emit(tree: Any, socket: Any = None) -> Any:
    """An emission node on the material's surface, coloured by `socket`."""
    emission = tree.nodes.new("ShaderNodeEmission")
    tree.links.new(emission.outputs[0], output(tree).inputs["Surface"])
    if socket is not None:
        tree.links.new(socket, emission.inputs["Color"])
    return emission


def output(tree: Any) -> Any:
    return next(node for node in tree.nodes if node.bl_idname == "ShaderNodeOutputMaterial")


def surface_color(material: Material) -> tuple[list[Node], Any]:
    """All nodes, and what feeds the colour of the node on the surface."""
    graph = material.graph
    assert graph is not None and graph.surface is not None
    return graph.nodes, graph.nodes[graph.surface.node].inputs.get("Color")


def make_group(*sockets: tuple[str, str, str]) -> Any:
    """A node group with `sockets` of name, direction and type; returns tree, input and output node."""
    import bpy

    group = bpy.data.node_groups.new("Group", "ShaderNodeTree")
    for name, direction, kind in sockets:
        group.interface.new_socket(name, in_out=direction, socket_type=kind)
    return group, group.nodes.new("NodeGroupInput"), group.nodes.new("NodeGroupOutput")


def add_group(tree: Any, group: Any) -> Any:
    node = tree.nodes.new("ShaderNodeGroup")
    node.node_tree = group
    return node


def test_values_properties_and_links(tree: Any) -> None:
    checker = tree.nodes.new("ShaderNodeTexChecker")
    checker.inputs["Scale"].default_value = 3.0
    principled = tree.nodes.new("ShaderNodeBsdfPrincipled")
    principled.distribution = "MULTI_GGX"
    tree.links.new(checker.outputs["Color"], principled.inputs["Base Color"])
    tree.links.new(principled.outputs[0], output(tree).inputs["Surface"])
    graph = only_material().graph
    assert graph is not None
    assert [node.kind for node in graph.nodes] == ["ShaderNodeTexChecker", "ShaderNodeBsdfPrincipled"]
    assert graph.surface == Link(1, "BSDF") and graph.volume is None and graph.displacement is None
    first, second = graph.nodes
    assert first.name == "Checker Texture"
    assert first.inputs["Scale"] == 3.0 and first.inputs["Color1"] == pytest.approx((0.8, 0.8, 0.8, 1.0))
    assert "Vector" not in first.inputs
    assert second.inputs["Base Color"] == Link(0, "Color")
    assert second.properties["distribution"] == "MULTI_GGX"
    # Left to the surface, or not available.
    assert not {"Normal", "Tangent", "Weight"} & set(second.inputs)
    assert {"Subsurface Weight", "Specular IOR Level", "Coat Weight", "Emission Color"} <= set(second.inputs)


def test_output_for_cycles_wins(tree: Any) -> None:
    first = emit(tree)
    other = tree.nodes.new("ShaderNodeOutputMaterial")
    other.target = "CYCLES"
    diffuse = tree.nodes.new("ShaderNodeBsdfDiffuse")
    tree.links.new(diffuse.outputs[0], other.inputs["Surface"])
    assert first is not None
    graph = only_material().graph
    assert graph is not None and [node.kind for node in graph.nodes] == ["ShaderNodeBsdfDiffuse"]


def test_only_what_is_used_is_exported(tree: Any) -> None:
    emit(tree)
    tree.nodes.new("ShaderNodeTexNoise")
    graph = only_material().graph
    assert graph is not None and len(graph.nodes) == 1


def test_shared_node_is_exported_once(tree: Any) -> None:
    noise, mix = tree.nodes.new("ShaderNodeTexNoise"), tree.nodes.new("ShaderNodeMix")
    mix.data_type = "RGBA"
    tree.links.new(noise.outputs["Color"], mix.inputs["A"] if mix.inputs["A"].enabled else mix.inputs[6])
    tree.links.new(noise.outputs["Color"], mix.inputs[7])
    tree.links.new(noise.outputs["Fac"], mix.inputs[0])
    emit(tree, mix.outputs[2])
    nodes, color = surface_color(only_material())
    assert [node.kind for node in nodes] == ["ShaderNodeTexNoise", "ShaderNodeMix", "ShaderNodeEmission"]
    assert color == Link(1, "Result_Color")
    assert nodes[1].inputs["Factor_Float"] == Link(0, "Fac") and nodes[1].inputs["B_Color"] == Link(0, "Color")


def test_displacement_and_volume(tree: Any) -> None:
    absorption, displacement = tree.nodes.new("ShaderNodeVolumeAbsorption"), tree.nodes.new("ShaderNodeDisplacement")
    tree.links.new(absorption.outputs[0], output(tree).inputs["Volume"])
    tree.links.new(displacement.outputs[0], output(tree).inputs["Displacement"])
    graph = only_material().graph
    assert graph is not None and graph.surface is None
    assert graph.volume == Link(0, "Volume") and graph.displacement == Link(1, "Displacement")


def test_reroutes_and_frames_vanish(tree: Any) -> None:
    rgb = tree.nodes.new("ShaderNodeRGB")
    rgb.outputs[0].default_value = (0.1, 0.2, 0.3, 1.0)
    rgb.parent = tree.nodes.new("NodeFrame")
    socket = rgb.outputs[0]
    for _ in range(3):
        reroute = tree.nodes.new("NodeReroute")
        tree.links.new(socket, reroute.inputs[0])
        socket = reroute.outputs[0]
    emit(tree, socket)
    nodes, color = surface_color(only_material())
    assert [node.kind for node in nodes] == ["ShaderNodeRGB", "ShaderNodeEmission"] and color == Link(0, "Color")
    assert nodes[0].properties["value"] == pytest.approx((0.1, 0.2, 0.3, 1.0))


def test_reroute_from_nowhere_leaves_the_value(tree: Any) -> None:
    emission = emit(tree, tree.nodes.new("NodeReroute").outputs[0])
    emission.inputs["Color"].default_value = (0.11, 0.12, 0.13, 1.0)
    # As Cycles 5.0.1 renders it.
    assert surface_color(only_material())[1] == pytest.approx((0.11, 0.12, 0.13, 1.0))


def test_muted_node_hands_its_input_on(tree: Any) -> None:
    rgb, invert = tree.nodes.new("ShaderNodeRGB"), tree.nodes.new("ShaderNodeInvert")
    tree.links.new(rgb.outputs[0], invert.inputs["Color"])
    invert.mute = True
    emit(tree, invert.outputs[0])
    nodes, color = surface_color(only_material())
    assert [node.kind for node in nodes] == ["ShaderNodeRGB", "ShaderNodeEmission"] and color == Link(0, "Color")


def test_muted_node_without_input_is_as_unlinked(tree: Any) -> None:
    mix = tree.nodes.new("ShaderNodeMix")
    mix.data_type = "RGBA"
    mix.mute = True
    emission = emit(tree, mix.outputs[2])
    emission.inputs["Color"].default_value = (0.11, 0.12, 0.13, 1.0)
    # As Cycles 5.0.1 renders it.
    assert surface_color(only_material())[1] == pytest.approx((0.11, 0.12, 0.13, 1.0))


def test_muted_link_counts_for_nothing(tree: Any) -> None:
    rgb = tree.nodes.new("ShaderNodeRGB")
    emission = emit(tree, rgb.outputs[0])
    link = next(link for link in tree.links if link.to_node == emission)
    link.is_muted = True
    assert isinstance(surface_color(only_material())[1], tuple)


def test_nested_groups(tree: Any) -> None:
    inner, inner_in, inner_out = make_group(
        ("In", "INPUT", "NodeSocketColor"), ("Out", "OUTPUT", "NodeSocketColor"), ("Twice", "OUTPUT", "NodeSocketColor")
    )
    gamma = inner.nodes.new("ShaderNodeGamma")
    inner.links.new(inner_in.outputs[0], gamma.inputs["Color"])
    inner.links.new(gamma.outputs[0], inner_out.inputs[0])
    outer, outer_in, outer_out = make_group(("In", "INPUT", "NodeSocketColor"), ("Out", "OUTPUT", "NodeSocketColor"))
    one, two = add_group(outer, inner), add_group(outer, inner)
    outer.links.new(outer_in.outputs[0], one.inputs[0])
    outer.links.new(one.outputs[0], two.inputs[0])
    outer.links.new(two.outputs[0], outer_out.inputs[0])
    group = add_group(tree, outer)
    group.inputs[0].default_value = (0.2, 0.4, 0.6, 1.0)
    emit(tree, group.outputs[0])
    nodes, color = surface_color(only_material())
    assert [node.kind for node in nodes] == ["ShaderNodeGamma", "ShaderNodeGamma", "ShaderNodeEmission"]
    assert nodes[0].inputs["Color"] == pytest.approx((0.2, 0.4, 0.6, 1.0))
    assert nodes[1].inputs["Color"] == Link(0, "Color") and color == Link(1, "Color")


def test_group_values_change_type_and_links_do_not(tree: Any) -> None:
    group, group_in, group_out = make_group(("In", "INPUT", "NodeSocketFloat"), ("Out", "OUTPUT", "NodeSocketColor"))
    group.links.new(group_in.outputs[0], group_out.inputs[0])
    node = add_group(tree, group)
    node.inputs[0].default_value = 0.25
    emit(tree, node.outputs[0])
    assert surface_color(only_material())[1] == (0.25, 0.25, 0.25, 1.0)
    noise = tree.nodes.new("ShaderNodeTexNoise")
    tree.links.new(noise.outputs["Color"], node.inputs[0])
    # Blender 5.0 shows the colour, though it passes through a float socket.
    assert surface_color(only_material())[1] == Link(0, "Color")


@pytest.mark.parametrize("space", ["Linear Rec.709", "Linear Rec.2020"])
def test_color_typed_into_a_float_group_is_its_luminance(tree: Any, space: str) -> None:
    import bpy

    inner, inner_in, inner_out = make_group(("In", "INPUT", "NodeSocketFloat"), ("Out", "OUTPUT", "NodeSocketFloat"))
    inner.links.new(inner_in.outputs[0], inner_out.inputs[0])
    outer, outer_in, outer_out = make_group(("In", "INPUT", "NodeSocketColor"), ("Out", "OUTPUT", "NodeSocketColor"))
    middle = add_group(outer, inner)
    outer.links.new(outer_in.outputs[0], middle.inputs[0])
    outer.links.new(middle.outputs[0], outer_out.inputs[0])
    node = add_group(tree, outer)
    node.inputs[0].default_value = (1.0, 0.5, 0.1, 1.0)
    emit(tree, node.outputs[0])
    if space != bpy.data.colorspace.working_space:
        bpy.ops.wm.set_working_color_space(working_space=space, convert_colors=False)
    try:
        # As Cycles 5.0.1 and 5.2.3 render it: by Rec.709's weights, whatever the working space.
        assert surface_color(only_material())[1] == pytest.approx((0.57742, 0.57742, 0.57742, 1.0), rel=1e-5)
    finally:
        if space != "Linear Rec.709":
            bpy.ops.wm.set_working_color_space(working_space="Linear Rec.709", convert_colors=False)


def test_group_output_without_link_is_its_value(tree: Any) -> None:
    group, _, group_out = make_group(("Out", "OUTPUT", "NodeSocketFloat"))
    group_out.inputs[0].default_value = 0.75
    emit(tree, add_group(tree, group).outputs[0])
    assert surface_color(only_material())[1] == (0.75, 0.75, 0.75, 1.0)


def test_hidden_vector_of_a_group_stays_implicit(tree: Any) -> None:
    group, group_in, group_out = make_group(("N", "INPUT", "NodeSocketVector"), ("Out", "OUTPUT", "NodeSocketFloat"))
    group.interface.items_tree["N"].hide_value = True
    weight = group.nodes.new("ShaderNodeLayerWeight")
    group.links.new(group_in.outputs[0], weight.inputs["Normal"])
    group.links.new(weight.outputs["Facing"], group_out.inputs[0])
    emit(tree, add_group(tree, group).outputs[0])
    nodes, _ = surface_color(only_material())
    # As Cycles 5.0.1 renders it: the surface's normal, not zero.
    assert "Normal" not in nodes[0].inputs


def test_group_without_tree(tree: Any) -> None:
    node = tree.nodes.new("ShaderNodeGroup")
    assert node.node_tree is None
    emit(tree)
    assert len(surface_color(only_material())[0]) == 1


def test_color_on_the_surface_is_emitted(tree: Any) -> None:
    rgb = tree.nodes.new("ShaderNodeRGB")
    tree.links.new(rgb.outputs[0], output(tree).inputs["Surface"])
    nodes, color = surface_color(only_material())
    assert [node.kind for node in nodes] == ["ShaderNodeRGB", "ShaderNodeEmission"]
    assert color == Link(0, "Color") and nodes[1].inputs["Strength"] == 1.0


def test_links_carry_what_their_socket_holds(tree: Any) -> None:
    """It counts where nothing is known of the node that is linked, as with EEVEE's Shader to RGB in Cycles."""
    group, inside, outside = make_group(
        ("Color", "INPUT", "NodeSocketColor"), ("Shader", "OUTPUT", "NodeSocketShader")
    )
    inner = group.nodes.new("ShaderNodeEmission")
    inner.inputs["Color"].default_value = (0.1, 0.2, 0.7, 1.0)
    group.links.new(inside.outputs["Color"], inner.inputs["Color"])
    group.links.new(inner.outputs[0], outside.inputs["Shader"])
    node = add_group(tree, group)
    node.inputs["Color"].default_value = (0.9, 0.5, 0.1, 1.0)
    unknown, reroute = tree.nodes.new("ShaderNodeShaderToRGB"), tree.nodes.new("NodeReroute")
    tree.links.new(unknown.outputs["Color"], reroute.inputs[0])
    tree.links.new(reroute.outputs[0], node.inputs["Color"])
    tree.links.new(node.outputs["Shader"], output(tree).inputs["Surface"])
    _nodes, color = surface_color(only_material())
    assert color == Link(0, "Color")
    np.testing.assert_allclose(color.otherwise, (0.1, 0.2, 0.7, 1.0), rtol=1e-6)


def test_before_groups_are_dissolved_their_sockets_count(tree: Any, monkeypatch: Any) -> None:
    import addon.export.nodes as exported_nodes

    monkeypatch.setattr(exported_nodes, "is_since", lambda version: version != exported_nodes.GROUPS_INLINED)
    group, inside, outside = make_group(
        ("Value", "INPUT", "NodeSocketFloat"), ("Shader", "OUTPUT", "NodeSocketShader")
    )
    inner = group.nodes.new("ShaderNodeEmission")
    group.links.new(inside.outputs["Value"], inner.inputs["Color"])
    group.links.new(inner.outputs[0], outside.inputs["Shader"])
    node = add_group(tree, group)
    node.inputs["Value"].default_value = 0.25
    unknown = tree.nodes.new("ShaderNodeShaderToRGB")
    tree.links.new(unknown.outputs["Color"], node.inputs["Value"])
    tree.links.new(node.outputs["Shader"], output(tree).inputs["Surface"])
    _nodes, color = surface_color(only_material())
    assert color.otherwise == (0.25, 0.25, 0.25, 1.0)


def test_unknown_node_on_the_surface_emits_nothing(tree: Any) -> None:
    unknown = tree.nodes.new("ShaderNodeShaderToRGB")
    tree.links.new(unknown.outputs["Color"], output(tree).inputs["Surface"])
    nodes, color = surface_color(only_material())
    assert color.otherwise == (0.0, 0.0, 0.0, 1.0) and nodes[1].properties["is_conversion"]


def test_loop_of_links_is_cut(tree: Any) -> None:
    one, two = tree.nodes.new("ShaderNodeGamma"), tree.nodes.new("ShaderNodeGamma")
    tree.links.new(one.outputs[0], two.inputs["Color"])
    tree.links.new(two.outputs[0], one.inputs["Color"])
    emit(tree, two.outputs[0])
    nodes, color = surface_color(only_material())
    assert color == Link(len(nodes) - 2, "Color") and len(nodes) in (2, 3)


def test_loop_blender_does_not_mark_is_cut_with_a_notice(tree: Any) -> None:
    from addon.export.images import ImageExporter
    from addon.export.nodes import GraphExporter

    one, two = tree.nodes.new("ShaderNodeGamma"), tree.nodes.new("ShaderNodeGamma")
    tree.links.new(one.outputs[0], two.inputs["Color"])
    tree.links.new(two.outputs[0], one.inputs["Color"])
    emit(tree, two.outputs[0])
    unmarked = Altered(tree, links=[Altered(link, is_valid=True) for link in tree.links])
    context = export_context()
    graph = GraphExporter(context, ImageExporter(context)).export(unmarked, "Plane / Material")
    assert [notice.subject for notice in context.notices] == [f"Plane / Material / {two.name}"]
    assert len(graph.nodes) == 3


def test_hundreds_of_nodes_in_a_row(tree: Any) -> None:
    socket = tree.nodes.new("ShaderNodeRGB").outputs[0]
    for _ in range(400):
        gamma = tree.nodes.new("ShaderNodeGamma")
        tree.links.new(socket, gamma.inputs["Color"])
        socket = gamma.outputs[0]
    emit(tree, socket)
    assert len(surface_color(only_material())[0]) == 402


def test_color_ramp(tree: Any) -> None:
    ramp = tree.nodes.new("ShaderNodeValToRGB")
    ramp.color_ramp.elements[0].color = (0.0, 0.5, 1.0, 0.25)
    emit(tree, ramp.outputs[0])
    nodes, _ = surface_color(only_material())
    table = nodes[0].properties["ramp"]
    assert table.shape == (257, 4) and table.dtype == np.float32
    x = np.linspace(0.0, 1.0, 257)
    np.testing.assert_allclose(table[:, 0], x, atol=1e-6)
    np.testing.assert_allclose(table[:, 1], 0.5 + 0.5 * x, atol=1e-6)
    np.testing.assert_allclose(table[:, 3], 0.25 + 0.75 * x, atol=1e-6)
    assert nodes[0].properties["interpolation"] == "LINEAR" and nodes[0].properties["interpolate"] is True
    ramp.color_ramp.interpolation = "CONSTANT"
    nodes, _ = surface_color(only_material())
    assert nodes[0].properties["interpolate"] is False
    assert (nodes[0].properties["ramp"][:256, 1] == 0.5).all()


def test_curves(tree: Any) -> None:
    curves = tree.nodes.new("ShaderNodeRGBCurve")
    mapping = curves.mapping
    mapping.use_clip = False
    mapping.curves[0].points[1].location = (2.0, 2.0)
    mapping.curves[3].points[1].location = (1.0, 0.5)
    for curve in mapping.curves:
        for point in curve.points:
            point.handle_type = "VECTOR"
    mapping.update()
    emit(tree, curves.outputs[0])
    properties = surface_color(only_material())[0][0].properties
    assert properties["curves"].shape == (257, 3)
    assert properties["min_x"] == 0.0 and properties["max_x"] == 2.0 and properties["extrapolate"] is True
    # The combined curve halves, the channels' own change nothing.
    x = np.linspace(0.0, 2.0, 257)
    np.testing.assert_allclose(properties["curves"][:, 0], 0.5 * x, atol=2e-3)


def test_float_and_vector_curves(tree: Any) -> None:
    curve, vector = tree.nodes.new("ShaderNodeFloatCurve"), tree.nodes.new("ShaderNodeVectorCurve")
    tree.links.new(curve.outputs[0], vector.inputs["Vector"])
    emit(tree, vector.outputs[0])
    nodes, _ = surface_color(only_material())
    assert nodes[0].properties["curves"].shape == (257, 1) and nodes[1].properties["curves"].shape == (257, 3)
    # Blender inlines a curve of a constant, here of 1.
    np.testing.assert_allclose(nodes[0].properties["curves"][:, 0], 1.0, atol=1e-6)
    tree.links.new(tree.nodes.new("ShaderNodeTexNoise").outputs[0], curve.inputs["Value"])
    nodes, _ = surface_color(only_material())
    of_float = next(node.properties["curves"] for node in nodes if node.kind == "ShaderNodeFloatCurve")
    np.testing.assert_allclose(of_float[:, 0], np.linspace(0.0, 1.0, 257), atol=1e-3)
    of_vector = next(node.properties for node in nodes if node.kind == "ShaderNodeVectorCurve")
    assert (of_vector["min_x"], of_vector["max_x"]) == (-1.0, 1.0)


@pytest.mark.parametrize(
    ("value", "is_clipped", "expected"),
    [(0.5, True, 0.45), (1.2, True, 0.8), (2.5, True, 1.0), (-0.5, True, 0.0), (2.5, False, 1.45)],
)
def test_float_curves_of_constants_are_clipped_as_by_blender(
    value: float, is_clipped: bool, expected: float, tree: Any
) -> None:
    curve = tree.nodes.new("ShaderNodeFloatCurve")
    curve.inputs["Value"].default_value = value
    first, last = curve.mapping.curves[0].points
    first.location, last.location = (0.0, 0.2), (1.0, 0.7)
    curve.mapping.use_clip = is_clipped
    curve.mapping.update()
    emit(tree, curve.outputs[0])
    curves = surface_color(only_material())[0][0].properties["curves"]
    np.testing.assert_allclose(curves, expected, atol=1e-3)


def test_object_coordinates_carry_the_inverse_matrix(tree: Any) -> None:
    import bpy

    target = bpy.data.objects.new("Target", None)
    target.location = (1.0, 2.0, 3.0)
    target.scale = (2.0, 2.0, 2.0)
    bpy.context.scene.collection.objects.link(target)
    coordinates = tree.nodes.new("ShaderNodeTexCoord")
    coordinates.object = target
    emit(tree, coordinates.outputs["Object"])
    matrix = surface_color(only_material())[0][0].properties["object_matrix"]
    assert matrix.dtype == np.float32
    np.testing.assert_allclose(matrix @ (1.0, 2.0, 3.0, 1.0), (0.0, 0.0, 0.0, 1.0), atol=1e-6)
    np.testing.assert_allclose(matrix @ (3.0, 2.0, 3.0, 1.0), (1.0, 0.0, 0.0, 1.0), atol=1e-6)


def test_view_layer_attribute_is_resolved(tree: Any) -> None:
    import bpy

    bpy.context.scene["tint"] = [0.1, 0.2, 0.3]
    attribute = tree.nodes.new("ShaderNodeAttribute")
    attribute.attribute_type, attribute.attribute_name = "VIEW_LAYER", "tint"
    emit(tree, attribute.outputs["Color"])
    nodes, _ = surface_color(only_material())
    assert nodes[0].properties["value"] == pytest.approx((0.1, 0.2, 0.3, 1.0))


def test_material_settings_and_keys(tree: Any) -> None:
    import bpy

    material = bpy.data.materials["Material"]
    material.pass_index = 5
    material.use_transparent_shadow = False
    material.cycles.emission_sampling = "FRONT"
    emission = emit(tree)
    first = only_material()
    assert (first.name, first.pass_index, first.use_transparent_shadow) == ("Material", 5, False)
    assert first.emission_sampling == "FRONT" and first.use_bump_map_correction
    assert only_material().key == first.key
    emission.inputs["Strength"].default_value = 2.0
    assert only_material().key != first.key
    assert hash(first.key) is not None


def test_texture_mapping_of_old_files_is_reported(tree: Any) -> None:
    checker = tree.nodes.new("ShaderNodeTexChecker")
    checker.texture_mapping.scale = (2.0, 1.0, 1.0)
    emit(tree, checker.outputs[0])
    assert [notice.subject for notice in export().notices] == ["Plane / Material / Checker Texture"]


@pytest.mark.parametrize("linked", [False, True])
def test_principled_of_blender_3(linked: bool) -> None:
    from addon.export.node_versions import modernize

    value: Any = Link(0, "Value") if linked else 0.5
    old: dict[str, Any] = {
        "Base Color": (0.8, 0.4, 0.2, 1.0),
        "Subsurface": 0.0,
        "Subsurface Radius": (1.0, 0.2, 0.1),
        "Subsurface Color": (1.0, 0.0, 0.0, 1.0),
        "Subsurface IOR": 1.4,
        "Metallic": 0.1,
        "Specular": 0.3,
        "Specular Tint": value,
        "Roughness": 0.2,
        "Sheen": value,
        "Sheen Tint": 0.5,
        "Clearcoat": value,
        "Clearcoat Roughness": 0.03,
        "IOR": 1.45,
        "Transmission": 0.6,
        "Transmission Roughness": 0.0,
        "Emission": (0.0, 1.0, 0.0, 1.0),
        "Emission Strength": 2.0,
        "Alpha": 0.9,
    }
    nodes = modernize(Node("ShaderNodeBsdfPrincipled", "Principled", old, {"distribution": "GGX"}), 3)
    new = nodes[-1].inputs
    assert new["Specular IOR Level"] == 0.3 and new["Transmission Weight"] == 0.6
    assert new["Emission Color"] == (0.0, 1.0, 0.0, 1.0) and new["Coat Roughness"] == 0.03
    assert not {"Specular", "Clearcoat", "Sheen", "Subsurface", "Subsurface Color", "Transmission"} & set(new)
    if linked:
        assert (new["Coat Weight"], new["Coat IOR"]) == (value, 1.2)
        assert (new["Sheen Weight"], new["Sheen Tint"]) == (value, (0.2, 0.2, 0.2, 1.0))
        assert nodes[0].kind == "ShaderNodeMix" and new["Specular Tint"] == Link(3, "Result_Color")
        assert nodes[0].inputs["Factor_Float"] == value
    else:
        assert (new["Coat Weight"], new["Coat IOR"]) == (0.125, 1.5)
        assert (new["Sheen Weight"], new["Sheen Tint"]) == (0.1, (1.0, 1.0, 1.0, 1.0))
        assert new["Specular Tint"] == pytest.approx((0.9, 0.7, 0.6, 1.0))
        assert len(nodes) == 1


def test_replaced_kinds_rename_their_outputs() -> None:
    from addon.export.node_versions import modernize

    node = modernize(Node("ShaderNodeSeparateRGB", "Separate", {"Image": (1.0, 0.5, 0.0, 1.0)}, {}), 0)[-1]
    assert node.kind == "ShaderNodeSeparateColor" and node.properties["mode"] == "RGB"
    assert node.inputs == {"Color": (1.0, 0.5, 0.0, 1.0)}
    assert node.properties["renamed_outputs"]["G"] == "Green"


@pytest.mark.parametrize("version", [(3, 4), (5, 0), (5, 1), (5, 2)])
def test_nodes_do_what_they_do_in_the_version_that_exports(version: tuple[int, int], monkeypatch: Any) -> None:
    from addon.export import node_versions
    from engine.scene.description import Node

    monkeypatch.setattr(node_versions, "is_since", lambda since: version >= since)
    magic, normal = (
        node_versions.modernize(Node(kind, kind), 0)[-1].properties
        for kind in ("ShaderNodeTexMagic", "ShaderNodeNormalMap")
    )
    assert magic == {"wraps_scaled": version >= (5, 2)}
    assert normal == {"has_unit_frame": version >= (5, 1)}
