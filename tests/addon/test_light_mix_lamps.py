# SPDX-License-Identifier: GPL-3.0-or-later
"""Write Back to Lamps: lamps, worlds and materials get a group's factor, or a sentence says why they do not."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from addon import light_mix
from addon.light_mix_lamps import write_back
from tests.helpers.light_groups import grouped
from tests.helpers.panel_layout import Layout

GROUPS = ["Key", "Glow", "Sky"]


@pytest.fixture
def scene(cube_scene: Any) -> Any:
    """A sun, a glowing cube and a world in a group each, with factors of 1."""
    grouped(cube_scene)
    light_mix.add_missing(cube_scene, GROUPS)
    return cube_scene


def write(scene: Any) -> tuple[list[str], list[str]]:
    import bpy

    return write_back(scene, scene.view_layers[0], bpy.context.evaluated_depsgraph_get())


def set_factor(scene: Any, group: str, strength: float, color: Any = (1.0, 1.0, 1.0)) -> None:
    entry = scene.neuralguide.light_mix[group]
    entry.strength, entry.color = strength, color


def named(problems: list[str], text: str) -> bool:
    return any(text in problem for problem in problems)


def test_lamps_get_strength_and_colour_and_the_factor_is_one_then(scene: Any) -> None:
    sun = scene.objects["Sun"].data
    sun.color = (0.5, 1.0, 1.0)
    set_factor(scene, "Key", 2.0, (1.0, 0.5, 0.25))
    assert write(scene) == (["Key"], [])
    assert sun.energy == pytest.approx(6.0)
    assert tuple(sun.color) == pytest.approx((0.5, 0.5, 0.25))
    assert light_mix.factors_of(scene)["Key"] == light_mix.NEUTRAL
    # The kept picture was rendered before.
    assert light_mix.shown_factors(scene)["Key"] == pytest.approx((2.0, 1.0, 0.5))


def test_a_group_that_is_off_goes_dark(scene: Any) -> None:
    scene.neuralguide.light_mix["Key"].is_on = False
    assert write(scene) == (["Key"], [])
    assert scene.objects["Sun"].data.energy == 0.0
    assert scene.neuralguide.light_mix["Key"].is_on


def test_materials_and_worlds_get_it_in_their_nodes(scene: Any) -> None:
    import bpy

    from addon.emission_nodes import emitting_nodes

    set_factor(scene, "Glow", 3.0, (1.0, 0.5, 1.0))
    set_factor(scene, "Sky", 0.5)
    assert write(scene) == (["Glow", "Sky"], [])
    ((node, _),) = emitting_nodes(bpy.data.materials["Glow"].node_tree)
    assert node.inputs["Emission Strength"].default_value == pytest.approx(15.0)
    assert tuple(node.inputs["Emission Color"].default_value)[:3] == pytest.approx((1.0, 0.5, 1.0))
    ((node, _),) = emitting_nodes(scene.world.node_tree)
    assert node.inputs["Strength"].default_value == pytest.approx(0.5)


def test_what_is_linked_gets_one_node_between(scene: Any) -> None:
    """Written twice, its factor is the product."""
    tree = scene.world.node_tree
    background = next(node for node in tree.nodes if node.type == "BACKGROUND")
    sky = tree.nodes.new("ShaderNodeTexSky")
    tree.links.new(sky.outputs["Color"], background.inputs["Color"])
    count = len(tree.nodes)
    for color in ((1.0, 0.5, 0.25), (0.5, 0.5, 1.0)):
        set_factor(scene, "Sky", 1.0, color)
        assert write(scene) == (["Sky"], [])
    assert len(tree.nodes) == count + 1
    between = background.inputs["Color"].links[0].from_node
    assert between.inputs[0].links[0].from_node == sky
    assert tuple(between.inputs[1].default_value) == pytest.approx((0.5, 0.25, 0.25))


def in_two_groups(scene: Any) -> str:
    copy = scene.objects["Sun"].copy()
    copy.lightgroup = "Glow"
    scene.collection.objects.link(copy)
    return "Key: lamp Sun is used by group Glow too"


def in_no_group_too(scene: Any) -> str:
    copy = scene.objects["Sun"].copy()
    copy.lightgroup = ""
    scene.collection.objects.link(copy)
    return "lamp Sun is used by objects without a group too"


def by_an_instance(scene: Any) -> str:
    """The collection with the sun is instanced by an empty of another group: the sun's own group counts there."""
    import bpy

    scene.objects["Sun"].lightgroup = ""
    collection = bpy.data.collections.new("Lamps")
    collection.objects.link(scene.objects["Sun"])
    empty = bpy.data.objects.new("Instancer", None)
    empty.instance_type, empty.instance_collection, empty.lightgroup = "COLLECTION", collection, "Key"
    scene.collection.objects.link(empty)
    bpy.context.view_layer.update()
    return "lamp Sun is used by objects without a group too"


def animated(scene: Any) -> str:
    scene.objects["Sun"].data.keyframe_insert("energy", frame=1)
    return "Key: lamp Sun is animated (energy)"


def driven(scene: Any) -> str:
    scene.objects["Sun"].data.driver_add("color", 0)
    return "Key: lamp Sun is animated (color)"


