# SPDX-License-Identifier: GPL-3.0-or-later
"""Glass and Glossy BSDFs of constant inputs, folded once a program, have the lobes that they have point by point."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from engine.kernels.bsdf.kinds import (
    ALPHA_X,
    ALPHA_Y,
    BUMP,
    ENERGY_SCALE,
    ETA,
    F0,
    F0_REAL,
    GLASS,
    REFLECTION_TINT,
    SMOOTH_N,
    TRANSMISSION_TINT,
)
from engine.kernels.shader import ops_closure
from engine.state.lanes import (
    CLOSURE_N,
    CLOSURE_SAMPLE_WEIGHT,
    CLOSURE_WEIGHT,
    POINT_FLAG_BACKFACING,
    POINT_FLAGS,
    Closures,
    ShadePoints,
)
from engine.state.shaders import (
    MODE_CLOSURES,
    MODE_NO_REFLECTIVE_CAUSTICS,
    MODE_NO_REFRACTIVE_CAUSTICS,
    ShaderArrays,
)
from tests.helpers.folded_closures import hemisphere_points, opcodes_of
from tests.helpers.shader_harness import Graph, compile_one, run

_GLASS, _GLOSSY = "ShaderNodeBsdfGlass", "ShaderNodeBsdfAnisotropic"
_PLAIN = {_GLASS: "PLAIN_GLASS", _GLOSSY: "PLAIN_GLOSSY"}
_WHOLE = {_GLASS: "GLASS", _GLOSSY: "GLOSSY"}


def _program(node: str, is_folded: bool, inputs: dict[str, Any], distribution: str) -> ShaderArrays:
    """A closure over a colour that varies; a factor of one that no compiler can know keeps it from being folded."""
    graph = Graph()
    inputs = {"Color": graph.link("ShaderNodeNewGeometry", "Position"), **inputs}
    if not is_folded:
        one = graph.link("ShaderNodeAttribute", "Alpha", attribute_name="UVMap")
        for name in {"Roughness", "IOR"} & set(inputs):
            factors = {"Value": inputs[name], "Value_001": one}
            inputs[name] = graph.link("ShaderNodeMath", "Value", inputs=factors, operation="MULTIPLY")
    closure = graph.link(node, "BSDF", inputs=inputs, distribution=distribution)
    shaders, _names, _notices = compile_one(graph.surface(closure))
    return shaders


def _points() -> ShadePoints:
    """Points as of `hemisphere_points`, from either side."""
    points = hemisphere_points()
    points.integer[::2, POINT_FLAGS] |= POINT_FLAG_BACKFACING
    return points


def _columns(closures: Closures) -> np.ndarray:
    param = closures.param[:, 0]
    columns = [CLOSURE_SAMPLE_WEIGHT, BUMP, ALPHA_X, ALPHA_Y, ETA, ENERGY_SCALE]
    for first in (CLOSURE_WEIGHT, CLOSURE_N):
        columns += range(first, first + 3)
    glass = [F0_REAL, *range(F0, F0 + 3), *range(REFLECTION_TINT, REFLECTION_TINT + 3)]
    glass += range(TRANSMISSION_TINT, TRANSMISSION_TINT + 3)
    bumped = np.where(param[:, [BUMP]] != 0.0, param[:, SMOOTH_N : SMOOTH_N + 3], 0.0)
    is_glass = (closures.kind[:, 0] == GLASS)[:, None]
    return np.concatenate([param[:, columns], bumped, np.where(is_glass, param[:, glass], 0.0)], axis=1)


@pytest.mark.parametrize("mode", [MODE_NO_REFLECTIVE_CAUSTICS, MODE_NO_REFRACTIVE_CAUSTICS])
@pytest.mark.parametrize("distribution", ["GGX", "MULTI_GGX"])
@pytest.mark.parametrize(
    ("node", "inputs"),
    [
        (_GLASS, {"Roughness": 0.0, "IOR": 1.45}),
        (_GLASS, {"Roughness": 0.37, "IOR": 1.8}),
        (_GLASS, {"Roughness": 1.0, "IOR": 0.6}),
        (_GLASS, {"Roughness": 0.2, "IOR": 1.01}),
        (_GLASS, {"Roughness": 7.0, "IOR": -3.0}),
        (_GLOSSY, {"Roughness": 0.0}),
        (_GLOSSY, {"Roughness": 0.37}),
        (_GLOSSY, {"Roughness": 1.0, "Color": (3.0, 0.5, 0.0)}),
    ],
    ids=str,
)
def test_folded_lobes_are_those_of_the_whole(node: str, inputs: dict[str, Any], distribution: str, mode: int) -> None:
    points = _points()
    folded, whole = (_program(node, is_folded, inputs, distribution) for is_folded in (True, False))
    assert ops_closure.opcode(_PLAIN[node]) in opcodes_of(folded)
    assert ops_closure.opcode(_WHOLE[node]) in opcodes_of(whole)
    ours, theirs = run(folded, points, MODE_CLOSURES | mode), run(whole, points, MODE_CLOSURES | mode)
    np.testing.assert_array_equal(ours.count, theirs.count)
    has_lobe = ours.count > 0
    assert has_lobe.any()
    np.testing.assert_array_equal(ours.kind[has_lobe, 0], theirs.kind[has_lobe, 0])
    np.testing.assert_allclose(_columns(ours)[has_lobe], _columns(theirs)[has_lobe], rtol=2e-5, atol=2e-6)


def test_anisotropic_glossy_is_not_folded() -> None:
    opcodes = opcodes_of(_program(_GLOSSY, True, {"Roughness": 0.3, "Anisotropy": 0.5}, "GGX"))
    assert ops_closure.opcode("GLOSSY") in opcodes and ops_closure.opcode("PLAIN_GLOSSY") not in opcodes
