# SPDX-License-Identifier: GPL-3.0-or-later
"""The background's radiance by direction."""

from __future__ import annotations

import numpy as np

import tests.helpers.light_probe as probe
from engine.builder.programs import compile_scene
from engine.kernels.bsdf import load_tables
from engine.scene.description import Link, Node, NodeGraph, World

_SKY = NodeGraph(
    [
        Node("ShaderNodeTexCoord", "Coordinates"),
        Node("ShaderNodeTexGradient", "Gradient", {"Vector": Link(0, "Generated")}),
        Node("ShaderNodeBackground", "Background", {"Color": Link(1, "Color"), "Strength": 3.0}),
    ],
    Link(2, "Background"),
)


def test_the_background_is_the_same_for_any_number_of_threads() -> None:
    """Directions of 4.25 batches, so that the last thread of three has less to do."""
    description = probe.make_description(world=World("w", "World", _SKY))
    programs = compile_scene(description)
    _, geometry = probe.build(description)
    grids = [programs.background_grid(132, geometry, load_tables(), threads) for threads in (1, 3, 64)]
    assert grids[0].shape == (66, 132, 3) and grids[0].min() >= 0.0 and grids[0].std() > 0.1
    assert all(np.array_equal(grid, grids[0]) for grid in grids[1:])
