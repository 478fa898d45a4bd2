# SPDX-License-Identifier: GPL-3.0-or-later
"""Light through many transparent surfaces: as many as a search keeps, more, and more than are allowed."""

from __future__ import annotations

import numpy as np
import pytest

from engine.accel.ray_words import MOST_PASSED
from engine.render.session import Session
from engine.scene.description import Link, Material, Node, NodeGraph
from engine.scene.instances import plain_instances
from engine.settings import RenderSettings
from tests.helpers.placed_quads import at
from tests.helpers.small_scenes import floor_scene, material, sun

pytestmark = pytest.mark.estimator

THROUGH = 0.97


def cut():
    """What lets the same share of light through everywhere, by a program that has to be run there."""
    checker = Node(
        "ShaderNodeTexChecker", "Checker",
        {"Scale": 0.3, "Color1": (THROUGH, THROUGH, THROUGH, 1.0), "Color2": (THROUGH, THROUGH, THROUGH, 1.0)},
    )
    clear = Node("ShaderNodeBsdfTransparent", "Cut", {"Color": Link(0, "Color")})
    return Material("Cut", "Cut", NodeGraph([checker, clear], Link(1, "BSDF")))


def mean_below(sheet_count, sheet, most=64):
    """How bright a floor is in the middle that lies below sheets, in no order by height."""
    description = floor_scene(lights=[sun()], materials=[material(), sheet], size=(8, 8))
    heights = 20.0 + 0.01 * np.random.default_rng(3).permutation(sheet_count)
    sheets = [at(0.0, 0.0, height) for height in heights]
    description.instances = plain_instances(np.stack([np.eye(4), *sheets]).astype(np.float32), name="Part")
    description.instances.material_offset = np.array([0] + [1] * sheet_count, np.int32)
    description.instances.materials = np.array([0, 1], np.int32)
    session = Session(RenderSettings(samples=2, threads=1, max_bounces=0, transparent_max_bounces=most))
    session.load(description)
    result = session.render()
    session.close()
    return float(result.passes["Combined"][3:5, 3:5, 1].mean()), result.report.rays["transparent_shadow"]


@pytest.mark.parametrize(
    "sheet", [material("Tinted", (THROUGH,) * 3, "ShaderNodeBsdfTransparent"), cut()], ids=["constant", "program"]
)
def test_every_sheet_dims_light_once(sheet):
    bare, _ = mean_below(0, sheet)
    assert bare > 0.0
    for count in (1, 7, MOST_PASSED):
        light, second_looks = mean_below(count, sheet)
        assert light / bare == pytest.approx(THROUGH**count, rel=1e-4)
        assert second_looks == 0
    light, second_looks = mean_below(MOST_PASSED + 9, sheet)
    assert light / bare == pytest.approx(THROUGH ** (MOST_PASSED + 9), rel=1e-4)
    assert second_looks > 0


def test_one_sheet_more_than_is_allowed_hides_the_light():
    sheet = material("Tinted", (THROUGH,) * 3, "ShaderNodeBsdfTransparent")
    assert mean_below(5, sheet, most=5)[0] > 0.0
    assert mean_below(6, sheet, most=5)[0] == 0.0
