# SPDX-License-Identifier: GPL-3.0-or-later
"""Nodes that choose, count and compare (Blender 5.3), and those that Cycles does not know, as Cycles shows them.

A sheet of squares has a case on each: what comes out of a node for a coordinate that varies and for constants.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("bpy")

from tests.helpers.blender_scenes import export
from tests.helpers.pass_scenes import make_material, render_passes
from tools.node_registry import AS_IN_CYCLES

#: Pixels along the edge of a square.
_SQUARE = 9
#: What shows where nothing is linked.
_UNLINKED = (0.9, 0.8, 0.7, 1.0)
_INTEGER = (
    "ADD", "SUBTRACT", "MULTIPLY", "DIVIDE", "MULTIPLY_ADD", "ABSOLUTE", "NEGATE", "POWER", "MINIMUM", "MAXIMUM",
    "SIGN", "DIVIDE_ROUND", "DIVIDE_FLOOR", "DIVIDE_CEIL", "FLOORED_MODULO", "MODULO", "GCD", "LCM",
)  # fmt: skip
_BOOLEAN = ("AND", "OR", "NOT", "NAND", "NOR", "XNOR", "XOR", "IMPLY", "NIMPLY")

Case = Callable[[Any], Any]


def _node(tree: Any, kind: str, properties: dict[str, Any] | None = None, **inputs: Any) -> Any:
    """A node; inputs by their identifiers, as values or as outputs of other nodes."""
    node = tree.nodes.new(kind)
    for name, value in (properties or {}).items():
        setattr(node, name, value)
    for socket in node.inputs:
        # Identifiers have spaces and numbers that arguments cannot have.
        value = inputs.get(socket.identifier.replace(" ", "_"))
        if hasattr(value, "is_output"):
            tree.links.new(value, socket)
        elif value is not None:
            socket.default_value = value
    return node


def _along(tree: Any, factor: float, offset: float) -> Any:
    """A number that grows from left to right over the square, by a step for each pixel."""
    split = _node(tree, "ShaderNodeSeparateXYZ", Vector=tree.nodes.new("ShaderNodeTexCoord").outputs["UV"])
    values = {"Value": split.outputs[0], "Value_001": float(_SQUARE)}
    pixel = _node(tree, "ShaderNodeMath", {"operation": "MULTIPLY"}, **values).outputs[0]
    step = _node(tree, "ShaderNodeMath", {"operation": "FLOOR"}, Value=pixel).outputs[0]
    values = {"Value": step, "Value_001": factor / _SQUARE, "Value_002": offset + 0.5 * factor / _SQUARE}
    return _node(tree, "ShaderNodeMath", {"operation": "MULTIPLY_ADD"}, **values).outputs[0]


def _number(tree: Any, value: float) -> Any:
    node = tree.nodes.new("ShaderNodeValue")
    node.outputs[0].default_value = value
    return node.outputs[0]


def _glow(tree: Any, strength: float) -> Any:
    return _node(tree, "ShaderNodeEmission", Strength=strength).outputs[0]


def _switch(kind: str, false: Any, true: Any, condition: float | None) -> Case:
    def build(tree: Any) -> Any:
        chosen = _along(tree, 1.0, -0.5) if condition is None else _number(tree, condition)
        given = (value(tree) if callable(value) else value for value in (false, true))
        inputs = dict(zip(("False", "True"), given, strict=True))
        return _node(tree, "GeometryNodeSwitch", {"input_type": kind}, Switch=chosen, **inputs).outputs[0]

    return build


def _index_switch(kind: str, *items: Any, index: float | None) -> Case:
    def build(tree: Any) -> Any:
        node = tree.nodes.new("GeometryNodeIndexSwitch")
        node.data_type = kind
        for _ in items[2:]:
            node.index_switch_items.new()
        for number, item in enumerate(items):
            socket = next(socket for socket in node.inputs if socket.identifier == f"Item_{number}")
            if callable(item):
                tree.links.new(item(tree), socket)
            else:
                socket.default_value = item
        tree.links.new(_along(tree, 6.0, -1.5) if index is None else _number(tree, index), node.inputs[0])
        return node.outputs[0]

    return build


def _integer(operation: str, second: int, first: float | None) -> Case:
    def build(tree: Any) -> Any:
        given = _along(tree, 36.0, -18.3) if first is None else _number(tree, first)
        inputs = {"Value": given, "Value_001": second, "Value_002": 4}
        return _node(tree, "FunctionNodeIntegerMath", {"operation": operation}, **inputs).outputs[0]

    return build


def _power(base: int) -> Case:
    def build(tree: Any) -> Any:
        inputs = {"Value": base, "Value_001": _along(tree, 9.0, -4.5)}
        return _node(tree, "FunctionNodeIntegerMath", {"operation": "POWER"}, **inputs).outputs[0]

    return build


def _boolean(operation: str, second: bool, first: float | None) -> Case:
    def build(tree: Any) -> Any:
        given = _along(tree, 2.0, -1.1) if first is None else _number(tree, first)
        inputs = {"Boolean": given, "Boolean_001": second}
        return _node(tree, "FunctionNodeBooleanMath", {"operation": operation}, **inputs).outputs[0]

    return build


def _component(index: float | None) -> Case:
    def build(tree: Any) -> Any:
        given = _along(tree, 6.0, -1.5) if index is None else _number(tree, index)
        vector = _node(tree, "ShaderNodeCombineXYZ", X=_along(tree, 1.0, 0.0), Y=0.4, Z=0.6).outputs[0]
        return _node(tree, "FunctionNodeGetVectorComponent", Vector=vector, Index=given).outputs[0]

    return build


def _converted(kind: str, source: str, value: float | None) -> Case:
    def build(tree: Any) -> Any:
        number = _along(tree, 4.0, -2.1) if value is None else _number(tree, value)
        if source:
            join = tree.nodes.new(source)
            tree.links.new(number, join.inputs[0])
            number = join.outputs[0]
        return _node(tree, "NodeImplicitConversion", {"data_type": kind}, Value=number).outputs[0]

    return build


def _enabled(kind: str, value: Any, condition: float | None) -> Case:
    def build(tree: Any) -> Any:
        chosen = _along(tree, 2.0, -1.1) if condition is None else _number(tree, condition)
        given = value(tree) if callable(value) else value
        return _node(tree, "NodeEnableOutput", {"data_type": kind}, Enable=chosen, Value=given).outputs[0]

    return build


def _string(kind: str, output: str = "", properties: dict[str, Any] | None = None, **inputs: Any) -> Case:
    """What a node of strings gives, its length where that is a string."""

    def build(tree: Any) -> Any:
        node = _node(tree, kind, properties, **inputs)
        socket = node.outputs[output] if output else node.outputs[0]
        if socket.type != "STRING":
            return socket
        return _node(tree, "FunctionNodeStringToValue", String=socket).outputs[0]

    return build


_ITEMS = {"a": ("FLOAT", 2.5), "b": ("INT", -7), "c": ("STRING", "34"), "d": ("INT", 6), "e": ("FLOAT", 4.0)}


def _formatted(text: str, *, by_length: bool = False) -> Case:
    """The number that a format gives, or how long its string is."""

    def build(tree: Any) -> Any:
        node = tree.nodes.new("FunctionNodeFormatString")
        for name, (kind, value) in _ITEMS.items():
            node.format_items.new(kind, name)
            node.inputs[len(node.inputs) - 2].default_value = value
        node.inputs["Format"].default_value = text
        if by_length:
            return _node(tree, "FunctionNodeStringLength", String=node.outputs[0]).outputs[0]
        return _node(tree, "FunctionNodeStringToValue", String=node.outputs[0]).outputs[0]

    return build


#: What Format String is asked for; what begins with no number is told by its length.
_FORMATS = (
    "{}", "{}{}", "{}5", "{1}", "{b}", "{c}{d}", "3{{{}", "{3:04}", "{d:<3}1", "{a:.3f}", "{a:e}", "{a:.2}", "{e}",
    "{e:.3}",
    "{d:b}", "{d:X}", "{c:>{d}}", "{c:.1}", "{a:.{d}f}", "{d:###}", "{b:#####}", "{x}", "{9}", "{", "9}", "{a:d}",
    "{d:.2f}", "{b:+}", "{d:+}", "{:>8}{:>8}", "{} {a} {}", "1{a:*^9.1f}", "{c:s}", "{d:c}", "{c:#}",
    "{a:a}", "{:<6}|{c}", "{a:08}", "{c:^9}",
)  # fmt: skip
#: Not followed: hexadecimal fractions.
_UNKNOWN = ("format {a:a}", "length of {a:a}")
_UNKNOWN_FORMAT = "has a setting of strings that is not supported"
_TRIMS = ("xx12x", "  12 ", "xxxx", "", "x1x2x")


def _format_cases() -> dict[str, Case]:
    cases = {f"format {text}": _formatted(text) for text in _FORMATS}
    cases |= {f"length of {text}": _formatted(text, by_length=True) for text in _FORMATS}
    whole = {"data_type": "INT"}
    for base in (2, 3, 16, 36, 10):
        for padding in (0, 6):
            for value in (0, 11, -35):
                inputs = {"Value": value, "Base": base, "Padding": padding}
                written = _string("FunctionNodeValueToString", properties=whole, **inputs)
                cases[f"{value} by {base}, {padding}"] = written
        for text in ("1011", "-1g", "fF", "+7", "0x1", "zz2", "-", "99999999999"):
            for output in ("Value", "Length"):
                read = _string("FunctionNodeStringToValue", output, properties=whole, String=text, Base=base)
                cases[f"{output} of {text} by {base}"] = read
    for text in _TRIMS:
        for ends in ("both", "start", "end"):
            for whitespace in (False, True):
                cases[f"trim {ends} of {text}, {whitespace}"] = _trimmed(text, ends, whitespace)
    return cases


def _trimmed(text: str, ends: str, whitespace: bool) -> Case:
    """How long a string is without what is trimmed."""

    def build(tree: Any) -> Any:
        trim = _node(
            tree, "FunctionNodeTrimString", String=text, Characters="x", Whitespace=whitespace, Start=ends != "end",
            End=ends != "start",
        )  # fmt: skip
        return _node(tree, "FunctionNodeStringLength", String=trim.outputs[0]).outputs[0]

    return build


def _joined(first: str, second: str, wanted: str) -> Case:
    def build(tree: Any) -> Any:
        join = tree.nodes.new("NodeJoinBundle")
        for name, value in ((first, 0.3), (second, 0.6)):
            bundle = tree.nodes.new("NodeCombineBundle")
            bundle.bundle_items.new("FLOAT", name)
            bundle.inputs[0].default_value = value
            tree.links.new(bundle.outputs[0], join.inputs[0])
        split = tree.nodes.new("NodeSeparateBundle")
        split.bundle_items.new("FLOAT", wanted)
        tree.links.new(join.outputs[0], split.inputs[0])
        return split.outputs[0]

    return build


def _menu(tree: Any) -> Any:
    node = tree.nodes.new("GeometryNodeMenuSwitch")
    node.data_type = "FLOAT"
    node.enum_definition.enum_items.clear()
    for name in "AB":
        node.enum_definition.enum_items.new(name)
    node.inputs[1].default_value, node.inputs[2].default_value = 0.2, 0.5
    menu = tree.nodes.new("FunctionNodeInputMenu")
    tree.links.new(menu.outputs[0], node.inputs[0])
    menu.value = "B"
    return node.outputs[0]


def _warning(tree: Any) -> Any:
    return _node(tree, "GeometryNodeWarning", Show=_along(tree, 2.0, -1.0)).outputs[0]


def _plain(kind: str, output: str) -> Case:
    return lambda tree: tree.nodes.new(kind).outputs[output]


def _from_shader(tree: Any) -> Any:
    return _node(tree, "ShaderNodeShaderToRGB", Shader=_glow(tree, 0.6)).outputs[0]


_RED, _BLUE = (0.5, 0.2, 0.1, 1.0), (0.1, 0.2, 0.7, 1.0)


def _dim(tree: Any) -> Any:
    return _glow(tree, 0.25)


def _bright(tree: Any) -> Any:
    return _glow(tree, 1.0)


def _rising(tree: Any) -> Any:
    return _along(tree, 4.0, -2.1)


def _new_cases() -> dict[str, Case]:
    """Nodes of Blender 5.3."""
    cases: dict[str, Case] = {"menu": _menu, "warning": _warning}
    for condition in (None, -1.0, 0.0, 0.4, 2.0):
        cases[f"switch {condition}"] = _switch("RGBA", _RED, _BLUE, condition)
        cases[f"switch vector {condition}"] = _switch("VECTOR", (0.1, 0.5, 0.3), (0.6, 0.2, 0.4), condition)
        cases[f"switch shader {condition}"] = _switch("SHADER", _dim, _bright, condition)
        cases[f"enable {condition}"] = _enabled("FLOAT", 0.7, condition)
        cases[f"enable shader {condition}"] = _enabled("SHADER", _dim, condition)
        for kind in ("INT", "BOOLEAN", "FLOAT"):
            cases[f"switch {kind} {condition}"] = _switch(kind, _rising, _rising, condition)
    for index in (None, -1.0, 0.9, 1.0, 2.6, 5.0):
        cases[f"index {index}"] = _index_switch("FLOAT", 0.1, 0.3, _rising, index=index)
        cases[f"index colour {index}"] = _index_switch("RGBA", _RED, _BLUE, index=index)
        cases[f"index shader {index}"] = _index_switch("SHADER", _dim, _bright, index=index)
        cases[f"component {index}"] = _component(index)
    for operation in _INTEGER:
        for second in (3, -4, 0):
            if operation == "POWER" and second < 0:
                continue
            for first in (None, 17.7, -6.0, 2e9):
                cases[f"integer {operation} {first} {second}"] = _integer(operation, second, first)
    for base in (-2, -1, 0, 1, 3):
        cases[f"power of {base}"] = _power(base)
    for operation in _BOOLEAN:
        for second in (False, True):
            for first in (None, 0.4, -2.0):
                cases[f"boolean {operation} {first} {second}"] = _boolean(operation, second, first)
    for kind in ("FLOAT", "INT", "BOOLEAN", "VECTOR", "RGBA"):
        for source in ("", "ShaderNodeCombineXYZ", "ShaderNodeCombineColor"):
            cases[f"{kind} of {source}"] = _converted(kind, source, None)
        for value in (1.7, -1.7):
            cases[f"{kind} of {value}"] = _converted(kind, "", value)
    cases["joined"], cases["joined twice"] = _joined("a", "b", "b"), _joined("a", "a", "a")
    return cases | _string_cases()


def _string_cases() -> dict[str, Case]:
    slices = {
        f"slice {begin}": _string("FunctionNodeSliceString", String="12345", Position=begin, Length=3)
        for begin in (-5, -2, 0, 2, 9)
    }
    matches = {
        f"match {operation}": _string("FunctionNodeMatchString", String="abcd", Operation=operation, Key="bc")
        for operation in ("Starts With", "Ends With", "Contains")
    }
    return slices | matches | {
        "length": _string("FunctionNodeStringLength", String="hello"),
        "number": _string("FunctionNodeStringToValue", String="3.5abc"),
        "number's length": _string("FunctionNodeStringToValue", "Length", String="-3.5abc"),
        "no number": _string("FunctionNodeStringToValue", String="abc"),
        "whole number": _string("FunctionNodeStringToValue", properties={"data_type": "INT"}, String="42.9"),
        "written": _string("FunctionNodeValueToString", Value=12.345, Decimals=2),
        "written whole": _string("FunctionNodeValueToString", properties={"data_type": "INT"}, Value=12),
        "found": _string("FunctionNodeFindInString", "First Found", String="xxaxa", Search="a"),
        "found nowhere": _string("FunctionNodeFindInString", "First Found", String="xx", Search="a"),
        "count": _string("FunctionNodeFindInString", "Count", String="aaxa", Search="a"),
        "replaced": _string("FunctionNodeReplaceString", String="1a2a", Find="a", Replace="7"),
        "reversed": _string("FunctionNodeReverseString", String="123"),
        "small": _string("FunctionNodeSetStringCase", String="1E2", Case="Lowercase"),
        "line break": _string("FunctionNodeInputSpecialCharacters"),
        "constant": _string("FunctionNodeInputString", properties={"string": "2.5"}),
    }  # fmt: skip


def _unknown_cases(bpy: Any) -> dict[str, Case]:
    """Nodes that Cycles does not know, those of this Blender: loops over lights are of Blender 5.3."""
    cases = {
        "ShaderNodeShaderToRGB": _from_shader,
        "ShaderNodeSqueeze": _plain("ShaderNodeSqueeze", "Value"),
        "ShaderNodeUVAlongStroke": _plain("ShaderNodeUVAlongStroke", "UV"),
        "ShaderNodeEeveeSpecular": _plain("ShaderNodeEeveeSpecular", "BSDF"),
        "ShaderNodeLightAccumulation": _plain("ShaderNodeLightAccumulation", "Shader"),
        "ShaderNodeLightEvaluation": _plain("ShaderNodeLightEvaluation", "Factor"),
        "ShaderNodeLightInfo": _plain("ShaderNodeLightInfo", "Color"),
        "ShaderNodeLightIterInternalInput": _plain("ShaderNodeLightIterInternalInput", "LightIndex"),
        "ShaderNodeShadowRaycast": _plain("ShaderNodeShadowRaycast", "Color"),
    }
    assert {*cases} == AS_IN_CYCLES
    return {kind: case for kind, case in cases.items() if hasattr(bpy.types, kind)}


def _shown(case: Case) -> Case:
    def surface(tree: Any) -> Any:
        output = case(tree)
        if output.type == "SHADER":
            return output
        node = _node(tree, "ShaderNodeEmission", Color=_UNLINKED)
        tree.links.new(output, node.inputs[0])
        return node.outputs[0]

    return surface


def _build_sheet(bpy: Any, cases: dict[str, Case]) -> int:
    """Returns how many squares are in a row."""
    columns = math.ceil(math.sqrt(len(cases)))
    vertices, faces = [], []
    for index in range(len(cases)):
        x, y = index % columns, index // columns
        vertices += [(x, y, 0), (x + 1, y, 0), (x + 1, y + 1, 0), (x, y + 1, 0)]
        faces.append(tuple(range(4 * index, 4 * index + 4)))
    mesh = bpy.data.meshes.new("sheet")
    mesh.from_pydata(vertices, [], faces)
    mesh.uv_layers.new(name="uv")
    for index, (name, case) in enumerate(cases.items()):
        mesh.materials.append(make_material(name, _shown(case)))
        mesh.polygons[index].material_index = index
    scene = bpy.context.scene
    scene.collection.objects.link(bpy.data.objects.new("sheet", mesh))
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    camera.data.type, camera.data.ortho_scale = "ORTHO", columns
    camera.location = (columns / 2, columns / 2, 5.0)
    scene.collection.objects.link(camera)
    scene.camera = camera
    scene.render.resolution_x = scene.render.resolution_y = columns * _SQUARE
    scene.render.resolution_percentage = 100
    return columns


def _rendered(scene: Any, engine: str, file: Path) -> np.ndarray:
    scene.render.engine = engine
    scene.cycles.samples = scene.neuralguide.samples = 1
    scene.cycles.use_adaptive_sampling = scene.cycles.use_denoising = False
    scene.cycles.pixel_filter_type, scene.cycles.filter_width = "BOX", 0.01
    images, _ = render_passes(scene, file)
    return np.stack([next(images[name] for name in images if name.endswith(f"Combined.{part}")) for part in "RGB"], -1)


def _differing(bpy: Any, cases: dict[str, Case], folder: Path) -> dict[str, tuple[list[float], list[float]]]:
    """The middle row of each square that differs: ours and Cycles'."""
    columns = _build_sheet(bpy, cases)
    scene = bpy.context.scene
    ours, theirs = (_rendered(scene, name, folder / f"{name}.exr")[::-1] for name in ("NEURALGUIDE", "CYCLES"))
    assert theirs.max() > 0.5
    found = {}
    for index, name in enumerate(cases):
        x, y = index % columns * _SQUARE, index // columns * _SQUARE + _SQUARE // 2
        row = slice(x, x + _SQUARE)
        if not np.allclose(ours[y, row], theirs[y, row], rtol=1e-4, atol=1e-4):
            found[name] = (ours[y, row, 0].round(3).tolist(), theirs[y, row, 0].round(3).tolist())
    return found


