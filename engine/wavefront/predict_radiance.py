# SPDX-License-Identifier: GPL-3.0-or-later
"""Stage: incident radiance along candidates, from the statistical fields. All that predict take the same arguments."""

from engine.guiding.table import predict_table
from engine.guiding.vmm.query import predict_vmm
from engine.jit import kernel
from engine.kernels.vector import load


@kernel
def predict_by_mixture(table, guide, guided, candidates, row_count):
    """Fill `candidates.radiance` with the grey radiance of the lane's mixture."""
    for row in range(row_count):
        lane = candidates.lane[candidates.vertex[row]]
        radiance = predict_vmm(guide, lane, load(candidates.direction, row), candidates.guide_pdf[row])
        for c in range(candidates.radiance.shape[1]):
            candidates.radiance[row, c] = radiance


@kernel
def predict_by_table(table, guide, guided, candidates, row_count):
    """Fill `candidates.radiance` from the directional table of the lane's region."""
    for row in range(row_count):
        lane = candidates.lane[candidates.vertex[row]]
        predict_table(table, guided.region[lane], load(candidates.direction, row), candidates.radiance, row)
