# SPDX-License-Identifier: GPL-3.0-or-later
"""How far around the camera no medium begins or ends: never too far, and not known where things move."""

from __future__ import annotations

import numpy as np
import pytest

from engine.builder.clearance import clear_distance
from engine.builder.scene import SceneCache, build_scene
from engine.settings import RenderSettings
from tests.helpers.media_scenes import media_scene, medium, placed, put_into_ball


def clear_at(point, description):
    scene = build_scene(description, RenderSettings(), SceneCache())
    return clear_distance(np.array(point), scene.geometry, scene.media.has_inside)


@pytest.mark.parametrize(
    ("point", "distance"),
    [((0.0, 0.0, 10.0), 9.0), ((4.0, 5.0, 0.0), 5.0), ((0.2, 0.0, 0.0), 0.8), ((0.0, 0.9, -0.5), 0.1)],
)
def test_outside_and_inside_of_a_box_it_is_a_little_less_than_the_distance(point, distance):
    found = clear_at(point, media_scene([medium("Scatter")], [placed()]))
    assert 0.95 * distance < found < distance


def test_the_nearest_of_several_boxes_counts_also_where_they_are_turned():
    turned = placed(offset=(5.0, 0.0, 0.0))
    cosine = np.sqrt(0.5)
    turned[:2, :2] = [[cosine, -cosine], [cosine, cosine]]
    scene = media_scene([medium("Scatter"), medium("Scatter")], [placed(offset=(0.0, 0.0, -9.0)), turned])
    # The corner of the box around the turned one holds the point, the turned one does not.
    point = (5.0 - 1.2, 1.2, 0.0)
    distance = (2.4 * cosine) - 1.0
    assert 0.9 * distance < clear_at(point, scene) < distance


def test_in_a_ball_it_is_the_distance_to_its_flat_faces():
    found = clear_at((0.0, 0.0, 0.1), put_into_ball(media_scene([medium("Scatter")], [placed()])))
    assert 0.8 < found < 0.9


def test_on_a_boundary_and_where_something_moves_nothing_is_known():
    scene = media_scene([medium("Scatter")], [placed()])
    assert clear_at((1.0, 0.3, 0.2), scene) == 0.0
    scene.instances.motion = {0: np.stack([placed(), placed(offset=(0.0, 0.0, 1.0))])}
    assert clear_at((0.0, 0.0, 10.0), scene) == 0.0
