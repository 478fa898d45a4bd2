# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenes of dispersion: what they promise by geometry, rendered with the one index that nodes have."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.images import auto_exposure
from benchmarks.rendering import image_stack, render_scene
from benchmarks.rivals import Budget, find_rival
from benchmarks.scene_files import SceneSource
from benchmarks.scenes import SCENES, build
from benchmarks.scenes.spectral import (
    FLINT,
    PRISM_CAMERA_DISTANCE,
    PRISM_LENS,
    RING,
    RING_WIDTH,
    SLIT_DISTANCE,
    WATER,
    least_deviation,
    rainbow_angle,
)
from engine.spectral.dispersion import dispersion_from_abbe
from tests.helpers.color_difference import delta_e_2000, lab_of_rec709
from tests.helpers.spectral_harness import wavelengths_and_weights

#: Kernels of wavelengths are kernels of their own, which take half a minute to compile.
pytestmark = pytest.mark.slow

NAMES = sorted(name for name in SCENES if name.startswith("spectral-"))


def _image(name: str, samples: int, out: Path, spectral: str = "OFF") -> np.ndarray:
    rival = find_rival("OFF", {"spectral": spectral})
    renders, failures = render_scene(
        SceneSource(f"builtin:{name}"), [rival], Budget(samples), 1, out=out, pixels=120 * 120,
        say=lambda _: None,
    )  # fmt: skip
    assert not failures
    return image_stack(renders["OFF"])[0][..., :3]


def test_angles_of_the_textbooks() -> None:
    assert least_deviation(1.5) == pytest.approx(37.18, abs=0.01)
    assert rainbow_angle(1.333) == pytest.approx(42.1, abs=0.05)
    # Water at 400 and 700 nm (Hale and Querry 1973): the bow is 1.8 degrees wide, red outside.
    assert rainbow_angle(1.3310) == pytest.approx(42.4, abs=0.1)
    assert rainbow_angle(1.3435) == pytest.approx(40.6, abs=0.1)


@pytest.mark.parametrize("name", NAMES)
def test_only_what_should_disperses(blender: Any, name: str) -> None:
    from addon.export import export_scene

    build(name)
    description = export_scene(blender.context.evaluated_depsgraph_get())
    assert description.has_dispersion == (name != "spectral-colors")
    for material in description.materials:
        assert material.dispersion in (0.0, *(pytest.approx(dispersion_from_abbe(v)) for v in (28.4, 55.7, 25.7, 20.0)))


def test_the_slit_is_seen_in_the_middle_through_the_prism(blender: Any, tmp_path: Path) -> None:
    # In RGB everything has the index of the d line, for which the camera is aimed.
    image = _image("spectral-prism", 16, tmp_path).mean(axis=(0, 2))
    columns = np.arange(len(image))
    bright = image > 0.5 * image.max()
    assert bright.sum() <= 0.06 * len(image)
    assert abs((columns * image * bright).sum() / (image * bright).sum() - 0.5 * (len(image) - 1)) < 1.0


