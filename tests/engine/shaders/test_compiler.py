# SPDX-License-Identifier: GPL-3.0-or-later
"""The shader compiler: folding, sharing, weights, facts about programs, broken graphs."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from engine.kernels.bsdf import kinds
from engine.kernels.shader import ops_closure
from engine.scene.description import Link, Node, NodeGraph
from engine.shaders.compiled_program import ProgramSource
from engine.shaders.compiler import compile_programs
from engine.state.lanes import CLOSURE_WEIGHT, POINT_NS
from engine.state.shaders import (
    MODE_CLOSURES,
    MODE_EMISSION,
    MODE_TRANSPARENCY,
    PROGRAM_EMISSION_CONSTANT,
    PROGRAM_END,
    PROGRAM_FLAGS,
    PROGRAM_HAS_EMISSION,
    PROGRAM_HAS_LOBES,
    PROGRAM_IS_BOUNDARY,
    PROGRAM_IS_CONSTANT,
    PROGRAM_IS_LAMBERTIAN,
    PROGRAM_MAY_BE_TRANSPARENT,
    PROGRAM_START,
    PROGRAM_TRANSPARENCY_CONSTANT,
    ShaderArrays,
)
from tests.helpers.shader_harness import Graph, compile_one, emitted, run, square_points


def opcodes(shaders: ShaderArrays, mode: int = MODE_CLOSURES) -> list[int]:
    """Opcodes of program 0 in order."""
    pc = int(shaders.programs[0, PROGRAM_START + 2 * mode])
    found = []
    while pc < shaders.programs[0, PROGRAM_END + 2 * mode]:
        found.append(int(shaders.code[pc]))
        pc += int(shaders.code[pc + 1])
    return found


def flags(shaders: ShaderArrays) -> int:
    return int(shaders.programs[0, PROGRAM_FLAGS])


def test_constants_are_folded_through_chains() -> None:
    graph = Graph()
    clamp = graph.link("ShaderNodeClamp", "Result", inputs={"Value": 7.0, "Min": 0.0, "Max": 0.25})
    combine = graph.link("ShaderNodeCombineXYZ", "Vector", inputs={"X": clamp, "Y": 0.5, "Z": 2.0})
    shaders, _names, notices = compile_one(graph.emit(combine, 2.0))
    assert opcodes(shaders) == [ops_closure.OP_EMISSION]
    assert flags(shaders) & PROGRAM_EMISSION_CONSTANT
    np.testing.assert_allclose(shaders.program_values[0, :3], (0.5, 1.0, 4.0))
    assert notices == []


def test_equal_nodes_run_once_and_unread_nodes_never() -> None:
    graph = Graph()
    first = graph.link("ShaderNodeNewGeometry", "Position")
    second = graph.link("ShaderNodeNewGeometry", "Position")
    graph.link("ShaderNodeTexChecker", "Color")
    a = graph.link("ShaderNodeTexChecker", "Fac", inputs={"Vector": first})
    b = graph.link("ShaderNodeTexChecker", "Fac", inputs={"Vector": second})
    combine = graph.link("ShaderNodeCombineXYZ", "Vector", inputs={"X": a, "Y": b, "Z": a})
    shaders, _names, _notices = compile_one(graph.emit(combine))
    assert len(opcodes(shaders)) == 4  # position, checker, combine, emission


def test_socket_conversions() -> None:
    graph = Graph()
    color = (0.1, 0.5, 0.9)
    position = graph.link("ShaderNodeNewGeometry", "Position")
    swatch = graph.link("ShaderNodeRGB", "Color", value=color)
    constant_gray = graph.link("ShaderNodeClamp", "Result", inputs={"Value": swatch})
    mean = graph.link("ShaderNodeClamp", "Result", inputs={"Value": position})
    combine = graph.link("ShaderNodeCombineXYZ", "Vector", inputs={"X": constant_gray, "Y": mean, "Z": 0.0})
    result = emitted(graph.emit(combine), square_points((0.6, 0.3)))
    luminance = 0.2126390 * 0.1 + 0.7151687 * 0.5 + 0.0721923 * 0.9
    np.testing.assert_allclose(result[0], (luminance, 0.3, 0.0), rtol=1e-6)
    graph = Graph()
    value = graph.link("ShaderNodeLightPath", "Is Camera Ray")
    np.testing.assert_allclose(emitted(graph.emit(value))[0], (1.0, 1.0, 1.0))


@pytest.mark.parametrize("fac", [-0.5, 0.0, 0.25, 1.0, 3.0])
def test_mix_and_add_weights(fac: float) -> None:
    graph = Graph()
    red = graph.link("ShaderNodeEmission", "Emission", inputs={"Color": (1.0, 0.0, 0.0)})
    blue = graph.link("ShaderNodeEmission", "Emission", inputs={"Color": (0.0, 0.0, 1.0)})
    mix = graph.link("ShaderNodeMixShader", "Shader", inputs={"Fac": fac, "Shader": red, "Shader_001": blue})
    both = graph.link("ShaderNodeAddShader", "Shader", inputs={"Shader": mix, "Shader_001": red})
    shaders, _names, _notices = compile_one(graph.surface(both))
    weight = min(max(fac, 0.0), 1.0)
    np.testing.assert_allclose(run(shaders).emission[0, :3], (2.0 - weight, 0.0, weight), atol=1e-6)
    assert flags(shaders) & PROGRAM_EMISSION_CONSTANT


@pytest.mark.parametrize(
    ("kind", "inputs", "is_lambertian"),
    [
        ("ShaderNodeBsdfDiffuse", {"Color": (0.8, 0.4, 0.2, 1.0), "Roughness": 0.0}, True),
        ("ShaderNodeBsdfDiffuse", {"Color": (0.8, 0.4, 0.2, 1.0), "Roughness": 0.3}, False),
        ("ShaderNodeBsdfDiffuse", {"Color": (0.8, 0.4, 0.2, 1.0), "Normal": (0.0, 0.6, 0.8)}, False),
        ("ShaderNodeBsdfTranslucent", {"Color": (0.8, 0.4, 0.2, 1.0)}, False),
    ],
)
def test_a_constant_diffuse_surface_is_told_apart_and_shades_as_its_program_does(kind, inputs, is_lambertian) -> None:
    graph = Graph()
    surface = graph.surface(graph.link(kind, "BSDF", inputs=inputs))
    shaders, _names, _notices = compile_one(surface)
    assert bool(flags(shaders) & PROGRAM_IS_LAMBERTIAN) == is_lambertian
    quick = run(shaders)
    shaders.programs[0, PROGRAM_FLAGS] &= ~PROGRAM_IS_LAMBERTIAN
    slow = run(shaders)
    assert quick.count[0] == slow.count[0] == 1
    assert quick.kind[0, 0] == slow.kind[0, 0]
    assert np.array_equal(quick.param[0, 0, :8], slow.param[0, 0, :8])
    assert quick.param[0, 0, kinds.BUMP] == slow.param[0, 0, kinds.BUMP]
    for mode in (MODE_EMISSION, MODE_TRANSPARENCY):
        assert run(shaders, mode=mode).count[0] == 0


def test_a_smooth_normal_is_not_taken_for_a_bumped_one() -> None:
    """Also where rounding makes its length differ from 1."""
    graph = Graph()
    shaders, _names, _notices = compile_one(graph.surface(graph.link("ShaderNodeBsdfGlossy", "BSDF")))
    points = square_points(np.random.default_rng(1).random((1000, 2)))
    normals = np.random.default_rng(2).normal(size=(1000, 3)).astype(np.float32)
    normals[:, 2] = 4.0 + np.abs(normals[:, 2])
    points.real[:, POINT_NS : POINT_NS + 3] = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    closures = run(shaders, points)
    assert (closures.count == 1).all()
    assert (closures.param[:, 0, kinds.BUMP] == 0.0).all()


def test_mix_by_a_varying_factor() -> None:
    graph = Graph()
    checker = graph.link("ShaderNodeTexChecker", "Fac", inputs={"Scale": 2.0})
    white = graph.link("ShaderNodeEmission", "Emission")
    clear = graph.link("ShaderNodeBsdfTransparent", "BSDF")
    mix = graph.link("ShaderNodeMixShader", "Shader", inputs={"Fac": checker, "Shader": white, "Shader_001": clear})
    shaders, _names, _notices = compile_one(graph.surface(mix))
    closures = run(shaders, square_points([(0.25, 0.2), (0.75, 0.25)]))
    np.testing.assert_allclose(closures.emission[:, 0] + closures.transparency[:, 0], 1.0)
    assert set(closures.emission[:, 0]) == {0.0, 1.0}
    assert flags(shaders) & PROGRAM_HAS_EMISSION and flags(shaders) & PROGRAM_MAY_BE_TRANSPARENT
    assert not flags(shaders) & (PROGRAM_EMISSION_CONSTANT | PROGRAM_TRANSPARENCY_CONSTANT)
    # Half of the square emits: the estimate says so.
    np.testing.assert_allclose(shaders.program_values[0, :3], 0.5, atol=0.02)


def test_modes_run_only_what_they_need() -> None:
    graph = Graph()
    position = graph.link("ShaderNodeNewGeometry", "Position")
    principled = graph.link(
        "ShaderNodeBsdfPrincipled",
        "BSDF",
        inputs={"Base Color": position, "Alpha": 0.25, "Emission Color": (1.0, 0.5, 0.0), "Emission Strength": 4.0},
    )
    shaders, _names, _notices = compile_one(graph.surface(principled))
    assert opcodes(shaders, MODE_EMISSION) == [ops_closure.OP_EMISSION]
    assert opcodes(shaders, MODE_TRANSPARENCY) == [ops_closure.OP_ALPHA]
    for mode in (MODE_CLOSURES, MODE_EMISSION):
        np.testing.assert_allclose(run(shaders, mode=mode).emission[0, :3], (1.0, 0.5, 0.0), rtol=1e-6)
    for mode in (MODE_CLOSURES, MODE_TRANSPARENCY):
        np.testing.assert_allclose(run(shaders, mode=mode).transparency[0, :3], 0.75, rtol=1e-6)
    np.testing.assert_allclose(shaders.program_values[0, :3], (1.0, 0.5, 0.0))
    np.testing.assert_allclose(shaders.program_values[0, 4:7], 0.75)
    assert flags(shaders) & PROGRAM_TRANSPARENCY_CONSTANT
    assert not flags(shaders) & PROGRAM_IS_CONSTANT


def test_transparent_shadows_can_be_switched_off() -> None:
    graph = Graph()
    surface = graph.surface(graph.link("ShaderNodeBsdfTransparent", "BSDF"))
    assert flags(compile_one(surface)[0]) & PROGRAM_MAY_BE_TRANSPARENT
    assert not flags(compile_one(surface, use_transparent_shadow=False)[0]) & PROGRAM_MAY_BE_TRANSPARENT


def test_default_and_empty_materials() -> None:
    shaders, _names, _notices = compile_one(None)
    closures = run(shaders)
    assert closures.count[0] == 1 and closures.kind[0, 0] == kinds.DIFFUSE
    np.testing.assert_allclose(closures.param[0, 0, CLOSURE_WEIGHT : CLOSURE_WEIGHT + 3], 0.8)
    assert flags(shaders) == PROGRAM_HAS_LOBES | PROGRAM_IS_CONSTANT | PROGRAM_EMISSION_CONSTANT | (
        PROGRAM_TRANSPARENCY_CONSTANT | PROGRAM_IS_LAMBERTIAN
    )
    shaders, _names, _notices = compile_one(NodeGraph())
    assert opcodes(shaders) == [] and run(shaders).count[0] == 0


def test_world_without_nodes_has_its_color() -> None:
    shaders, _names, _notices = compile_one(None, kind="WORLD", color=(0.1, 0.2, 0.3))
    np.testing.assert_allclose(shaders.program_values[0, :3], (0.1, 0.2, 0.3))


def test_unsupported_nodes_are_reported_once() -> None:
    graph = Graph()
    odd = graph.link("ShaderNodeFromTheFuture", "Value", name="Odd")
    odder = graph.link("ShaderNodeFromTheFuture", "Value", name="Odder", inputs={"Value": odd})
    _shaders, _names, notices = compile_one(graph.emit(odder, odd))
    assert sorted((n.subject, n.fallback) for n in notices) == [
        ("M / Odd", "as if it were not linked"),
        ("M / Odder", "as if it were not linked"),
    ]
    graph = Graph()
    _shaders, _names, notices = compile_one(graph.surface(graph.link("ShaderNodeBsdfOdd", "BSDF", name="Odd")))
    assert [n.subject for n in notices] == ["M / Odd"]


def test_links_from_what_is_not_known_are_none() -> None:
    graph = Graph()
    odd = graph.add("ShaderNodeFromTheFuture", name="Odd")
    old = graph.add("ShaderNodeRGB", name="Old", value=(1.0, 1.0, 1.0, 1.0))
    color = Link(odd, "Color", otherwise=(0.9, 0.5, 0.1, 1.0))
    strength = Link(old, "Not Yet", otherwise=0.5)
    shaders, _names, notices = compile_one(graph.emit(color, strength))
    np.testing.assert_allclose(run(shaders).emission[0, :3], (0.45, 0.25, 0.05), rtol=1e-6)
    assert {(notice.subject, notice.fallback) for notice in notices} == {
        ("M / Odd", "as if it were not linked"),
        ("M / Old", "as if it were not linked"),
    }


def test_closure_on_a_value_is_no_link() -> None:
    for kind in ("ShaderNodeEmission", "ShaderNodeMixShader"):
        graph = Graph()
        shader = Link(graph.add(kind, name="Shader"), "Out", otherwise=(0.9, 0.5, 0.1, 1.0))
        shaders, _names, notices = compile_one(graph.emit(shader))
        np.testing.assert_allclose(run(shaders).emission[0, :3], (0.9, 0.5, 0.1), rtol=1e-6)
        assert [notice.problem for notice in notices] == ["is a shader linked to a value"]


def test_output_linked_to_what_is_not_known_is_not_linked() -> None:
    graph = Graph()
    odd = Link(graph.add("ShaderNodeFromTheFuture", name="Odd"), "Color", otherwise=(0.0, 0.0, 0.0, 1.0))
    converted = Link(
        graph.add("ShaderNodeEmission", inputs={"Color": odd, "Strength": 1.0}, is_conversion=True), "Emission"
    )
    fog = graph.link("ShaderNodeVolumeAbsorption", "Volume", inputs={"Color": (0.5, 0.5, 0.5, 1.0), "Density": 1.0})
    for unknown in (odd, converted):
        # Nothing on the surface: it is nothing but the boundary of its volume.
        shaders, _names, notices = compile_one(NodeGraph(graph.nodes, surface=unknown, volume=fog))
        assert flags(shaders) & PROGRAM_IS_BOUNDARY and len(notices) == 1
        shaders, _names, notices = compile_one(NodeGraph(graph.nodes, volume=unknown))
        assert not flags(shaders) & PROGRAM_IS_BOUNDARY and len(notices) == 1
        diffuse = graph.link("ShaderNodeBsdfDiffuse", "BSDF")
        shaders, _names, notices = compile_one(NodeGraph(graph.nodes, surface=diffuse, displacement=odd))
        assert flags(shaders) & PROGRAM_IS_LAMBERTIAN and len(notices) == 1


def test_cycles_are_cut_and_reported() -> None:
    graph = Graph()
    first = graph.add("ShaderNodeClamp", name="First")
    second = graph.link("ShaderNodeClamp", "Result", name="Second", inputs={"Value": Link(first, "Result")})
    graph.nodes[first].inputs["Value"] = second
    _shaders, _names, notices = compile_one(graph.emit(second))
    assert len(notices) == 1 and "loop" in notices[0].problem
    graph = Graph()
    mix = graph.add("ShaderNodeMixShader", name="Mix")
    white = graph.link("ShaderNodeEmission", "Emission")
    graph.nodes[mix].inputs.update({"Fac": 0.5, "Shader": Link(mix, "Shader"), "Shader_001": white})
    shaders, _names, notices = compile_one(graph.surface(Link(mix, "Shader")))
    assert len(notices) == 1
    np.testing.assert_allclose(run(shaders).emission[0, :3], 0.5)


def test_broken_links_and_values_do_not_crash() -> None:
    graph = Graph()
    color = graph.link("ShaderNodeRGB", "No Such Output", value=(1.0, 1.0, 1.0, 1.0))
    surface = graph.emit(color, Link(99, "Value"))
    _shaders, _names, notices = compile_one(surface)
    assert len(notices) == 2
    compile_one(NodeGraph([], Link(0, "BSDF")))
    graph = Graph()
    bad = graph.link("ShaderNodeBsdfDiffuse", "BSDF", inputs={"Color": "red", "Roughness": (), "Normal": None})
    compile_one(graph.surface(bad))


def test_long_chains_do_not_exhaust_the_stack() -> None:
    graph = Graph()
    value = graph.link("ShaderNodeLightPath", "Ray Length")
    for _ in range(3000):
        value = graph.link("ShaderNodeClamp", "Result", inputs={"Value": value, "Max": 9.0})
    assert emitted(graph.emit(value))[0, 0] == 2.0


def test_many_live_values_keep_their_registers() -> None:
    """Sums of many values that are all alive at once: a wrong register shows as a wrong sum."""
    graph = Graph()
    position = graph.link("ShaderNodeNewGeometry", "Position")
    parts = []
    for k in range(60):
        location = (float(k), 0.0, 0.0)
        parts.append(graph.link("ShaderNodeMapping", "Vector", inputs={"Vector": position, "Location": location}))
    surface = None
    for part in parts:
        emission = graph.link("ShaderNodeEmission", "Emission", inputs={"Color": part})
        if surface is None:
            surface = emission
        else:
            surface = graph.link("ShaderNodeAddShader", "Shader", inputs={"Shader": surface, "Shader_001": emission})
    assert surface is not None
    shaders, _names, _notices = compile_one(graph.surface(surface))
    result = run(shaders, square_points((0.5, 0.25))).emission[0, :3]
    np.testing.assert_allclose(result, (60 * 0.5 + 59 * 30, 60 * 0.25, 0.0), rtol=1e-5)


REC2020_TO_XYZ = np.array(
    ((0.6369580, 0.1446169, 0.1688810), (0.2627002, 0.6779981, 0.0593017), (0.0, 0.0280727, 1.0609851)), np.float32
)
#: Red of Rec.709 in Rec.2020 and so on by column (ITU-R BT.2087, table 3).
REC709_TO_REC2020 = np.array(
    ((0.6274, 0.3293, 0.0433), (0.0691, 0.9195, 0.0114), (0.0164, 0.0880, 0.8956)), np.float32
)


def emitted_in(graph: NodeGraph, to_xyz: Any) -> np.ndarray:
    shaders, _, notices = compile_programs([ProgramSource("M", graph)], [], to_xyz=to_xyz)
    assert not notices
    return np.asarray(run(shaders, square_points((0.5, 0.25))).emission[0, :3])


@pytest.mark.parametrize("is_varying", [False, True])
@pytest.mark.parametrize("kind", ["ShaderNodeRGBToBW", "ShaderNodeMath"])
def test_luminance_is_that_of_the_working_space(is_varying: bool, kind: str) -> None:
    graph = Graph()
    color: Any = (0.5, 0.25, 0.0, 1.0)
    if is_varying:
        color = graph.link("ShaderNodeNewGeometry", "Position")
        color = graph.link("ShaderNodeGamma", "Color", inputs={"Color": color, "Gamma": 1.0})
    elif kind == "ShaderNodeMath":
        color = graph.link("ShaderNodeGamma", "Color", inputs={"Color": color, "Gamma": 1.0})
    if kind == "ShaderNodeRGBToBW":
        value = graph.link(kind, "Val", inputs={"Color": color})
    else:
        value = graph.link(kind, "Value", operation="ADD", inputs={"Value": color, "Value_001": 0.0})
    surface = graph.emit(value)
    np.testing.assert_allclose(emitted_in(surface, None), 0.5 * 0.2126390 + 0.25 * 0.7151687, rtol=1e-4)
    np.testing.assert_allclose(emitted_in(surface, REC2020_TO_XYZ), 0.5 * 0.2627002 + 0.25 * 0.6779981, rtol=1e-4)


@pytest.mark.parametrize("is_varying", [False, True])
@pytest.mark.parametrize(("kind", "socket", "scale"), [
    ("ShaderNodeBlackbody", "Temperature", 6000.0), ("ShaderNodeWavelength", "Wavelength", 1160.0),
])  # fmt: skip
def test_black_bodies_and_wavelengths_are_in_the_working_space(
    kind: str, socket: str, scale: float, is_varying: bool
) -> None:
    graph = Graph()
    value: Any = 0.5 * scale
    if is_varying:
        position = graph.link("ShaderNodeNewGeometry", "Position")
        separate = graph.link("ShaderNodeSeparateXYZ", "X", inputs={"Vector": position})
        value = graph.link(
            "ShaderNodeMath", "Value", operation="MULTIPLY", inputs={"Value": separate, "Value_001": scale}
        )
    surface = graph.emit(graph.link(kind, "Color", inputs={socket: value}))
    in_rec709 = emitted_in(surface, None)
    assert in_rec709.max() > 0.1
    np.testing.assert_allclose(emitted_in(surface, REC2020_TO_XYZ), REC709_TO_REC2020 @ in_rec709, atol=2e-3)


def test_attribute_slots_are_named() -> None:
    graph = Graph()
    color = graph.link("ShaderNodeAttribute", "Color", attribute_name="wear")
    fac = graph.link("ShaderNodeVertexColor", "Alpha", layer_name="Col")
    _shaders, names, _notices = compile_one(graph.emit(color, fac))
    assert names == ["wear", "Col"]


@pytest.mark.parametrize("distribution", ["BECKMANN", "ASHIKHMIN_SHIRLEY"])
@pytest.mark.parametrize("roughness", [0.5, 0.0])
def test_distributions_are_as_they_were_asked_for(distribution: str, roughness: float) -> None:
    node = Node("ShaderNodeBsdfGlossy", "Shine", {"Roughness": roughness}, {"distribution": distribution})
    shaders, _, notices = compile_programs([ProgramSource("sea", NodeGraph([node], Link(0, "BSDF")))], [])
    assert not notices
    # A mirror has no facets: its lobe need not be linked.
    name = "GLOSSY" if roughness > 0.0 else "PLAIN_GLOSSY"
    assert opcodes(shaders)[-1] == ops_closure.opcode(name)
