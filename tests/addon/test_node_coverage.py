# SPDX-License-Identifier: GPL-3.0-or-later
"""Every shader node that this Blender has is known or reported, with all of its inputs and settings.

Where one of these tests fails on a new Blender, it has found what is new there: implement that, or see that it is
reported, and list it in `engine/shaders/vocabulary.py`, a closure's parts in its entry (`nodes_closure.py`).
"""

from __future__ import annotations

from typing import Any

import pytest

pytest.importorskip("bpy")

import bpy

from engine.scene.description import Link
from engine.shaders import nodes_closure
from engine.shaders.node_values import gives_values
from engine.shaders.vocabulary import SETTINGS
from tools.node_registry import kinds, notices, properties_of, settings_of, variants

#: Reported whole, whatever their inputs and settings.
REPORTED_WHOLE: set[str] = set()
#: Known nodes and settings that are reported: part of the notice.
REPORTED = (
    "thin film", "BECKMANN", "ROTATION",
    "of lights", "'LIGHT'",
)  # fmt: skip
#: Settings that decide nothing here: an unknown value of theirs may pass.
WITHOUT_EFFECT: set[tuple[str, str]] = {
    # The export reads the file or the text.
    ("ShaderNodeTexIES", "mode"),
}


def known(kind: str) -> bool:
    if kind in REPORTED_WHOLE:
        return False
    closure = nodes_closure.CLOSURES.get(kind)
    named = gives_values(kind) or kind in nodes_closure.MIXES or (closure is not None and closure.inputs is not None)
    return named or kind in ("ShaderNodeBump", "ShaderNodeDisplacement")


def known_settings(kind: str) -> tuple[str, ...]:
    closure = nodes_closure.CLOSURES.get(kind)
    return SETTINGS.get(kind, ()) if closure is None else closure.settings


@pytest.fixture(scope="module")
def tree() -> Any:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    material = bpy.data.materials.new("Every node")
    material.use_nodes = True
    return material.node_tree


def test_every_kind_of_node_is_known_or_reported(tree: Any) -> None:
    silent = []
    for kind in kinds(tree):
        node = tree.nodes.new(kind)
        for socket in node.outputs:
            if socket.type == "CUSTOM" or socket.is_unavailable or known(kind):
                continue
            found = notices(kind, socket.identifier, socket.type == "SHADER", {}, properties_of(node))
            if not any("not supported" in notice.problem or "is a volume" in notice.problem for notice in found):
                silent.append(f"{kind}.{socket.identifier}")
        tree.nodes.remove(node)
    assert silent == []


def test_every_output_of_known_nodes_is_there(tree: Any) -> None:
    missing = []
    for kind in filter(known, kinds(tree)):
        for node in variants(tree, kind):
            for socket in node.outputs:
                if socket.is_unavailable or not socket.enabled or socket.type == "CUSTOM":
                    continue
                found = notices(kind, socket.identifier, socket.type == "SHADER", {}, properties_of(node))
                missing += [f"{kind}: {notice.problem}" for notice in found if "has no output" in notice.problem]
    assert sorted(set(missing)) == []


def test_every_input_of_known_nodes_is_known(tree: Any) -> None:
    """With every input linked nothing is said of inputs, but of those that are known and reported."""
    unknown = set()
    for kind in filter(known, kinds(tree)):
        for node in variants(tree, kind):
            sockets = [socket for socket in node.inputs if socket.enabled and not socket.is_unavailable]
            inputs = {
                socket.identifier: Link(0, "Value") for socket in sockets if socket.type not in ("SHADER", "CUSTOM")
            }
            output = next(socket for socket in node.outputs if socket.enabled)
            found = notices(kind, output.identifier, output.type == "SHADER", inputs, properties_of(node))
            unknown |= {f"{kind}: {notice.problem}" for notice in found if notice.problem.startswith("the input")}
    assert sorted(unknown) == []


def test_every_setting_of_known_nodes_is_known(tree: Any) -> None:
    unknown = {}
    for kind in filter(known, kinds(tree)):
        node = tree.nodes.new(kind)
        unknown[kind] = sorted(settings_of(node).keys() - set(known_settings(kind)))
        tree.nodes.remove(node)
    assert {kind: names for kind, names in unknown.items() if names} == {}


def test_every_value_of_enums_is_known_or_reported(tree: Any) -> None:
    unknown = set()
    for kind in filter(known, kinds(tree)):
        for node in variants(tree, kind):
            output = next(socket for socket in node.outputs if socket.enabled)
            found = notices(kind, output.identifier, output.type == "SHADER", {}, properties_of(node))
            for notice in found:
                if not any(lack in notice.problem for lack in ("has no image", "has no table", "photometric data")):
                    unknown.add(f"{kind}: {notice.problem}")
    unexpected = {problem for problem in unknown if not any(known_one in problem for known_one in REPORTED)}
    unexpected = {problem for problem in unexpected if "data is not supported" not in problem}
    assert sorted(unexpected) == []


