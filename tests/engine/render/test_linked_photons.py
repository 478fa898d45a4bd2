# SPDX-License-Identifier: GPL-3.0-or-later
"""Caustics where lights and shadows are linked, and on shadow catchers: the same light as paths find."""

from __future__ import annotations

import numpy as np
import pytest

from engine.render.shadow_catchers import CATCHER_PASS
from engine.scene.description import SceneDescription
from tests.helpers.caustic_scenes import mirror_scene, water_scene
from tests.helpers.linked_caustics import lit_by_a_mesh, screened_water
from tests.helpers.linked_lights import no_linking
from tests.helpers.photon_renders import assert_same_light, pictures

pytestmark = pytest.mark.estimator
#: Kernels of links are kernels of their own, which take half a minute to compile.
with_links = pytest.mark.slow


@with_links
@pytest.mark.parametrize("passes", [1, 2])
def test_light_comes_through_what_casts_no_shadow_in_it(passes: int) -> None:
    """A screen between lamp and water, or the water itself, is no blocker."""
    scene = screened_water(passes)
    by_photons, by_paths = (pictures(scene, caustics) for caustics in ("PHOTONS", "PATHS"))
    assert_same_light(by_photons, by_paths, 0.02)
    assert by_photons.mean() > 1.1 * pictures(screened_water(None), "PHOTONS", [1]).mean()


@with_links
@pytest.mark.parametrize("roughness", [0.0, 0.2])
def test_glowing_meshes_with_blockers_are_the_photons_own(roughness: float) -> None:
    by_photons, by_paths = (pictures(lit_by_a_mesh(roughness), caustics) for caustics in ("PHOTONS", "PATHS"))
    assert_same_light(by_photons, by_paths, 0.02)


@with_links
def test_the_caster_decides_by_which_lamps_it_is_lit() -> None:
    """As paths do: behind glass they find what lights the glass."""
    scene = water_scene()
    scene.linking = no_linking(2, 1)
    scene.linking.receiver_set = np.array([0, 1], np.int32)
    for lit in (1, 2):
        scene.linking.lamp_receivers = np.full(1, lit, np.uint64)
        by_photons, by_paths = (pictures(scene, caustics) for caustics in ("PHOTONS", "PATHS"))
        if lit == 1:
            np.testing.assert_array_equal(by_photons, by_paths)
        else:
            assert_same_light(by_photons, by_paths, 0.02)


def _catching(scene: SceneDescription) -> SceneDescription:
    scene.instances.is_shadow_catcher = np.array([True, False])
    return scene


def test_a_catcher_shows_the_caustic_as_an_effect_of_the_object() -> None:
    """Beside a mirror it is brighter than alone; what it has alone stays the same."""
    by_photons, by_paths = (
        pictures(_catching(mirror_scene(2.0)), caustics, shown=CATCHER_PASS)[:, :9] for caustics in ("PHOTONS", "PATHS")
    )
    assert_same_light(by_photons, by_paths, 0.02)
    assert by_photons.mean() > 1.05


def test_a_catcher_that_reflects_casts_nothing() -> None:
    """The mirror catches, and the floor does not."""
    scene = mirror_scene(2.0)
    scene.instances.is_shadow_catcher = np.array([False, True])
    by_photons, by_paths = (pictures(scene, caustics, [1], samples=4) for caustics in ("PHOTONS", "PATHS"))
    np.testing.assert_array_equal(by_photons, by_paths)
