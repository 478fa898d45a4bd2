# SPDX-License-Identifier: GPL-3.0-or-later
"""The radiance cache together with what else a render may have: the mean stays that of paths that find all light."""

import numpy as np
import pytest

from engine.scene.description import Light, World
from tests.helpers.media_scenes import volume_graph
from tests.helpers.pits import PITS
from tests.helpers.seeded_renders import Z_LIMIT, render, z_score
from tests.helpers.small_scenes import pit_scene

pytestmark = pytest.mark.estimator

#: Paths are long, and limits that they often meet would keep them from ending.
SETTINGS = {
    "samples": 63, "max_bounces": 96, "diffuse_bounces": 96, "volume_bounces": 96, "light_sampling_threshold": 0.0,
}  # fmt: skip
SEEDS = 4


def lamp(x, energy=400.0):
    """A small lamp in a pit, above its floor."""
    transform = np.eye(4, dtype=np.float32)
    transform[:3, 3] = x, 0.5, 2.0
    return Light(f"lamp{x}", "Lamp", "POINT", transform, (1.0, 0.8, 0.6), energy, radius=0.3)


def moving_pit():
    """A wall comes nearer while the shutter is open."""
    scene = pit_scene((24, 24))
    still = scene.instances.transform
    moved = still.copy()
    moved[1, 0, 3] += 1.5
    scene.instances.motion = {1: np.stack([still[1], moved[1]])}
    return scene


def foggy_pit():
    """A lamp in a pit, all in fog."""
    scene = pit_scene((24, 24))
    scene.lights = [lamp(-1.0)]
    graph = volume_graph("Scatter", Color=(0.9, 0.8, 0.7, 1.0), Density=0.08, Anisotropy=0.3)
    scene.world = World("fog", "Fog", graph)
    return scene


def means(scene, cache, first, **settings):
    """Mean of each render, and the share of its paths that ended in the cache."""
    found, ended = [], []
    for seed in range(SEEDS):
        result = render("OFF", first + seed, scene=scene, radiance_cache=cache, **{**SETTINGS, **settings})
        assert not result.report.notices
        found.append(result.passes["Combined"][..., :3].mean())
        ended.append(sum(result.report.cached_shares))
    return np.array(found), min(ended)


CASES = {"motion": moving_pit, "fog": foggy_pit, **PITS}


@pytest.mark.parametrize("scene", CASES.values(), ids=CASES)
def test_the_mean_is_that_of_paths_that_find_all_light(scene):
    plain, nothing = means(scene, "OFF", 100)
    cached, ended = means(scene, "CONVERGING", 0)
    assert nothing == 0.0 and ended > 0.2
    assert z_score(cached, plain) < Z_LIMIT
    assert cached.mean() == pytest.approx(plain.mean(), rel=0.02)


def test_the_mean_is_right_where_pixels_stop_by_their_noise():
    settings = {
        "samples": 256, "use_adaptive_sampling": True, "adaptive_threshold": 0.02, "adaptive_min_samples": 16,
        "scene": pit_scene,
    }  # fmt: skip
    plain, _ = means(cache="OFF", first=100, **{**settings, "use_adaptive_sampling": False, "samples": 64})
    cached, ended = means(cache="CONVERGING", first=0, **settings)
    assert ended > 0.2 and cached.mean() == pytest.approx(plain.mean(), rel=0.01)
