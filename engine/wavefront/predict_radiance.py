# SPDX-License-Identifier: GPL-3.0-or-later
"""Stages: incident radiance along candidates, by the finest of what has been learned."""

import numpy as np

from engine.guiding.fields.table import predict_table
from engine.guiding.sampling.guide import predict_guide
from engine.kernels.constants import FLOAT_MAX
from engine.kernels.vector import load
from engine.ris.candidates import MIXTURE_SHARE
from engine.runtime.jit import kernel
from engine.wavefront.columns import ROWS


@kernel
def predict_radiance(radiance, guidance, work):
    """Fill `candidates.radiance` from the region's table, else from the (grey) mixture.

    Parameters
    ----------
    radiance : RadianceView
    """
    table = radiance.table
    guide, guided, candidates, row_count = guidance.guide, work.guided, work.candidates, work.counts[ROWS]
    has_table = table.values.shape[0] > 0
    for row in range(row_count):
        lane = candidates.lane[candidates.vertex[row]]
        if has_table:
            predict_table(table, guided.region[lane], load(candidates.direction, row), candidates.radiance, row)
            continue
        mean = predict_guide(guide, lane, load(candidates.direction, row), candidates.guide_pdf[row])
        for c in range(candidates.radiance.shape[1]):
            candidates.radiance[row, c] = mean


@kernel
def ask_model(memory, candidates, vertex_count, row_count):
    """Stands for the kernel of a model (`CandidateModel.kernel`), which fills `candidates.radiance`."""


@kernel
def blend_with_mixture(guidance, work):
    """Give the lane's mixture its share of `candidates.radiance`; what is negative, infinite or NaN there is black."""
    guide, candidates, row_count = guidance.guide, work.candidates, work.counts[ROWS]
    for row in range(row_count):
        lane = candidates.lane[candidates.vertex[row]]
        mixture = predict_guide(guide, lane, load(candidates.direction, row), candidates.guide_pdf[row])
        for c in range(candidates.radiance.shape[1]):
            learned = candidates.radiance[row, c]
            # Written so that NaN fails.
            if not (learned > 0.0 and learned < FLOAT_MAX):
                learned = np.float32(0.0)
            candidates.radiance[row, c] = learned + MIXTURE_SHARE * (mixture - learned)
