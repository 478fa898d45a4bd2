# SPDX-License-Identifier: GPL-3.0-or-later
"""Rows of the table: errors to a reference, or to two, whose own noise is then in no figure but as noise."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from benchmarks import metrics
from benchmarks.images import Float32Array
from benchmarks.total_error import product_error

HEADER = ["scene", "rival", "seeds", "spp", "seconds", "ref err", "trimmed", "MAPE", "mean"]


def _error(image: Float32Array, references: Sequence[Float32Array]) -> metrics.Error:
    """Relative squared error to one reference, `product_error` to two."""
    if len(references) == 1:
        return metrics.relative_squared_error(image, references[0])
    first, second = references
    return product_error(image, (first, second))


def row(
    scene: str, rival: str, images: Sequence[Float32Array], seconds: Sequence[float], samples: Sequence[float],
    references: Sequence[Float32Array],
) -> list[float | int | str | None]:  # fmt: skip
    """Medians over the seeds, and the mean of their means, over the references' where there are any."""
    spent: list[float | int | str | None] = [scene, rival, len(images)]
    spent += [float(np.median(samples)), float(np.median(seconds))]
    if not references:
        mean = np.mean([image[..., :3].mean(dtype=np.float64) for image in images])
        return [*spent, None, None, None, f"{mean:.5g}"]
    truth = np.mean(np.stack([reference[..., :3] for reference in references]), axis=0)
    known = metrics.known_pixels(truth)
    errors = [_error(image, references) for image in images]
    mean = np.mean([image[known][:, :3].mean(dtype=np.float64) for image in images])
    shares = [metrics.absolute_percentage_error(image, truth) for image in images]
    return [
        *spent, float(np.median([error.whole for error in errors])),
        float(np.median([error.trimmed for error in errors])), float(np.median(shares)),
        f"{mean / truth[known].mean(dtype=np.float64) - 1.0:+.2%}",
    ]  # fmt: skip
