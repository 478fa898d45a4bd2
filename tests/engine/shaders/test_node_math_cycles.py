# SPDX-License-Identifier: GPL-3.0-or-later
"""Nodes on numbers, vectors and colours against Cycles, pixel by pixel on the same inputs."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

pytest.importorskip("bpy")

import bpy

from engine.kernels.shader.color_math import BLEND_MODES
from engine.kernels.shader.scalar_math import MATH_OPERATIONS
from engine.kernels.shader.vector_math import COMPONENT_OPERATIONS, VECTOR_OPERATIONS
from tests.helpers.node_oracle import NodeCase, node_inputs, render_cases
from tests.helpers.node_runner import run_node


def _numbers() -> list[NodeCase]:
    cases = []
    for operation in MATH_OPERATIONS:
        inputs = {"Value": ("A.x", 3.0), "Value_001": "B.x", "Value_002": "B.y"}
        cases.append(NodeCase("ShaderNodeMath", "Value", inputs, {"operation": operation}))
        inputs = {"Value": "A.z", "Value_001": 2.0, "Value_002": 0.25}
        settings = {"operation": operation, "use_clamp": True}
        cases.append(NodeCase("ShaderNodeMath", "Value", inputs, settings))
        inputs = {"Value": "A.z", "Value_001": 0.0, "Value_002": 0.0}
        cases.append(NodeCase("ShaderNodeMath", "Value", inputs, {"operation": operation}))
    for interpolation in ("LINEAR", "STEPPED", "SMOOTHSTEP", "SMOOTHERSTEP"):
        for clamp in (False, True):
            settings = {"interpolation_type": interpolation, "clamp": clamp}
            inputs = {"Value": "A.x", "From Min": -0.5, "From Max": 0.7, "To Min": 2.0, "To Max": -1.0, "Steps": 3.0}
            cases.append(NodeCase("ShaderNodeMapRange", "Result", inputs, settings))
            inputs = {"Value": "A.x", "From Min": "A.y", "From Max": "B.x", "To Min": "B.y", "To Max": "B.z"}
            cases.append(NodeCase("ShaderNodeMapRange", "Result", {**inputs, "Steps": 0.0}, settings))
            empty = {"Value": "A.x", "From Min": 0.5, "From Max": 0.5, "To Min": 0.3, "To Max": "B.x"}
            cases.append(NodeCase("ShaderNodeMapRange", "Result", empty, settings, label="empty"))
            vectors = {
                "Vector": "A",
                "From_Min_FLOAT3": (-0.5, 0.4, 0.2),
                "From_Max_FLOAT3": (0.8, -0.6, 0.2),
                "To_Min_FLOAT3": "B",
                "To_Max_FLOAT3": (1.0, 2.0, 3.0),
                "Steps_FLOAT3": (2.0, 3.5, 0.0),
            }
            settings = {**settings, "data_type": "FLOAT_VECTOR"}
            cases.append(NodeCase("ShaderNodeMapRange", "Vector", vectors, settings))
    for kind in ("MINMAX", "RANGE"):
        inputs = {"Value": "A.x", "Min": "B.x", "Max": "B.y"}
        cases.append(NodeCase("ShaderNodeClamp", "Result", inputs, {"clamp_type": kind}))
    return cases


def _vectors() -> list[NodeCase]:
    cases = []
    numbers = VECTOR_OPERATIONS[-3:]
    there = bpy.types.ShaderNodeVectorMath.bl_rna.properties["operation"].enum_items.keys()
    for operation in (*COMPONENT_OPERATIONS, *VECTOR_OPERATIONS):
        if operation not in there:  # Blender 5.2 has ROUND.
            continue
        output = "Value" if operation in numbers else "Vector"
        inputs: dict[str, Any] = {"Vector": ("A", 2.0), "Vector_001": "B", "Vector_002": (0.3, -0.4, 0.2)}
        for scale in {"REFRACT": (1.4, 0.7), "SCALE": (1.4,)}.get(operation, ()):
            scaled = {**inputs, "Scale": scale}
            cases.append(NodeCase("ShaderNodeVectorMath", output, scaled, {"operation": operation}))
        cases.append(NodeCase("ShaderNodeVectorMath", output, inputs, {"operation": operation}))
        inputs = {"Vector": "A", "Vector_001": (0.0, 0.0, 0.0), "Vector_002": "B"}
        cases.append(NodeCase("ShaderNodeVectorMath", output, inputs, {"operation": operation}, label="zero"))
    if "ROUND" in there:
        halves = {"Vector": (0.5, -0.5, -1.5)}
        cases.append(NodeCase("ShaderNodeVectorMath", "Vector", halves, {"operation": "ROUND"}, label="halves"))
    for kind in ("AXIS_ANGLE", "X_AXIS", "Y_AXIS", "Z_AXIS", "EULER_XYZ"):
        for invert in (False, True):
            inputs = {"Vector": "A", "Center": (0.2, 0.1, -0.3), "Axis": (0.4, -0.9, 0.5)}
            inputs |= {"Rotation": ("B", 2.0), "Angle": ("B.x", 3.0)}
            settings = {"rotation_type": kind, "invert": invert}
            cases.append(NodeCase("ShaderNodeVectorRotate", "Vector", inputs, settings))
    zero = {"Vector": "A", "Axis": (0.0, 0.0, 0.0), "Angle": 1.0}
    cases.append(NodeCase("ShaderNodeVectorRotate", "Vector", zero, {"rotation_type": "AXIS_ANGLE"}, label="zero"))
    cases.append(NodeCase("ShaderNodeCombineXYZ", "Vector", {"X": "A.y", "Y": "B.x", "Z": 0.3}))
    cases += [NodeCase("ShaderNodeSeparateXYZ", axis, {"Vector": "A"}) for axis in "XYZ"]
    return cases


def _mixes() -> list[NodeCase]:
    cases = []
    for mode in BLEND_MODES:
        # The inputs reach from -1.5 to 1.7: below 0 and above 1, where blend modes differ most.
        inputs = {"Factor_Float": "A.z", "A_Color": "A", "B_Color": "B"}
        settings = {"data_type": "RGBA", "blend_type": mode, "clamp_factor": False, "clamp_result": False}
        cases.append(NodeCase("ShaderNodeMix", "Result_Color", inputs, settings))
        settings = {**settings, "clamp_factor": True, "clamp_result": True}
        cases.append(NodeCase("ShaderNodeMix", "Result_Color", inputs, settings))
        inputs = {"Fac": 0.6, "Color1": "B", "Color2": (0.8, 0.3, 0.5)}
        settings = {"blend_type": mode, "use_clamp": mode in BLEND_MODES[::2]}
        cases.append(NodeCase("ShaderNodeMixRGB", "Color", inputs, settings))
    for clamp in (False, True):
        inputs = {"Factor_Float": "A.x", "A_Float": "A.y", "B_Float": "B.x"}
        cases.append(
            NodeCase("ShaderNodeMix", "Result_Float", inputs, {"data_type": "FLOAT", "clamp_factor": clamp})
        )
        for mode, factor in (("UNIFORM", {"Factor_Float": "A.x"}), ("NON_UNIFORM", {"Factor_Vector": "B"})):
            inputs = {**factor, "A_Vector": "A", "B_Vector": (0.2, -0.7, 1.3)}
            settings = {"data_type": "VECTOR", "factor_mode": mode, "clamp_factor": clamp}
            cases.append(NodeCase("ShaderNodeMix", "Result_Vector", inputs, settings))
    return cases


def _ramp(interpolation: str, mode: str = "RGB") -> Any:
    def set_up(node: Any) -> None:
        ramp = node.color_ramp
        ramp.color_mode = mode
        ramp.interpolation = interpolation
        ramp.elements[0].color = (0.9, 0.1, 0.05, 0.4)
        ramp.elements[1].position = 0.83
        ramp.elements[1].color = (0.1, 0.3, 0.8, 1.0)
        ramp.elements.new(0.37).color = (0.2, 0.9, 0.4, 0.7)

    return set_up


def _curves(extend: str) -> Any:
    def set_up(node: Any) -> None:
        mapping = node.mapping
        mapping.extend = extend
        for index, curve in enumerate(mapping.curves):
            start, end = curve.points[0], curve.points[-1]
            start.location = (start.location[0] + 0.1 * index - 0.1, 0.1 + 0.05 * index)
            end.location = (end.location[0] - 0.05 * index, end.location[1])
            curve.points.new(0.3 + 0.1 * index, 0.6 - 0.1 * index)
        mapping.update()

    return set_up


def _colors() -> list[NodeCase]:
    cases = [
        NodeCase("ShaderNodeRGBToBW", "Val", {"Color": "A"}),
        NodeCase("ShaderNodeInvert", "Color", {"Fac": "B.x", "Color": "A"}),
        NodeCase("ShaderNodeGamma", "Color", {"Color": "A", "Gamma": "B.x"}),
        NodeCase("ShaderNodeGamma", "Color", {"Color": "A", "Gamma": 0.0}),
        NodeCase("ShaderNodeBrightContrast", "Color", {"Color": "A", "Bright": "B.x", "Contrast": "B.y"}),
        NodeCase("ShaderNodeHueSaturation", "Color", {"Color": "A"}),
        NodeCase(
            "ShaderNodeHueSaturation",
            "Color",
            {"Color": "A", "Hue": "B.x", "Saturation": ("B.y", 1.5), "Value": "B.z", "Fac": 0.8},
        ),
        NodeCase("ShaderNodeBlackbody", "Color", {"Temperature": ("A.x", 10000.0)}),
        NodeCase("ShaderNodeBlackbody", "Color", {"Temperature": ("A.x", 1600.0)}),
        NodeCase("ShaderNodeWavelength", "Color", {"Wavelength": ("A.x", 600.0)}),
    ]
    for mode in ("RGB", "HSV", "HSL"):
        inputs = {"Red": "A.x", "Green": "A.y", "Blue": "A.z"}
        cases.append(NodeCase("ShaderNodeCombineColor", "Color", inputs, {"mode": mode}))
        cases += [
            NodeCase("ShaderNodeSeparateColor", channel, {"Color": "A"}, {"mode": mode})
            for channel in ("Red", "Green", "Blue")
        ]
    for interpolation in ("LINEAR", "CONSTANT", "EASE", "B_SPLINE", "CARDINAL"):
        for output in ("Color", "Alpha"):
            set_up = _ramp(interpolation)
            cases.append(NodeCase("ShaderNodeValToRGB", output, {"Fac": "A.x"}, {}, set_up, label=interpolation))
    cases.append(NodeCase("ShaderNodeValToRGB", "Color", {"Fac": "A.x"}, {}, _ramp("LINEAR", "HSV"), label="HSV"))
    for extend in ("HORIZONTAL", "EXTRAPOLATED"):
        set_up = _curves(extend)
        inputs = {"Fac": "B.x", "Color": "A"}
        cases.append(NodeCase("ShaderNodeRGBCurve", "Color", inputs, {}, set_up, label=extend))
        inputs = {"Fac": 0.9, "Vector": ("A", 1.3)}
        cases.append(NodeCase("ShaderNodeVectorCurve", "Vector", inputs, {}, set_up, label=extend))
        inputs = {"Factor": "B.x", "Value": "A.x"}
        cases.append(NodeCase("ShaderNodeFloatCurve", "Value", inputs, {}, set_up, label=extend))
    return cases


#: Blenders 5.1 and 5.2 take the way from Rec.709 to the working space through ACES' white, in matrices of seven digits.
_BLACKBODY_OF_5_2 = np.array((1.000159, 0.999976, 0.999760), np.float32)

_CASES = _numbers() + _vectors() + _mixes() + _colors()


@pytest.fixture(scope="module")
def rendered(tmp_path_factory: pytest.TempPathFactory) -> list[tuple[dict[str, np.ndarray], np.ndarray]]:
    return render_cases(_CASES, tmp_path_factory.mktemp("cycles"))


@pytest.mark.parametrize("index", range(len(_CASES)), ids=[case.name() for case in _CASES])
def test_node_is_that_of_cycles(rendered: list[tuple[dict[str, np.ndarray], np.ndarray]], index: int) -> None:
    case = _CASES[index]
    sources, theirs = rendered[index]
    ours = run_node(case.kind, case.output, node_inputs(case, sources), {**case.properties, **case.baked})
    if case.kind == "ShaderNodeBlackbody" and (5, 1) <= bpy.app.version < (5, 3):
        ours = ours * _BLACKBODY_OF_5_2
    np.testing.assert_allclose(np.broadcast_to(ours, theirs.shape), theirs, rtol=2e-5, atol=2e-5)


def test_every_entry_is_compared() -> None:
    from engine.shaders.nodes_texture_math import NODES

    kinds = {kind for kind in NODES if not kind.startswith("ShaderNodeTex")}
    assert kinds == {case.kind for case in _CASES}
