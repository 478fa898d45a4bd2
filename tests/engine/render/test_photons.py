# SPDX-License-Identifier: GPL-3.0-or-later
"""Caustics by photons: the same light as paths find, and as mirrored lamps give; for any number of threads."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from engine.kernels.hash_grid import bucket_of
from engine.render.photon_maps import divisions_of, make_map, map_of_sample, samples_of_map
from engine.render.photon_radius import MOST_NEIGHBOURS
from engine.render.photon_trial import gain_of_photons, tried_pixels
from engine.render.session import Session
from engine.scene.description import VISIBLE_SHADOW, World
from engine.scene.fast_gi import FastGi
from engine.settings import RenderSettings
from engine.state.photons import MAP_BUCKETS, MAP_INVERSE_CELL, PHOTON_P, PHOTON_WIDTH, no_photons
from tests.helpers.caustic_scenes import (
    hidden_glass_scene,
    mirror_scene,
    mirrored_scene,
    mixed_with_nothing,
    water_scene,
)
from tests.helpers.photon_renders import assert_same_light
from tests.helpers.photon_renders import pictures as by_caustics

pytestmark = pytest.mark.estimator


def render(scene, samples=16, seed=1, threads=1, **settings):
    chosen = {"caustics": "PHOTONS", "filter_glossy": 0.0} | settings
    session = Session(RenderSettings(samples=samples, seed=seed, threads=threads, **chosen))
    session.load(scene)
    result = session.render()
    session.close()
    return result


def pictures(scene, seeds, caustics="PHOTONS", **settings):
    """Grey ones, with as many neighbours as renders have."""
    return by_caustics(scene, caustics, seeds, neighbours=MOST_NEIGHBOURS, **settings).mean(axis=-1)


def z_of_means(a, b):
    """Difference of the means of two stacks of pictures, in standard errors of their seeds."""
    means = [one.reshape(len(one), -1).mean(axis=1) for one in (a, b)]
    error = np.sqrt(sum(mean.var(ddof=1) / len(mean) for mean in means))
    return (means[0].mean() - means[1].mean()) / error


@pytest.mark.parametrize("divisions", [1, 2, 8])
def test_each_sample_has_one_map(divisions: int) -> None:
    found = [map_of_sample(sample, divisions) for sample in range(600)]
    expected = [number for number in range(80) for _ in range(samples_of_map(number, divisions)[1])][:600]
    assert found == expected
    assert max(samples_of_map(number, divisions)[1] for number in range(80)) == 16


def test_large_pictures_have_more_maps() -> None:
    assert [samples_of_map(number)[0] for number in range(8)] == [0, 1, 2, 4, 8, 16, 32, 48]
    assert [samples_of_map(number, 2)[0] for number in range(9)] == [0, 1, 2, 3, 4, 6, 8, 12, 16]
    sides = (320, 480, 640, 960, 1920, 8192)
    assert [divisions_of(side * side * 9 // 16) for side in sides] == [1, 1, 2, 4, 8, 8]


def test_a_map_holds_each_photon_once_in_the_bucket_of_its_cell() -> None:
    numbers = np.random.default_rng(1)
    photons = numbers.uniform(-3.0, 3.0, (500, PHOTON_WIDTH)).astype(np.float32)
    grid = make_map(photons, 1000, 0.25, no_photons())
    assert sorted(map(tuple, grid.photons)) == sorted(map(tuple, photons))
    starts, mask = grid.starts, int(grid.header[MAP_BUCKETS]) - 1
    assert starts[0] == 0 and starts[-1] == 500 and (np.diff(starts) >= 0).all()
    cells = np.floor(grid.photons[:, PHOTON_P : PHOTON_P + 3] * grid.numbers[MAP_INVERSE_CELL]).astype(np.int64)
    buckets = [bucket_of(*(np.int64(i) for i in cell), np.int64(0), np.int64(mask)) for cell in cells]
    assert (np.searchsorted(starts, np.arange(500), side="right") - 1 == buckets).all()
    np.testing.assert_array_equal(grid.places, grid.photons[:, PHOTON_P : PHOTON_P + 3])


def test_cells_next_to_each_other_share_buckets_with_few() -> None:
    """Of a block of 4 x 4 x 4 cells each has a bucket of its own, and eight that touch lie next to each other."""
    block = np.array([[bucket_of(x, y, z, 0, 4095) for x, y, z in np.ndindex(4, 4, 4)]]).ravel()
    assert len(set(block)) == 64 and np.ptp(block) == 63
    small = [bucket_of(x, y, z, 0, 4095) for x, y, z in np.ndindex(2, 2, 2)]
    assert np.ptp(small) == 7


def test_a_mirror_lights_as_the_mirrored_lamp_does() -> None:
    """Paths alone meet the lamp in the mirror in one of a thousand samples."""
    # As far before the mirror as photons are gathered from.
    found, expected = (pictures(scene, range(4), samples=256)[:, :9] for scene in (mirror_scene(), mirrored_scene()))
    assert found.mean() == pytest.approx(expected.mean(), rel=0.01)
    np.testing.assert_allclose(found.mean(axis=(0, 2)), expected.mean(axis=(0, 2)), rtol=0.05)


def test_the_foot_of_a_mirror_is_as_bright_as_elsewhere() -> None:
    """Half of a disc there has no photons, since it is no floor: the foot's row of pixels was 17% too dark."""
    found, expected = (pictures(scene, range(4), samples=256) for scene in (mirror_scene(), mirrored_scene()))
    ratio = found.mean(axis=(0, 2)) / expected.mean(axis=(0, 2))
    # The twelfth row has the foot in it.
    np.testing.assert_allclose(np.delete(ratio, 12), 1.0, atol=0.02)
    assert ratio[12] == pytest.approx(1.0, abs=0.05)


