# SPDX-License-Identifier: GPL-3.0-or-later
"""Boundaries of media that lie in other surfaces: which are drawn apart, how far, and what a ray meets then."""

from __future__ import annotations

import numpy as np
import pytest

from engine.builder.boundaries import separate_boundaries, touching_boundaries
from engine.scene.description import Link
from tests.helpers.media_renders import picture
from tests.helpers.media_scenes import media_scene, medium, placed

#: Twice the relative error of a point, by which a ray may skip what it should meet.
SKIPPED = 2.0 * 28.0 * 2.0**-24


def turned(matrix):
    """A transform followed by a turn about an axis that is none of the coordinates'."""
    angle, axis = 0.7, np.array([1.0, 2.0, 3.0]) / np.sqrt(14.0)
    cross = np.cross(np.eye(3), axis)
    turn = np.eye(4)
    turn[:3, :3] += np.sin(angle) * -cross + (1.0 - np.cos(angle)) * cross @ cross
    return (turn @ matrix).astype(np.float32)


@pytest.mark.parametrize("place", [lambda matrix: matrix, turned])
def test_boxes_that_share_a_face_are_drawn_apart_and_others_are_not(place):
    inks = [medium("Absorption", name=f"Ink {k}") for k in range(4)]
    far = placed(offset=(0.0, 0.0, 40.0))
    overlapping = placed((0.5, 0.5, 0.5), (0.3, 0.2, 5.1))
    scene = media_scene(inks, [place(m) for m in (placed(), placed(offset=(2.0, 0.5, 0.0)), far, overlapping)])
    distances = touching_boundaries(scene, np.ones(4, bool))
    assert set(distances) == {0, 1} and len(set(distances.values())) == 2
    grown = separate_boundaries(scene, distances).instances
    for row, distance in distances.items():
        before, after = (
            np.abs(transform[row, :3, :3].astype(np.float64)).sum(axis=1)
            for transform in (scene.instances.transform, grown.transform)
        )
        assert (after - before).max() == pytest.approx(distance, rel=0.8)
        assert distance > SKIPPED
    assert np.array_equal(grown.transform[2:], scene.instances.transform[2:])
    assert touching_boundaries(scene, np.array([False, False, True, True])) == {}


def test_moving_boundaries_grow_at_all_times():
    scene = media_scene([medium("Absorption"), medium("Absorption")], [placed(), placed(offset=(0.0, 0.0, 2.0))])
    scene.instances.motion[1] = np.stack([placed(offset=(0.0, 0.0, z)) for z in (1.9, 2.1)])
    grown = separate_boundaries(scene, touching_boundaries(scene, np.ones(2, bool))).instances
    assert (grown.motion[1][:, 0, 0] == grown.transform[1, 0, 0]).all() and grown.transform[1, 0, 0] > 1.0
    assert scene.instances.transform[1, 0, 0] == 1.0


@pytest.mark.parametrize("size", [0.001, 1.0, 1000.0])
def test_light_is_dimmed_by_each_of_two_boxes_one_on_the_other(size):
    """A ray that missed where the second begins would be in the first for ever."""
    inks = [medium("Absorption", name=name, Color=(*color, 1.0), Density=0.5 / size)
            for name, color in (("Red", (1.0, 0.2, 0.5)), ("Blue", (0.1, 0.5, 1.0)))]  # fmt: skip
    boxes = [placed((size,) * 3, (0.0, 0.0, z * size)) for z in (-1.0, 1.0)]
    scene = media_scene(inks, boxes, height=10.0 * size)
    scene.camera.clip_start, scene.camera.clip_end = size, 100.0 * size
    image = picture(scene)
    expected = np.exp(-(1.0 - np.array([1.0, 0.2, 0.5])) - (1.0 - np.array([0.1, 0.5, 1.0])))
    assert np.allclose(image, expected, rtol=5e-4)


def test_a_box_of_ink_on_a_glowing_floor_hides_none_of_it():
    """A ray that met the boundary first would go on behind the floor."""
    ink = medium("Absorption", Color=(0.5, 0.2, 0.8, 1.0), Density=0.5)
    glow = medium("Absorption", "ShaderNodeEmission", name="Floor", Density=0.0)
    glow.graph.nodes[1].inputs.update({"Color": (1.0, 1.0, 1.0, 1.0), "Strength": 2.0})
    glow.graph.surface = Link(1, "Emission")
    scene = media_scene([ink, glow], [placed(), placed((9.0, 9.0, 1.0), (0.0, 0.0, -2.0))], world=(0.0, 0.0, 0.0))
    assert np.allclose(picture(scene), 2.0 * np.exp(-(1.0 - np.array([0.5, 0.2, 0.8]))), rtol=5e-4)
