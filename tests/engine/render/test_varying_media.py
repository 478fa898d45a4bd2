# SPDX-License-Identifier: GPL-3.0-or-later
"""Media that vary in space against what can be worked out: Beer's law, furnaces, emission, lamps and shadows.

Statistical tests have fixed seeds and reject at 4 standard errors, which a correct renderer fails once in 15,000;
`is_mean` once in 1,000.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy import integrate

from engine.builder import media as media_builder
from engine.scene.description import Light, Link, Material, Node, NodeGraph
from tests.helpers.media_renders import SIGMAS, is_mean, means_by_seed, picture, render
from tests.helpers.media_scenes import box_of_voxels, let_voxels_move, media_scene, medium, placed, varying

pytestmark = pytest.mark.estimator

COLOR = np.array([0.5, 0.2, 0.8])


def ink(factor=1.0, **settings):
    """Absorption that grows with the height above the middle of the object; nothing is below."""
    return varying("Absorption", "Density", factor, Color=(*COLOR, 1.0), **settings)


def test_absorption_follows_beers_law_with_the_density_along_the_ray():
    # Twice as large: 2 m of a density from 0 to 1.5.
    means = means_by_seed(media_scene([ink(1.5)], [placed((2.0, 2.0, 2.0))], height=20.0), seeds=4, samples=64)
    expected = np.exp(-0.5 * 2.0 * 1.5 * (1.0 - COLOR))
    assert is_mean(means, expected)
    assert not is_mean(1.02 * means, expected)


@pytest.mark.slow
def test_varying_media_add_up_with_each_other_and_with_uniform_ones():
    grey = medium("Absorption", name="Grey", Color=(0.0, 0.0, 0.0, 1.0), Density=0.25)
    other = varying("Absorption", "Density", -0.8, name="Other", Color=(0.3, 0.3, 0.3, 1.0))
    scene = media_scene([ink(), grey, other], [placed(), placed((0.5, 0.5, 0.5)), placed((0.7, 0.7, 0.7))])
    expected = np.exp(-(0.5 * (1.0 - COLOR) + 0.25 + 0.5 * 0.7 * 0.8 * 0.7))
    assert is_mean(means_by_seed(scene, samples=64), expected)


@pytest.mark.slow
def test_a_camera_inside_and_a_world_whose_fog_varies():
    # 0.9 m of the upper half, from the clip distance of 0.1 m on.
    inside = media_scene([ink(2.0, space="World")], [placed((4.0, 4.0, 4.0))], height=1.0)
    assert is_mean(means_by_seed(inside, samples=64), np.exp(-2.0 * 0.5 * 0.9**2 * (1.0 - COLOR)))
    fog = ink(0.01, space="World").graph
    world = media_scene([], np.zeros((0, 4, 4)), fog=fog)
    assert is_mean(means_by_seed(world, samples=64), np.exp(-0.01 * 0.5 * 9.9**2 * (1.0 - COLOR)))


@pytest.mark.slow
def test_with_wavelengths_the_furnace_is_as_if_nothing_were_there():
    """Every path has its wavelengths, of which one alone is no white: the same paths are compared."""
    fog = varying("Scatter", "Density", 2.0, Color=(1.0, 0.4, 0.1, 1.0), Anisotropy=0.4)
    settings = {"volume_bounces": 1024, "max_bounces": 1024, "samples": 64, "spectral": "ON"}
    empty = picture(media_scene([], np.zeros((0, 4, 4))), **settings)
    image = picture(media_scene([fog], [placed()]), **settings)
    assert np.allclose(image.mean(axis=(0, 1)), empty.mean(axis=(0, 1)), atol=0.02)


@pytest.mark.parametrize("density", [0.5, 8.0])
def test_what_scatters_all_light_is_not_seen_in_a_white_furnace(density):
    fog = varying("Scatter", "Density", density, Color=(1.0, 1.0, 1.0, 1.0), Anisotropy=0.4)
    image = picture(media_scene([fog], [placed()]), volume_bounces=1024, max_bounces=1024, samples=16)
    assert np.allclose(image, 1.0, atol=1e-4)


def test_nor_is_a_layer_of_fog_that_fills_the_world():
    """As dense as 1.5 times what the square of the height leaves of 1."""

    def math(name, operation, first, second):
        return Node("ShaderNodeMath", name, {"Value": first, "Value_001": second}, {"operation": operation})

    nodes = [
        Node("ShaderNodeVolumeScatter", "Fog", {"Color": (1.0, 1.0, 1.0, 1.0), "Density": Link(1, "Value")}),
        math("Times", "MULTIPLY", Link(2, "Value"), 1.5), math("Positive", "MAXIMUM", Link(3, "Value"), 0.0),
        math("Rest", "SUBTRACT", 1.0, Link(4, "Value")), math("Square", "MULTIPLY", Link(5, "Z"), Link(5, "Z")),
        Node("ShaderNodeSeparateXYZ", "Separate", {"Vector": Link(6, "Position")}),
        Node("ShaderNodeNewGeometry", "Place"),
    ]  # fmt: skip
    scene = media_scene([], np.zeros((0, 4, 4)), fog=NodeGraph(nodes, None, Link(0, "Volume")))
    image = picture(scene, volume_bounces=1024, max_bounces=1024, samples=16)
    assert np.allclose(image, 1.0, atol=1e-4)


def test_channels_of_different_density_are_unbiased_in_a_furnace():
    """One bound serves all channels, and what is left of each is divided by one probability: a wrong one shows."""
    fog = varying("Scatter", "Density", 3.0, Color=(0.2, 1.0, 5.0, 1.0), Anisotropy=-0.5)
    # What the colour has above white is scattered all the same: coefficients are colour times density.
    means = means_by_seed(media_scene([fog], [placed()]), volume_bounces=1024, max_bounces=1024, samples=64)
    assert is_mean(means, np.ones(3))
    assert not is_mean(1.02 * means, np.ones(3))


def test_emission_is_collected_along_the_ray():
    """A black body's emission does not hang on density, so the ray must look where there is nothing else."""
    nodes = [
        Node("ShaderNodeEmission", "Glow", {"Color": (1.0, 2.0, 3.0, 1.0), "Strength": Link(1, "Z")}),
        Node("ShaderNodeSeparateXYZ", "Separate", {"Vector": Link(2, "Object")}), Node("ShaderNodeTexCoord", "Place"),
    ]  # fmt: skip
    glow = Material("Glow", "Glow", NodeGraph(nodes, None, Link(0, "Emission")))
    grey = medium("Absorption", name="Grey", Color=(0.0, 0.0, 0.0, 1.0), Density=0.5)
    scene = media_scene([glow, grey], [placed(), placed((1.5, 1.5, 1.5))], world=(0.0, 0.0, 0.0))
    # Over z from 1 down to 0, behind what lies above: z exp(-0.5 (1.5 - z)).
    z = np.linspace(0.0, 1.0, 20_001)
    expected = integrate.trapezoid(z * np.exp(-0.5 * (1.5 - z)), z) * np.array([1.0, 2.0, 3.0])
    means = means_by_seed(scene, samples=256)
    assert is_mean(means, expected)
    assert not is_mean(1.02 * means, expected)