def test_lamps_without_a_size_are_mirrored_too() -> None:
    """No path meets them."""
    mirror, mirrored = mirror_scene(), mirrored_scene()
    for scene in (mirror, mirrored):
        scene.lights = [replace(light, kind="POINT", radius=0.0) for light in scene.lights]
    found, expected = (pictures(scene, range(4), samples=256)[:, :9] for scene in (mirror, mirrored))
    assert found.mean() == pytest.approx(expected.mean(), rel=0.01)
    np.testing.assert_allclose(found.mean(axis=(0, 2)), expected.mean(axis=(0, 2)), rtol=0.05)


@pytest.mark.parametrize("roughness", [0.0, 0.1, 0.3])
def test_water_is_as_bright_as_by_paths(roughness: float) -> None:
    """Light is squeezed below water: factors that paths leave out photons must leave out too."""
    by_photons, by_paths = (
        by_caustics(water_scene(4.0, roughness), caustics, range(4)) for caustics in ("PHOTONS", "PATHS")
    )
    assert abs(z_of_means(by_photons, by_paths)) < 4.0
    assert by_photons.mean() == pytest.approx(by_paths.mean(), rel=0.02)


def test_a_mirror_that_half_of_the_light_passes_reflects_the_other_half() -> None:
    """As windows are made: light samples pass it, and know nothing of what it reflects."""
    half = mirror_scene()
    half.materials[1] = mixed_with_nothing(half.materials[1])
    alone = mirrored_scene()
    alone.lights = alone.lights[:1]
    found, direct, both = (pictures(scene, range(4), samples=256)[:, :9] for scene in (half, alone, mirrored_scene()))
    expected = 0.5 * (direct + both)
    assert found.mean() == pytest.approx(expected.mean(), rel=0.01)
    np.testing.assert_allclose(found.mean(axis=(0, 2)), expected.mean(axis=(0, 2)), rtol=0.05)


@pytest.mark.parametrize("to_shadows", [False, True])
def test_water_that_light_samples_pass_is_as_bright_as_by_paths(to_shadows: bool) -> None:
    """If all of them do, light comes to the floor twice, as in Cycles."""
    scene = water_scene()
    scene.materials[1] = mixed_with_nothing(scene.materials[1], to_shadows=to_shadows)
    by_photons, by_paths = (by_caustics(scene, caustics, range(4)) for caustics in ("PHOTONS", "PATHS"))
    assert abs(z_of_means(by_photons, by_paths)) < 4.0
    assert by_photons.mean() == pytest.approx(by_paths.mean(), rel=0.02)


