# SPDX-License-Identifier: GPL-3.0-or-later
"""What programs of lamps read of their lamp: its own space and its object's facts."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from engine.scene.description import Light, Link, NodeGraph
from engine.shaders.lamp_facts import facts_of
from engine.state.lanes import (
    POINT_INSTANCE,
    POINT_LIGHT,
    POINT_NG,
    POINT_NS,
    POINT_P,
    POINT_TRIANGLE,
    POINT_WO,
    ShadePoints,
)
from engine.state.shaders import VALUE_EMISSION
from tests.helpers.shader_harness import Graph, compile_one, run, square_points

MATRIX = np.array([[0.8, 0.3, 0.6, 3.0], [0.0, 1.5, 0.1, -2.0], [-0.6, 0.2, 0.8, 5.0], [0, 0, 0, 1]], np.float32)
LIGHT = Light(
    "l", "L", "AREA", MATRIX, (1, 1, 1), 9.0, size_x=1.0, random=0.25, object_color=(0.9, 0.5, 0.3, 0.7), pass_index=4
)
PLACE, NORMAL = np.array([3.2, -1.5, 4.0]), np.array([0.6, 0.0, -0.8])


def _vector(kind: str, output: str, **settings: Any) -> NodeGraph:
    graph = Graph()
    return graph.emit(graph.link(kind, output, **settings))


def _transformed(kind: str, source: str, target: str) -> NodeGraph:
    graph = Graph()
    place = graph.link("ShaderNodeNewGeometry", "Position")
    settings = {"vector_type": kind, "convert_from": source, "convert_to": target}
    return graph.emit(graph.link("ShaderNodeVectorTransform", "Vector", inputs={"Vector": place}, **settings))


def _point() -> ShadePoints:
    points = square_points((0.5, 0.25))
    points.real[:, POINT_P : POINT_P + 3] = PLACE
    for column, values in ((POINT_NG, NORMAL), (POINT_NS, NORMAL), (POINT_WO, NORMAL)):
        points.real[:, column : column + 3] = values
    points.integer[:] = 0
    points.integer[:, [POINT_INSTANCE, POINT_TRIANGLE]] = -1
    points.integer[:, POINT_LIGHT] = 0
    return points


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / np.linalg.norm(vector)


AXES, ORIGIN = MATRIX[:3, :3].astype(np.float64), MATRIX[:3, 3].astype(np.float64)
LOCAL = np.linalg.solve(AXES, PLACE - ORIGIN)


@pytest.mark.parametrize(("graph", "expected"), [
    (_vector("ShaderNodeTexCoord", "Object"), LOCAL),
    (_vector("ShaderNodeTexCoord", "Generated"), LOCAL),
    (_vector("ShaderNodeTexCoord", "Normal"), _unit(AXES.T @ NORMAL)),
    (_vector("ShaderNodeNewGeometry", "Position"), PLACE),
    (_transformed("POINT", "WORLD", "OBJECT"), LOCAL),
    (_transformed("POINT", "OBJECT", "WORLD"), AXES @ PLACE + ORIGIN),
    (_transformed("VECTOR", "WORLD", "OBJECT"), np.linalg.solve(AXES, PLACE)),
    (_transformed("VECTOR", "OBJECT", "WORLD"), AXES @ PLACE),
    (_transformed("NORMAL", "WORLD", "OBJECT"), _unit(AXES.T @ PLACE)),
    (_transformed("NORMAL", "OBJECT", "WORLD"), _unit(np.linalg.solve(AXES.T, PLACE))),
])  # fmt: skip
def test_coordinates_are_in_the_lamps_own_space(graph: NodeGraph, expected: np.ndarray) -> None:
    shaders, _names, notices = compile_one(graph, kind="LIGHT", lamp=facts_of(LIGHT, graph))
    assert not notices
    np.testing.assert_allclose(run(shaders, _point()).emission[0, :3], expected, rtol=2e-5, atol=2e-5)


@pytest.mark.parametrize(("output", "expected"), [
    ("Location", (3.0, -2.0, 5.0)), ("Color", (0.9, 0.5, 0.3)), ("Alpha", (0.7,) * 3), ("Object Index", (4.0,) * 3),
    ("Random", (0.25,) * 3),
])  # fmt: skip
def test_facts_of_its_object_are_constants(output: str, expected: tuple[float, ...]) -> None:
    graph = _vector("ShaderNodeObjectInfo", output)
    shaders, _names, _notices = compile_one(graph, kind="LIGHT", lamp=facts_of(LIGHT, graph))
    emission = shaders.program_values[0, VALUE_EMISSION : VALUE_EMISSION + 3]
    np.testing.assert_allclose(emission, expected, rtol=1e-6)


def test_the_camera_is_no_space_of_lamps() -> None:
    graph = _transformed("POINT", "CAMERA", "OBJECT")
    _shaders, _names, notices = compile_one(graph, kind="LIGHT", lamp=facts_of(LIGHT, graph))
    assert [notice.problem for notice in notices] == ["between a lamp's own space and the camera's is not supported"]


def test_what_reads_nothing_of_a_lamp_is_the_same_for_all() -> None:
    plain = _vector("ShaderNodeNewGeometry", "Position")
    assert facts_of(LIGHT, plain) is None
    graph = _vector("ShaderNodeTexNoise", "Fac")
    assert facts_of(LIGHT, graph) is not None
    assert facts_of(replace(LIGHT, transform=np.full((4, 4), np.nan, np.float32)), graph) is None


def test_the_estimate_looks_at_the_lamp_where_it_is() -> None:
    """A gradient by Object coordinates that is black but within a metre of the lamp, which is far from the origin."""
    graph = Graph()
    place = graph.link("ShaderNodeTexCoord", "Object")
    settings = {"gradient_type": "SPHERICAL", "inputs": {"Vector": place}}
    shine = graph.emit(graph.link("ShaderNodeTexGradient", "Color", **settings))
    assert isinstance(shine.surface, Link)
    shaders, _names, _notices = compile_one(shine, kind="LIGHT", lamp=facts_of(LIGHT, shine))
    assert 0.3 < shaders.program_values[0, VALUE_EMISSION] < 0.9
