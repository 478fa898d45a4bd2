# SPDX-License-Identifier: GPL-3.0-or-later
"""Volume nodes as coefficients, by Cycles' formulas worked out by hand, folded and looked up at a point."""

from __future__ import annotations

import numpy as np
import pytest

from engine.kernels.bsdf import load_tables
from engine.kernels.bsdf.phase import PHASE_ALPHA, PHASE_DELTA, PHASE_G
from engine.scene.description import Link, Node, NodeGraph
from engine.shaders.assembly import shader_arrays
from engine.shaders.compiled_program import ProgramSource
from engine.shaders.folding import stand_in_geometry
from engine.shaders.image_pool import ImagePoolCache
from engine.shaders.media import mie_parameters
from engine.shaders.medium import Medium, PhaseLobe
from engine.shaders.pools import ScenePools
from engine.shaders.surface_compiler import SurfaceCompiler
from engine.state.lanes import (
    CLOSURE_WEIGHT,
    POINT_LIGHT,
    POINT_TRIANGLE,
    allocate_closures,
    allocate_points,
)
from engine.state.shaders import (
    MODE_MEDIUM,
    PROGRAM_IS_BOUNDARY,
    PROGRAM_MAY_BE_TRANSPARENT,
    allocate_memory,
    identity_camera,
)
from engine.wavefront.evaluate_shaders import evaluate_shaders
from tests.helpers.media_scenes import volume_graph


def compiled(graph, kind="MATERIAL"):
    """The program of a graph, and what was reported."""
    pools = ScenePools([], None)
    return SurfaceCompiler(pools, ProgramSource("M", graph, kind=kind)).compile(), pools.notices


def folded(graph) -> Medium:
    program, notices = compiled(graph)
    assert not notices
    return program.medium


def test_absorption_takes_what_the_color_lacks():
    medium = folded(volume_graph("Absorption", Color=(0.9, 0.5, 1.0, 1.0), Density=3.0))
    assert np.allclose(medium.absorption, (0.3, 1.5, 0.0)) and not medium.lobes and not any(medium.emission)


def test_scattering_is_density_times_color():
    medium = folded(volume_graph("Scatter", Color=(0.9, 0.5, 0.1, 1.0), Density=2.0, Anisotropy=0.3))
    assert np.allclose(medium.lobes[0].scattering, (1.8, 1.0, 0.2)) and medium.lobes[0].g == pytest.approx(0.3)
    assert not any(medium.absorption)


def test_principled_volume_has_cycles_absorption_and_black_body():
    medium = folded(
        volume_graph(
            "Principled", **{"Color": (0.5, 0.2, 0.8, 1.0), "Density": 2.0, "Absorption Color": (0.25, 0.0, 1.0, 1.0)},
        )
    )
    assert np.allclose(medium.absorption, (0.5, 1.6, 0.0)) and np.allclose(medium.lobes[0].scattering, (1.0, 0.4, 1.6))
    hot = folded(volume_graph("Principled", **{"Density": 0.0, "Blackbody Intensity": 1.0, "Temperature": 2000.0}))
    # Stefan and Boltzmann's law, in Cycles' unit, times a reddish colour of about unit luminance.
    power = 5.670373e-14 * 2000.0**4 / np.pi
    assert hot.emission[0] > power > hot.emission[2] and not hot.lobes


def test_mixes_weigh_and_additions_add_up():
    nodes = [
        Node("ShaderNodeVolumeScatter", "A", {"Color": (1.0, 1.0, 1.0, 1.0), "Density": 4.0}),
        Node("ShaderNodeVolumeAbsorption", "B", {"Color": (0.0, 0.0, 0.0, 1.0), "Density": 4.0}),
        Node("ShaderNodeMixShader", "Mix", {"Fac": 0.25, "Shader": Link(0, "Volume"), "Shader_001": Link(1, "Volume")}),
        Node("ShaderNodeAddShader", "Add", {"Shader": Link(2, "Shader"), "Shader_001": Link(1, "Volume")}),
    ]
    medium = folded(NodeGraph(nodes, None, Link(3, "Shader")))
    assert np.allclose(medium.lobes[0].scattering, 3.0) and np.allclose(medium.absorption, 5.0)


def test_a_material_with_nothing_but_a_volume_has_no_surface():
    program, _ = compiled(volume_graph("Scatter"))
    assert program.is_boundary and program.transparency == (1.0, 1.0, 1.0)
    assert program.flags & PROGRAM_IS_BOUNDARY and program.flags & PROGRAM_MAY_BE_TRANSPARENT
    for surface, kind in (("ShaderNodeBsdfGlass", "MATERIAL"), (None, "WORLD")):
        program, _ = compiled(volume_graph("Scatter", surface), kind)
        assert not program.is_boundary and program.medium is not None


