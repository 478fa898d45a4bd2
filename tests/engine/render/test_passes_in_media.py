# SPDX-License-Identifier: GPL-3.0-or-later
"""Passes of surfaces that are seen through media, against Beer's law."""

import numpy as np
import pytest

from engine.render.session import Session
from engine.scene.description import World
from engine.settings import RenderSettings
from tests.helpers.media_scenes import media_scene, medium, placed, volume_graph
from tests.helpers.small_scenes import floor_scene, material

pytestmark = pytest.mark.estimator

#: Of the medium, for each channel [m^-1].
EXTINCTION = 0.02 * (1.0 - np.array([0.0, 0.5, 0.9]))
ALBEDO = np.array([0.6, 0.3, 0.9])


def floor_in_ink():
    """A floor 10 m below the camera, in a world that absorbs."""
    ink = volume_graph("Absorption", Color=(0.0, 0.5, 0.9, 1.0), Density=0.02)
    description = floor_scene(materials=[material(color=ALBEDO)], world=World("ink", "Ink", ink), size=(8, 8))
    description.camera.lens = 2000.0
    return description


def render(description, passes, **settings):
    session = Session(RenderSettings(**{"samples": 16, "threads": 1, "guiding_method": "OFF", **settings}))
    session.load(description)
    images = session.render(passes=passes).passes
    session.close()
    return images


def test_the_color_of_a_surface_is_that_which_the_medium_leaves():
    color = render(floor_in_ink(), ("Combined", "Diffuse Color"))["Diffuse Color"]
    # The clip distance of 0.1 m is empty.
    assert np.allclose(color, ALBEDO * np.exp(-9.9 * EXTINCTION), rtol=2e-4)


def test_rays_of_ambient_occlusion_are_dimmed_on_their_way():
    description = floor_in_ink()
    description.passes.occlusion_distance = 25.0
    occlusion = render(description, ("Combined", "Ambient Occlusion"))["Ambient Occlusion"]
    assert np.allclose(occlusion, np.exp(-(9.9 + 25.0) * EXTINCTION), rtol=2e-4)


def test_what_a_medium_emits_is_albedo_for_denoisers():
    glow = medium("Coefficients", **{
        "Absorption Coefficients": (0.5, 0.25, 1.0), "Scatter Coefficients": (0.0, 0.0, 0.0),
        "Emission Coefficients": (0.3, 0.2, 0.1),
    })  # fmt: skip
    images = render(media_scene([glow], [placed()], world=(0.0, 0.0, 0.0)), ("Combined", "Denoising Albedo"))
    assert images["Combined"][..., :3].min() > 0.0
    assert np.allclose(images["Denoising Albedo"], images["Combined"][..., :3], rtol=1e-4)
