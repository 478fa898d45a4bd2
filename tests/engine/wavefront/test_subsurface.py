# SPDX-License-Identifier: GPL-3.0-or-later
"""Light that goes in below a surface comes out again: all of it where nothing is absorbed."""

from __future__ import annotations

import numpy as np
import pytest

from engine.kernels.disk_sampling import burley_density
from engine.kernels.random_walk import Entry, direction_about, towards_densities, towards_surface
from engine.render.session import Session
from engine.runtime.jit import in_python
from engine.scene.description import Light
from engine.settings import RenderSettings
from tests.helpers.media_renders import means_by_seed, picture, render
from tests.helpers.media_scenes import media_scene, placed
from tests.helpers.placed_quads import steps, turned
from tests.helpers.small_scenes import material
from tests.helpers.subsurface_scenes import below, box_scene

pytestmark = pytest.mark.estimator

METHODS = ("RANDOM_WALK", "RANDOM_WALK_LEGACY", "RANDOM_WALK_SKIN")


def test_guided_directions_have_the_density_that_they_are_weighed_by() -> None:
    length = 1.7
    log_ratio = float(np.log((length + 1.0) / (length - 1.0)))
    entry = Entry((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), length, 1.0 / length, log_ratio, -1.0)
    u = (np.arange(4096) + 0.5) / 4096
    cosines = np.array([in_python(towards_surface)(entry, number) for number in u])
    densities, mirrored = np.array([in_python(towards_densities)(entry, cosine) for cosine in cosines]).T
    # Of an even u the density is that of its steps.
    np.testing.assert_allclose(2.0 * np.pi * densities[1:-1] * np.gradient(cosines)[1:-1] * 4096, 1.0, rtol=1e-3)
    other_side = [in_python(towards_densities)(entry, -cosine)[0] for cosine in cosines]
    np.testing.assert_allclose(mirrored, other_side, rtol=1e-5)
    assert cosines.min() >= -1.0 and cosines.max() <= 1.0
    axis = (0.0, 0.6, 0.8)
    assert np.dot(in_python(direction_about)(axis, 0.3, 0.7), axis) == pytest.approx(0.3, abs=1e-6)


def test_all_of_burleys_profile_lies_within_its_end() -> None:
    r = (np.arange(40000) + 0.5) / 40000 * 16.0 * 0.2
    total = sum(in_python(burley_density)(np.float32(0.2), np.float32(distance)) for distance in r) * (r[1] - r[0])
    assert total == pytest.approx(1.0, abs=1e-3)
    assert in_python(burley_density)(np.float32(0.0), np.float32(0.1)) == 0.0


# Rays that skin refracts at a facet seen from its back do not go in: Cycles 5.3 gives 0.9098.
@pytest.mark.parametrize(
    "method, white", [("RANDOM_WALK", 1.0), ("RANDOM_WALK_LEGACY", 1.0), ("RANDOM_WALK_SKIN", 0.9098)]
)
def test_a_white_box_under_a_white_sky_is_white(method: str, white: float) -> None:
    means = means_by_seed(box_scene(below(method, scale=2.0)), samples=64, seeds=6)
    error = means.std(axis=0, ddof=1) / np.sqrt(len(means))
    # A millionth is absorbed at each step, and a walk of 256 steps ends (Cycles' rules).
    assert (np.abs(means.mean(axis=0) - white) <= 4.0 * error + 5e-4).all()


def test_a_white_box_stays_white_while_it_moves() -> None:
    """Up by two metres, and turning, under a camera that sees its top throughout: walks keep to their path's time."""
    scene = box_scene(below("RANDOM_WALK", scale=0.5))
    places = (turned(0.4 * t, position=(0.3 * t, -0.2 * t, t)) for t in (-1.0, 0.0, 1.0))
    scene.instances.motion = {0: steps(*places)}
    means = means_by_seed(scene, samples=64, seeds=6)
    error = means.std(axis=0, ddof=1) / np.sqrt(len(means))
    assert (np.abs(means.mean(axis=0) - 1.0) <= 4.0 * error + 5e-4).all()


def test_shallow_light_comes_back_as_in_cycles() -> None:
    means = means_by_seed(box_scene(below("RANDOM_WALK", (0.8, 0.5, 0.2), scale=0.01)), samples=64, seeds=6)
    error = means.std(axis=0, ddof=1) / np.sqrt(len(means))
    # Cycles 5.3, 32 x 32 pixels of 256 samples, of a box of the same size.
    cycles = (0.76553, 0.44440, 0.16587)
    assert (np.abs(means.mean(axis=0) - cycles) <= 4.0 * error + 0.005 * np.array(cycles)).all()


