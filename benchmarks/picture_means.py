# SPDX-License-Identifier: GPL-3.0-or-later
"""What pictures of some seeds say of a renderer's mean picture: all that comparing two renderers takes of each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.floating[Any]]
Means = npt.NDArray[np.float64]


@dataclass(frozen=True)
class PictureMeans:
    """Means of a picture's channels and of its cells, over seeds, and the variances of these means.

    seeds : int
    channels, channel_variances : float64 (channels,), of the whole picture; the variance is the sum of its pixels'
    cells : float64 (rows, columns), of the mean over the colours
    cell_variances : float64 (rows, columns), by the pixels' variances over seeds, as if pixels were independent
    cell_spreads : float64 (rows, columns), by how cells differ from seed to seed

    Hundreds of pixels give far steadier variances than a handful of seeds' cells. A denoiser's pixels err together,
    and only the spreads see that.
    """

    seeds: int
    channels: Means
    channel_variances: Means
    cells: Means
    cell_variances: Means
    cell_spreads: Means


def grid_edges(size: int, cell_count: int) -> npt.NDArray[np.intp]:
    """Pixel bounds that cut `size` pixels into at most `cell_count` cells, none of them empty."""
    return np.unique(np.linspace(0, size, cell_count + 1).round().astype(np.intp))


def picture_means(images: Sequence[FloatArray], rows: int, columns: int) -> PictureMeans:
    """Means over seeds, and their variances.

    Parameters
    ----------
    images : sequence of float (height, width, channels), one a seed; the first three channels are colours

    Raises
    ------
    ValueError
        With fewer than two seeds, which say nothing of variances.
    """
    if len(images) < 2:
        raise ValueError("standard errors need at least 2 seeds")
    stack = np.stack([np.asarray(image, np.float64) for image in images])
    grey = stack[..., :3].mean(axis=-1)
    pixels = grey[0].size
    row_edges, column_edges = grid_edges(grey.shape[1], rows), grid_edges(grey.shape[2], columns)
    sizes = np.diff(row_edges)[:, None] * np.diff(column_edges)

    def cells_of(values: Means) -> Means:
        sums = np.add.reduceat(np.add.reduceat(values, row_edges[:-1], axis=-2), column_edges[:-1], axis=-1)
        return np.asarray(sums / sizes)

    cells = cells_of(grey)
    return PictureMeans(
        seeds=len(stack),
        channels=stack.mean(axis=(0, 1, 2)),
        channel_variances=stack.var(axis=0, ddof=1).sum(axis=(0, 1)) / (len(stack) * pixels**2),
        cells=cells.mean(axis=0),
        cell_variances=cells_of(grey.var(axis=0, ddof=1)) / (len(stack) * sizes),
        cell_spreads=cells.var(axis=0, ddof=1) / len(stack),
    )
