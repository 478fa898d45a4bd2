# SPDX-License-Identifier: GPL-3.0-or-later
"""Homogeneous media against what can be worked out: Beer's law, a furnace, a lamp in fog; and their passes.

Statistical tests have fixed seeds and reject at 4 standard errors, which a correct renderer fails once in 15,000;
`is_mean` once in 1,000.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy import integrate

from engine.render.light_passes import LIGHT_PASSES
from engine.scene.description import Light, Link, Material, Node, NodeGraph
from engine.scene.instances import plain_instances
from engine.state.media import MAX_MEDIA
from tests.helpers.light_sums import sum_of_passes
from tests.helpers.media_renders import SIGMAS, is_mean, means_by_seed, picture, render
from tests.helpers.media_scenes import media_scene, medium, placed, put_into_ball, varying, volume_graph

pytestmark = pytest.mark.estimator

GLASS = "ShaderNodeBsdfRefraction"


@pytest.mark.parametrize("surface", [None, GLASS])
def test_absorption_follows_beers_law_with_and_without_a_surface(surface):
    color = np.array([0.5, 0.2, 0.8])
    ink = medium("Absorption", surface, Color=(*color, 1.0), Density=0.7)
    image = picture(media_scene([ink], [placed()]))
    assert np.allclose(image, np.exp(-2.0 * 0.7 * (1.0 - color)), rtol=2e-4)


def test_media_that_overlap_add_up_and_a_nested_one_is_left_again():
    red = medium("Absorption", name="Red", Color=(1.0, 0.0, 0.5, 1.0), Density=0.3)
    blue = medium("Absorption", name="Blue", Color=(0.0, 0.5, 1.0, 1.0), Density=0.4)
    small = placed((0.5, 0.5, 0.25))
    expected = np.exp(-2.0 * 0.3 * np.array([0.0, 1.0, 0.5]) - 0.5 * 0.4 * np.array([1.0, 0.5, 0.0]))
    assert np.allclose(picture(media_scene([red, blue], [placed(), small])), expected, rtol=2e-4)
    # Half of it sticks out, which makes no difference to what is on the ray.
    shifted = placed((0.5, 0.5, 0.25), (0.0, 0.0, 1.0))
    assert np.allclose(picture(media_scene([red, blue], [placed(), shifted])), expected, rtol=2e-4)


def test_a_camera_inside_of_media_starts_in_them():
    ink = medium("Absorption", Color=(0.5, 0.2, 0.8, 1.0), Density=0.7)
    around = [placed((4.0, 4.0, 4.0)), placed((2.0, 2.0, 1.0), (0.0, 0.0, -2.0))]
    image = picture(media_scene([ink, ink], around, height=1.0))
    # 5 m of the one from the camera down, 2 m of the other; the clip distance of 0.1 m is empty.
    assert np.allclose(image, np.exp(-0.7 * (4.9 + 2.0) * (1.0 - np.array([0.5, 0.2, 0.8]))), rtol=5e-4)


def test_emission_is_collected_along_the_ray():
    glow = medium("Coefficients", **{
        "Absorption Coefficients": (0.5, 0.0, 2.0), "Scatter Coefficients": (0.0, 0.0, 0.0),
        "Emission Coefficients": (1.0, 2.0, 3.0),
    })  # fmt: skip
    image = picture(media_scene([glow], [placed()], world=(0.0, 0.0, 0.0)))
    expected = [1.0 * (1.0 - np.exp(-1.0)) / 0.5, 2.0 * 2.0, 3.0 * (1.0 - np.exp(-4.0)) / 2.0]
    assert np.allclose(image, expected, rtol=5e-4)


@pytest.mark.parametrize("density", [0.05, 2.0, 8.0])
def test_what_scatters_all_light_is_not_seen_in_a_white_furnace(density):
    fog = medium("Scatter", Color=(1.0, 1.0, 1.0, 1.0), Density=density, Anisotropy=0.4)
    image = picture(media_scene([fog], [placed()]), volume_bounces=1024, max_bounces=1024, samples=16)
    assert np.allclose(image, 1.0, atol=1e-4)


@pytest.mark.parametrize(
    ("varies", "g"),
    [(False, -0.5), (False, 0.0), (False, 0.8), (True, 0.8)]
    + [pytest.param(True, g, marks=pytest.mark.slow) for g in (-0.5, 0.0)],
)
def test_a_ball_that_scatters_all_light_is_not_seen_in_a_white_furnace(varies, g):
    color = {"Color": (1.0, 1.0, 1.0, 1.0), "Anisotropy": g}
    # The lower half of the one that varies is empty: there is no density below 0.
    fog = varying("Scatter", "Density", 4.0, **color) if varies else medium("Scatter", Density=2.0, **color)
    endless = {"volume_bounces": 1024, "max_bounces": 1024, "samples": 16}
    assert np.allclose(picture(put_into_ball(media_scene([fog], [placed()])), **endless), 1.0, atol=1e-4)
    # It is there: what scatters no more than once lacks light.
    assert picture(put_into_ball(media_scene([fog], [placed()])), volume_bounces=0, samples=16).mean() < 0.95


@pytest.mark.parametrize(("ior", "backscatter"), [(1.33, 0.1), (1.33, 0.0), (1.0, 0.5)])
@pytest.mark.parametrize("varies", [False, True])
def test_particles_in_water_are_not_seen_in_a_white_furnace(ior, backscatter, varies):
    """Nor are those that send next to nothing back: what goes straight on within rounding is not lost."""
    white = {"phase": "FOURNIER_FORAND", "Color": (1.0, 1.0, 1.0, 1.0), "IOR": ior, "Backscatter": backscatter}
    fog = varying("Scatter", "Density", 2.0, **white) if varies else medium("Scatter", Density=1.0, **white)
    image = picture(media_scene([fog], [placed()]), volume_bounces=1024, max_bounces=1024, samples=16)
    assert np.allclose(image, 1.0, atol=1e-4)


def _light_sent_back(albedo):
    """What a medium without an end sends straight back under a white sky, by Chandrasekhar 1960, Radiative Transfer.

    1 - H(1) sqrt(1 - albedo), for scattering that is alike in all directions (section 38 there).
    """
    nodes, weights = np.polynomial.legendre.leggauss(64)
    mu, weights = 0.5 * (nodes + 1.0), 0.5 * weights
    lost = np.sqrt(1.0 - albedo)
    h = np.ones(64)
    for _ in range(200):
        h = 1.0 / (lost + 0.5 * albedo * (weights * mu * h / (mu[:, None] + mu)).sum(axis=1))
    return 1.0 - lost / (lost + 0.5 * albedo * (weights * mu * h / (1.0 + mu)).sum())


@pytest.mark.parametrize(("density", "is_varying"), [(1e3, False), (1e5, True), (1e6, False)])
def test_what_is_too_dense_to_see_into_sends_back_what_theory_says(density, is_varying):
    """By 1e6 a mean free path is as short as what a ray skips at a surface: 61% of the light was lost once.

    What varies with depth alone has the same answer, for depth counts in mean free paths.
    """
    milk = medium("Coefficients", **{
        "Absorption Coefficients": (0.1 * density,) * 3, "Scatter Coefficients": (0.9 * density,) * 3,
    })  # fmt: skip
    if is_varying:
        milk = varying("Principled", "Density", density, Color=(0.9, 0.9, 0.9, 1.0))
    means = means_by_seed(media_scene([milk], [placed()]), samples=256, volume_bounces=128, max_bounces=128)
    expected = np.full(3, _light_sent_back(0.9))
    error = means.std(axis=0, ddof=1) / np.sqrt(len(means))
    assert (np.abs(means.mean(axis=0) - expected) <= 0.002 * expected + SIGMAS * error).all()
    # And the test sees a bias of 2%.
    assert (SIGMAS * error < 0.015 * expected).all()


@pytest.mark.slow
def test_with_wavelengths_the_furnace_is_as_if_nothing_were_there():
    """Every path has its wavelengths, of which one alone is no white: the same paths are compared."""
    fog = medium("Scatter", Color=(1.0, 1.0, 1.0, 1.0), Density=2.0, Anisotropy=0.4)
    settings = {"volume_bounces": 1024, "max_bounces": 1024, "samples": 16, "spectral": "ON"}
    empty = picture(media_scene([], np.zeros((0, 4, 4))), **settings)
    assert np.allclose(picture(media_scene([fog], [placed()]), **settings).mean(), empty.mean(), atol=2e-3)


def test_channels_of_different_density_are_unbiased_in_a_furnace():
    """Each channel of the throughput is divided by one density for all: a wrong one shows at once."""
    fog = medium("Coefficients", **{
        "Absorption Coefficients": (0.0, 0.0, 0.0), "Scatter Coefficients": (0.2, 1.0, 5.0), "Anisotropy": -0.5,
    })  # fmt: skip
    means = means_by_seed(media_scene([fog], [placed()]), volume_bounces=1024, max_bounces=1024, samples=64)
    assert is_mean(means, np.ones(3))
    # And the test sees a bias of 2%.
    assert not is_mean(1.02 * means, np.ones(3))


def _single_scattering(extinction, scattering, lamp_height, energy):
    """Radiance that fog without an end sends straight up to a camera at 10 m, by a point lamp beside its ray.

    The lamp is 1 m away from the ray; isotropic, one scattering, from the clip distance on.
    """
    intensity = energy / (4.0 * np.pi)

    def arriving(t):
        distance = np.hypot(10.0 - t - lamp_height, 1.0)
        return np.exp(-extinction * (t - 0.1 + distance)) / distance**2

    return scattering * intensity / (4.0 * np.pi) * integrate.quad(arriving, 0.1, 200.0, limit=500)[0]


def test_a_lamp_in_endless_fog_is_as_bright_as_the_integral_says():
    fog = volume_graph("Scatter", Color=(0.5, 1.0, 0.2, 1.0), Density=0.2)
    lamp = Light("lamp", "Lamp", "POINT", placed(offset=(1.0, 0.0, 4.0)), (1.0, 1.0, 1.0), 100.0)
    scene = media_scene([], np.zeros((0, 4, 4)), lights=[lamp], world=(0.0, 0.0, 0.0), fog=fog)
    # So narrow a view that rays at its edge are as far from the lamp as the one in the middle.
    scene.camera.lens = 50000.0
    means = means_by_seed(scene, volume_bounces=0, samples=256)
    expected = np.array([_single_scattering(0.2 * c, 0.2 * c, 4.0, 100.0) for c in (0.5, 1.0, 0.2)])
    assert is_mean(means, expected)
    assert not is_mean(1.02 * means, expected)


def test_light_sampling_and_scattering_alone_agree():
    """A large lamp in a coloured medium: found by shadow rays, through the boundary, and by rays that are scattered."""
    fog = medium("Coefficients", **{
        "Absorption Coefficients": (0.1, 0.5, 0.0), "Scatter Coefficients": (1.0, 0.5, 0.2), "Anisotropy": 0.3,
    })  # fmt: skip
    lamp = Light("lamp", "Lamp", "AREA", placed(offset=(0.0, 0.0, 3.0)), (1.0, 1.0, 1.0), 100.0, size_x=4.0)
    scene = media_scene([fog], [placed()], lights=[lamp], world=(0.0, 0.0, 0.0), height=2.5)
    both, alone = (means_by_seed(scene, samples=1024, volume_bounces=4, use_nee=use_nee) for use_nee in (True, False))
    error = np.sqrt((both.var(axis=0, ddof=1) + alone.var(axis=0, ddof=1)) / len(both))
    assert (np.abs(both.mean(axis=0) - alone.mean(axis=0)) <= SIGMAS * error).all()
    assert (error < 0.01 * both.mean(axis=0)).all()


def test_light_sampling_and_scattering_alone_agree_in_water():
    water = medium(
        "Scatter", phase="FOURNIER_FORAND", Color=(0.9, 0.9, 0.9, 1.0), Density=0.7, IOR=1.2, Backscatter=0.2
    )
    lamp = Light("lamp", "Lamp", "AREA", placed(offset=(0.0, 0.0, 3.0)), (1.0, 1.0, 1.0), 100.0, size_x=4.0)
    scene = media_scene([water], [placed()], lights=[lamp], world=(0.0, 0.0, 0.0), height=2.5)
    both, alone = (means_by_seed(scene, samples=1024, volume_bounces=4, use_nee=use_nee) for use_nee in (True, False))
    error = np.sqrt((both.var(axis=0, ddof=1) + alone.var(axis=0, ddof=1)) / len(both))
    assert (np.abs(both.mean(axis=0) - alone.mean(axis=0)) <= SIGMAS * error).all()
    assert (error < 0.02 * both.mean(axis=0)).all()


def test_surfaces_in_fog_weigh_their_light_by_their_own_densities():
    """The same of a floor in thin fog: light of segments must leave nothing behind in a path's light sample."""
    fog = medium("Scatter", Color=(0.3, 0.5, 0.9, 1.0), Density=0.15, Anisotropy=-0.3)
    white = medium("Absorption", "ShaderNodeBsdfDiffuse", name="Floor", Density=0.0)
    around = [placed((4.0, 4.0, 2.0), (0.0, 0.0, 2.0)), placed((4.0, 4.0, 0.5), (0.0, 0.0, 0.0))]
    lamp = Light("lamp", "Lamp", "AREA", placed(offset=(0.0, 0.0, 3.0)), (1.0, 1.0, 1.0), 100.0, size_x=4.0)
    scene = media_scene([fog, white], around, lights=[lamp], world=(0.0, 0.0, 0.0), height=2.0)
    both, alone = (means_by_seed(scene, samples=1024, volume_bounces=2, use_nee=use_nee) for use_nee in (True, False))
    error = np.sqrt((both.var(axis=0, ddof=1) + alone.var(axis=0, ddof=1)) / len(both))
    assert (np.abs(both.mean(axis=0) - alone.mean(axis=0)) <= SIGMAS * error).all()
    assert (error < 0.005 * both.mean(axis=0)).all()


