# SPDX-License-Identifier: GPL-3.0-or-later
"""What a mesh that is to be diced is diced by."""

from __future__ import annotations

from dataclasses import dataclass

from engine.array_types import Float32Array


@dataclass
class Dicing:
    """How finely a mesh is to be divided before it is displaced.

    Attributes
    ----------
    lengths : float32 (V,)
        How long edges may be at each vertex; between vertices it changes steadily.
    to_lengths : float32 (3, 3)
        From the object's space to that in which these lengths are.
    level : int
        How many times an edge may be halved.
    """

    lengths: Float32Array
    to_lengths: Float32Array
    level: int