@pytest.mark.parametrize("learned", [{"guiding_method": "VMM"}, {"radiance_cache": "CONVERGING"}])
def test_what_is_learned_changes_no_mean(learned: dict[str, str]) -> None:
    scene = water_scene()
    guided = by_caustics(scene, "PHOTONS", range(2), samples=128, **learned)
    assert guided.mean() == pytest.approx(by_caustics(scene, "PATHS", range(2)).mean(), rel=0.02)


@pytest.mark.parametrize("roughness", [0.1, 0.3])
def test_rough_mirrors_are_as_bright_as_by_paths(roughness: float) -> None:
    """Paths find the lamp by light samples at the mirror too, and all three are weighed against each other."""
    by_photons, by_paths = (
        pictures(mirror_scene(1.0, roughness), range(4), samples=256, caustics=caustics)[:, :9]
        for caustics in ("PHOTONS", "PATHS")
    )
    assert by_photons.mean() == pytest.approx(by_paths.mean(), rel=0.01)
    np.testing.assert_allclose(by_photons.mean(axis=(0, 2)), by_paths.mean(axis=(0, 2)), rtol=0.05)


def test_noise_makes_no_jump_where_facets_become_rough() -> None:
    """From a mirror on, and at the roughness from which on photons are gathered there."""
    noise = np.array([
        pictures(mirror_scene(0.1, roughness), range(4), samples=64)[:, :9].var(axis=0).mean()
        for roughness in (0.0, 0.005, 0.02, 0.05, 0.1, 0.15, 0.2)
    ])  # fmt: skip
    steps = noise[1:] / noise[:-1]
    assert 0.5 < steps.min() and steps.max() < 2.0


def test_photons_make_less_noise_where_the_lamp_is_small() -> None:
    by_photons, by_paths = (
        pictures(water_scene(0.3), range(2), samples=32, caustics=caustics) for caustics in ("PHOTONS", "PATHS")
    )
    assert 10.0 * by_photons.var(axis=0).mean() < by_paths.var(axis=0).mean()


@pytest.mark.parametrize("caustics", ["PHOTONS", "AUTO"])
def test_the_picture_is_the_same_for_any_number_of_threads(caustics: str) -> None:
    one, three = (
        render(mirror_scene(), threads=threads, caustics=caustics).passes["Combined"] for threads in (1, 3)
    )
    np.testing.assert_array_equal(one, three)


def test_a_trial_gives_up_where_photons_find_nothing_and_keeps_them_where_they_do() -> None:
    by_paths, automatic = (
        render(hidden_glass_scene(), caustics=caustics).passes["Combined"] for caustics in ("PATHS", "AUTO")
    )
    np.testing.assert_array_equal(automatic, by_paths)
    by_photons, automatic = (
        render(mirror_scene(), caustics=caustics).passes["Combined"] for caustics in ("PHOTONS", "AUTO")
    )
    np.testing.assert_array_equal(automatic, by_photons)


def test_the_gain_counts_light_that_paths_miss_as_missing() -> None:
    first, second = np.full((100, 3), 1.0, np.float32), np.full((100, 3), 1.2, np.float32)
    noise = 0.5 * 0.2**2
    rare = np.tile(np.array([0.001, 1e6], np.float32), (100, 1))
    assert gain_of_photons(first, second, rare) == pytest.approx(1.0 + 256 * 0.001**2 / noise, rel=1e-4)
    often = np.tile(np.array([1.0, 0.5], np.float32), (100, 1))
    assert gain_of_photons(first, second, often) == pytest.approx(1.0 + 0.5 / noise, rel=1e-4)


def test_pixels_of_a_trial_lie_in_the_region() -> None:
    pixels = tried_pixels((3, 5, 9, 8), 1)
    assert sorted(map(tuple, pixels)) == [(x, y) for x in range(3, 9) for y in range(5, 8)]


def test_filter_glossy_leaves_smooth_surfaces_to_photons_and_automatic_leaves_them_to_it() -> None:
    settings = {"filter_glossy": 1.0, "samples": 64}
    sharp, expected = render(mirror_scene(), **settings), render(mirrored_scene(), samples=64)
    assert sharp.passes["Combined"].mean() == pytest.approx(expected.passes["Combined"].mean(), rel=0.03)
    blurred = [render(mirror_scene(), caustics=caustics, **settings) for caustics in ("AUTO", "PATHS")]
    np.testing.assert_array_equal(blurred[0].passes["Combined"], blurred[1].passes["Combined"])