def test_camera_rays_collide_for_sure_where_nothing_lies_behind_a_medium():
    """A sky that is not quite black has some of them pass."""
    fog = medium("Coefficients", **{
        "Absorption Coefficients": (0.0, 0.1, 0.0), "Scatter Coefficients": (0.6, 0.2, 0.1), "Anisotropy": 0.2,
    })  # fmt: skip
    lamp = Light("lamp", "Lamp", "AREA", placed(offset=(3.0, 0.0, 2.0)), (1.0, 1.0, 1.0), 100.0, size_x=1.0)
    images = [
        np.array([picture(scene, seed=seed, samples=32, volume_bounces=8) for seed in range(8)])
        for scene in (media_scene([fog], [placed()], lights=[lamp], world=(sky,) * 3) for sky in (0.0, 1e-7))
    ]
    sure, likely = (image.mean(axis=(1, 2), dtype=np.float64) for image in images)
    error = np.sqrt((sure.var(axis=0, ddof=1) + likely.var(axis=0, ddof=1)) / len(sure))
    assert (np.abs(sure.mean(axis=0) - likely.mean(axis=0)) <= SIGMAS * error).all()
    assert (error < 0.02 * likely.mean(axis=0)).all()
    variances = [image.var(axis=0, ddof=1).mean(axis=(0, 1)) for image in images]
    assert (variances[0] < 0.8 * variances[1]).all()


