# SPDX-License-Identifier: GPL-3.0-or-later
"""Photons within media: the same light as paths find, and as mirrored lamps give.

Means are of seeds that are fixed. Tests of two means reject at 4 standard errors, which a correct renderer fails once
in 15,000.
"""

from __future__ import annotations

import numpy as np
import pytest

from engine.kernels.hash_grid import bucket_of, occupied_of_block
from engine.render.photon_radius import MOST_NEIGHBOURS
from engine.render.photons_within import PhotonsWithin, part_marks, with_marks
from engine.render.session import Session
from engine.settings import RenderSettings
from engine.state.photons import (
    BLOCK_CELLS,
    IS_WITHIN,
    MAP_MARKS,
    MAP_TUBE_BUCKETS,
    MAP_TUBE_EXPECTED,
    MAP_TUBE_INVERSE_CELL,
    MAP_TUBE_RADIUS,
    PHOTON_IS_WITHIN,
    PHOTON_P,
    PHOTON_START,
    PHOTON_WIDTH,
    PhotonMap,
    no_photons,
)
from tests.helpers.light_sums import LOBES, sum_of_passes
from tests.helpers.misty_scenes import milk_in_glass, milk_in_open_glass, mirror_in_fog, mirrored_in_fog, water_in_fog
from tests.helpers.photon_renders import pictures as by_caustics

pytestmark = pytest.mark.estimator

#: So many bounces that most light is found.
LIMITS = {"volume_bounces": 8, "max_bounces": 16}


def render(scene, samples=16, threads=1, passes=("Combined",), **settings):
    chosen = {"caustics": "PHOTONS", "filter_glossy": 0.0} | LIMITS | settings
    session = Session(RenderSettings(samples=samples, threads=threads, **chosen))
    session.load(scene)
    result = session.render(passes=passes)
    session.close()
    return result.passes


def pictures(scene, seeds, caustics="PHOTONS", **settings):
    """Grey ones, with as many neighbours as renders have."""
    chosen = LIMITS | settings
    return by_caustics(scene, caustics, seeds, neighbours=MOST_NEIGHBOURS, **chosen).mean(axis=-1)


def assert_alike(scene, seeds=range(4), samples=256, rel=0.02, **settings):
    """By photons the picture has the mean that it has by paths."""
    by_photons, by_paths = (
        pictures(scene, seeds, samples=samples, caustics=caustics, **settings).reshape(len(seeds), -1).mean(axis=1)
        for caustics in ("PHOTONS", "PATHS")
    )
    error = np.sqrt((by_photons.var(ddof=1) + by_paths.var(ddof=1)) / len(seeds))
    assert not np.array_equal(by_photons, by_paths), "no photon was gathered"
    assert abs(by_photons.mean() - by_paths.mean()) < 4.0 * error
    assert by_photons.mean() == pytest.approx(by_paths.mean(), rel=rel)


def marks_at(places) -> np.ndarray:
    marks = np.zeros((len(places), PHOTON_WIDTH), np.float32)
    marks[:, PHOTON_P : PHOTON_P + 3] = places
    marks[:, PHOTON_IS_WITHIN] = IS_WITHIN
    return marks


def begins(rows=4) -> PhotonMap:
    return no_photons(np.ones(rows, np.float32), np.linspace(0.25, 1.0, rows))


def test_marks_are_told_from_photons_that_have_arrived_at_surfaces() -> None:
    arrived = np.zeros((3, PHOTON_WIDTH), np.float32)
    # A unit normal's last column.
    arrived[:, PHOTON_IS_WITHIN] = 1.0, -1.0, 0.0
    marks = marks_at(np.ones((2, 3)))
    photons, within = part_marks(np.concatenate([arrived[:1], marks, arrived[1:]]))
    np.testing.assert_array_equal(photons, arrived)
    np.testing.assert_array_equal(within, marks)


