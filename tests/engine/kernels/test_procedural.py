# SPDX-License-Identifier: GPL-3.0-or-later
"""Procedural textures where Cycles is no guide: limits on work, ranges, and inputs that are not numbers."""

from __future__ import annotations

import numpy as np
import pytest

from engine.shaders.nodes_patterns import NODES as PATTERNS
from engine.shaders.nodes_texture_math import NODES as TEXTURES
from tests.helpers.node_runner import run_node

NODES = TEXTURES | PATTERNS
_TEXTURES = [*sorted(kind for kind in NODES if kind.startswith("ShaderNodeTex")), "ShaderNodeRadialTiling"]


def _outputs(kind: str) -> list[str]:
    from engine.scene.description import Node
    from tests.helpers.node_runner import TableBuilder

    entry = NODES[kind]
    operation = entry(Node(kind, kind), TableBuilder()) if callable(entry) else entry
    return [socket.identifier for socket in operation.outputs]


@pytest.mark.parametrize("kind", _TEXTURES)
def test_strange_coordinates_stay_local(kind: str) -> None:
    """NaN, infinite and huge coordinates neither raise nor hang, nor disturb their neighbours."""
    ordinary = np.random.default_rng(3).uniform(-4.0, 4.0, (16, 3)).astype(np.float32)
    strange = np.repeat(ordinary, 2, axis=0)
    strange[1::2, 0] = np.tile(np.array((np.nan, np.inf, -np.inf, 3e38), np.float32), 4)
    for output in _outputs(kind):
        expected = run_node(kind, output, {"Vector": ordinary})
        np.testing.assert_array_equal(run_node(kind, output, {"Vector": strange})[::2], expected)


@pytest.mark.parametrize(
    ("kind", "output", "inputs"),
    [
        ("ShaderNodeTexNoise", "Fac", {}),
        ("ShaderNodeTexVoronoi", "Distance", {}),
        ("ShaderNodeTexWave", "Fac", {"Distortion": 2.0}),
    ],
)
def test_octaves_are_bounded(kind: str, output: str, inputs: dict[str, float]) -> None:
    points = np.random.default_rng(5).uniform(-4.0, 4.0, (8, 3)).astype(np.float32)
    many = run_node(kind, output, {"Vector": points, **inputs, "Detail": 1e9})
    np.testing.assert_array_equal(many, run_node(kind, output, {"Vector": points, **inputs, "Detail": 15.0}))


def test_noise_color_starts_with_fac() -> None:
    points = np.random.default_rng(7).uniform(-4.0, 4.0, (64, 3)).astype(np.float32)
    color = run_node("ShaderNodeTexNoise", "Color", {"Vector": points})
    np.testing.assert_array_equal(color[:, :1], run_node("ShaderNodeTexNoise", "Fac", {"Vector": points}))
    assert np.abs(np.corrcoef(color.T) - np.eye(3)).max() < 0.5  # three fields, not one three times


def test_white_noise_is_uniform() -> None:
    """Kolmogorov distance of 4096 values from the uniform distribution: 0.0255 is exceeded once in 100 seeds."""
    points = np.random.default_rng(11).uniform(-4.0, 4.0, (4096, 3)).astype(np.float32)
    values = np.sort(run_node("ShaderNodeTexWhiteNoise", "Value", {"Vector": points}).ravel())
    steps = (np.arange(4096) + 0.5) / 4096
    assert np.abs(values - steps).max() < 0.0255


@pytest.mark.parametrize(("sides", "width"), [(2.0, 0.0), (4.0, 1.0), (6.0, 3.0**-0.5)])
def test_width_of_a_straight_side(sides: float, width: float) -> None:
    """Half a side of a polygon about the unit circle; two sides have no end."""
    found = run_node("ShaderNodeRadialTiling", "Segment Width", {"Vector": np.ones((1, 3), np.float32), "Sides": sides})
    np.testing.assert_allclose(found, width, rtol=1e-6)


def test_width_of_a_round_side() -> None:
    inputs = {"Vector": np.ones((1, 3), np.float32), "Sides": 5.0, "Roundness": 1.0}
    found = run_node("ShaderNodeRadialTiling", "Segment Width", inputs)
    np.testing.assert_allclose(found, np.pi / 5.0, rtol=1e-6)