def test_what_lies_behind_a_medium_is_seen_through_it():
    """Under a black sky a lamp or something that glows is met by the camera rays that pass."""
    thin = medium("Scatter", name="Thin", Color=(0.9, 0.9, 0.9, 1.0), Density=1e-3)
    below, black = placed(offset=(0.0, 0.0, -4.0)), (0.0, 0.0, 0.0)
    upwards = (below @ np.diag((1.0, -1.0, -1.0, 1.0))).astype(np.float32)
    lamp = Light("lamp", "Lamp", "AREA", upwards, (1.0, 1.0, 1.0), 100.0, size_x=2.0)
    seen = picture(media_scene([thin], [placed()], lights=[lamp], world=black), samples=16).mean()
    alone = picture(media_scene([], np.zeros((0, 4, 4)), lights=[lamp], world=black), samples=16).mean()
    assert alone > 0.0 and np.allclose(seen, alone, rtol=1e-2)
    glow = medium("Absorption", "ShaderNodeEmission", name="Glow", Density=0.0)
    alone = picture(media_scene([glow], [below], world=black), samples=16).mean()
    seen = picture(media_scene([thin, glow], [placed(), below], world=black), samples=16).mean()
    assert alone > 0.0 and np.allclose(seen, alone, rtol=1e-2)


