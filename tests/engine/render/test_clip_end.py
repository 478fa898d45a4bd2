# SPDX-License-Identifier: GPL-3.0-or-later
"""The camera sees no farther than its clip end, behind what is transparent and behind media too."""

from __future__ import annotations

import numpy as np
import pytest

from tests.helpers.media_renders import picture
from tests.helpers.media_scenes import media_scene, medium, placed
from tests.helpers.small_scenes import material

pytestmark = pytest.mark.estimator

SKY, RED = (0.5, 0.5, 0.5), (1.0, 0.0, 0.0)


@pytest.mark.parametrize("kind", ["transparent", "medium", "both"])
@pytest.mark.parametrize(("clip_end", "expected"), [(12.0, SKY), (14.9, SKY), (15.1, RED)])
def test_what_lies_beyond_the_clip_end_is_not_seen(kind, clip_end, expected):
    """A box from 9 m to 11 m, then one that shines red from 15 m on."""
    clear = material("Clear", (1.0, 1.0, 1.0), "ShaderNodeBsdfTransparent")
    thin = medium("Absorption", Density=1e-6)
    red = material("Red", RED, "ShaderNodeEmission")
    boxes = {"transparent": [clear], "medium": [thin], "both": [clear, thin]}[kind]
    places = [placed(), placed((2.0, 2.0, 0.5))][: len(boxes)]
    scene = media_scene([*boxes, red], [*places, placed(offset=(0.0, 0.0, -6.0))], world=SKY)
    scene.camera.clip_end = clip_end
    assert np.allclose(picture(scene), expected, atol=1e-4)