def test_a_map_holds_each_mark_once_in_the_bucket_of_its_cell() -> None:
    marks = marks_at(np.random.default_rng(1).uniform(-3.0, 3.0, (500, 3)))
    grid = with_marks(begins(), marks, 1000, 0.25)
    assert sorted(map(tuple, grid.within)) == sorted(map(tuple, marks))
    mask = int(grid.header[MAP_TUBE_BUCKETS]) - 1
    starts = grid.starts_within[: mask + 2]
    assert starts[0] == 0 and starts[-1] == 500 and (np.diff(starts) >= 0).all()
    cells = np.floor(grid.within[:, PHOTON_P : PHOTON_P + 3] * grid.numbers[MAP_TUBE_INVERSE_CELL]).astype(np.int64)
    buckets = [bucket_of(*(np.int64(i) for i in cell), np.int64(0), np.int64(mask)) for cell in cells]
    assert (np.searchsorted(starts, np.arange(500), side="right") - 1 == buckets).all()
    # Of each block's cells it is known which hold any.
    places = np.arange(BLOCK_CELLS)
    for first in range(0, mask + 1, BLOCK_CELLS):
        word = occupied_of_block(grid.starts_within, mask + 1, first)
        np.testing.assert_array_equal(word >> places & 1, np.diff(starts)[first : first + BLOCK_CELLS] > 0)


def test_marks_are_as_many_as_pay_and_radii_shrink_as_knaus_and_zwicker_say() -> None:
    within, marks = PhotonsWithin(), marks_at(np.random.default_rng(2).uniform(0.0, 1.0, (1000, 3)))
    marks[:, PHOTON_START] = 1
    first = within.begin_with(begins(), marks, 4000, np.inf)
    # From now on all begin where those few have begun that left the marks: four times as many.
    later = begins()._replace(place_density=np.array([0.0, 4.0, 0.0, 0.0], np.float32))
    within.learn(first, later, 4000, 8000, np.inf)
    drawn = int(within.ready(later).header[MAP_MARKS])
    # One photon in sixteen collided for each mark drawn, one in four will.
    assert drawn == 2
    radii = [
        float(within.add_to(within.ready(later), marks, 8000, sent).numbers[MAP_TUBE_RADIUS])
        for sent in (8000, 8000 * 2**7)
    ]
    assert radii[1] == pytest.approx(0.5 * radii[0], rel=1e-5)
    # Four times as many marks lie as close in a quarter of the volume.
    assert radii[0] == pytest.approx(4.0 ** (-1.0 / 3.0) * first.numbers[MAP_TUBE_RADIUS], rel=0.02)
    made = within.add_to(within.ready(later), marks, 8000, 8000)
    assert made.numbers[MAP_TUBE_EXPECTED] == pytest.approx(2 * 8000 / 4 * 4.0 * np.pi * radii[0] ** 3, rel=1e-5)


def test_a_first_map_without_marks_has_the_radius_of_surfaces() -> None:
    within, none = PhotonsWithin(), marks_at(np.zeros((0, 3)))
    bare = begins()
    bare.numbers[0] = 0.5
    first = within.begin_with(bare, none, 4000, np.inf)
    within.learn(first, begins(), 4000, 8000, np.inf)
    assert first.numbers[MAP_TUBE_RADIUS] == pytest.approx(0.5)
    assert within.add_to(begins(), none, 8000, 8000).numbers[MAP_TUBE_RADIUS] == pytest.approx(0.5)


def test_fog_beside_a_mirror_is_lit_as_by_the_mirrored_lamp() -> None:
    """However often it scatters; no path finds that light."""
    # As far before the mirror as photons are gathered from.
    found, expected = (
        pictures(scene, range(4), samples=256)[:, :9] for scene in (mirror_in_fog(), mirrored_in_fog())
    )
    assert found.mean() == pytest.approx(expected.mean(), rel=0.01)
    np.testing.assert_allclose(found.mean(axis=(0, 2)), expected.mean(axis=(0, 2)), rtol=0.05)