def test_a_lamp_is_seen_through_what_lies_before_it():
    upwards = np.diag([1.0, -1.0, -1.0, 1.0]).astype(np.float32)
    upwards[2, 3] = -3.0
    lamp = Light("lamp", "Lamp", "AREA", upwards, (1.0, 1.0, 1.0), 100.0, size_x=2.0)
    behind = upwards.copy()
    behind[2, 3] = 0.25
    middle = Light("middle", "Middle", "AREA", behind, (1.0, 1.0, 1.0), 50.0, size_x=2.0)
    clear = picture(media_scene([], np.zeros((0, 4, 4)), lights=[lamp], world=(0.0, 0.0, 0.0))).mean(axis=(0, 1))
    scene = media_scene([ink(3.0)], [placed()], lights=[lamp, middle], world=(0.0, 0.0, 0.0))
    expected = clear * (
        np.exp(-1.5 * (1.0 - COLOR)) + 0.5 * np.exp(-1.5 * (1.0 - 0.25**2) * (1.0 - COLOR))
    )
    assert is_mean(means_by_seed(scene, samples=256), expected)


def test_distances_are_drawn_as_the_density_along_the_ray_says():
    """What a lamp beside the ray sends back, scattered once: it weighs every distance by another amount."""
    factor, energy, lamp_height = 2.0, 100.0, 4.0
    fog = varying("Scatter", "Density", factor, Color=(1.0, 1.0, 1.0, 1.0))
    lamp = Light("lamp", "Lamp", "POINT", placed(offset=(1.0, 0.0, lamp_height)), (1.0, 1.0, 1.0), energy)
    scene = media_scene([fog], [placed((3.0, 3.0, 1.0))], lights=[lamp], world=(0.0, 0.0, 0.0))

    def arriving(z):
        length = np.hypot(lamp_height - z, 1.0)
        above = 0.5 * factor * (1.0 - z * z)
        return factor * z * np.exp(-above * (1.0 + length / (lamp_height - z))) / length**2

    expected = energy / (4.0 * np.pi) / (4.0 * np.pi) * integrate.quad(arriving, 0.0, 1.0)[0]
    means = means_by_seed(scene, volume_bounces=0, samples=256)
    assert is_mean(means, np.full(3, expected))
    assert not is_mean(1.02 * means, np.full(3, expected))


@pytest.mark.slow
def test_light_sampling_and_scattering_alone_agree():
    fog = varying("Scatter", "Density", 2.0, Color=(0.9, 0.5, 0.2, 1.0), Anisotropy=0.3)
    lamp = Light("lamp", "Lamp", "AREA", placed(offset=(0.0, 0.0, 3.0)), (1.0, 1.0, 1.0), 100.0, size_x=4.0)
    scene = media_scene([fog], [placed()], lights=[lamp], world=(0.0, 0.0, 0.0), height=2.5)
    both, alone = (means_by_seed(scene, samples=1024, volume_bounces=4, use_nee=use_nee) for use_nee in (True, False))
    error = np.sqrt((both.var(axis=0, ddof=1) + alone.var(axis=0, ddof=1)) / len(both))
    assert (np.abs(both.mean(axis=0) - alone.mean(axis=0)) <= SIGMAS * error).all()
    assert (error < 0.01 * both.mean(axis=0)).all()


