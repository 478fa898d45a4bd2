# SPDX-License-Identifier: GPL-3.0-or-later
"""Anisotropic glass of both nodes is one linked lobe of two alphas, along the tangent and across it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from engine.kernels.bsdf.kinds import ALPHA_X, ALPHA_Y, GLASS, LINKED_GLASS
from engine.kernels.bsdf.linked import TANGENT_ANGLE
from engine.kernels.shader import ops_closure
from engine.shaders.compiled_program import ProgramSource
from engine.shaders.compiler import compile_programs
from engine.shaders.program_cache import ProgramCache
from engine.state.lanes import Closures
from tests.helpers.folded_closures import opcodes_of
from tests.helpers.shader_harness import Graph, compile_one, run

_GLASS, _PRINCIPLED = "ShaderNodeBsdfGlass", "ShaderNodeBsdfPrincipled"
_OF_GLASS = {"Roughness": 0.5, "Anisotropy": 0.6, "Tangent": (0.6, 0.8, 0.0)}
_OF_PRINCIPLED = {"Roughness": 0.5, "Anisotropic": 0.8, "Transmission Weight": 1.0, "Tangent": (0.6, 0.8, 0.0)}


def _shaded(node: str, inputs: dict[str, Any], **properties: Any) -> tuple[Closures, set[int]]:
    graph = Graph()
    shaders, _names, notices = compile_one(graph.surface(graph.link(node, "BSDF", inputs=inputs, **properties)))
    assert notices == []
    return run(shaders), opcodes_of(shaders)


@pytest.mark.parametrize(("node", "inputs", "alphas"), [
    (_GLASS, _OF_GLASS, (0.25 * 0.4, 0.25 / 0.4)),
    (_GLASS, {**_OF_GLASS, "Anisotropy": -0.6}, (0.25 / 0.4, 0.25 * 0.4)),
    (_PRINCIPLED, _OF_PRINCIPLED, (0.25 / np.sqrt(0.28), 0.25 * np.sqrt(0.28))),
])  # fmt: skip
def test_its_lobe_has_two_alphas_and_the_tangents_direction(node: str, inputs: dict[str, Any], alphas: Any) -> None:
    closures, _ = _shaded(node, inputs)
    assert closures.kind[0, 0] == LINKED_GLASS
    np.testing.assert_allclose(closures.param[0, 0, [ALPHA_X, ALPHA_Y]], alphas, rtol=1e-6)
    turned, _ = _shaded(node, {**inputs, "Tangent": (-0.8, 0.6, 0.0)})
    quarter = turned.param[0, 0, TANGENT_ANGLE] - closures.param[0, 0, TANGENT_ANGLE]
    np.testing.assert_allclose(np.mod(quarter, 2.0 * np.pi), 0.5 * np.pi, atol=1e-5)


@pytest.mark.parametrize(("node", "inputs"), [
    (_GLASS, {**_OF_GLASS, "Anisotropy": 0.0}), (_GLASS, {**_OF_GLASS, "Roughness": 0.0}),
    (_PRINCIPLED, {**_OF_PRINCIPLED, "Anisotropic": 0.0}), (_PRINCIPLED, {**_OF_PRINCIPLED, "Roughness": 0.0}),
])  # fmt: skip
def test_other_glass_is_not_linked(node: str, inputs: dict[str, Any]) -> None:
    closures, opcodes = _shaded(node, inputs)
    assert closures.kind[0, 0] == GLASS and ops_closure.opcode("LINKED") not in opcodes


def test_before_blender_53_glass_of_the_principled_bsdf_is_as_rough_in_all_directions() -> None:
    closures, _ = _shaded(_PRINCIPLED, _OF_PRINCIPLED, tints_by_bounce=False)
    assert closures.kind[0, 0] == GLASS and closures.param[0, 0, ALPHA_X] == closures.param[0, 0, ALPHA_Y]


def test_a_tangent_along_the_normal_leaves_it_as_rough_in_all_directions() -> None:
    closures, _ = _shaded(_GLASS, {**_OF_GLASS, "Tangent": (0.0, 0.0, 1.0)})
    assert closures.param[0, 0, ALPHA_X] == closures.param[0, 0, ALPHA_Y] == np.float32(0.25)


@pytest.mark.parametrize(("node", "inputs"), [(_GLASS, _OF_GLASS), (_PRINCIPLED, _OF_PRINCIPLED)])
def test_it_is_known_to_bend_light(node: str, inputs: dict[str, Any]) -> None:
    graph, cache = Graph(), ProgramCache()
    source = ProgramSource("M", graph.surface(graph.link(node, "BSDF", inputs=inputs)))
    compile_programs([source], [], cache=cache)
    assert [program.refracts for program in cache.compiled] == [True]