def test_volume_bounces_count_scatterings_after_the_first():
    fog = medium("Scatter", Color=(1.0, 1.0, 1.0, 1.0), Density=3.0)
    scene = media_scene([fog], [placed()])
    means = [picture(scene, volume_bounces=count, samples=16).mean() for count in (0, 2, 8)]
    assert means[0] < means[1] - 0.05 < means[2] - 0.1 < 0.9


def test_passes_of_volumes_and_surfaces_add_up_to_the_picture():
    fog = medium("Scatter", Color=(0.9, 0.6, 0.3, 1.0), Density=1.0)
    lamp = Light("lamp", "Lamp", "AREA", placed(offset=(3.0, 0.0, 4.0)), (1.0, 1.0, 1.0), 500.0, size_x=1.0)
    scene = media_scene([fog], [placed()], lights=[lamp], world=(0.2, 0.2, 0.2))
    images = render(
        scene, ("Combined", "Emission", "Environment", *LIGHT_PASSES), volume_bounces=3, samples=16
    ).passes
    assert images["Volume Direct"].mean() > 0.01 and images["Volume Indirect"].mean() > 0.01
    assert np.allclose(sum_of_passes(images), images["Combined"][..., :3], rtol=1e-4, atol=1e-5)


def test_guided_renders_of_media_have_the_same_mean():
    fog = medium("Scatter", Color=(0.9, 0.9, 0.9, 1.0), Density=0.5)
    white = medium("Absorption", "ShaderNodeBsdfDiffuse", name="Floor", Density=0.0)
    lamp = Light("lamp", "Lamp", "AREA", placed(offset=(1.0, 0.0, 4.0)), (1.0, 1.0, 1.0), 200.0, size_x=1.0)
    around = [placed((3.0, 3.0, 2.0), (0.0, 0.0, 2.0)), placed((4.0, 4.0, 0.5), (0.0, 0.0, -0.6))]
    scene = media_scene([fog, white], around, lights=[lamp], world=(0.0, 0.0, 0.0))
    plain = means_by_seed(scene, samples=63, volume_bounces=4)
    guided = means_by_seed(scene, samples=63, volume_bounces=4, guiding_method="VMM")
    error = np.sqrt((plain.var(axis=0, ddof=1) + guided.var(axis=0, ddof=1)) / len(plain))
    assert (np.abs(plain.mean(axis=0) - guided.mean(axis=0)) <= SIGMAS * error).all()


