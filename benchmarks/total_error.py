# SPDX-License-Identifier: GPL-3.0-or-later
"""Total error of finished renders, taken apart into squared bias and variance: `python -m benchmarks.total_error`.

Differences to two independent references are multiplied: their own noise is not correlated, and so it is in none of the
figures but as noise.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.metrics import (
    EPSILON,
    Error,
    FloatArray,
    flip,
    image_scale,
    known_pixels,
    reduce_error,
    seed_variance,
)
from benchmarks.report.collect import Batch, SceneResults, collect
from benchmarks.rivals import denoised_label
from benchmarks.tables import table


@dataclass(frozen=True)
class TotalError:
    """Relative squared errors without the worst 0.1% of the pixels, and the mean's relative difference.

    total : float, median over seeds; variance, bias_squared : float, nan of a single seed
    difference : float, of the mean over seeds
    """

    total: float
    variance: float
    bias_squared: float
    difference: float


def product_error(image: FloatArray, references: tuple[FloatArray, FloatArray]) -> Error:
    """Product of the differences to both references, relative, where these are known."""
    first, second = (np.asarray(reference, np.float64)[..., :3] for reference in references)
    truth, seen = 0.5 * (first + second), np.asarray(image, np.float64)[..., :3]
    scale = truth**2 + EPSILON * image_scale(truth) ** 2
    product = ((seen - first) * (seen - second) / scale).mean(axis=-1)
    return reduce_error(product[known_pixels(truth)])


def total_error(images: Sequence[FloatArray], references: tuple[FloatArray, FloatArray]) -> TotalError:
    """Errors of renders of one kind.

    Parameters
    ----------
    images, references : float (height, width, >= 3)
        Independent of each other.
    """
    first, second = (np.asarray(reference, np.float64)[..., :3] for reference in references)
    truth = 0.5 * (first + second)
    stack = np.stack([np.asarray(image, np.float64)[..., :3] for image in images])
    total = float(np.median([product_error(image, references).trimmed for image in stack]))
    mean = stack.mean(axis=0)
    variance = bias_squared = float("nan")
    if len(stack) > 1:
        variance = seed_variance(images, truth, least_seeds=2).trimmed
        bias_squared = product_error(mean, references).trimmed - variance / len(stack)
    return TotalError(total, variance, bias_squared, float(mean.mean() / truth.mean()) - 1.0)


def flip_of(images: Sequence[FloatArray], references: tuple[FloatArray, FloatArray]) -> float:
    """FLIP of renders of one kind to the mean of the references, whose noise is in it: median over seeds."""
    truth = 0.5 * (references[0] + references[1])
    return float(np.median([flip(image, truth) for image in images]))


def two_references(scene: SceneResults, among: Sequence[SceneResults]) -> tuple[FloatArray, FloatArray]:
    """The two renders of a scene that others are compared with.

    Raises
    ------
    ValueError
        If there are none of its size, not two, or of the seeds of what is to be compared.
    """
    seeds = {render.record.seed for batch in scene.batches for render in batch.renders}
    for other in among:
        if (other.scene, other.width, other.height) == (scene.scene, scene.width, scene.height):
            renders = [render for batch in other.batches for render in batch.renders]
            if seeds & {render.record.seed for render in renders}:
                raise ValueError(f"{scene.name}: references have seeds of the renders: make them with --first-seed")
            if len(renders) == 2:
                return renders[0].image, renders[1].image
    raise ValueError(f"{scene.name}: its references are not two renders of {scene.width} x {scene.height} pixels")


def _row(
    scene: SceneResults, batch: Batch, references: tuple[FloatArray, FloatArray]
) -> list[float | int | str | None]:
    images = [render.image for render in batch.renders]
    error = total_error(images, references)
    samples = float(np.median([render.record.samples for render in batch.renders]))
    return [
        scene.name, batch.rival, denoised_label(batch.rival), str(batch.budget), len(batch.renders), error.total,
        error.variance, error.bias_squared, f"{error.difference:+.2%}",
        flip_of(images, references), round(samples),
    ]


def main(arguments: list[str] | None = None) -> int:
    """Print a table; returns the exit status."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.total_error", description=__doc__)
    parser.add_argument("results", type=Path, help="folder that `run` or `sweep` wrote")
    parser.add_argument("references", type=Path, help="folder that `run` wrote, with two renders of each scene")
    chosen = parser.parse_args(arguments)
    try:
        (scenes, _), (others, _) = collect(chosen.results), collect(chosen.references)
        rows = []
        for scene in scenes:
            references = two_references(scene, others)
            rows += [_row(scene, batch, references) for batch in scene.batches]
    except ValueError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    header = ["scene", "rival", "denoised", "budget", "seeds", "total", "variance", "bias^2", "mean", "FLIP", "samples"]
    print(table(header, rows))
    return 0


if __name__ == "__main__":
    sys.exit(main())