def test_a_medium_denser_than_its_bound_is_named_and_the_picture_stays_right(monkeypatch):
    build = media_builder.build_majorants

    def too_low(*arguments):
        grids = build(*arguments)
        return grids._replace(values=np.float32(0.7) * grids.values)

    monkeypatch.setattr(media_builder, "build_majorants", too_low)
    scene = media_scene([ink(3.0)], [placed()])
    assert is_mean(means_by_seed(scene, seeds=4, samples=64), np.exp(-1.5 * (1.0 - COLOR)))
    notices = render(scene).report.notices
    assert any(notice.subject == "Volumes" and "denser" in notice.problem for notice in notices)


@pytest.mark.slow
@pytest.mark.parametrize("density", [1e-6, 1e6])
def test_extreme_media_leave_no_pixel_that_is_not_finite(density):
    fog = varying("Scatter", "Density", density, Color=(0.9999, 0.5, 0.0, 1.0), Anisotropy=0.999)
    image = picture(media_scene([fog], [placed()]), volume_bounces=16, max_bounces=16, samples=16)
    assert np.isfinite(image).all() and 0.0 <= image.mean() < 1.1


def test_densities_that_are_no_numbers_are_named_and_count_as_nothing():
    nan = varying("Absorption", "Density", float("nan"), Color=(*COLOR, 1.0))
    result = render(media_scene([nan], [placed()]))
    assert np.allclose(result.passes["Combined"][..., :3], 1.0)


def test_a_grid_gives_the_density_of_a_principled_volume():
    black = {"Color": (0.0, 0.0, 0.0, 1.0)}
    values = np.zeros((21, 21, 21, 1), np.float32)
    values[:, :, :, 0] = np.linspace(0.0, 1.0, 21) ** 2
    means = means_by_seed(box_of_voxels(values, 1.5, **black), samples=64)
    # Straight lines between the values: the trapezoidal rule, over 2 m.
    expected = np.exp(-1.5 * integrate.trapezoid(values[0, 0, :, 0], dx=0.1))
    assert is_mean(means, np.full(3, expected))
    # A grid of another name: the node's own number, everywhere.
    image = picture(box_of_voxels(values, 1.5, name="smoke", **black))
    assert np.allclose(image, np.exp(-3.0), rtol=5e-4)


def _edge_of_voxels(smooth=False):
    """A box that is filled with black fog behind the middle one of its 21 voxels along x."""
    values = np.zeros((21, 21, 21, 1), np.float32)
    values[11:] = 1.0
    scene = box_of_voxels(values, 1.5, Color=(0.0, 0.0, 0.0, 1.0))
    scene.materials[0].has_smooth_voxels = smooth
    scene.camera.lens = 2e5
    return scene


@pytest.mark.parametrize("still", [0.0, 0.5])
def test_what_moves_by_its_velocity_is_blurred(still):
    """An edge that goes over the middle of the picture while the shutter is open, next to where nothing moves."""
    velocity = np.zeros((21, 21, 21, 3), np.float32)
    velocity[..., 0] = -0.9
    scene = let_voxels_move(_edge_of_voxels(), velocity, still)
    # What is seen at x = 0 at a time t has come from 0.9 (t - still).
    time = (np.arange(100_000) + 0.5) / 100_000
    there = np.clip(10.0 * 0.9 * (time - still), 0.0, 1.0)
    expected = np.exp(-1.5 * 2.0 * there).mean()
    means = means_by_seed(scene, samples=128)
    assert is_mean(means, np.full(3, expected))
    result = render(scene, samples=16)
    assert not [notice for notice in result.report.notices if "denser" in notice.problem]
    # Shadow rays look the same way.
    passes = render(scene, passes=("Combined", "Ambient Occlusion"), samples=2)
    assert np.isfinite(passes.passes["Combined"]).all()


def test_voxels_are_interpolated_by_cubic_splines_where_the_material_says_so():
    """The middle of the picture is at the voxel before the edge: a sixth of the next one's density."""
    means = means_by_seed(_edge_of_voxels(smooth=True), samples=64)
    # Along the ray it fades towards both faces, behind which there is nothing.
    z = np.linspace(-1.0, 1.0, 20_001)
    distance = np.abs(10.0 * (z[:, None] + 1.0) - np.arange(21))
    near, far = 2.0 / 3.0 + distance**2 * (0.5 * distance - 1.0), np.maximum(2.0 - distance, 0.0) ** 3 / 6.0
    depth = integrate.trapezoid(np.where(distance < 1.0, near, far).sum(axis=1), z)
    assert is_mean(means, np.full(3, np.exp(-1.5 * depth / 6.0)))
    assert np.allclose(picture(_edge_of_voxels(), samples=16).mean(), 1.0, atol=0.02)
