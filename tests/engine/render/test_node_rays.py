# SPDX-License-Identifier: GPL-3.0-or-later
"""Nodes that trace rays, where what they find can be worked out on paper."""

from __future__ import annotations

import math

import numpy as np
import pytest

from engine.builder.scene import SceneCache, build_scene
from engine.kernels.disk_sampling import sample_cubic
from engine.scene.description import (
    VISIBLE_ALL,
    VISIBLE_CAMERA,
    VISIBLE_RAYCAST,
    VISIBLE_SHADOW,
    Link,
    Material,
    Node,
    NodeGraph,
)
from engine.settings import RenderSettings
from tests.helpers.media_renders import picture
from tests.helpers.media_scenes import media_scene, medium, placed
from tests.helpers.small_scenes import material

#: Between the top of the box that is seen and what hangs above it [m].
GAP = 1.0
SEEN = VISIBLE_ALL | VISIBLE_RAYCAST
#: What the camera does not see: it hangs between camera and box.
HANGING = placed((40.0, 40.0, 0.25), (0.0, 0.0, 1.25 + GAP))


def shown(kind, output, inputs=None, more=(), **properties):
    """A material that glows as bright as what a node gives; `more` are nodes that its inputs link to, from 2 on."""
    nodes = [
        Node("ShaderNodeEmission", "Emission", {"Color": Link(1, output), "Strength": 1.0}),
        Node(kind, "It", inputs or {}, properties),
        *more,
    ]
    return Material("Shown", "Shown", NodeGraph(nodes, Link(0, "Emission")))


def under_ceiling(seen, above=None, transforms=(placed(), HANGING)):
    """A box under another that hides all of the sky."""
    scene = media_scene([seen, above or material()], list(transforms))
    show_above(scene, SEEN & ~VISIBLE_CAMERA)
    return scene


def show_above(scene, visibility):
    """Let what hangs above be visible to these rays alone."""
    scene.instances.visibility[1:] = visibility


def mean(scene, **settings):
    return picture(scene, **{"samples": 16, **settings}).mean(axis=(0, 1))


def occlusion(inputs=None, **properties):
    return shown("ShaderNodeAmbientOcclusion", "AO", inputs, **{"samples": 16, **properties})


def is_near(value, expected, error):
    return np.abs(value - expected).max() <= error


@pytest.mark.parametrize("distance, expected", [(0.5, 1.0), (2.0, 0.25), (4.0, 0.0625), (1e9, 0.0)])
def test_occlusion_counts_what_is_near(distance, expected):
    """A plane at height h over a point takes the part 1 - (h / d)^2 of cosine-weighted rays of length d."""
    assert is_near(mean(under_ceiling(occlusion({"Distance": distance}))), expected, 0.01)


@pytest.mark.parametrize("distance", [-1.0, math.nan])
def test_without_distance_nothing_is_occluded(distance):
    assert is_near(mean(under_ceiling(occlusion({"Distance": distance})), samples=2), 1.0, 0.0)


def test_distance_0_means_the_worlds():
    scene = under_ceiling(occlusion({"Distance": 0.0}))
    scene.passes.occlusion_distance = 2.0
    assert is_near(mean(scene), 0.25, 0.01)
    linked = occlusion({"Distance": Link(2, "Value")}, more=[Node("ShaderNodeValue", "Value", {}, {"value": 0.0})])
    scene = under_ceiling(linked)
    scene.passes.occlusion_distance = 2.0
    assert is_near(mean(scene, samples=2), 1.0, 0.0)


@pytest.mark.parametrize("samples", [1, 128])
def test_any_number_of_samples_gives_the_same_mean(samples):
    assert is_near(mean(under_ceiling(occlusion({"Distance": 2.0}, samples=samples))), 0.25, 0.01)


def test_no_samples_occlude_nothing():
    assert is_near(mean(under_ceiling(occlusion({"Distance": 2.0}, samples=0)), samples=1), 1.0, 0.0)


def test_inside_and_only_local_look_at_the_object():
    """The box is 2 m deep, and wider than rays of 2.5 m from its middle see."""
    wide = (placed((40.0, 40.0, 1.0)), HANGING)
    inside = under_ceiling(occlusion({"Distance": 4.0}, inside=True), transforms=wide)
    assert is_near(mean(inside), 0.25, 0.01)
    local = under_ceiling(occlusion({"Distance": 4.0}, inside=True, only_local=True), transforms=wide)
    assert is_near(mean(local), 0.25, 0.01)
    outside = under_ceiling(occlusion({"Distance": 4.0}, only_local=True), transforms=wide)
    assert is_near(mean(outside, samples=2), 1.0, 0.0)


def test_the_normal_turns_the_hemisphere():
    """About a normal along the plane half of the rays go up."""
    sideways = occlusion(
        {"Distance": 1e6, "Normal": Link(2, "Vector")},
        more=[Node("ShaderNodeCombineXYZ", "Sideways", {"X": 3.0, "Y": 0.0, "Z": 0.0})],
    )
    scene = under_ceiling(sideways, transforms=(placed((40.0, 40.0, 1.0)), placed((1e4, 1e4, 0.25), (0.0, 0.0, 2.25))))
    # Rays below the surface meet the bottom of the box.
    assert is_near(mean(scene), 0.0, 0.01)
    show_above(scene, SEEN & ~VISIBLE_CAMERA & ~VISIBLE_SHADOW)
    assert is_near(mean(scene), 0.5, 0.01)


def test_the_color_is_shaded():
    inputs = {"Color": (0.8, 0.4, 0.2, 1.0), "Distance": 2.0}
    scene = under_ceiling(shown("ShaderNodeAmbientOcclusion", "Color", inputs))
    assert is_near(mean(scene), np.array([0.2, 0.1, 0.05]), 0.01)


