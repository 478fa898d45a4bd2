# SPDX-License-Identifier: GPL-3.0-or-later
"""Light groups with a radiance cache that converges: each group's light, and that their sum is the picture."""

from dataclasses import replace

import numpy as np
import pytest

from engine.render.group_residual import groups_behind
from engine.render.light_passes import group_pass
from engine.scene.description import World
from engine.state.film import LIGHT_PARTS
from engine.state.group_parts import FOUND_SQUARE, FOUND_WIDTH
from engine.state.lanes import PART_GROUPS
from tests.helpers.seeded_renders import Z_LIMIT, render, z_score
from tests.helpers.small_scenes import pit_scene, sun

GROUPS = ("Key", "Sky")
NAMES = ("Combined", *map(group_pass, GROUPS))
#: Paths are long, and limits that they often meet would keep them from ending.
SETTINGS = {"samples": 63, "max_bounces": 96, "diffuse_bounces": 96, "passes": NAMES}
SEEDS = 4


def grouped_pit(sky_group=1):
    """A pit under a white sun and a blue sky: most light has met several walls."""
    scene = replace(pit_scene((24, 24)), light_groups=GROUPS)
    scene.lights = [replace(sun(), light_group=0)]
    scene.world = World("sky", "Sky", None, (0.05, 0.1, 0.3), light_group=sky_group)
    return scene


def images(seed, cache="CONVERGING", **settings):
    result = render("OFF", seed, **{"scene": grouped_pit, **SETTINGS, **settings}, radiance_cache=cache)
    assert not result.report.notices
    if cache != "OFF":
        assert sum(result.report.cached_shares) > 0.3
    return {name: image[..., :3] for name, image in result.passes.items()}


def test_the_mean_of_each_group_is_right_and_their_sum_the_picture():
    plain = [images(100 + seed, "OFF") for seed in range(SEEDS)]
    cached = [images(seed) for seed in range(SEEDS)]
    for name in NAMES:
        means = [np.array([image[name].mean() for image in renders]) for renders in (cached, plain)]
        assert z_score(*means) < Z_LIMIT, name
        assert means[0].mean() == pytest.approx(means[1].mean(), rel=0.02), name
    for image in cached:
        whole = image["Combined"]
        assert np.allclose(sum(image[name] for name in NAMES[1:]), whole, rtol=1e-4, atol=1e-5 * whole.max())
    reference = {name: np.mean([image[name] for image in plain], axis=0) for name in NAMES}
    for name in NAMES:
        # The reference has a quarter of the noise of one of its renders.
        error, of_plain = (
            np.mean([((image[name] - reference[name]) ** 2).mean() for image in renders]) for renders in (cached, plain)
        )
        assert error < of_plain, (name, error, of_plain)


def test_light_of_no_group_is_in_none():
    """The sky's is left over; that it is what the sky brings is told by its own pass."""
    whole, alone = images(1), images(1, scene=lambda: grouped_pit(sky_group=-1))
    assert not alone["Combined_Sky"].any()
    left = alone["Combined"] - alone["Combined_Key"]
    np.testing.assert_allclose(left, whole["Combined_Sky"], rtol=1e-3, atol=1e-4 * whole["Combined"].max())


def film_light(found, second, square, cells):
    """Columns of a film of 1 group by hand: found (2, P, 3) of it and of none, their second halves and squares."""
    pixel_count = found.shape[1]
    part_count = PART_GROUPS + 1 + 3 + 2
    light = np.zeros((pixel_count, LIGHT_PARTS + 3 * part_count + 2 * FOUND_WIDTH), np.float32)
    first = LIGHT_PARTS + 3 * (PART_GROUPS + 1)
    light[:, first : first + 3] = cells
    for group in range(2):
        column = first + 3 * (1 + group)
        light[:, column : column + 3] = found[group]
        apart = LIGHT_PARTS + 3 * part_count + FOUND_WIDTH * group
        light[:, apart : apart + 3] = second[group]
        light[:, apart + FOUND_SQUARE] = square[group]
    return light, part_count


def behind(found, square, cells, residual, shape):
    light, part_count = film_light(found, 0.5 * found, square, cells)
    ones = np.ones((len(cells), 1), np.float32)
    return groups_behind(light, 1, part_count, ones, ones[:, 0], residual, shape)


def test_what_is_sure_is_kept_and_the_rest_is_shared_out():
    shape, rng = (16, 16), np.random.default_rng(1)
    cells = np.ones((256, 3), np.float32)
    found = np.stack([0.25 * cells, 0.75 * cells]) * np.array([1.0, 2.0, 4.0], np.float32)
    nothing = np.zeros((2, 256))
    # Paths found other light in all than cells said: shares are by what was found, by channel.
    known = behind(found, nothing, cells, np.zeros_like(cells), shape)
    np.testing.assert_allclose(known[0], 0.25, rtol=1e-3)
    residual = rng.uniform(-0.5, 0.5, cells.shape).astype(np.float32)
    known = behind(found, nothing, cells, residual, shape)
    np.testing.assert_allclose(known.sum(axis=0), cells + residual, rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(known[0], 0.25 * (cells + residual), rtol=1e-2, atol=1e-4)


def test_noise_of_single_pixels_is_not_kept():
    shape, rng = (16, 16), np.random.default_rng(2)
    cells = np.ones((256, 3), np.float32)
    is_key = rng.uniform(size=(256, 1)) < 0.25
    found = np.stack([np.where(is_key, cells, 0.0), np.where(is_key, 0.0, cells)]).astype(np.float32)
    # One path a pixel: half of the pixels are in each half, and squares are those of what was found.
    second = np.where(rng.uniform(size=(256, 1)) < 0.5, found, 0.0)
    light, part_count = film_light(found, second, (found**2).mean(axis=-1), cells)
    ones = np.ones((256, 1), np.float32)
    known = groups_behind(light, 1, part_count, ones, ones[:, 0], np.zeros_like(cells), shape)
    assert known[0].std() < 0.1 and known[0].mean() == pytest.approx(found[0].mean(), abs=0.05)
    np.testing.assert_allclose(known.sum(axis=0), cells, rtol=1e-4)


def test_without_any_measure_light_is_of_no_group():
    cells = np.ones((256, 3), np.float32)
    known = behind(np.zeros((2, 256, 3), np.float32), np.zeros((2, 256)), cells, np.zeros_like(cells), (16, 16))
    assert not known[0].any() and np.allclose(known[1], 1.0)