@pytest.mark.parametrize(
    "scene",
    [
        pytest.param(lambda: water_in_fog(), id="even"),
        pytest.param(lambda: water_in_fog(g=0.7), id="forward"),
        pytest.param(lambda: water_in_fog(density=1.0, color=(0.9, 0.6, 0.2)), id="coloured"),
        pytest.param(lambda: water_in_fog(roughness=0.2), id="rough"),
        pytest.param(lambda: milk_in_glass(), id="milk"),
        pytest.param(lambda: milk_in_glass(roughness=0.2), id="milk in rough glass"),
    ],
)
def test_media_are_as_bright_as_by_paths(scene) -> None:
    """Below water, and within what is filled with them: the lamp is so wide that paths find it."""
    assert_alike(scene())


@pytest.mark.parametrize("scene", [milk_in_open_glass, lambda: milk_in_glass(boxes=2)], ids=["open", "touching"])
def test_broken_glass_around_a_medium_is_as_bright_as_by_paths(scene) -> None:
    """A side is missing, or another glass of milk touches it in a whole side."""
    assert_alike(scene())


@pytest.mark.parametrize("limits", [{"volume_bounces": 1}, {"max_bounces": 3}, {"transmission_bounces": 2}])
def test_photons_keep_to_the_limits_of_paths(limits: dict[str, int]) -> None:
    assert_alike(water_in_fog(density=1.0), **limits)


@pytest.mark.parametrize("limits", [{"volume_bounces": 0}, {"max_bounces": 2}])
def test_where_no_path_goes_on_from_a_collision_photons_find_nothing_there(limits: dict[str, int]) -> None:
    by_photons, by_paths = (
        pictures(water_in_fog(density=1.0), range(4), samples=64, caustics=caustics, **limits)
        for caustics in ("PHOTONS", "PATHS")
    )
    means = [one.reshape(len(one), -1).mean(axis=1) for one in (by_photons, by_paths)]
    error = np.sqrt(sum(mean.var(ddof=1) for mean in means) / len(by_paths))
    assert abs(means[0].mean() - means[1].mean()) < 4.0 * error


@pytest.mark.parametrize("learned", [{"guiding_method": "VMM"}, {"radiance_cache": "CONVERGING"}])
def test_what_is_learned_changes_no_mean(learned: dict[str, str]) -> None:
    scene = water_in_fog()
    found = pictures(scene, range(2), samples=128, **learned).mean()
    assert found == pytest.approx(pictures(scene, range(2), samples=256, caustics="PATHS").mean(), rel=0.02)


def test_photons_make_less_noise_in_media_where_the_lamp_is_small() -> None:
    by_photons, by_paths = (
        pictures(milk_in_glass(size=0.3, x=2.0), range(3), samples=32, caustics=caustics)
        for caustics in ("PHOTONS", "PATHS")
    )
    assert 4.0 * by_photons.var(axis=0).mean() < by_paths.var(axis=0).mean()


def test_the_picture_is_the_same_for_any_number_of_threads() -> None:
    one, three = (render(mirror_in_fog(), threads=threads, caustics="AUTO")["Combined"] for threads in (1, 3))
    np.testing.assert_array_equal(one, three)


def test_a_trial_counts_what_media_gather() -> None:
    """The floor is black: what photons bring is the fog's."""
    scene = mirror_in_fog()
    scene.materials[0].graph.nodes[0].inputs["Color"] = (0.0, 0.0, 0.0, 1.0)
    by_photons, automatic = (render(scene, caustics=caustics)["Combined"] for caustics in ("PHOTONS", "AUTO"))
    np.testing.assert_array_equal(automatic, by_photons)


def test_passes_sum_to_the_picture() -> None:
    parts = ["Combined", "Volume Direct", "Volume Indirect", "Emission", "Environment"]
    parts += [f"{lobes} {part}" for lobes in LOBES for part in ("Direct", "Indirect", "Color")]
    images = render(mirror_in_fog(), samples=8, passes=parts)
    np.testing.assert_allclose(sum_of_passes(images), images["Combined"][..., :3], rtol=1e-3, atol=1e-5)
