# SPDX-License-Identifier: GPL-3.0-or-later
"""What a mesh that is to be diced is diced by."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt


@dataclass
class Dicing:
    """How finely a mesh is to be divided before it is displaced: edges are as long as something is there.

    Attributes
    ----------
    level : int
        How many times an edge may be halved.
    to_space : float64 (3, 4)
        From the object's space to that in which edges are measured: a camera's, or the object's own.
    length : float
        Of an edge, everywhere.
    growth : float
        What is added to that with each length of the distance from the camera.
    sides : float64 (N, 4)
        Planes beyond which a point is out of view; their normals are unit vectors.
    outside : float
        What is added with each length of the distance from the view.
    """

    level: int
    to_space: npt.NDArray[np.float64]
    length: float
    growth: float
    sides: npt.NDArray[np.float64]
    outside: float

    def lengths_at(self, points: np.ndarray) -> np.ndarray:
        """How long edges may be at points of the space in which they are measured, (N, 3): float64 (N,)."""
        lengths = np.full(len(points), self.length)
        if not self.growth and not self.outside:
            return lengths
        distance = np.linalg.norm(points, axis=1)
        lengths += self.growth * distance
        if self.outside and len(self.sides):
            beyond = (points @ self.sides[:, :3].T + self.sides[:, 3]).max(axis=1)
            if self.growth:
                # Behind a camera its own place is the nearest in view.
                beyond = np.where(points[:, 2] > 0.0, distance, np.minimum(beyond, distance))
            lengths += self.outside * np.maximum(beyond, 0.0)
        return lengths
