# SPDX-License-Identifier: GPL-3.0-or-later
"""Fast GI Approximation where its light can be worked out on paper: floors of albedo 0.5 under a white sky."""

from __future__ import annotations

import numpy as np
import pytest

from engine.render.session import Session
from engine.scene.description import Link, Node, World
from engine.scene.fast_gi import FastGi
from engine.settings import RenderSettings
from tests.helpers.media_scenes import volume_graph
from tests.helpers.small_scenes import floor_scene, material

pytestmark = pytest.mark.estimator

#: A wall of 50 m at y = 3 m.
WALL = np.array([[1, 0, 0, 0], [0, 0, -1, 3], [0, 1, 0, 0], [0, 0, 0, 1]], np.float32)
ALBEDO = 0.5


def scene_of(fast_gi, *, transforms=None, materials=None, has_sky=True, distance=10.0):
    scene = floor_scene(transforms=transforms, materials=materials, size=(16, 16))
    scene.world = World("world", "World", None, (1.0, 1.0, 1.0)) if has_sky else None
    scene.fast_gi, scene.passes.occlusion_distance = fast_gi, distance
    return scene


def render(scene, passes=("Combined",), **settings):
    session = Session(RenderSettings(**{"samples": 4, "threads": 1, **settings}))
    session.load(scene)
    result = session.render(passes=passes)
    session.close()
    return result


def picture(scene, **settings):
    return render(scene, **settings).passes["Combined"][..., :3]


def is_on_floor(scene):
    """Which pixels show the floor well before the wall, and how far from the wall they are."""
    position = render(scene, ("Combined", "Position")).passes["Position"]
    distance = 3.0 - position[..., 1]
    return (np.abs(position[..., 2]) < 1e-3) & (distance > 1.2), distance


def test_short_rays_see_their_share_of_the_background() -> None:
    assert picture(scene_of(FastGi(1, 0.3))) == pytest.approx(0.3 * ALBEDO, rel=1e-5)
    # Rays of the first two bounces are as ever.
    assert picture(scene_of(FastGi(2, 0.3))) == pytest.approx(ALBEDO, rel=1e-5)
    # The camera's rays are never short, nor are those that pass through what it sees first.
    clear = [material("Clear", (1.0, 1.0, 1.0), "ShaderNodeBsdfTransparent")]
    assert picture(scene_of(FastGi(1, 0.3), materials=clear)) == pytest.approx(1.0, rel=1e-5)


def test_one_glossy_reflection_does_not_count() -> None:
    mirror = [material("Mirror", (0.8, 0.8, 0.8), "ShaderNodeBsdfAnisotropic")]
    assert picture(scene_of(FastGi(1, 0.3), materials=mirror)) == pytest.approx(0.8, rel=1e-4)


def test_what_is_far_hides_nothing_and_objects_say_themselves_how_far() -> None:
    """At its own distance of 100 m the floor sees the wall, from which nothing comes: paths end there."""
    scene = scene_of(FastGi(1, 1.0), transforms=[np.eye(4), WALL], distance=1.0)
    on_floor, distance = is_on_floor(scene)
    assert on_floor.sum() > 50
    assert picture(scene)[on_floor] == pytest.approx(ALBEDO, rel=1e-5)
    scene.instances.occlusion_distance = np.array([100.0, 0.0], np.float32)
    free = 0.5 * (1.0 + distance[on_floor] / np.hypot(distance[on_floor], 50.0))
    shown = picture(scene, samples=64)[on_floor].mean(axis=-1)
    assert shown.mean() == pytest.approx(ALBEDO * free.mean(), abs=0.005)