def test_what_is_clear_occludes_as_in_cycles():
    clear = material("Clear", (1.0, 1.0, 1.0), "ShaderNodeBsdfTransparent")
    assert is_near(mean(under_ceiling(occlusion({"Distance": 2.0}), clear)), 0.25, 0.01)
    assert is_near(mean(under_ceiling(occlusion({"Distance": 2.0}), medium("Scatter", Density=1e-9))), 0.25, 0.01)


def normals(radius, place=placed(), **inputs):
    """Mean normal that a Bevel node gives in the middle of the picture of a box's top."""
    plus = Node(
        "ShaderNodeVectorMath", "Plus", {"Vector": Link(2, "Normal"), "Vector_001": (1.0, 1.0, 1.0)},
        {"operation": "ADD"},
    )  # fmt: skip
    node = Node("ShaderNodeBevel", "Bevel", {"Radius": radius, **inputs}, {"samples": 8})
    nodes = [Node("ShaderNodeEmission", "E", {"Color": Link(1, "Vector"), "Strength": 1.0}), plus, node]
    scene = media_scene([Material("Bevel", "Bevel", NodeGraph(nodes, Link(0, "Emission")))], [place])
    scene.camera.lens = 2e5  # a picture of 1.6 mm
    return mean(scene) - 1.0


@pytest.mark.parametrize("radius", [0.0, -1.0, math.nan, math.inf, 0.5])
def test_nothing_is_rounded_away_from_edges(radius):
    assert is_near(normals(radius), np.array([0.0, 0.0, 1.0]), 1e-5)


def test_edges_are_rounded():
    """At an edge both faces count for as much; far within one of them it counts alone."""
    at_edge = normals(0.5, placed(offset=(-0.999, 0.0, 0.0)))
    assert abs(at_edge[0] - at_edge[2]) < 0.03 and at_edge[0] > 0.6 and abs(at_edge[1]) < 0.01
    near = normals(0.5, placed(offset=(-0.75, 0.0, 0.0)))
    assert 0.0 < near[0] < at_edge[0] and near[2] > at_edge[2]
    assert is_near(normals(0.5, placed(offset=(-0.4, 0.0, 0.0))), np.array([0.0, 0.0, 1.0]), 1e-5)


def test_a_radius_beyond_all_sense_is_finite():
    assert np.isfinite(normals(1e9)).all()


def raycast(output, inputs=None, **properties):
    return shown("ShaderNodeRaycast", output, inputs, **properties)


@pytest.mark.parametrize("output, expected", [
    ("Is Hit", (1.0, 1.0, 1.0)), ("Self Hit", (0.0, 0.0, 0.0)), ("Hit Distance", (GAP, GAP, GAP)),
])  # fmt: skip
def test_a_ray_says_what_it_has_met(output, expected):
    assert is_near(mean(under_ceiling(raycast(output, {"Length": 5.0})), samples=1), np.array(expected), 1e-4)


@pytest.mark.parametrize("inputs", [{"Length": 0.9}, {"Length": -1.0}, {"Length": math.nan}])
def test_a_ray_that_meets_nothing(inputs):
    assert is_near(mean(under_ceiling(raycast("Is Hit", inputs)), samples=1), 0.0, 0.0)


def test_rays_meet_what_they_are_let_see():
    scene = under_ceiling(raycast("Is Hit", {"Length": 5.0}))
    show_above(scene, VISIBLE_RAYCAST)
    assert is_near(mean(scene, samples=1), 1.0, 0.0)
    show_above(scene, VISIBLE_SHADOW)
    assert is_near(mean(scene, samples=1), 0.0, 0.0)


def test_a_ray_through_the_object_itself():
    down = [Node("ShaderNodeCombineXYZ", "Down", {"X": 0.0, "Y": 0.0, "Z": -0.5})]
    for only_local in (False, True):
        for output, expected in (("Self Hit", 1.0), ("Hit Distance", 4.0), ("Hit Normal", np.array([0.0, 0.0, 1.0]))):
            seen = raycast(output, {"Direction": Link(2, "Vector"), "Length": 9.0}, more=down, only_local=only_local)
            assert is_near(mean(under_ceiling(seen), samples=1), expected, 1e-4)
    seen = raycast("Is Hit", {"Length": 5.0}, only_local=True)
    assert is_near(mean(under_ceiling(seen), samples=1), 0.0, 0.0)


def test_any_number_of_threads_gives_the_same_picture():
    scene = under_ceiling(occlusion({"Distance": 2.0}, samples=3))
    pictures = [picture(scene, threads=threads, samples=8) for threads in (1, 2)]
    np.testing.assert_array_equal(*pictures)


def test_only_what_traces_is_marked():
    def traces(*materials):
        scene = build_scene(media_scene(list(materials), [placed()] * len(materials)), RenderSettings(), SceneCache())
        return scene.traces, len(scene.local_scenes.handles) > 0, scene.has_subsurface

    assert traces(material()) == (False, False, False)
    assert traces(material(), occlusion()) == (True, False, False)
    assert traces(occlusion(only_local=True)) == (True, True, False)
    assert traces(shown("ShaderNodeWireframe", "Fac")) == (False, False, False)


def test_distances_have_the_cubic_profile():
    """Of the profile (1 - r)^3 over a disk the part 10 r^2 - 20 r^3 + 15 r^4 - 4 r^5 lies within r."""
    for u in np.linspace(0.0, 0.999, 60, dtype=np.float32):
        r = float(sample_cubic(u))
        assert 0.0 <= r <= 1.0
        assert abs(10.0 * r**2 - 20.0 * r**3 + 15.0 * r**4 - 4.0 * r**5 - u) < 2e-5
