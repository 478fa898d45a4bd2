# SPDX-License-Identifier: GPL-3.0-or-later
"""The Principled BSDF of constant inputs, folded once a program, has the lobes that it has point by point."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from engine.kernels.bsdf.kinds import ALPHA_X, ALPHA_Y, BUMP, ENERGY_SCALE, ETA, F0, F0_REAL, GLOSSY_SCHLICK, SMOOTH_N
from engine.kernels.shader import ops_closure
from engine.state.lanes import (
    CLOSURE_N,
    CLOSURE_SAMPLE_WEIGHT,
    CLOSURE_WEIGHT,
    Closures,
)
from engine.state.shaders import MODE_CLOSURES, MODE_NO_REFLECTIVE_CAUSTICS, ShaderArrays
from tests.helpers.folded_closures import hemisphere_points, opcodes_of
from tests.helpers.shader_harness import Graph, compile_one, run

PLAIN, WHOLE = ops_closure.opcode("PLAIN_PRINCIPLED"), ops_closure.opcode("PRINCIPLED")


def _program(is_folded: bool, inputs: dict[str, Any], **properties: Any) -> ShaderArrays:
    """Principled over a colour that varies; an alpha of one that no compiler can know keeps it from being folded."""
    graph = Graph()
    inputs = {"Base Color": graph.link("ShaderNodeNewGeometry", "Position"), **inputs}
    if not is_folded:
        inputs["Alpha"] = graph.link("ShaderNodeAttribute", "Alpha", attribute_name="UVMap")
    shaders, _names, _notices = compile_one(
        graph.surface(graph.link("ShaderNodeBsdfPrincipled", "BSDF", inputs=inputs, **properties))
    )
    return shaders


def _columns(closures: Closures, lobe: int) -> np.ndarray:
    param = closures.param[:, lobe]
    columns = [CLOSURE_SAMPLE_WEIGHT, BUMP]
    for first in (CLOSURE_WEIGHT, CLOSURE_N):
        columns += range(first, first + 3)
    specular = [ALPHA_X, ALPHA_Y, ETA, ENERGY_SCALE, F0_REAL, *range(F0, F0 + 3)]
    bumped = np.where(param[:, [BUMP]] != 0.0, param[:, SMOOTH_N : SMOOTH_N + 3], 0.0)
    is_specular = (closures.kind[:, lobe] == GLOSSY_SCHLICK)[:, None]
    return np.concatenate([param[:, columns], bumped, np.where(is_specular, param[:, specular], 0.0)], axis=1)


@pytest.mark.parametrize(
    "inputs",
    [
        {},
        {"Roughness": 0.0},
        {"Roughness": 1.0, "IOR": 2.4},
        {"Roughness": 0.37, "Specular IOR Level": 0.9, "Specular Tint": (1.0, 0.4, 0.1)},
        {"Roughness": 0.2, "IOR": 0.7, "Specular IOR Level": 0.2},
        {"Specular IOR Level": 0.0},
        {"IOR": 1.0},
        {"Roughness": 5.0, "IOR": -3.0, "Specular IOR Level": 40.0, "Specular Tint": (9.0, -1.0, 0.5)},
    ],
    ids=str,
)
@pytest.mark.parametrize("distribution", ["GGX", "MULTI_GGX"])
def test_folded_lobes_are_those_of_the_whole(inputs: dict[str, Any], distribution: str) -> None:
    points = hemisphere_points()
    folded, whole = (_program(is_folded, inputs, distribution=distribution) for is_folded in (True, False))
    assert PLAIN in opcodes_of(folded) and WHOLE in opcodes_of(whole)
    mode = MODE_CLOSURES | MODE_NO_REFLECTIVE_CAUSTICS
    ours, theirs = run(folded, points, mode), run(whole, points, mode)
    np.testing.assert_array_equal(ours.count, theirs.count)
    np.testing.assert_array_equal(ours.emission, theirs.emission)
    np.testing.assert_array_equal(ours.transparency, theirs.transparency)
    for lobe in range(2):
        has_lobe = ours.count > lobe
        np.testing.assert_array_equal(ours.kind[has_lobe, lobe], theirs.kind[has_lobe, lobe])
        np.testing.assert_allclose(
            _columns(ours, lobe)[has_lobe], _columns(theirs, lobe)[has_lobe], rtol=2e-5, atol=2e-6
        )
    assert (ours.count == 1).any()


@pytest.mark.parametrize(
    "inputs",
    [
        {"Metallic": 0.5},
        {"Transmission Weight": 0.1},
        {"Coat Weight": 0.1},
        {"Sheen Weight": 0.1},
        {"Diffuse Roughness": 0.5},
        {"Anisotropic": 0.5},
        {"Alpha": 0.9},
        {"Emission Color": (1.0, 1.0, 1.0), "Emission Strength": 1.0},
    ],
    ids=str,
)
def test_what_asks_for_more_is_not_folded(inputs: dict[str, Any]) -> None:
    opcodes = opcodes_of(_program(True, inputs))
    assert WHOLE in opcodes and PLAIN not in opcodes
