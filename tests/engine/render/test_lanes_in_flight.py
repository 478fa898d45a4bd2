# SPDX-License-Identifier: GPL-3.0-or-later
"""How many paths are in flight at once changes when they are traced, and nothing in the picture."""

from __future__ import annotations

import numpy as np

from engine.render import tracer
from engine.render.batch import LANES_AMONG_STRANDS
from engine.render.session import Session
from engine.scene.description import Frame
from engine.scene.rounds import RIBBONS
from engine.settings import RenderSettings
from engine.state.lanes import LANE_COUNT
from tests.helpers.fur_scenes import fur_scene
from tests.helpers.small_scenes import floor_scene, sun


def rendered(description):
    """Picture, and the most rays that a stage has traced at once."""
    description.frame = Frame(32, 32, (0, 0, 32, 32))
    session = Session(RenderSettings(samples=4, threads=1, max_bounces=3))
    session.load(description)
    counts = []
    session.render(ray_observer=lambda kind, first, second, count: counts.append(count))
    picture = session.render().passes["Combined"]
    session.close()
    return picture, max(counts)


def test_fewer_paths_are_in_flight_among_strands_and_the_picture_is_the_same(monkeypatch):
    few, at_once = rendered(fur_scene(RIBBONS))
    assert at_once == LANES_AMONG_STRANDS
    monkeypatch.setattr(tracer, "LANES_AMONG_STRANDS", LANE_COUNT)
    many, at_once = rendered(fur_scene(RIBBONS))
    assert at_once > LANES_AMONG_STRANDS
    assert few[..., :3].std() > 0.0
    # The order in which a pixel's samples are added is another.
    assert np.allclose(few, many, rtol=1e-5, atol=1e-6)


def test_other_scenes_have_all_lanes():
    assert rendered(floor_scene(lights=[sun()], size=(32, 32)))[1] > LANES_AMONG_STRANDS