@pytest.mark.parametrize(
    "inputs",
    [
        {"radius": (0.0, 0.0, 0.0)}, {"radius": (1.0, 0.0, -1.0)}, {"scale": 1e6}, {"scale": 1e-6}, {"scale": 0.0},
        {"color": (0.0, 1.0, 2.0)}, {"Anisotropy": 1.0}, {"Anisotropy": -1.0}, {"IOR": 0.0}, {"Roughness": 0.0},
        {"radius": (float("nan"), 1.0, 1.0)}, {"color": (0.0, 0.0, 0.0)},
    ],
)  # fmt: skip
def test_whatever_the_numbers_are_the_picture_is_one(inputs: dict) -> None:
    materials = [below(method, **inputs) for method in (*METHODS, "BURLEY")]
    image = picture(box_scene(*materials), samples=4)
    assert np.isfinite(image).all() and (image >= 0.0).all()


@pytest.mark.parametrize("size", [(1.0, 1.0, 0.0), (0.0, 0.0, 0.0), (1.0, 1.0, 1e-20), (1e4, 1.0, 1e-3)])
def test_open_and_flat_objects_give_a_picture(size: tuple[float, float, float]) -> None:
    materials = [below(method, Anisotropy=g) for method in (*METHODS, "BURLEY") for g in (-0.99, 0.99)]
    scene = media_scene(materials, [placed(size, (0.1 * k, 0.0, 0.0)) for k in range(len(materials))])
    mesh = scene.meshes[0]
    mesh.triangles, mesh.material_slots = mesh.triangles[2:7].copy(), mesh.material_slots[2:7].copy()
    image = picture(scene, samples=4)
    assert np.isfinite(image).all() and (image >= 0.0).all()


@pytest.mark.slow
def test_wavelengths_keep_the_mean() -> None:
    """Greys are the same at every wavelength, so that channels of different depths show their own mean."""
    scene = box_scene(below(color=(0.6, 0.6, 0.6), radius=(0.4, 0.4, 0.4)), below("BURLEY", color=(0.6, 0.6, 0.6)))
    plain, spectral = (means_by_seed(scene, samples=64, seeds=6, spectral=on) for on in ("OFF", "ON"))
    error = np.hypot(plain.std(axis=0, ddof=1), spectral.std(axis=0, ddof=1)) / np.sqrt(6)
    assert (np.abs(plain.mean(axis=0) - spectral.mean(axis=0)) <= 4.0 * error + 0.002).all()


def test_the_picture_is_the_same_for_any_number_of_threads() -> None:
    scene = box_scene(below(), below("BURLEY"), lights=[Light("l", "Lamp", "POINT", np.eye(4), (1.0, 1.0, 1.0), 50.0)])
    one, four = (picture(scene, samples=8, threads=threads) for threads in (1, 4))
    np.testing.assert_array_equal(one, four)


def test_light_below_is_diffuse_light_in_passes() -> None:
    passes = ("Combined", "Diffuse Direct", "Diffuse Indirect", "Diffuse Color", "Glossy Direct", "Albedo")
    found = render(box_scene(below(color=(0.5, 0.5, 0.5), scale=0.2)), passes, samples=16).passes
    light = found["Diffuse Color"] * (found["Diffuse Direct"] + found["Diffuse Indirect"])
    np.testing.assert_allclose(light[..., :3], found["Combined"][..., :3], atol=1e-5)
    np.testing.assert_allclose(found["Albedo"][..., :3], 0.5, atol=1e-5)
    assert not found["Glossy Direct"][..., :3].any()


@pytest.mark.slow
def test_guiding_changes_no_mean() -> None:
    """Guided wherever it can be. No path would end in a radiance cache here: `tests/helpers/pits.py` is for that."""
    settings = {"guiding_method": "VMM", "guiding_trial": False, "learn_guiding_probability": False}
    lamp = Light("l", "Lamp", "POINT", np.eye(4), (1.0, 1.0, 1.0), 50.0)
    scene = box_scene(below(color=(0.8, 0.6, 0.4)), below("BURLEY"), lights=[lamp], world=(0.2, 0.2, 0.2))
    plain = means_by_seed(scene, samples=128, seeds=8)
    learned = means_by_seed(scene, samples=128, seeds=8, **settings)
    error = np.hypot(plain.std(axis=0, ddof=1), learned.std(axis=0, ddof=1)) / np.sqrt(8)
    assert (np.abs(plain.mean(axis=0) - learned.mean(axis=0)) <= 4.0 * error).all()


def test_scenes_without_it_have_no_stage_for_it() -> None:
    session = Session(RenderSettings(samples=1, threads=1, guiding_method="OFF"))
    session.load(box_scene(material()))
    scene = session.scene
    assert scene is not None and not scene.local_scenes.handles.any() and not len(scene.local_scenes.scenes)
    session.close()
