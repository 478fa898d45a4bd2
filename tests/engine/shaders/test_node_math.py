# SPDX-License-Identifier: GPL-3.0-or-later
"""Texture, math and colour nodes as parts of compiled graphs: folding, defaults, conversions, notices."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from engine.kernels.shader import ops_closure, ops_math
from engine.state.shaders import PROGRAM_EMISSION_CONSTANT, PROGRAM_FLAGS, ShaderArrays
from tests.helpers.shader_harness import Graph, compile_one, emitted, run, square_points

_UV = np.array(((0.12, 0.85), (0.61, 0.34), (0.93, 0.07)), np.float32)


def _opcodes(shaders: ShaderArrays) -> list[int]:
    pc, found = 0, []
    while pc < shaders.programs[0, 1]:
        found.append(int(shaders.code[pc]))
        pc += int(shaders.code[pc + 1])
    return found


def _position(graph: Graph) -> Any:
    return graph.link("ShaderNodeNewGeometry", "Position")


# Nodes of every kind of instruction, with what they are fed where it is not a constant.
_GRAPHS: dict[str, tuple[str, str, dict[str, Any], dict[str, Any], str]] = {
    "noise": ("ShaderNodeTexNoise", "Color", {"Scale": 3.0, "Distortion": 0.2}, {}, "Vector"),
    "voronoi": ("ShaderNodeTexVoronoi", "Position", {"Scale": 3.0}, {"feature": "F2"}, "Vector"),
    "wave": ("ShaderNodeTexWave", "Color", {"Distortion": 2.0}, {}, "Vector"),
    "brick": ("ShaderNodeTexBrick", "Color", {"Mortar": (0.1, 0.2, 0.3, 1.0)}, {"squash": 1.5}, "Vector"),
    "magic": ("ShaderNodeTexMagic", "Color", {}, {}, "Vector"),
    "white noise": ("ShaderNodeTexWhiteNoise", "Color", {}, {}, "Vector"),
    "gradient": ("ShaderNodeTexGradient", "Color", {}, {}, "Vector"),
    "reflect": ("ShaderNodeVectorMath", "Vector", {"Vector_001": (0.3, 0.2, 0.9)}, {"operation": "REFLECT"}, "Vector"),
    "snap": ("ShaderNodeVectorMath", "Vector", {"Vector_001": (0.3, 0.2, 0.9)}, {"operation": "SNAP"}, "Vector"),
    "mix": (
        "ShaderNodeMix",
        "Result_Color",
        {"B_Color": (0.9, 0.1, 0.4, 1.0), "Factor_Float": 0.4},
        {"data_type": "RGBA", "blend_type": "OVERLAY"},
        "A_Color",
    ),
    "mix rgb": ("ShaderNodeMixRGB", "Color", {"Fac": 0.3}, {"blend_type": "HUE"}, "Color2"),
    "map range": ("ShaderNodeMapRange", "Vector", {}, {"data_type": "FLOAT_VECTOR"}, "Vector"),
    "hue": ("ShaderNodeHueSaturation", "Color", {"Hue": 0.7, "Saturation": 1.3}, {}, "Color"),
    "rotate": ("ShaderNodeVectorRotate", "Vector", {"Angle": 0.7}, {}, "Vector"),
    "gamma": ("ShaderNodeGamma", "Color", {"Gamma": 2.2}, {}, "Color"),
    "combine": ("ShaderNodeCombineColor", "Color", {"Red": 0.3, "Blue": 0.9}, {"mode": "HSV"}, "Green"),
}


@pytest.mark.parametrize("name", _GRAPHS)
def test_folding_gives_what_running_gives(name: str) -> None:
    kind, output, inputs, properties, varying = _GRAPHS[name]
    graph = Graph()
    given = {**inputs, varying: _position(graph)}
    at_run_time = emitted(graph.emit(graph.link(kind, output, inputs=given, **properties)), square_points(_UV))
    assert np.isfinite(at_run_time).all()
    for uv, expected in zip(_UV, at_run_time, strict=True):
        graph = Graph()
        position = (float(uv[0]), float(uv[1]), 0.0)
        # A linked vector becomes a number by the mean of its components.
        value = sum(position) / 3.0 if varying == "Green" else position
        given = {**inputs, varying: value}
        shaders, _names, notices = compile_one(graph.emit(graph.link(kind, output, inputs=given, **properties)))
        assert notices == []
        assert _opcodes(shaders) == [ops_closure.OP_EMISSION]
        assert shaders.programs[0, PROGRAM_FLAGS] & PROGRAM_EMISSION_CONSTANT
        np.testing.assert_allclose(run(shaders).emission[0, :3], expected, rtol=1e-6, atol=1e-6)


def test_uniform_factor_of_a_linked_vector_is_its_mean() -> None:
    graph = Graph()
    inputs = {"Factor_Float": _position(graph), "A_Vector": (0.0, 0.0, 0.0), "B_Vector": (1.0, 2.0, 3.0)}
    mixed = graph.link("ShaderNodeMix", "Result_Vector", inputs=inputs, data_type="VECTOR")
    result = emitted(graph.emit(mixed), square_points((0.6, 0.3)))
    np.testing.assert_allclose(result[0], np.array((0.3, 0.6, 0.9)), rtol=1e-6)


def test_ramp_steps_or_interpolates() -> None:
    table = np.zeros((257, 4), np.float32)
    table[:, 0] = np.linspace(0.0, 1.0, 257)
    table[:, 3] = 1.0
    for interpolate, expected in ((True, 0.5 + 0.25 / 256), (False, 0.5)):
        graph = Graph()
        fac = graph.link("ShaderNodeMath", "Value", inputs={"Value": _position(graph), "Value_001": 0.0})
        ramp = graph.link("ShaderNodeValToRGB", "Color", inputs={"Fac": fac}, ramp=table, interpolate=interpolate)
        third = 0.5 + 0.25 / 256  # a third of x + y + z
        result = emitted(graph.emit(ramp), square_points((0.9, 3.0 * third - 0.9)))
        np.testing.assert_allclose(result[0, 0], expected, atol=1e-6)


def test_tables_are_shared() -> None:
    table = np.linspace(0.0, 1.0, 257 * 3, dtype=np.float32).reshape(257, 3)
    graph = Graph()
    first = graph.link("ShaderNodeRGBCurve", "Color", inputs={"Color": _position(graph)}, curves=table)
    second = graph.link("ShaderNodeRGBCurve", "Color", inputs={"Color": first}, curves=table.copy())
    shaders, _names, _notices = compile_one(graph.emit(second))
    codes = _opcodes(shaders)
    assert codes.count(ops_math.OP_CURVES) == 2
    one = Graph()
    only = one.link("ShaderNodeRGBCurve", "Color", inputs={"Color": _position(one)}, curves=table)
    assert len(compile_one(one.emit(only))[0].tables) == len(shaders.tables)


def test_textures_default_to_generated_coordinates() -> None:
    graph = Graph()
    gradient = graph.link("ShaderNodeTexGradient", "Fac")
    result = emitted(graph.emit(gradient), square_points(_UV))
    np.testing.assert_allclose(result[:, 0], _UV[:, 0], rtol=1e-6)


@pytest.mark.parametrize(
    ("kind", "output", "properties"),
    [
        ("ShaderNodeMath", "Value", {"operation": "HYPERBOLE"}),
        ("ShaderNodeVectorMath", "Vector", {"operation": "HYPERBOLE"}),
        ("ShaderNodeTexNoise", "Fac", {"noise_type": "SIMPLEX"}),
        ("ShaderNodeMix", "Result_Float", {"data_type": "ROTATION"}),
        ("ShaderNodeValToRGB", "Color", {}),
        ("ShaderNodeFloatCurve", "Value", {}),
    ],
)
def test_unknown_settings_and_missing_tables_are_reported(
    kind: str, output: str, properties: dict[str, Any]
) -> None:
    graph = Graph()
    node = graph.link(kind, output, name="The node", **properties)
    shaders, _names, notices = compile_one(graph.emit(node))
    assert len(notices) == 1 and "The node" in notices[0].subject
    assert np.isfinite(run(shaders).emission).all()