def test_short_rays_find_what_glows_near_and_nothing_of_what_is_far() -> None:
    glow = material("Glow", (1.0, 1.0, 1.0), "ShaderNodeEmission")
    scene = scene_of(FastGi(1, 1.0), transforms=[np.eye(4), WALL], materials=[material(), glow], distance=1.0)
    scene.instances.material_offset = np.array([0, 1], np.int32)
    scene.instances.materials = np.array([0, 1], np.int32)
    on_floor, distance = is_on_floor(scene)
    # By scattering alone, so that no light sample finds the wall.
    assert picture(scene, use_nee=False)[on_floor] == pytest.approx(ALBEDO, rel=1e-5), "the sky behind the wall"
    scene.world = None
    assert not picture(scene, use_nee=False)[on_floor].any()
    scene.passes.occlusion_distance = 100.0
    hidden = 0.5 * (1.0 - distance[on_floor] / np.hypot(distance[on_floor], 50.0))
    shown = picture(scene, use_nee=False, samples=64)[on_floor].mean(axis=-1)
    assert shown.mean() == pytest.approx(ALBEDO * hidden.mean(), abs=0.01)


def test_media_go_on_behind_the_end_of_short_rays() -> None:
    """As in Cycles, for which a ray that meets nothing has no end: of the sky nothing is left."""
    scene = scene_of(FastGi(1, 1.0))
    ink = volume_graph("Absorption", Color=(0.0, 0.5, 0.9, 1.0), Density=0.02)
    ink.nodes.append(Node("ShaderNodeBackground", "Background", {"Color": (1.0, 1.0, 1.0, 1.0), "Strength": 1.0}))
    ink.surface = Link(1, "Background")
    scene.world = World("ink", "Ink", ink)
    assert picture(scene) == pytest.approx(0.0, abs=1e-6)


def test_added_light_is_white_and_comes_at_every_bounce() -> None:
    """A floor that sees nothing but the sky has one bounce; nothing else gives light."""
    colors = [material(color=(0.6, 0.3, 0.1))]
    shown = picture(scene_of(FastGi(added=0.7), materials=colors, has_sky=False))
    assert np.allclose(shown, 0.7 * np.array([0.6, 0.3, 0.1]), rtol=1e-5)
    dark = scene_of(FastGi(added=0.7), transforms=[np.eye(4), WALL], has_sky=False)
    first, all_of_them = picture(dark, max_bounces=0, samples=16), picture(dark, samples=16)
    assert all_of_them.mean() > 1.02 * first.mean()


@pytest.mark.slow  # compiles stages for wavelengths
@pytest.mark.parametrize(("fast_gi", "expected"), [(FastGi(1, 0.3), 0.3), (FastGi(added=0.7), 1.7)])
def test_it_is_the_same_with_wavelengths(fast_gi: FastGi, expected: float) -> None:
    colors = [material(color=(0.6, 0.3, 0.1))]
    shown = picture(scene_of(fast_gi, materials=colors), spectral="ON", samples=64).mean(axis=(0, 1))
    assert shown == pytest.approx(expected * np.array([0.6, 0.3, 0.1]), rel=0.02)


def test_added_light_is_what_is_free_of_the_hemisphere_and_in_no_pass_but_the_picture() -> None:
    scene = scene_of(FastGi(added=0.7), transforms=[np.eye(4), WALL], has_sky=False, distance=5.0)
    names = ("Combined", "Ambient Occlusion", "Diffuse Direct", "Diffuse Indirect")
    images = render(scene, names, max_bounces=0).passes
    free = images["Ambient Occlusion"]
    assert free.min() < 0.9 < free.max()
    assert np.allclose(images["Combined"][..., :3], 0.7 * ALBEDO * free, rtol=1e-4, atol=1e-5)
    assert not images["Diffuse Direct"].any() and not images["Diffuse Indirect"].any()


@pytest.mark.parametrize("limit", [0.0, 0.5])
def test_added_light_is_clamped_before_the_surface_weighs_it(limit: float) -> None:
    shown = picture(scene_of(FastGi(added=4.0), has_sky=False), clamp_direct=limit)
    assert shown == pytest.approx(4.0 * ALBEDO * (limit or 1.0), rel=1e-5)
