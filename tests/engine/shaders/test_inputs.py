# SPDX-License-Identifier: GPL-3.0-or-later
"""Nodes that read the surface, the ray or the object, bump and normal maps, against formulas."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from engine.kernels.bsdf import kinds
from engine.kernels.bsdf.sheen import SHEEN
from engine.kernels.bsdf.translucent import TRANSLUCENT
from engine.scene.description import Link, NodeGraph
from engine.shaders.folding import stand_in_geometry
from engine.shaders.nodes_input import mapping_matrix
from engine.state import geometry as layout
from engine.state.geometry import GeometryArrays
from engine.state.lanes import (
    CLOSURE_N,
    POINT_INSTANCE,
    POINT_NG,
    POINT_NS,
    POINT_PATH_DEPTH,
    POINT_RADIUS,
    POINT_RAY_FLAGS,
    POINT_WO,
    RAY_DIFFUSE_ANCESTOR,
    RAY_EMISSION,
    ShadePoints,
)
from engine.state.shaders import MODE_CLOSURES, MODE_NO_REFLECTIVE_CAUSTICS
from tests.helpers.shader_harness import Graph, compile_one, emitted, run, square_points


def moved_geometry() -> GeometryArrays:
    """The square turned 90 degrees about z, scaled by 2 in x and moved by (10, 20, 30)."""
    geometry = stand_in_geometry(8)
    matrix = np.array([[0, -1, 0, 10], [2, 0, 0, 20], [0, 0, 1, 30], [0, 0, 0, 1]], np.float64)
    geometry.transforms[0] = matrix[:3].ravel()
    geometry.inverses[0] = np.linalg.inv(matrix)[:3].ravel()
    geometry.instance_table[0, layout.INSTANCE_PASS_INDEX] = 7
    geometry.instance_values[0, :5] = (0.25, 0.1, 0.2, 0.3, 0.4)
    return geometry


def output(
    kind: str, name: str, points: ShadePoints, geometry: GeometryArrays | None = None, **more: Any
) -> np.ndarray:
    graph = Graph()
    shaders, _names, _notices = compile_one(graph.emit(graph.link(kind, name, **more)), pass_index=5)
    return run(shaders, points, geometry=geometry).emission[:, :3].copy()


def moved_points() -> ShadePoints:
    """One point at object coordinates (0.5, 0.25, 0) of `moved_geometry`."""
    points = square_points((0.5, 0.25))
    points.real[0, :3] = (10 - 0.25, 20 + 1.0, 30)
    return points


@pytest.mark.parametrize(
    ("kind", "name", "expected"),
    [
        ("ShaderNodeNewGeometry", "Position", (9.75, 21.0, 30.0)),
        ("ShaderNodeTexCoord", "Object", (0.5, 0.25, 0.0)),
        ("ShaderNodeTexCoord", "Generated", (0.5, 0.25, 0.5)),
        ("ShaderNodeTexCoord", "UV", (0.5, 0.25, 0.0)),
        ("ShaderNodeTexCoord", "Normal", (0.0, 0.0, 1.0)),
        ("ShaderNodeTexCoord", "Reflection", (0.0, 0.0, 1.0)),
        ("ShaderNodeNewGeometry", "Parametric", (0.5, 0.25, 0.0)),
        ("ShaderNodeObjectInfo", "Location", (10.0, 20.0, 30.0)),
        ("ShaderNodeObjectInfo", "Color", (0.1, 0.2, 0.3)),
        ("ShaderNodeObjectInfo", "Alpha", (0.4,) * 3),
        ("ShaderNodeObjectInfo", "Object Index", (7.0,) * 3),
        ("ShaderNodeObjectInfo", "Material Index", (5.0,) * 3),
        ("ShaderNodeObjectInfo", "Random", (0.25,) * 3),
        ("ShaderNodeLightPath", "Is Camera Ray", (1.0,) * 3),
        ("ShaderNodeLightPath", "Is Shadow Ray", (0.0,) * 3),
        ("ShaderNodeLightPath", "Ray Length", (2.0,) * 3),
        ("ShaderNodeLayerWeight", "Facing", (0.0,) * 3),
        ("ShaderNodeFresnel", "Fac", (0.04,) * 3),
    ],
)
def test_inputs(kind: str, name: str, expected: tuple[float, ...]) -> None:
    np.testing.assert_allclose(output(kind, name, moved_points(), moved_geometry())[0], expected, atol=1e-5)


def test_light_seen_from_a_surface_is_one_bounce_further() -> None:
    points = square_points((0.5, 0.25))
    points.integer[0, POINT_PATH_DEPTH] = 3
    assert output("ShaderNodeLightPath", "Ray Depth", points)[0, 0] == 3.0
    points.integer[0, POINT_RAY_FLAGS] |= RAY_EMISSION
    assert output("ShaderNodeLightPath", "Ray Depth", points)[0, 0] == 4.0


def test_background_sees_its_direction() -> None:
    points = square_points((0.5, 0.25))
    direction = np.array((0.6, 0.0, 0.8), np.float32)
    points.integer[0, POINT_INSTANCE] = -1
    points.real[0, :3] = direction
    for column in (POINT_WO, POINT_NG, POINT_NS):
        points.real[0, column : column + 3] = -direction
    for name in ("Generated", "Object"):
        np.testing.assert_allclose(output("ShaderNodeTexCoord", name, points)[0], direction)
    np.testing.assert_allclose(output("ShaderNodeTexCoord", "Reflection", points)[0], -direction)
    np.testing.assert_allclose(output("ShaderNodeTexCoord", "UV", points)[0], 0.0)


@pytest.mark.parametrize("kind", ["POINT", "TEXTURE", "VECTOR", "NORMAL"])
def test_mapping_folded_and_at_run_time_agree(kind: str) -> None:
    settings = {"Location": (0.1, -0.2, 0.3), "Rotation": (0.4, 0.5, -0.6), "Scale": (2.0, -1.0, 0.5)}
    points = square_points((0.7, 0.2))
    results = []
    for varying in (False, True):
        graph = Graph()
        inputs = {"Vector": graph.link("ShaderNodeNewGeometry", "Position")} | settings
        if varying:
            zero = graph.link("ShaderNodeLightPath", "Is Shadow Ray")
            inputs["Scale"] = graph.link(
                "ShaderNodeMapping", "Vector", inputs={"Vector": zero, "Location": settings["Scale"]}
            )
        color = graph.link("ShaderNodeMapping", "Vector", inputs=inputs, vector_type=kind)
        results.append(emitted(graph.emit(color), points)[0])
    np.testing.assert_allclose(results[0], results[1], rtol=1e-5, atol=1e-6)
    matrix = mapping_matrix(kind, *settings.values())
    expected = matrix @ (0.7, 0.2, 0.0, 1.0)
    if kind == "NORMAL":
        expected /= np.linalg.norm(expected)
    np.testing.assert_allclose(results[0], expected, rtol=1e-5, atol=1e-6)


def attribute_geometry(domain: int, data: np.ndarray) -> GeometryArrays:
    geometry = stand_in_geometry(1)
    geometry.attribute_table[0] = (domain, data.shape[1], 0)
    return geometry._replace(attribute_data=np.ascontiguousarray(data.ravel(), np.float32))


@pytest.mark.parametrize(
    ("domain", "data", "color"),
    [
        (layout.DOMAIN_POINT, [[0.0], [1.0], [2.0], [3.0]], (1.0, 1.0, 1.0)),
        (layout.DOMAIN_FACE, [[5.0, 6.0], [7.0, 8.0]], (5.0, 6.0, 0.0)),
        (layout.DOMAIN_CORNER, [[1, 0, 0], [0, 1, 0], [0, 0, 1]] * 2, (0.5, 0.25, 0.25)),
        (layout.DOMAIN_INSTANCE, [[1.0, 2.0, 3.0, 0.5]], (1.0, 2.0, 3.0)),
    ],
)
def test_attribute_domains(domain: int, data: list, color: tuple[float, ...]) -> None:
    """At (0.5, 0.25) barycentrics are u = 0.25, v = 0.25 on corners 0, 1, 2 of the square."""
    geometry = attribute_geometry(domain, np.array(data, np.float32))
    points = square_points((0.5, 0.25))
    found = output("ShaderNodeAttribute", "Color", points, geometry, attribute_name="a")[0]
    if domain == layout.DOMAIN_POINT:
        color = (0.25 * 1.0 + 0.25 * 2.0,) * 3
    np.testing.assert_allclose(found, color, rtol=1e-6)
    vector = output("ShaderNodeAttribute", "Vector", points, geometry, attribute_name="a")[0]
    np.testing.assert_array_equal(vector, found)
    alpha = output("ShaderNodeAttribute", "Alpha", points, geometry, attribute_name="a")[0, 0]
    assert alpha == (0.5 if domain == layout.DOMAIN_INSTANCE else 1.0)


def test_missing_attributes() -> None:
    geometry = stand_in_geometry(1)
    geometry.attribute_table[0, layout.ATTRIBUTE_DOMAIN] = layout.DOMAIN_ABSENT
    points = square_points((0.5, 0.25))
    assert output("ShaderNodeAttribute", "Color", points, geometry, attribute_name="a")[0, 0] == 0.0
    assert output("ShaderNodeAttribute", "Alpha", points, geometry, attribute_name="a")[0, 0] == 1.0
    assert output("ShaderNodeVertexColor", "Alpha", points, geometry, layer_name="a")[0, 0] == 0.0


def bumped_normal(graph: Graph, height: Link, points: ShadePoints, **settings: object) -> np.ndarray:
    inputs = {"Height": height, "Strength": 1.0, "Distance": 0.2, "Filter Width": 0.5}
    inputs |= {key: value for key, value in settings.items() if key in inputs}
    normal = graph.link("ShaderNodeBump", "Normal", inputs=inputs, invert=settings.get("invert", False))
    diffuse = graph.link("ShaderNodeBsdfDiffuse", "BSDF", inputs={"Normal": normal})
    shaders, _names, _notices = compile_one(graph.surface(diffuse))
    closures = run(shaders, points)
    assert (closures.kind[:, 0] == kinds.DIFFUSE).all()
    return closures.param[:, 0, CLOSURE_N : CLOSURE_N + 3].copy()


@pytest.mark.parametrize("source", ["Position", "UV", "Generated", "Object"])
@pytest.mark.parametrize("invert", [False, True])
def test_bump_of_a_slope(source: str, invert: bool) -> None:
    """Height 3 x - 2 y (in whatever coordinates) times distance 0.2 raises the normal (-0.6, 0.4, 1)."""
    graph = Graph()
    kind = "ShaderNodeNewGeometry" if source == "Position" else "ShaderNodeTexCoord"
    vector = graph.link(kind, source)
    # A vector on a float socket is its mean: scale by 3 so that the sum is the height.
    scaled = graph.link("ShaderNodeMapping", "Vector", inputs={"Vector": vector, "Scale": (9.0, -6.0, 0.0)})
    points = square_points([(0.5, 0.25), (0.2, 0.7)], radius=1e-3)
    found = bumped_normal(graph, scaled, points, invert=invert)
    sign = -1.0 if invert else 1.0
    expected = np.array((-0.6 * sign, 0.4 * sign, 1.0))
    np.testing.assert_allclose(found, np.tile(expected / np.linalg.norm(expected), (2, 1)), atol=2e-3)


def test_bump_strength_blends_normals_and_needs_a_footprint() -> None:
    graph = Graph()
    position = graph.link("ShaderNodeNewGeometry", "Position")
    points = square_points((0.5, 0.25), radius=1e-3)
    full = bumped_normal(graph, position, points)[0]
    half = bumped_normal(graph, position, points, Strength=0.5)[0]
    blend = 0.5 * full + 0.5 * np.array((0.0, 0.0, 1.0))
    np.testing.assert_allclose(half, blend / np.linalg.norm(blend), atol=1e-4)
    points.real[:, POINT_RADIUS] = 0.0
    np.testing.assert_allclose(bumped_normal(graph, position, points)[0], (0.0, 0.0, 1.0))


def test_displacement_without_subdivision_is_bump() -> None:
    graph = Graph()
    position = graph.link("ShaderNodeNewGeometry", "Position")
    slope = graph.link("ShaderNodeMapping", "Vector", inputs={"Vector": position, "Scale": (3.0, 0.0, 0.0)})
    displaced = graph.link(
        "ShaderNodeDisplacement", "Displacement", inputs={"Height": slope, "Midlevel": 0.5, "Scale": 0.5}
    )
    surface = NodeGraph(graph.nodes, graph.link("ShaderNodeBsdfDiffuse", "BSDF"), displacement=displaced)
    closures = run(compile_one(surface)[0], square_points((0.5, 0.25), radius=1e-3))
    expected = np.array((-0.5, 0.0, 1.0)) / np.sqrt(1.25)
    np.testing.assert_allclose(closures.param[0, 0, CLOSURE_N : CLOSURE_N + 3], expected, atol=1e-3)


@pytest.mark.parametrize("space", ["TANGENT", "OBJECT", "WORLD"])
def test_normal_map(space: str) -> None:
    graph = Graph()
    tilted = np.array((0.6, 0.0, 0.8))
    color = tuple(0.5 + 0.5 * tilted)
    normal = graph.link("ShaderNodeNormalMap", "Normal", inputs={"Color": color, "Strength": 1.0}, space=space)
    diffuse = graph.link("ShaderNodeBsdfDiffuse", "BSDF", inputs={"Normal": normal})
    geometry = stand_in_geometry(2)
    geometry.attribute_table[0, layout.ATTRIBUTE_DOMAIN] = layout.DOMAIN_ABSENT  # no tangents: taken from the UV map
    geometry.mesh_table[0, layout.MESH_DEFAULT_UV] = 1
    closures = run(compile_one(graph.surface(diffuse))[0], geometry=geometry)
    np.testing.assert_allclose(closures.param[0, 0, CLOSURE_N : CLOSURE_N + 3], tilted, atol=1e-5)


def test_caustics_switched_off_drop_glossy_lobes_behind_diffuse_ones() -> None:
    graph = Graph()
    shaders, _names, _notices = compile_one(graph.surface(graph.link("ShaderNodeBsdfAnisotropic", "BSDF")))
    points = square_points((0.5, 0.25))
    mode = MODE_CLOSURES | MODE_NO_REFLECTIVE_CAUSTICS
    assert run(shaders, points, mode).count[0] == 1
    points.integer[0, POINT_RAY_FLAGS] |= RAY_DIFFUSE_ANCESTOR
    assert run(shaders, points, mode).count[0] == 0
    assert run(shaders, points).count[0] == 1


@pytest.mark.parametrize(
    ("kind", "lobes"),
    [
        ("ShaderNodeBsdfDiffuse", [kinds.DIFFUSE]),
        ("ShaderNodeBsdfTranslucent", [TRANSLUCENT]),
        ("ShaderNodeBsdfAnisotropic", [kinds.GLOSSY]),
        ("ShaderNodeBsdfRefraction", [kinds.REFRACTION]),
        ("ShaderNodeBsdfGlass", [kinds.GLASS]),
        ("ShaderNodeBsdfTransparent", [kinds.TRANSPARENT]),
        ("ShaderNodeBsdfMetallic", [kinds.GLOSSY_F82]),
        ("ShaderNodeBsdfSheen", [SHEEN]),
        ("ShaderNodeBsdfPrincipled", [kinds.GLOSSY_SCHLICK, kinds.DIFFUSE]),
    ],
)
def test_closures_and_their_lobes(kind: str, lobes: list[int]) -> None:
    graph = Graph()
    closures = run(compile_one(graph.surface(graph.link(kind, "BSDF")))[0])
    assert list(closures.kind[0, : closures.count[0]]) == lobes
