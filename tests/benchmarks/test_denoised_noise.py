# SPDX-License-Identifier: GPL-3.0-or-later
"""What the denoiser makes of our noise: nothing about which pixels had which samples may be seen in its picture."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest

from benchmarks import metrics
from benchmarks.images import Float32Array
from benchmarks.metrics import FloatArray
from benchmarks.stability_cases import Case, describe_case
from engine.denoise import library
from engine.denoise.filter import denoise
from engine.render.session import Session
from tests.helpers.some_cases import every

pytestmark = pytest.mark.skipif(bool(library.problem()), reason="no Open Image Denoise here")

#: Blender's defaults, but for what a scene says of its samples.
DEFAULTS = {"clamp_indirect": 10.0, "filter_glossy": 1.0, "light_sampling_threshold": 0.01}
PASSES = ("Combined", "Denoising Albedo", "Denoising Normal")
#: Of everything that a pixel has: colour, albedo, normal.
CHANNELS = 9


@contextmanager
def opened(scene: str, size: tuple[int, int], **settings: object) -> Iterator[Session]:
    description, base = describe_case(Case(scene, scene, size=size, settings=DEFAULTS | settings), threads=0)
    session = Session(base)
    try:
        session.load(description)
        yield session
    finally:
        session.close()


def rendered(session: Session, seed: int, samples: int) -> Float32Array:
    """Colour, albedo and normal, float32 (height, width, CHANNELS)."""
    session.settings = replace(session.settings, seed=seed, samples=samples)
    passes = session.render(passes=PASSES).passes
    return np.concatenate([passes[name][..., :3] for name in PASSES], axis=2)


def denoised(picture: Float32Array) -> Float32Array:
    color, albedo, normal = (np.ascontiguousarray(picture[..., first : first + 3]) for first in (0, 3, 6))
    result = denoise(color, albedo, normal, prefilter="NONE")
    assert result is not None
    return result


def patches(picture: Float32Array) -> float:
    """Mean square of how much, relatively, 4 x 4 pixels of a picture differ from those around them, edges left out."""
    height, width = (size // 4 for size in picture.shape[:2])
    grey = np.log(picture[: 4 * height, : 4 * width].mean(axis=2).astype(np.float64) + 1e-3)
    cells = grey.reshape(height, 4, width, 4).mean(axis=(1, 3))
    around = (cells[:-2, 1:-1] + cells[2:, 1:-1] + cells[1:-1, :-2] + cells[1:-1, 2:]) / 4.0
    squared = np.sort((cells[1:-1, 1:-1] - around) ** 2, axis=None)
    return float(squared[: len(squared) // 2].mean())


@pytest.mark.parametrize("samples", [6, 8])
def test_a_trial_of_guiding_leaves_no_pattern_in_a_denoised_picture(samples: int) -> None:
    """A quarter of the pixels have guided samples, with a sixth of the others' noise."""
    found = {}
    for method in ("OFF", "VMM"):
        with opened("clamped-ceiling-lamp", (160, 90), guiding_method=method, deterministic=True) as session:
            found[method] = np.mean([patches(denoised(rendered(session, seed, samples))) for seed in (1, 2)])
    print(samples, found)
    assert found["VMM"] < 2.0 * found["OFF"], found


#: Rooms that are noisy and others that are not, glass, many lamps, a sun in the world.
SCENES = ("clamped-ceiling-lamp", "clamped-sun-gap", "diffuse", "glass-rough", "many-lamps", "world-image-sun")
COUNTS = (2, 5, 13)
#: Pictures of each order: each of a cell's 4 x 4 pixels comes from another seed where they are to be independent.
SEEDS = 16
#: Standard errors: 36 ratios, one false alarm in a hundred choices of seeds for normal noise.
SIGMAS = 3.5


def as_independent(pictures: Float32Array) -> Float32Array:
    """The pictures' pixels, each once and in its place, but neighbours from renders that know nothing of each other."""
    count, height, width = pictures.shape[:3]
    rng = np.random.default_rng(0)
    order = rng.permuted(np.tile(np.arange(SEEDS), (-(-height // 4), -(-width // 4), 1)), axis=2)
    row, column = np.mgrid[:height, :width]
    first = order[row // 4, column // 4, 4 * (row % 4) + column % 4]
    return pictures[(first + np.arange(count)[:, None, None]) % count, row, column]


def log_errors(pictures: Float32Array, reference: Float32Array) -> FloatArray:
    """Mean squared difference of logarithms, by picture: of squared errors a few pixels have half
    (docs/decisions/blue-noise.md)."""
    scale = 0.02 * metrics.image_scale(reference)
    squared = (np.log(np.maximum(pictures, 0.0) + scale) - np.log(reference + scale)) ** 2
    return squared.reshape(len(pictures), -1).mean(axis=1)


def flip_errors(pictures: Float32Array, reference: Float32Array) -> FloatArray:
    """FLIP by picture: one above the other, since a call costs more than the pixels."""
    count, height, width = pictures.shape[:3]
    errors = metrics.flip_map(pictures.reshape(count * height, width, 3), np.tile(reference, (count, 1, 1)))
    return errors.reshape(count, -1).mean(axis=1)


def ratio_and_error(a: FloatArray, b: FloatArray) -> tuple[float, float]:
    """Ratio of two sums and its standard error, by leaving out each picture in turn."""
    without = (a.sum() - a) / (b.sum() - b)
    return float(a.sum() / b.sum()), float(np.sqrt((len(a) - 1) * without.var()))


@pytest.mark.slow
@pytest.mark.parametrize("scene", every(SCENES, 2))
def test_denoised_pictures_are_no_worse_than_of_independent_pixels(scene: str) -> None:
    problems = []
    with opened(scene, (64, 48), guiding_method="OFF") as session:
        reference = rendered(session, 1000, 512)[..., :3]
        for samples in COUNTS:
            pictures = np.stack([rendered(session, seed, samples) for seed in range(SEEDS)])
            orders = [np.stack([denoised(one) for one in order]) for order in (pictures, as_independent(pictures))]
            for name, errors in (("logarithms", log_errors), ("FLIP", flip_errors)):
                ratio, spread = ratio_and_error(*(errors(order, reference) for order in orders))
                print(f"{scene}, {samples} samples, {name}: {ratio:.3f} ± {spread:.3f}")
                if ratio > 1.0 + SIGMAS * spread:
                    problems.append(f"{name} at {samples} samples: {ratio:.3f} ± {spread:.3f}")
    assert not problems