@pytest.mark.slow
def test_guiding_where_fog_scatters_keeps_the_mean():
    """Fog in a room whose lamp stands behind a wall: most of its light comes round it, by surfaces and by fog.

    `tests/benchmarks/test_stability.py` has fog that scatters forward and backward.
    """
    fog = medium("Scatter", Color=(0.9, 0.9, 0.9, 1.0), Density=0.5, Anisotropy=0.0)
    white = medium("Absorption", "ShaderNodeBsdfDiffuse", name="Wall", Density=0.0)
    lamp = Light("lamp", "Lamp", "AREA", placed(offset=(2.5, 0.0, 3.9)), (1.0, 1.0, 1.0), 300.0, size_x=0.5)
    around = [
        placed((4.0, 4.0, 2.2), (0.0, 0.0, 2.0)), placed((0.05, 4.0, 1.7), (1.2, 0.0, 1.6)),
        placed((4.0, 4.0, 0.5), (0.0, 0.0, -0.6)), placed((4.0, 4.0, 0.5), (0.0, 0.0, 4.6)),
        *(placed((0.5, 4.0, 3.0), (side, 0.0, 2.0)) for side in (-4.4, 4.4)),
        *(placed((4.0, 0.5, 3.0), (0.0, side, 2.0)) for side in (-4.4, 4.4)),
    ]  # fmt: skip
    scene = media_scene(
        [fog, *[white] * 7], around, lights=[lamp], world=(0.0, 0.0, 0.0), height=3.9, size=(16, 16)
    )
    scene.camera.lens = 20.0
    settings = {"samples": 511, "volume_bounces": 12, "max_bounces": 12, "diffuse_bounces": 8}
    plain = means_by_seed(scene, 12, **settings)
    guided = means_by_seed(scene, 12, guiding_method="VMM", guiding_trial=False, **settings)
    error = np.sqrt((plain.var(axis=0, ddof=1) + guided.var(axis=0, ddof=1)) / len(plain))
    assert (np.abs(plain.mean(axis=0) - guided.mean(axis=0)) <= SIGMAS * error).all()
    # And the test sees a bias.
    assert (SIGMAS * error < 0.02 * plain.mean(axis=0)).all()


