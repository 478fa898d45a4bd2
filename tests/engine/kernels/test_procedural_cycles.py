# SPDX-License-Identifier: GPL-3.0-or-later
"""Procedural textures against Cycles, pixel by pixel on the same coordinates."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

pytest.importorskip("bpy")

import bpy

from tests.helpers.node_oracle import NodeCase, node_inputs, render_cases
from tests.helpers.node_runner import run_node

_NOISE_KINDS = ("MULTIFRACTAL", "RIDGED_MULTIFRACTAL", "HYBRID_MULTIFRACTAL", "FBM", "HETERO_TERRAIN")
_DIMENSIONS = ("1D", "2D", "3D", "4D")
_METRICS = ("EUCLIDEAN", "MANHATTAN", "CHEBYCHEV", "MINKOWSKI")


def _noise() -> list[NodeCase]:
    cases = []
    for dimensions in _DIMENSIONS:
        for kind in _NOISE_KINDS:
            properties = {"noise_dimensions": dimensions, "noise_type": kind, "normalize": kind == "FBM"}
            inputs = {
                "Vector": "A", "W": "B.x", "Scale": 3.7, "Detail": 3.4, "Roughness": 0.6, "Lacunarity": 2.3,
                "Offset": 0.4, "Gain": 1.7, "Distortion": 0.35,
            }  # fmt: skip
            cases.append(NodeCase("ShaderNodeTexNoise", "Color", inputs, properties))
    plain = {"Vector": "A"}
    cases.append(NodeCase("ShaderNodeTexNoise", "Fac", plain))
    cases.append(NodeCase("ShaderNodeTexNoise", "Fac", {**plain, "Detail": 15.0, "Scale": 1.0}))
    cases.append(NodeCase("ShaderNodeTexNoise", "Color", {**plain, "Detail": 2.5}, {"normalize": False}))
    # Inputs that vary, go out of range, or are so large that noise wraps around.
    varying = {"Vector": "A", "Detail": ("B.x", 4.0), "Roughness": "B.y", "Distortion": "B.z"}
    cases.append(NodeCase("ShaderNodeTexNoise", "Color", varying))
    cases.append(NodeCase("ShaderNodeTexNoise", "Fac", {"Vector": ("A", 150000.0), "Scale": 1.0, "Detail": 0.0}))
    cases.append(NodeCase("ShaderNodeTexNoise", "Fac", {"Vector": ("A", 3000000.0), "Scale": 1.0, "Detail": 0.0}))
    return cases


def _voronoi() -> list[NodeCase]:
    cases = []
    for dimensions in _DIMENSIONS:
        inputs = {"Vector": "A", "W": "B.x", "Scale": 2.7, "Exponent": 1.7, "Randomness": 0.8}
        for feature in ("F1", "F2", "SMOOTH_F1"):
            for metric in _METRICS if dimensions != "1D" else _METRICS[:1]:
                properties = {"voronoi_dimensions": dimensions, "feature": feature, "distance": metric}
                cases.append(NodeCase("ShaderNodeTexVoronoi", "Distance", inputs, properties))
            properties = {"voronoi_dimensions": dimensions, "feature": feature}
            cases.append(NodeCase("ShaderNodeTexVoronoi", "Color", inputs, properties))
            position = "W" if dimensions in ("1D", "4D") else "Position"
            cases.append(NodeCase("ShaderNodeTexVoronoi", position, inputs, properties))
            fractal = {**inputs, "Detail": 2.6, "Roughness": 0.7, "Lacunarity": 1.9}
            properties = {**properties, "normalize": True}
            for output in ("Distance", "Color", position):
                cases.append(NodeCase("ShaderNodeTexVoronoi", output, fractal, properties))
        properties = {"voronoi_dimensions": dimensions, "feature": "DISTANCE_TO_EDGE"}
        cases.append(NodeCase("ShaderNodeTexVoronoi", "Distance", inputs, properties))
        fractal = {**inputs, "Detail": 2.6, "Roughness": 0.7, "Lacunarity": 1.9}
        cases.append(NodeCase("ShaderNodeTexVoronoi", "Distance", fractal, {**properties, "normalize": True}))
        properties = {"voronoi_dimensions": dimensions, "feature": "N_SPHERE_RADIUS"}
        cases.append(NodeCase("ShaderNodeTexVoronoi", "Radius", inputs, properties))
    varying = {"Vector": "A", "Randomness": "B.x", "Smoothness": "B.y", "Detail": ("B.z", 2.0)}
    for feature in ("F1", "SMOOTH_F1"):
        cases.append(NodeCase("ShaderNodeTexVoronoi", "Distance", varying, {"feature": feature}))
    cases.append(NodeCase("ShaderNodeTexVoronoi", "Position", {"Vector": "A", "Scale": 0.0}))
    return cases


def _small() -> list[NodeCase]:
    cases = [
        NodeCase("ShaderNodeTexChecker", "Color", {"Vector": "A", "Scale": 4.0, "Color1": (0.1, 0.7, 0.3)}),
        NodeCase("ShaderNodeTexChecker", "Fac", {"Vector": ("A", 3.0), "Scale": "B.x"}),
        NodeCase("ShaderNodeTexMagic", "Color", {"Vector": "A", "Scale": 0.0}),
        NodeCase("ShaderNodeTexMagic", "Fac", {"Vector": ("A", 9.0), "Scale": 1.3, "Distortion": 0.0}),
        # Coordinates that are wrapped.
        NodeCase("ShaderNodeTexMagic", "Color", {"Vector": ("A", 9.0), "Scale": 1.3}),
        NodeCase("ShaderNodeTexMagic", "Color", {"Vector": ("A", 9.0), "Scale": "B.x"}),
    ]
    for kind in ("LINEAR", "QUADRATIC", "EASING", "DIAGONAL", "SPHERICAL", "QUADRATIC_SPHERE", "RADIAL"):
        cases.append(NodeCase("ShaderNodeTexGradient", "Fac", {"Vector": "A"}, {"gradient_type": kind}))
    for depth in (0, 1, 2, 3, 5, 8, 10):
        inputs = {"Vector": "A", "Scale": 1.7, "Distortion": 1.3}
        cases.append(NodeCase("ShaderNodeTexMagic", "Color", inputs, {"turbulence_depth": depth}))
    for dimensions in _DIMENSIONS:
        for output in ("Value", "Color"):
            inputs = {"Vector": "A", "W": "B.x"}
            cases.append(NodeCase("ShaderNodeTexWhiteNoise", output, inputs, {"noise_dimensions": dimensions}))
    for profile in ("SIN", "SAW", "TRI"):
        for direction in ("X", "Y", "Z", "DIAGONAL"):
            properties = {"wave_type": "BANDS", "bands_direction": direction, "wave_profile": profile}
            cases.append(NodeCase("ShaderNodeTexWave", "Fac", {"Vector": "A", "Scale": 0.7}, properties))
        for direction in ("X", "Y", "Z", "SPHERICAL"):
            properties = {"wave_type": "RINGS", "rings_direction": direction, "wave_profile": profile}
            inputs = {
                "Vector": "A", "Scale": 1.2, "Distortion": 3.5, "Detail": 2.4, "Detail Scale": 1.6,
                "Detail Roughness": 0.6, "Phase Offset": 0.8,
            }  # fmt: skip
            cases.append(NodeCase("ShaderNodeTexWave", "Color", inputs, properties))
    for settings in (
        {},
        {"offset": 0.3, "offset_frequency": 3, "squash": 1.6, "squash_frequency": 2},
        {"offset": 0.7, "offset_frequency": 1, "squash": 0.6, "squash_frequency": 1},
    ):
        for output in ("Color", "Fac"):
            inputs = {
                "Vector": "A", "Scale": 3.0, "Mortar Size": 0.06, "Mortar Smooth": 0.4, "Bias": 0.1,
                "Color1": (0.9, 0.2, 0.1), "Mortar": (0.3, 0.3, 0.6),
            }  # fmt: skip
            cases.append(NodeCase("ShaderNodeTexBrick", output, inputs, settings))
    inputs = {"Vector": "A", "Mortar Size": 0.08, "Mortar Smooth": 0.0, "Bias": "B.x"}
    cases.append(NodeCase("ShaderNodeTexBrick", "Color", inputs))
    return cases


def _patterns() -> list[NodeCase]:
    """Gabor Textures, and Radial Tilings of every kind of segment and corner."""
    cases = []
    for kind in ("2D", "3D"):
        inputs = {"Vector": "A", "Scale": 2.3, "Frequency": 1.7, "Orientation 2D": 0.4}
        for output in ("Value", "Phase", "Intensity"):
            for anisotropy, direction in ((1.0, "B"), (0.6, (0.3, -0.5, 0.7)), (0.0, (-1.0, 0.2, -0.1))):
                given = {**inputs, "Anisotropy": anisotropy, "Orientation 3D": direction}
                cases.append(NodeCase("ShaderNodeTexGabor", output, given, {"gabor_type": kind}))
        varying = {"Vector": ("A", 3.0), "Frequency": "B.x", "Anisotropy": "B.y", "Orientation 2D": "B.z"}
        cases.append(NodeCase("ShaderNodeTexGabor", "Value", varying, {"gabor_type": kind}))
    for sides in (1.0, 2.0, 2.4, 5.0, 5.3, 7.9):
        for roundness in (0.0, 0.35, 1.0):
            for normalize in (False, True):
                given = {"Vector": "A", "Sides": sides, "Roundness": roundness}
                if sides < 2.1 and 0.0 < roundness < 1.0:  # Cycles divides by the tangent of a right angle.
                    continue
                # All segments are of one width unless a fraction of a side is left.
                width = ("Segment Width",) if sides % 1.0 else ()
                for output in ("Segment Coordinates", "Segment Rotation", *width):
                    cases.append(NodeCase("ShaderNodeRadialTiling", output, given, {"normalize": normalize}))
        cases.append(NodeCase("ShaderNodeRadialTiling", "Segment ID", {"Vector": "A", "Sides": sides}))
    for varying in ({"Sides": ("B.x", 9.0), "Roundness": 1.0}, {"Sides": 6.7, "Roundness": "B.y"}):
        given = {"Vector": "A", **varying}
        for output in ("Segment Coordinates", "Segment Width"):
            cases.append(NodeCase("ShaderNodeRadialTiling", output, given, {"normalize": True}))
    return cases


_CASES = _noise() + _voronoi() + _small() + _patterns()


@pytest.fixture(scope="module")
def rendered(tmp_path_factory: pytest.TempPathFactory) -> list[tuple[dict[str, np.ndarray], np.ndarray]]:
    return render_cases(_CASES, tmp_path_factory.mktemp("cycles"))


@pytest.mark.parametrize("index", range(len(_CASES)), ids=[case.name() for case in _CASES])
def test_texture_is_that_of_cycles(rendered: list[tuple[dict[str, np.ndarray], np.ndarray]], index: int) -> None:
    case = _CASES[index]
    sources, theirs = rendered[index]
    properties = {**case.properties, **case.baked}
    inputs = node_inputs(case, sources)
    ours = np.broadcast_to(run_node(case.kind, case.output, inputs, properties), theirs.shape)
    assert np.isfinite(theirs).all()
    assert theirs.std() > 0.0 or 0.0 in (case.inputs.get("Scale"), case.inputs.get("Distortion"))
    allowance = 1e-4 + 1e-4 * np.abs(theirs)
    if case.kind == "ShaderNodeTexNoise" and case.output == "Color" and bpy.app.version >= (5, 1):
        allowance = allowance + _effect_of_rounding(case, inputs, properties)
    if case.output == "Phase":
        # The angle of a phasor is as exact as the phasor is long.
        allowance = allowance + 1e-6 / run_node(case.kind, "Intensity", inputs, properties)
    assert (np.abs(ours - theirs) <= allowance).all(), np.abs(ours - theirs).max()


def _effect_of_rounding(case: NodeCase, inputs: dict[str, Any], properties: dict[str, Any]) -> np.ndarray:
    """How far a Noise Texture's colours move where the shifts between its channels differ by their last digit.

    They are between 100 and 200, and Blender 5.2 is compiled without fusing the product and the sum they come from.
    """
    digit = np.float32(2.0**-16)
    ours = run_node(case.kind, case.output, inputs, properties)
    effect = np.zeros_like(ours)
    for name in inputs.keys() & {"Vector", "W"}:
        value = np.asarray(inputs[name], np.float32)
        for axis in range(3 if name == "Vector" else 1):
            step = np.zeros_like(value)
            step[(..., axis) if name == "Vector" else ...] = digit / np.float32(inputs.get("Scale", 5.0))
            effect += np.abs(run_node(case.kind, case.output, {**inputs, name: value + step}, properties) - ours)
    return effect