def test_values_that_enums_do_not_have_yet_are_reported(tree: Any) -> None:
    silent = []
    for kind in filter(known, kinds(tree)):
        node = tree.nodes.new(kind)
        output = next(socket for socket in node.outputs if socket.enabled)
        for name, prop in settings_of(node).items():
            if prop.type != "ENUM" or (kind, name) in WITHOUT_EFFECT:
                continue
            heard = False
            # Some enums matter only with certain values of another.
            for variant in variants(tree, kind):
                properties = properties_of(variant) | {name: "OF_TOMORROW"}
                inputs = {socket.identifier: Link(0, "Value") for socket in node.inputs if socket.type != "SHADER"}
                found = notices(kind, output.identifier, output.type == "SHADER", inputs, properties)
                heard = heard or any("OF_TOMORROW" in notice.problem for notice in found)
            if not heard:
                silent.append(f"{kind}.{name}")
        tree.nodes.remove(node)
    assert silent == []


@pytest.mark.parametrize("kind, output", [("ShaderNodeMath", "Value"), ("ShaderNodeBsdfDiffuse", "BSDF")])
def test_inputs_and_settings_of_tomorrow_are_reported(kind: str, output: str) -> None:
    is_shader = output == "BSDF"

    def problems(inputs: Any, changed: Any) -> list[str]:
        found = notices(kind, output, is_shader, inputs, {"quality": "HIGH"}, changed)
        return [notice.problem for notice in found]

    assert problems({"Speed": 0.5}, ()) == []
    assert problems({"Speed": Link(0, "Value")}, ()) == ["the input 'Speed' is not supported"]
    assert problems({"Speed": 0.5}, ("Speed", "Roughness")) == ["the input 'Speed' is not supported"]
    assert problems({}, ("quality",)) == ["the setting 'quality' is not supported"]


def test_a_newer_blender_is_asked_what_was_changed(tree: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    from addon.export import node_defaults

    node = tree.nodes.new("ShaderNodeTexNoise")
    properties = properties_of(node)
    assert node_defaults.changed_parts(node, properties) == frozenset()
    monkeypatch.setattr(node_defaults, "NEWEST_KNOWN", (3, 0))
    count = len(bpy.data.node_groups)
    assert node_defaults.changed_parts(node, properties) == frozenset()
    node.inputs["Scale"].default_value = 7.0
    node.noise_dimensions = "4D"
    assert node_defaults.changed_parts(node, properties_of(node)) == {"Scale", "noise_dimensions"}
    assert len(bpy.data.node_groups) == count


def test_passes_are_known_or_reported() -> None:
    from addon import passes

    layer = bpy.context.view_layer
    switches = {name for name in layer.bl_rna.properties.keys() if name.startswith("use_pass_")}
    ours = {name for name, is_ours, _pass in passes.OPTIONAL if not is_ours} | set(passes.LIGHT)
    ours |= {name for name, _kind in passes.MATTES}
    # What comes anyway, and an option of Cryptomatte.
    assert switches - ours - set(passes.UNSUPPORTED) <= {"use_pass_combined", "use_pass_cryptomatte_accurate"}
    switches = {name for name in layer.cycles.bl_rna.properties.keys() if name.startswith(("use_pass_", "pass_"))}
    assert switches <= set(passes.UNSUPPORTED_CYCLES) | set(passes.CYCLES_LIGHT) | {"pass_debug_sample_count"}


def test_settings_are_where_their_table_says() -> None:
    from addon.versions import SETTINGS as TABLE
    from addon.versions import is_since

    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    mesh = bpy.data.objects.new("Mesh", bpy.data.meshes.new("Mesh"))
    owners = [
        bpy.data.cameras.new("Camera"), bpy.data.lights.new("Sun", "POINT"), bpy.data.materials.new("Material"), mesh,
        scene, scene.render, bpy.data.worlds.new("World"), mesh.modifiers.new("Subdivision", "SUBSURF"),
    ]  # fmt: skip
    for name, setting in TABLE.items():
        group, _, attribute = name.rpartition(".")
        places = [getattr(owner, group, None) if group else owner for owner in owners]
        assert any(hasattr(place, attribute) for place in places) == is_since(setting.since), name


def test_unknown_shaders_are_no_surface() -> None:
    found = notices("ShaderNodeBsdfOfTomorrow", "BSDF", True, {}, {})
    assert [(notice.problem, notice.fallback) for notice in found] == [
        ("ShaderNodeBsdfOfTomorrow is not supported", "no surface")
    ]
    assert "ShaderNodeBsdfOfTomorrow" not in nodes_closure.CLOSURES