@pytest.mark.parametrize("density", [1e-6, 1e6])
@pytest.mark.parametrize("anisotropy", [-0.999, 0.999])
def test_extreme_media_leave_no_pixel_that_is_not_finite(density, anisotropy):
    fog = medium("Scatter", Color=(0.9999, 0.5, 0.0, 1.0), Density=density, Anisotropy=anisotropy)
    image = picture(media_scene([fog], [placed()]), volume_bounces=64, max_bounces=64, samples=64)
    assert np.isfinite(image).all() and 0.0 <= image.mean() < 1.1


@pytest.mark.parametrize("density", [1e-6, 1.0, 1e6])
@pytest.mark.parametrize("anisotropy", [-0.999, 0.999])
def test_lamps_in_and_before_extreme_media_leave_no_pixel_that_is_not_finite(density, anisotropy):
    """One lamp is on the camera's axis, where segments lead through it."""
    fog = medium("Scatter", Color=(0.9999, 0.5, 0.0, 1.0), Density=density, Anisotropy=anisotropy)
    on_axis = Light("point", "Point", "POINT", placed(offset=(0.0, 0.0, 0.2)), (1.0, 1.0, 1.0), 10.0)
    before = Light("spot", "Spot", "SPOT", placed(offset=(0.0, 0.0, 3.0)), (1.0, 1.0, 1.0), 100.0, spot_angle=0.5)
    scene = media_scene([fog], [placed()], lights=[on_axis, before], world=(0.0, 0.0, 0.0))
    image = picture(scene, volume_bounces=16, max_bounces=16, samples=64)
    assert np.isfinite(image).all() and image.min() >= 0.0


def test_what_scatters_nearly_all_light_takes_away_what_a_path_of_its_length_loses():
    """Albedo 0.9999 in a furnace: darker than white, by less than the loss of very long paths."""
    fog = medium("Coefficients", **{
        "Absorption Coefficients": (1e-4,) * 3, "Scatter Coefficients": (1.0 - 1e-4,) * 3, "Anisotropy": 0.0,
    })  # fmt: skip
    image = picture(media_scene([fog], [placed()]), volume_bounces=1024, max_bounces=1024, samples=64)
    assert 0.995 < image.mean() < 1.0


def test_a_camera_on_a_boundary_is_on_one_side_of_it():
    ink = medium("Absorption", Color=(0.5, 0.2, 0.8, 1.0), Density=0.7)
    # Rays start 0.1 m before the camera: one box begins there, another a camera's rounding before.
    for top in (1.0, np.nextafter(np.float32(1.0), np.float32(2.0))):
        around = [placed((4.0, 4.0, 2.0), (0.0, 0.0, float(top) - 2.0))]
        image = picture(media_scene([ink], around, height=1.1))
        assert np.allclose(image, np.exp(-0.7 * 4.0 * (1.0 - np.array([0.5, 0.2, 0.8]))), rtol=1e-3)


def test_of_64_nested_media_those_that_there_is_room_for_count_and_a_message_says_so():
    sizes = 1.0 + 0.01 * np.arange(64, 0, -1)
    inks = [medium("Absorption", name=f"Ink {k}", Color=(0.5, 0.5, 0.5, 1.0), Density=0.05) for k in range(64)]
    result = render(media_scene(inks, [placed((1.0, 1.0, size)) for size in sizes]))
    expected = np.exp(-0.05 * 0.5 * 2.0 * sizes[:MAX_MEDIA].sum())
    assert np.allclose(result.passes["Combined"][..., :3], expected, rtol=1e-3)
    assert any("more than 32 media" in notice.problem for notice in result.report.notices)