def test_without_dispersion_wavelengths_show_the_same_colours(blender: Any, tmp_path: Path) -> None:
    """Mean ΔE2000 of at most 1 after auto-exposure; of cells, since noise is no difference."""
    images = [_image("spectral-colors", 64, tmp_path / mode, mode) for mode in ("OFF", "ON")]
    exposure = auto_exposure(images[0])
    rows, columns = (size // 6 for size in images[0].shape[:2])
    labs = [
        lab_of_rec709(exposure * image[: 6 * rows, : 6 * columns].reshape(rows, 6, columns, 6, 3).mean(axis=(1, 3)))
        for image in images
    ]
    difference = delta_e_2000(*labs)
    assert difference.mean() < 1.0, difference.mean()
    # They are two renders: colours in the light of other colours do differ.
    assert difference.max() > 0.1


def test_the_ball_shows_the_ring_where_descartes_has_it(blender: Any, tmp_path: Path) -> None:
    image = _image("spectral-sphere", 64, tmp_path).mean(axis=2)
    height, width = image.shape
    y, x = np.mgrid[:height, :width]
    radius = np.hypot(x - 0.5 * (width - 1), y - 0.5 * (height - 1)) * 2.2 / width
    impact = np.linspace(0.75, 0.99, 2000)
    seen = np.degrees(4.0 * np.arcsin(impact / WATER[0]) - 2.0 * np.arcsin(impact))
    lit = impact[np.abs(seen - RING) < 0.5 * RING_WIDTH]
    expected = lit.min(), lit.max()
    pixel = 2.2 / width
    inside = (radius > expected[0] - 1.5 * pixel) & (radius < expected[1] + 1.5 * pixel)
    assert image[inside].sum() > 0.95 * image[radius > 0.6].sum()


def _weights(count: int = 400) -> tuple[np.ndarray, np.ndarray]:
    """Wavelengths as paths draw them [nm], and what each adds to Rec.709."""
    drawn = wavelengths_and_weights((np.arange(count) + 0.5) / count)
    return drawn[:, 0], drawn[:, 1:] / count


def _index(glass: tuple[float, float], wavelength: float) -> float:
    """Cauchy's formula from index and Abbe number; wavelengths in nm."""
    ior, abbe_number = glass
    b = (ior - 1.0) / abbe_number / (486.1**-2 - 656.3**-2)
    return ior + b * (wavelength**-2 - 587.6**-2)


def _refract(direction: np.ndarray, normal: np.ndarray, ratio: float) -> np.ndarray:
    """Snell's law in the plane: `ratio` is the index in front over that behind, the normal is on the side in front."""
    cosine = -direction @ normal
    behind = np.sqrt(1.0 - ratio**2 * (1.0 - cosine**2))
    return ratio * direction + (ratio * cosine - behind) * normal


def _crosses(origin: np.ndarray, direction: np.ndarray, point: np.ndarray, normal: np.ndarray) -> np.ndarray:
    return origin + direction * ((point - origin) @ normal) / (direction @ normal)


def _slit_offset(angle: float, ior: float) -> float:
    """How far from the slit's middle a ray ends that leaves the camera at an angle to its axis [m]."""
    half = np.radians(0.5 * least_deviation(FLINT[0]))
    face = 2.0 / (2.0 * np.sqrt(3.0)) / np.cos(np.radians(30.0))
    origin = np.array([face + PRISM_CAMERA_DISTANCE * np.cos(half), -PRISM_CAMERA_DISTANCE * np.sin(half)])
    axis = np.array([face, 0.0]) - origin
    heading = np.arctan2(axis[1], axis[0]) + angle
    direction = np.array([np.cos(heading), np.sin(heading)])
    # The faces that meet in the edge towards +y.
    right, left = np.array([np.cos(np.pi / 6), 0.5]), np.array([-np.cos(np.pi / 6), 0.5])
    corner = np.array([0.0, 2.0 / np.sqrt(3.0)])
    place = _crosses(origin, direction, corner, right)
    direction = _refract(direction, right, 1.0 / ior)
    place = _crosses(place, direction, corner, left)
    direction = _refract(direction, -left, ior)
    middle = np.array([-face - SLIT_DISTANCE * np.cos(half), -SLIT_DISTANCE * np.sin(half)])
    along = np.array([np.cos(half), np.sin(half)])
    across = np.array([-along[1], along[0]])
    return float((_crosses(place, direction, middle, along) - middle) @ across)


def _columns_of(ior: float, columns: int) -> float:
    """Column of the picture at which the slit's middle is seen through the prism."""
    low, high = -0.2, 0.2
    for _ in range(60):
        middle = 0.5 * (low + high)
        if _slit_offset(low, ior) * _slit_offset(middle, ior) <= 0.0:
            high = middle
        else:
            low = middle
    # 36 mm of film; angles grow to the left, columns to the right.
    return 0.5 * columns - np.tan(0.5 * (low + high)) * PRISM_LENS / 36.0 * columns - 0.5


def test_the_prism_spreads_the_slit_by_the_textbook(blender: Any, tmp_path: Path) -> None:
    """Where each channel's light is, to a third of a pixel; red is turned least."""
    image = _image("spectral-prism", 256, tmp_path, "AUTO")
    wide = image.shape[1]
    middle = image[image.shape[0] // 2 - 10 : image.shape[0] // 2 + 10].mean(axis=0)
    # The wall behind is a hundredth of the slit.
    middle = np.where(np.abs(middle) > 0.3, middle, 0.0)
    wavelengths, weights = _weights()
    expected = np.array([_columns_of(_index(FLINT, wavelength), wide) for wavelength in wavelengths])
    seen = (expected > 0.0) & (expected < wide - 1.0)
    columns = np.arange(wide)
    for channel in range(3):
        profile, weight = np.maximum(middle[:, channel], 0.0), weights[:, channel] * seen
        histogram = np.histogram(expected, np.arange(wide + 1) - 0.5, weights=weight)[0]
        histogram = np.maximum(np.convolve(histogram, np.ones(3) / 3.0, "same"), 0.0)
        found = (columns * profile).sum() / profile.sum()
        wanted = (columns * histogram).sum() / histogram.sum()
        assert abs(found - wanted) < 1.0, (channel, found, wanted)
    assert expected[wavelengths < 450.0].mean() - expected[wavelengths > 650.0].mean() > 20.0


def test_the_ball_shows_each_colour_where_descartes_has_it(blender: Any, tmp_path: Path) -> None:
    """Light that was reflected once inside, with Fresnel's terms, over the distance from the ball's middle."""
    image = _image("spectral-sphere", 256, tmp_path, "AUTO")
    height, width = image.shape[:2]
    y, x = np.mgrid[:height, :width]
    radius = np.hypot(x - 0.5 * (width - 1), y - 0.5 * (height - 1)) * 2.2 / width
    impact = np.linspace(0.6, 0.9995, 8000)
    expected = np.zeros((len(impact), 3))
    for wavelength, weight in zip(*_weights(), strict=True):
        ior = _index(WATER, wavelength)
        outer, inner = np.arcsin(impact), np.arcsin(impact / ior)
        # Reflectances across and along the plane; through the surface, off it inside, and through it.
        across = (np.sin(outer - inner) / np.sin(outer + inner)) ** 2
        along = (np.tan(outer - inner) / np.tan(outer + inner)) ** 2
        passed = 0.5 * ((1.0 - across) ** 2 * across + (1.0 - along) ** 2 * along)
        lit = np.abs(np.degrees(4.0 * inner - 2.0 * outer) - RING) < 0.5 * RING_WIDTH
        expected += 20.0 * np.outer(passed * lit, weight)
    # Two pixels wide, so that edges that fall into pixels matter little.
    edges = np.arange(0.72, 1.0, 0.04)
    for low, high in itertools.pairwise(edges):
        found = image[(radius >= low) & (radius < high)].mean(axis=0)
        wanted = expected[(impact >= low) & (impact < high)].mean(axis=0)
        np.testing.assert_allclose(found, wanted, atol=0.1, err_msg=f"{low} to {high}")
    assert np.ptp(expected, axis=1).max() > 0.8, "the colours come apart"
