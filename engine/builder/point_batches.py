# SPDX-License-Identifier: GPL-3.0-or-later
"""Programs run at points that no path has come to, a batch of lanes after the other."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from engine.kernels.bsdf import BsdfTables
from engine.state.geometry import GeometryArrays
from engine.state.lanes import LANE_COUNT, allocate_closures, allocate_points
from engine.state.shaders import ShaderArrays, allocate_memory
from engine.wavefront.evaluate_shaders import evaluate_shaders


class PointBatches:
    """Lanes for points, and what programs leave there; for one thread.

    Attributes
    ----------
    points : Points
        Columns that are alike at all points are the caller's to set; they are 0.
    closures : Closures
        What the last batch gave.
    """

    def __init__(self, shaders: ShaderArrays) -> None:
        self.points, self.closures = allocate_points(LANE_COUNT), allocate_closures(LANE_COUNT)
        self.points.real[:], self.points.integer[:] = 0.0, 0
        self._lanes = np.arange(LANE_COUNT, dtype=np.int32)
        self._memory = allocate_memory(shaders)

    def run(
        self, shaders: ShaderArrays, geometry: GeometryArrays, tables: BsdfTables, mode: int,
        real: Mapping[int, np.ndarray], integer: Mapping[int, np.ndarray] | None = None,
    ) -> Iterator[tuple[slice, int]]:
        """Run programs at N points; after each batch, which points it has and how many.

        Parameters
        ----------
        mode : int
            MODE_*: what is asked of programs.
        real, integer : mapping
            By first column: values of the points, (N,) or (N, width).
        """
        total = len(next(iter(real.values())))
        columns = [(self.points.real, real), (self.points.integer, integer or {})]
        for start in range(0, total, LANE_COUNT):
            part = slice(start, min(start + LANE_COUNT, total))
            count = part.stop - start
            for lanes, values in columns:
                for first, column in values.items():
                    rows = column[part].reshape(count, -1)
                    lanes[:count, first : first + rows.shape[1]] = rows
            evaluate_shaders(
                shaders, geometry, tables, self.points, self.closures, self._lanes, count, self._memory, mode
            )
            yield part, count