def test_shadow_rays_are_dimmed_through_hundreds_of_boundaries():
    """A floor below the camera, and ink between camera and lamp: in one layer, or in 150 that have gaps between."""
    floor = Material("Floor", "Floor", NodeGraph([Node("ShaderNodeBsdfDiffuse", "White", {})], Link(0, "BSDF")))
    lamp = Light("lamp", "Lamp", "POINT", placed(offset=(0.0, 0.0, 400.0)), (1.0, 1.0, 1.0), 1e6)

    def lit(count):
        ink = medium("Absorption", Color=(0.5, 0.2, 0.8, 1.0), Density=0.125)
        # No two of a width: faces in one plane would be drawn apart.
        layers = [
            placed((5.0 + k, 5.0 + k, 6.0 / count), (0.0, 0.0, 20.0 + 15.0 * k / count)) for k in range(count)
        ]
        scene = media_scene([floor], [placed()], lights=[lamp], world=(0.0, 0.0, 0.0))
        scene.instances = plain_instances(np.array([placed(), *layers]), materials=[0] + [1] * count, name="Box")
        scene.materials = [floor, ink]
        return picture(scene)

    one = lit(1)
    assert one.min() > 0.0
    assert np.allclose(lit(150), one, rtol=1e-3)


def test_a_box_a_million_times_as_large_as_what_is_in_it():
    """Ink around the camera and a glowing box 10 m below it: the ink's own faces are 4,000 km away."""
    ink = medium("Absorption", Color=(0.5, 0.2, 0.8, 1.0), Density=0.1)
    glow = medium("Absorption", "ShaderNodeEmission", name="Glow", Density=0.0)
    glow.graph.nodes[1].inputs.update({"Color": (1.0, 1.0, 1.0, 1.0), "Strength": 2.0})
    glow.graph.surface = Link(1, "Emission")
    around = [placed((4e6, 4e6, 4e6)), placed((4.0, 4.0, 1.0), (0.0, 0.0, -1.0))]
    image = picture(media_scene([ink, glow], around, world=(0.0, 0.0, 0.0)))
    assert np.allclose(image, 2.0 * np.exp(-0.1 * 9.9 * (1.0 - np.array([0.5, 0.2, 0.8]))), rtol=5e-4)


@pytest.mark.parametrize("is_varying", [False, True])
@pytest.mark.parametrize("kind", ["lamp", "mesh"])
def test_lights_within_media_too_dense_to_see_into_are_found_alike_by_both_techniques(kind, is_varying):
    """Twenty mean free paths wide, three deep: light samples ended before a lamp, and made it a quarter brighter."""
    density = 1e5
    milk = medium("Coefficients", **{
        "Absorption Coefficients": (0.1 * density,) * 3, "Scatter Coefficients": (0.9 * density,) * 3,
    })  # fmt: skip
    if is_varying:
        milk = varying("Principled", "Density", density, Color=(0.9, 0.9, 0.9, 1.0))
    half, top = 10.0 / density, 1.0 - 3.0 / density
    materials, around, lamps = [milk], [placed((4.0, 4.0, 1.0))], []
    if kind == "lamp":
        facing_up = placed((1.0, -1.0, -1.0), (0.0, 0.0, top))
        lamps = [Light("lamp", "Lamp", "AREA", facing_up, (1.0, 1.0, 1.0), 400.0 * half**2, size_x=2.0 * half)]
    else:
        glow = Node("ShaderNodeEmission", "Glow", {"Color": (1.0, 1.0, 1.0, 1.0), "Strength": 2.0})
        materials.append(
            Material("Glow", "Glow", NodeGraph([glow], Link(0, "Emission")), emission_sampling="FRONT_BACK")
        )
        around.append(placed((half, half, 1.0 / density), (0.0, 0.0, top - 1.0 / density)))
    scene = media_scene(materials, around, lights=lamps, world=(0.0, 0.0, 0.0))
    scene.camera.lens *= 0.08 / half
    settings = {"samples": 256, "volume_bounces": 64, "max_bounces": 64}
    both, alone = (means_by_seed(scene, use_nee=use_nee, **settings) for use_nee in (True, False))
    error = np.sqrt((both.var(axis=0, ddof=1) + alone.var(axis=0, ddof=1)) / len(both))
    assert (np.abs(both.mean(axis=0) - alone.mean(axis=0)) <= SIGMAS * error).all()
    assert (error < 0.01 * both.mean(axis=0)).all()