def looked_up(graph):
    """What a graph is at a point of the stand-in object: absorption, emission, lobes."""
    pools = ScenePools([], None)
    source = ProgramSource("M", graph)
    program = SurfaceCompiler(pools, source).compile()
    assert program.medium.varies and not pools.notices
    images = ImagePoolCache().get([])
    shaders = shader_arrays([source], [program], pools, images, identity_camera())
    points, closures = allocate_points(1), allocate_closures(1)
    points.integer[0, [POINT_TRIANGLE, POINT_LIGHT]] = -1
    lanes = np.zeros(1, np.int32)
    geometry, memory = stand_in_geometry(1), allocate_memory(shaders)
    evaluate_shaders(shaders, geometry, load_tables(), points, closures, lanes, 1, memory, MODE_MEDIUM)
    lobes = [
        PhaseLobe(
            tuple(param[CLOSURE_WEIGHT : CLOSURE_WEIGHT + 3].tolist()), param[PHASE_G], param[PHASE_ALPHA],
            param[PHASE_DELTA],
        )
        for param in closures.param[0, : closures.count[0]]
    ]
    return Medium(tuple(closures.transparency[0, :3].tolist()), tuple(closures.emission[0, :3].tolist()), tuple(lobes))


@pytest.mark.parametrize(
    ("kind", "inputs"),
    [
        ("Absorption", {"Color": (0.9, 0.5, 1.0, 1.0), "Density": 3.0}),
        ("Scatter", {"Color": (0.9, 0.5, 0.1, 1.0), "Density": 2.0, "Anisotropy": 0.3}),
        ("Scatter", {"phase": "DRAINE", "Color": (0.9, 0.5, 0.1, 1.0), "Density": 2.0, "Alpha": 0.7}),
        ("Scatter", {"phase": "DRAINE", "Color": (0.9, 0.5, 0.1, 1.0), "Anisotropy": 0.2, "Alpha": 9.0}),
        ("Scatter", {"phase": "FOURNIER_FORAND", "Color": (0.9, 0.5, 0.1, 1.0), "Density": 2.0, "IOR": 1.2}),
        ("Scatter", {"phase": "MIE", "Color": (0.9, 0.5, 0.1, 1.0), "Density": 2.0, "Diameter": 8.0}),
        (
            "Coefficients",
            {
                "Absorption Coefficients": (0.1, 0.2, 3.0), "Scatter Coefficients": (1.0, 0.5, 0.0),
                "Emission Coefficients": (0.0, 1.0, 2.0), "Anisotropy": -0.999999,
            },
        ),
        (
            "Principled",
            {
                "Color": (0.5, 0.2, 0.8, 1.0), "Density": 2.0, "Absorption Color": (0.25, 0.0, 1.0, 1.0),
                "Emission Strength": 0.5, "Emission Color": (0.1, 0.2, 0.3, 1.0), "Blackbody Intensity": 0.6,
                "Temperature": 1800.0,
            },
        ),
    ],
)
def test_a_program_says_at_a_point_what_folding_says_of_everywhere(kind, inputs):
    """Mixed by a factor that the compiler cannot know, and that is 0.5 at the point."""
    graph = volume_graph(kind, **inputs)
    expected = folded(volume_graph(kind, **inputs))
    graph.nodes += [
        Node("ShaderNodeMixShader", "Mix", {"Fac": Link(2, "Random"), "Shader_001": Link(0, "Volume")}),
        Node("ShaderNodeObjectInfo", "Object"),
    ]
    graph.volume = Link(1, "Shader")
    found = looked_up(graph)
    assert np.allclose(2.0 * np.array(found.absorption), expected.absorption, rtol=1e-5)
    assert np.allclose(2.0 * np.array(found.emission), expected.emission, rtol=1e-4)
    assert len(found.lobes) == len(expected.lobes)
    for mine, theirs in zip(found.lobes, expected.lobes, strict=True):
        assert np.allclose(2.0 * np.array(mine.scattering), theirs.scattering, rtol=1e-5)
        assert np.allclose((mine.g, mine.alpha, mine.delta), (theirs.g, theirs.alpha, theirs.delta), rtol=1e-5)


def test_a_surface_shader_in_a_volume_and_numbers_that_are_none_are_named():
    program, notices = compiled(NodeGraph([Node("ShaderNodeBsdfDiffuse", "Paint")], None, Link(0, "BSDF")))
    assert program.medium is None and [notice.subject for notice in notices] == ["M / Paint"]
    program, notices = compiled(volume_graph("Scatter", Density=float("nan")))
    assert program.medium is None and "Density" in notices[0].problem
    assert compiled(volume_graph("Absorption", Density=-3.0))[0].medium is None


@pytest.mark.parametrize("diameter", [0.05, 0.5, 2.0, 8.0, 40.0])
def test_droplets_scatter_the_more_forwards_the_larger_they_are(diameter):
    g, draine_g, alpha, share = mie_parameters(diameter)
    assert -1.0 < draine_g < 1.0 and 0.0 <= g < 1.0 and alpha > 0.0 and 0.0 <= share <= 1.0
    assert mie_parameters(diameter * 1.05)[0] > g
