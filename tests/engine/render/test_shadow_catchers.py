# SPDX-License-Identifier: GPL-3.0-or-later
"""Shadow catchers where they can be worked out on paper: a floor that catches, and what stands between it and a sun."""

import numpy as np
import pytest

from engine.render.session import Session
from engine.render.shadow_catchers import CATCHER_PASS, caught_share, with_shadows
from engine.scene.description import World
from engine.settings import RenderSettings
from engine.state.film import CAUGHT_ALONE, CAUGHT_COUNT, CAUGHT_LIGHT, CAUGHT_WIDTH
from tests.helpers.seeded_renders import Z_LIMIT, z_score
from tests.helpers.small_scenes import floor_scene, pit_scene, sun

pytestmark = pytest.mark.estimator

#: A sheet of 2 x 2 m over the middle of the floor, above the camera: its shadow is seen and it is not.
_SHEET = np.diag([0.02, 0.02, 1.0, 1.0]).astype(np.float32)
_SHEET[2, 3] = 12.0


def render(description, passes=("Combined",), **settings):
    session = Session(RenderSettings(**{"samples": 4, "threads": 1, **settings}))
    session.load(description)
    result = session.render(passes=passes)
    session.close()
    return result


def catching(*, sheet=_SHEET, world=None):
    """The floor catches shadows; the sheet does not."""
    description = floor_scene(lights=[sun(2.0)], transforms=[np.eye(4), sheet], world=world)
    description.instances.is_shadow_catcher = np.array([True, False])
    return description


def middle(image):
    """Pixels well within the sheet's shadow, and well outside of it."""
    return image[14:18, 22:26], image[:4, :6]


def test_a_shadow_is_alpha_on_a_transparent_film():
    image = render(catching(), film_transparent=True).passes["Combined"]
    inside, outside = middle(image)
    assert np.allclose(inside, (0.0, 0.0, 0.0, 1.0), atol=1e-6)
    assert np.allclose(outside, 0.0, atol=1e-6)


def test_with_its_pass_the_shadow_is_there_alone():
    # Light that goes from the floor to the sheet and back counts as well.
    images = render(catching(), passes=["Combined", CATCHER_PASS], film_transparent=True, max_bounces=0).passes
    assert np.allclose(images["Combined"], 0.0, atol=1e-6)
    inside, outside = middle(images[CATCHER_PASS])
    assert np.allclose(inside, 0.0, atol=1e-6) and np.allclose(outside, 1.0, atol=1e-6)


def test_a_shadow_darkens_the_background_of_a_film_that_is_not_transparent():
    """The world, of 0.2, and the sun: in the shadow there is the world's light alone, or less behind the sheet."""
    image = render(catching(world=World("world", "World", None, (0.2, 0.2, 0.2))), samples=64).passes["Combined"]
    inside, outside = middle(image)
    assert np.allclose(image[..., 3], 1.0)
    # Irradiance: pi x 0.2 of the world, 2 of the sun; the sheet hides little of the world.
    share = 0.2 * np.pi / (0.2 * np.pi + 2.0)
    assert inside[..., 0].mean() == pytest.approx(0.2 * share, rel=0.05)
    assert outside[..., 0].mean() == pytest.approx(0.2, rel=0.02)


def test_what_is_no_catcher_is_shown_before_the_catcher():
    low = _SHEET.copy()
    low[2, 3] = 4.0
    image = render(catching(sheet=low), film_transparent=True).passes["Combined"]
    assert np.allclose(image[14:18, 22:26], (0.5 / np.pi * 2.0,) * 3 + (1.0,), rtol=1e-3)


def test_the_pass_of_a_scene_without_catchers_is_white():
    assert (render(floor_scene(lights=[sun()]), passes=["Combined", CATCHER_PASS]).passes[CATCHER_PASS] == 1.0).all()


def test_a_holdout_catches_nothing():
    description = catching()
    description.instances.is_holdout[0] = True
    image = render(description, film_transparent=True).passes["Combined"]
    assert np.allclose(image, 0.0, atol=1e-6)


def test_guided_paths_catch_the_same_shadows():
    world = World("world", "World", None, (0.2, 0.2, 0.2))
    plain = render(catching(world=world), samples=64, film_transparent=True).passes["Combined"]
    guided = render(
        catching(world=world), samples=64, film_transparent=True, guiding_method="VMM", guiding_trial=False
    ).passes["Combined"]
    assert guided.mean(axis=(0, 1)) == pytest.approx(plain.mean(axis=(0, 1)), abs=0.01)


def catching_pit():
    """A pit, one wall of which catches shadows, under a sun and a sky."""
    scene = pit_scene((24, 24))
    scene.world = World("world", "World", None, (0.1, 0.1, 0.2))
    scene.instances.is_shadow_catcher = np.array([False, True, False, False, False])
    return scene


def test_with_a_converging_cache_the_picture_and_its_shadows_are_right_on_average():
    """Paths of catchers find all light themselves; those of the walls end in the cache."""
    long = {"samples": 63, "max_bounces": 96, "diffuse_bounces": 96, "passes": ("Combined", CATCHER_PASS)}
    means: dict[str, list] = {"OFF": [], "CONVERGING": []}
    for cache, found in means.items():
        for seed in range(4):
            first = 100 if cache == "OFF" else 0
            result = render(catching_pit(), radiance_cache=cache, seed=first + seed, **long)
            assert not result.report.notices and (sum(result.report.cached_shares) > 0.1) == (cache != "OFF")
            found.append([result.passes[name][..., :3].mean() for name in long["passes"]])
    for plain, cached in zip(np.transpose(means["OFF"]), np.transpose(means["CONVERGING"]), strict=True):
        assert z_score(cached, plain) < Z_LIMIT and cached.mean() == pytest.approx(plain.mean(), rel=0.02)


def test_shares_and_shadows_of_pixels():
    caught = np.zeros((4, CAUGHT_WIDTH), np.float32)
    caught[:, CAUGHT_LIGHT], caught[:, CAUGHT_ALONE] = (0.0, 0.5, 0.5, 0.5), (0.0, 1.0, 1.0, 0.0)
    caught[1:, CAUGHT_COUNT] = 1.0
    share = caught_share(caught, np.array((1.0, 1.0, 0.5, 1.0), np.float32))
    assert np.allclose(share[:, 0], (1.0, 0.5, 0.75, 1.0)) and np.allclose(share[:, 1:], 1.0)
    color = np.full((4, 3), 0.5, np.float32)
    matte, alpha = with_shadows(color, np.ones(4, np.float32), caught, is_transparent=True, has_pass=True)
    assert np.allclose(matte[:, 0], (0.5, 0.0, 0.0, 0.0)) and np.allclose(alpha, 1.0)