def test_what_casts_no_shadow_casts_no_caustics() -> None:
    """Light samples go through it already."""
    scene = water_scene()
    scene.instances.visibility = scene.instances.visibility.copy()
    scene.instances.visibility[1] &= ~np.uint32(VISIBLE_SHADOW)
    by_photons, by_paths = (render(scene, caustics=caustics).passes["Combined"] for caustics in ("PHOTONS", "PATHS"))
    np.testing.assert_array_equal(by_photons, by_paths)


@pytest.mark.parametrize("caustics", ["PHOTONS", "AUTO"])
def test_a_scene_without_lamps_has_no_photons(caustics: str) -> None:
    """Stages that sample lights are not there either."""
    scene = mirror_scene()
    scene.lights = []
    scene.world = World("world", "World", None, (1.0, 1.0, 1.0))
    picture = render(scene, samples=4, caustics=caustics).passes["Combined"]
    np.testing.assert_array_equal(picture, render(scene, samples=4, caustics="PATHS").passes["Combined"])


def test_what_photons_do_not_know_is_said() -> None:
    scene = mirror_scene()
    scene.fast_gi = FastGi(bounces=1)
    result = render(scene, samples=1)
    assert any(notice.subject == "Caustics by photons" for notice in result.report.notices)
    result = render(scene, samples=1, caustics="AUTO")
    assert not any(notice.subject == "Caustics by photons" for notice in result.report.notices)


def test_passes_sum_to_the_picture() -> None:
    session = Session(RenderSettings(samples=8, threads=1, caustics="PHOTONS", filter_glossy=0.0))
    session.load(mirror_scene())
    kinds = [f"{lobes} {part}" for lobes in ("Diffuse", "Glossy", "Transmission") for part in ("Direct", "Indirect")]
    colors = [f"{lobes} Color" for lobes in ("Diffuse", "Glossy", "Transmission")]
    passes = session.render(passes=["Combined", *kinds, *colors]).passes
    session.close()
    total = sum(
        passes[f"{lobes} Color"][..., :3] * (passes[f"{lobes} Direct"][..., :3] + passes[f"{lobes} Indirect"][..., :3])
        for lobes in ("Diffuse", "Glossy", "Transmission")
    )
    np.testing.assert_allclose(total, passes["Combined"][..., :3], rtol=1e-3, atol=1e-5)


def test_denoised_pictures_have_the_same_light_with_noise_of_their_own_in_each_pixel() -> None:
    """Noise of pixels next to each other is alike where they gather the same photons, which a denoiser would keep."""

    def noisy(is_denoised: bool) -> np.ndarray:
        name, settings = ("Noisy Image", {"use_denoising": True}) if is_denoised else ("Combined", {})
        found = by_caustics(mirror_scene(), "PHOTONS", range(8), name, MOST_NEIGHBOURS, samples=64, **settings)
        return found[:, :9].mean(axis=-1)

    def likeness(found: np.ndarray) -> float:
        noise = (found - found.mean(axis=0)) / found.mean(axis=0)
        return float((noise[:, :, 1:] * noise[:, :, :-1]).mean() / (noise**2).mean())

    plain, denoised = noisy(False), noisy(True)
    assert abs(z_of_means(plain, denoised)) < 4.0
    assert likeness(denoised) < 0.05 < likeness(plain)


def test_photons_keep_to_the_limit_of_diffuse_bounces() -> None:
    """With 0 no path goes on from the floor; so there are no caustics either, as in Cycles."""
    found, expected = (
        [by_caustics(water_scene(), name, range(4), samples=64, diffuse_bounces=bounces) for bounces in (0, 1)]
        for name in ("PHOTONS", "PATHS")
    )
    # The camera sees the lamp in the water.
    assert np.median(found[0]) == np.median(expected[0]) == 0.0 < np.median(expected[1])
    assert_same_light(found[1], expected[1], 0.02)
