# SPDX-License-Identifier: GPL-3.0-or-later
"""What a path saw at its vertices: the training data of every field."""

from __future__ import annotations

import numpy as np

from engine.bundle import Bundle
from engine.scene.arrays import Float32Array


class Records(Bundle):
    """One row per scattering at a path vertex that a field may learn from (not delta, roughness above 0.01).

    position : float32 (R, 3), world [m]
    direction : float32 (R, 3), unit, from the vertex to where the light came from (`wi`)
    radiance : float32 (R, C), one unbiased estimate of the incident radiance along `direction`; emission found by the
        scattering itself counts with its MIS weight against light sampling. Zero is a valid estimate. Always finite
    pdf : float32 [sr^-1], density with which `direction` was drawn (the source density under resampling)
    distance : float32 [m], to where the light was last scattered roughly or emitted, at most twice the scene's size
    normal : float32 (R, 3), unit shading normal on the viewer's side
    roughness : float32 in [0, 1], of the lobe that scattered
    time : float32 in [0, 1], of the shutter
    """

    position: Float32Array
    direction: Float32Array
    radiance: Float32Array
    pdf: Float32Array
    distance: Float32Array
    normal: Float32Array
    roughness: Float32Array
    time: Float32Array


def allocate_records(row_count: int, channel_count: int = 3) -> Records:
    """Zeroed `Records` of `row_count` rows."""

    def scalars() -> np.ndarray:
        return np.zeros(row_count, np.float32)

    def vectors() -> np.ndarray:
        return np.zeros((row_count, 3), np.float32)

    return Records(
        vectors(), vectors(), np.zeros((row_count, channel_count), np.float32), scalars(), scalars(), vectors(),
        scalars(), scalars(),
    )
