# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenes of dispersion: what they promise by geometry, rendered with the one index that nodes have."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.rendering import image_stack, render_scene
from benchmarks.rivals import Budget, find_rival
from benchmarks.scene_files import SceneSource
from benchmarks.scenes import SCENES, build
from benchmarks.scenes.spectral import RING, RING_WIDTH, WATER, least_deviation, rainbow_angle
from engine.spectral.dispersion import dispersion_from_abbe

NAMES = sorted(name for name in SCENES if name.startswith("spectral-"))


def _image(name: str, samples: int, out: Path) -> np.ndarray:
    rival = find_rival("OFF", {"spectral": "OFF"})
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
