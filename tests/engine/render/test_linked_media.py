# SPDX-License-Identifier: GPL-3.0-or-later
"""Which lamps light media, whose light media dim, and whom fire lights, where that can be worked out.

`tests/addon/test_parity.py` compares with Cycles.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from engine.scene.description import Light, Link, Material, Node, NodeGraph
from tests.helpers.linked_lights import no_linking
from tests.helpers.media_renders import picture
from tests.helpers.media_scenes import media_scene, medium, placed, varying, volume_graph

# Linked lights in media have kernels of their own, which take a minute to compile.
pytestmark = pytest.mark.slow

BLACK = (0.0, 0.0, 0.0)
#: A fog around all that the camera sees.
WIDE = placed((40.0, 40.0, 40.0))
FOG = {"Color": (0.8, 0.8, 0.8, 1.0), "Density": 0.05}
SIGMA = 0.4
FLOOR = Material(
    "Floor", "Floor",
    NodeGraph([Node("ShaderNodeBsdfDiffuse", "White", {"Color": (0.8, 0.8, 0.8, 1.0)})], Link(0, "BSDF")),
)
GROUND = placed((1.0, 1.0, 1.0), (0.0, 0.0, -1.0))


def lamp() -> Light:
    matrix = np.eye(4, dtype=np.float32)
    matrix[:3, 3] = 6.0, 0.0, 6.0
    return Light("lamp", "Lamp", "POINT", matrix, (1.0, 1.0, 1.0), 2000.0, radius=0.05)


def lit(scene, sets, receivers):
    """The scene with its instances in these sets, where its lamp lights those of these bits."""
    links = no_linking(len(sets), 1)
    scene.linking = replace(
        links, receiver_set=np.array(sets, np.int32), lamp_receivers=np.array([receivers], np.uint64)
    )
    return scene


def is_seen(scene):
    """Whether any light comes to the camera by one scattering."""
    return bool(picture(scene, max_bounces=0, volume_bounces=0, samples=64).max() > 0.0)


@pytest.mark.parametrize("varies", [False, True])
@pytest.mark.parametrize(("receivers", "is_lit"), [(0b01, False), (0b10, False), (0b11, True)])
def test_a_lamp_lights_the_world_s_fog_and_a_cloud_in_it_only_together(receivers, is_lit, varies):
    """As in Cycles; the world is in set 0. All that the camera sees lies in both."""
    inside = varying("Scatter", "Density", 0.1, Color=FOG["Color"]) if varies else medium("Scatter", **FOG)
    fog = volume_graph("Scatter", **FOG)
    scene = media_scene([inside, FLOOR], [WIDE, GROUND], lights=[lamp()], world=BLACK, fog=fog)
    assert is_seen(lit(scene, [1, 3], receivers)) == is_lit


@pytest.mark.parametrize(("receivers", "is_lit"), [(0b010, False), (0b100, False), (0b110, True)])
def test_a_lamp_lights_two_fogs_that_overlap_only_together(receivers, is_lit):
    fogs = [medium("Scatter", name=name, **FOG) for name in ("One", "Other")]
    scene = media_scene([*fogs, FLOOR], [WIDE, placed((41.0, 41.0, 41.0)), GROUND], lights=[lamp()], world=BLACK)
    assert is_seen(lit(scene, [1, 2, 3], receivers)) == is_lit


@pytest.mark.parametrize(("receivers", "share"), [(0b01, 1.0), (0b10, 0.0), (0b11, 1.0)])
def test_a_camera_sees_fire_that_lights_what_is_in_no_collection(receivers, share):
    """As in Cycles, where a fire that is linked to a ball alone is not seen."""
    glow = medium("Coefficients", **{
        "Absorption Coefficients": (0.5, 0.0, 2.0), "Scatter Coefficients": BLACK,
        "Emission Coefficients": (1.0, 2.0, 3.0),
    })  # fmt: skip
    other = medium("Absorption", name="Other", Density=1.0)
    scene = media_scene([glow, other], [placed(), placed(offset=(9.0, 9.0, 0.0))], world=BLACK)
    scene.linking = no_linking(2, 0)
    scene.linking.receiver_set[1], scene.linking.surface_receivers[0] = 1, receivers
    expected = [1.0 * (1.0 - np.exp(-1.0)) / 0.5, 2.0 * 2.0, 3.0 * (1.0 - np.exp(-4.0)) / 2.0]
    assert np.allclose(picture(scene), share * np.array(expected), rtol=5e-4)


def floor_under(transforms, blockers, *, varies=False):
    """What a camera sees of a floor: of media in these places, and of a lamp in whose light sets of bits dim it."""
    ink = medium("Absorption", Color=(0.0, 0.0, 0.0, 1.0), Density=SIGMA)
    if varies:
        ink = varying("Absorption", "Density", SIGMA, Color=(0.0, 0.0, 0.0, 1.0))
    scene = media_scene([FLOOR, *[ink] * len(transforms)], [GROUND, *transforms], lights=[lamp()], world=BLACK)
    links = no_linking(1 + len(transforms), 1)
    links.blocker_set[1:], links.lamp_blockers[0] = 1, blockers
    scene.linking = links
    return picture(scene, max_bounces=0, samples=64).mean()


@pytest.mark.parametrize("varies", [False, True])
def test_ink_dims_the_light_of_lamps_that_it_blocks_alone(varies):
    between = [placed((0.5, 1.0, 1.0), (3.0, 0.0, 3.0))]
    clear = floor_under([], 0b11)
    assert floor_under(between, 0b01, varies=varies) == pytest.approx(clear, rel=1e-4)
    dimmed = floor_under(between, 0b11, varies=varies) / clear
    if varies:
        assert dimmed < 0.95
    else:
        assert dimmed == pytest.approx(np.exp(-SIGMA * 2.0**0.5), rel=2e-3)


@pytest.mark.parametrize("blockers", [0b01, 0b11])
def test_what_lies_in_ink_is_lit_through_it_as_far_as_that_goes(blockers):
    around = [placed((2.0, 2.0, 2.0))]
    seen = floor_under(around, blockers) / floor_under([], 0b11)
    # 2 m to the camera, and as far as the boundary to the lamp.
    assert seen == pytest.approx(np.exp(-SIGMA * (2.0 + 2.0 * 2.0**0.5)), rel=2e-2)
