# SPDX-License-Identifier: GPL-3.0-or-later
"""Lobes about a normal that is no number: none is left, and rough facets that reflect take all others along.

Measured in Cycles 5.0 and 5.3 (`engine/kernels/bsdf/no_normal.py`). Roughness 0.3 unless it is said.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from engine.kernels.bsdf.kinds import DIFFUSE, TRANSPARENT
from engine.scene.description import Link
from tests.helpers.shader_harness import Graph, compile_one, run

_BSDF = "ShaderNodeBsdf"


def _left(kind: str, orientation: tuple[float, float, float], inputs: dict[str, Any], **properties: Any) -> list[int]:
    """Kinds of the lobes of Diffuse + this one + Transparent, about a Normal node's Dot."""
    graph = Graph()
    dot = graph.link("ShaderNodeNormal", "Dot", inputs={"Normal": orientation})
    inputs = {"Color": (0.8, 0.8, 0.8), "Roughness": 0.3, **inputs, "Normal": dot}
    shader = graph.link(f"{_BSDF}Diffuse", "BSDF", inputs={"Color": (0.8, 0.8, 0.8)})
    for added in (kind, f"{_BSDF}Transparent"):
        own = (inputs, properties) if added == kind else ({"Color": (0.5, 0.5, 0.5)}, {})
        link = graph.link(added, "BSDF", inputs=own[0], **own[1])
        node = graph.add("ShaderNodeAddShader", inputs={"Shader": shader, "Shader_001": link})
        shader = Link(node, "Shader")
    closures = run(compile_one(graph.surface(shader))[0])
    assert np.isfinite(closures.param[0, : closures.count[0]]).all()
    return closures.kind[0, : closures.count[0]].tolist()


@pytest.mark.parametrize(
    ("kind", "takes_others", "inputs", "properties"),
    [
        ("Diffuse", False, {}, {}),
        ("Translucent", False, {}, {}),
        ("Toon", False, {}, {"component": "GLOSSY"}),
        ("Refraction", False, {}, {}),
        ("Glossy", True, {}, {}),
        ("Glossy", False, {"Roughness": 0.0}, {}),
        ("Glossy", True, {"Roughness": 0.3, "Anisotropy": 0.5}, {}),
        ("Glass", True, {}, {}),
        ("Glass", False, {"Roughness": 0.0}, {}),
        ("Metallic", True, {}, {"fresnel_type": "F82"}),
        ("Principled", True, {}, {}),
        ("Principled", False, {"IOR": 1.0, "Alpha": 0.5}, {}),
    ],
)
def test_what_is_left(kind: str, takes_others: bool, inputs: dict[str, Any], properties: dict[str, Any]) -> None:
    others = [DIFFUSE, TRANSPARENT]
    found = _left(_BSDF + kind, (0.0, 0.0, 0.0), inputs, **properties)
    assert found == ([] if takes_others else others)
    # About a normal that is a number the lobe is there.
    assert len(_left(_BSDF + kind, (0.0, 0.3, 1.0), inputs, **properties)) > len(others)
