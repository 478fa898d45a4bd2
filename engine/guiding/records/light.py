# SPDX-License-Identifier: GPL-3.0-or-later
"""What a path saw at its vertices: the training data of every field."""

from __future__ import annotations

import numpy as np

from engine.array_types import Float32Array
from engine.kernels.constants import FLOAT_MAX
from engine.kernels.vector import dot, load
from engine.runtime.bundle import Bundle
from engine.runtime.jit import kernel
from engine.state.columns import allocate, column


class Records(Bundle):
    """One row per scattering at a path vertex that a field may learn from (not delta, roughness above 0.01), R rows.

    Radiance is finite, except by quarter of the wavelengths (`vertices.as_records_by_quarter`), where NaN stands for
    what is not known. A channel that the scattering swallowed has the mean of the others.
    """

    position: Float32Array = column("world [m]", "R", 3)
    direction: Float32Array = column("unit, from the vertex to where the light came from (`wi`)", "R", 3)
    radiance: Float32Array = column(
        "one estimate of the incident radiance along `direction`; emission that the scattering itself found counts "
        "with its MIS weight against light sampling; zero is a valid estimate", "R", "C",
    )
    pdf: Float32Array = column(
        "one over the contribution weight of `direction`: the density it was drawn with, or under resampling the "
        "reciprocal of an unbiased estimate of one over that density [sr^-1]", "R",
    )
    distance: Float32Array = column(
        "to where the light was last scattered roughly or emitted, at most twice the diagonal of the box of the "
        "positions recorded first [m]", "R",
    )
    normal: Float32Array = column("unit shading normal on the viewer's side", "R", 3)
    roughness: Float32Array = column("in [0, 1], of the lobe that scattered", "R")
    time: Float32Array = column(
        "in [0, 1], of the shutter; by quarter of the wavelengths, how far within the quarter they lie", "R"
    )


#: Largest difference of a direction's squared length from one.
_UNIT_TOLERANCE = np.float32(1e-3)


@kernel
def is_usable(records, row):
    """Whether a record (`Records` or `VertexRecords`) can be learned from: bool.

    Position, direction, radiance and density are finite, no radiance is negative, the density is positive and the
    direction of unit length. The other columns are not looked at.
    """
    direction = load(records.direction, row)
    position = load(records.position, row)
    squared = dot(direction, direction)
    pdf = records.pdf[row]
    usable = abs(squared - 1.0) < _UNIT_TOLERANCE and pdf > 0.0 and pdf < FLOAT_MAX
    for axis in range(3):
        usable = usable and abs(position[axis]) < FLOAT_MAX
    for channel in range(records.radiance.shape[1]):
        value = records.radiance[row, channel]
        usable = usable and value >= 0.0 and value < FLOAT_MAX
    return usable


def allocate_records(row_count: int, channel_count: int = 3) -> Records:
    """Zeroed `Records` of `row_count` rows."""
    return allocate(Records, {"R": row_count, "C": channel_count})