def in_a_node_group(scene: Any) -> str:
    import bpy

    inner = bpy.data.node_groups.new("Inner", "ShaderNodeTree")
    inner.interface.new_socket("Shader", in_out="OUTPUT", socket_type="NodeSocketShader")
    emission, end = inner.nodes.new("ShaderNodeEmission"), inner.nodes.new("NodeGroupOutput")
    inner.links.new(emission.outputs[0], end.inputs[0])
    tree = bpy.data.materials["Glow"].node_tree
    outer = tree.nodes.new("ShaderNodeGroup")
    outer.node_tree = inner
    tree.links.new(outer.outputs[0], tree.get_output_node("CYCLES").inputs["Surface"])
    set_factor(scene, "Key", 1.0)
    set_factor(scene, "Glow", 2.0)
    return "Glow: material Glow emits in the node group"


def shared_material(scene: Any) -> str:
    import bpy

    bpy.ops.mesh.primitive_cube_add(size=0.1)
    bpy.context.object.data.materials.append(bpy.data.materials["Glow"])
    set_factor(scene, "Key", 1.0)
    set_factor(scene, "Glow", 2.0)
    return "Glow: material Glow is used by objects without a group too"


def animated_factor(scene: Any) -> str:
    scene.neuralguide.light_mix["Key"].keyframe_insert("strength", frame=1)
    return "Key: its factor is animated"


def nothing_in_it(scene: Any) -> str:
    scene.objects["Sun"].lightgroup = ""
    return "Key: nothing emits in it"


def no_such_group(scene: Any) -> str:
    layer = scene.view_layers[0]
    layer.lightgroups.remove(layer.lightgroups["Key"])
    return "Key: the view layer has no such light group"


@pytest.mark.parametrize(
    "spoil",
    [
        in_two_groups, in_no_group_too, by_an_instance, animated, driven, in_a_node_group, shared_material,
        animated_factor, nothing_in_it, no_such_group,
    ],
)  # fmt: skip
def test_what_cannot_be_written_is_named_and_all_of_its_group_stays(spoil: Any, scene: Any) -> None:
    set_factor(scene, "Key", 2.0)
    sentence = spoil(scene)
    before = light_mix.factors_of(scene)
    written, problems = write(scene)
    assert written == []
    assert named(problems, sentence), problems
    assert scene.objects["Sun"].data.energy == pytest.approx(3.0)
    assert light_mix.factors_of(scene) == before


def test_one_lamp_that_cannot_be_written_keeps_its_group_and_no_other(scene: Any) -> None:
    animated(scene)
    set_factor(scene, "Key", 2.0)
    set_factor(scene, "Sky", 2.0)
    written, problems = write(scene)
    assert written == ["Sky"]
    assert named(problems, "Key: lamp Sun is animated")


def test_the_operator_says_what_it_wrote_and_what_not(scene: Any) -> None:
    import bpy

    assert bpy.ops.neuralguide.write_light_mix() == {"CANCELLED"}
    set_factor(scene, "Key", 2.0)
    assert bpy.ops.neuralguide.write_light_mix() == {"FINISHED"}


@pytest.mark.parametrize(
    ("by", "expected"),
    [
        ("COLLECTION", {"Scene", "Lamp_s", "World"}),
        ("LAMP_KIND", {"Suns", "Glowing Objects", "World"}),
        ("OBJECT", {"Sun", "Cube_001", "World"}),
    ],
)
def test_lights_are_put_into_groups_at_one_click(by: str, expected: set[str], scene: Any) -> None:
    """Names get no dots, groups that nothing is in any longer go, and what does not emit stays."""
    import bpy

    collection = bpy.data.collections.new("Lamp.s")
    scene.collection.children.link(collection)
    sun = scene.objects["Sun"]
    collection.objects.link(sun)
    scene.collection.objects.unlink(sun)
    layer = scene.view_layers[0]
    assert bpy.ops.neuralguide.make_light_groups(by=by) == {"FINISHED"}
    assert {group.name for group in layer.lightgroups} == expected
    assert scene.world.lightgroup == "World"
    assert {scene.objects[name].lightgroup for name in ("Sun", "Cube.001")} == expected - {"World"}
    assert scene.objects["Cube"].lightgroup == ""
    bpy.ops.neuralguide.make_light_groups(by=by)
    assert {group.name for group in layer.lightgroups} == expected


def test_too_many_groups_are_refused_and_the_scene_stays(scene: Any) -> None:
    import bpy

    for _ in range(40):
        scene.collection.objects.link(bpy.data.objects.new("P", bpy.data.lights.new("P", "POINT")))
    with pytest.raises(RuntimeError, match=r"would be 43 light groups.*32 at most"):
        bpy.ops.neuralguide.make_light_groups(by="OBJECT")
    assert [group.name for group in scene.view_layers[0].lightgroups] == GROUPS


def test_a_scene_without_light_gets_no_group(blender: Any) -> None:
    layer = blender.context.view_layer
    assert blender.ops.neuralguide.make_light_groups() == {"CANCELLED"}
    assert len(layer.lightgroups) == 0


def test_the_panel_offers_groups_and_factors(scene: Any) -> None:
    import bpy

    from addon.light_mix_panel import NEURALGUIDE_PT_light_mix

    layout = Layout()
    NEURALGUIDE_PT_light_mix.draw(SimpleNamespace(layout=layout), bpy.context)
    assert {"neuralguide.make_light_groups", "neuralguide.write_light_mix"} <= set(layout.operators)
    mix = scene.neuralguide.light_mix
    assert [(owner.name, name) for owner, name in layout.drawn] == [
        (group, name) for group in mix.keys() for name in ("is_on", "strength", "color")
    ]