def test_switches_and_whole_numbers_are_those_of_cycles(blender: Any, tmp_path: Path) -> None:
    if blender.app.version < (5, 3):
        pytest.skip("these nodes are of Blender 5.3")
    assert _differing(blender, _new_cases(), tmp_path) == {}


def test_formats_bases_and_trimming_are_those_of_cycles(blender: Any, tmp_path: Path) -> None:
    if blender.app.version < (5, 3):
        pytest.skip("these nodes are of Blender 5.3")
    cases = _format_cases()
    columns = _build_sheet(blender, cases)
    theirs = _rendered(blender.context.scene, "CYCLES", tmp_path / "cycles.exr")[::-1]
    description = export()
    assert [notice.problem for notice in description.notices] == [_UNKNOWN_FORMAT] * 2
    differing = {}
    for index, (name, material) in enumerate(zip(cases, description.materials, strict=True)):
        graph = material.graph
        emission = next(node for node in graph.nodes if node.kind == "ShaderNodeEmission")
        ours, shown = emission.inputs["Color"], theirs[index // columns * _SQUARE + 1, index % columns * _SQUARE + 1]
        if name not in _UNKNOWN and not np.allclose(ours[:3], shown, rtol=1e-5):
            differing[name] = (ours, shown.tolist())
    assert differing == {}


def test_nodes_that_cycles_does_not_know_are_as_in_cycles(blender: Any, tmp_path: Path) -> None:
    assert _differing(blender, _unknown_cases(blender) | {"glow": _bright}, tmp_path) == {}
