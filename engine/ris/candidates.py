# SPDX-License-Identifier: GPL-3.0-or-later
"""Directions proposed at the vertices of a batch, one row each, those of a vertex next to each other."""

from __future__ import annotations

import numpy as np

from engine.array_types import Float32Array, Int32Array, Int64Array, Uint8Array
from engine.runtime.bundle import Bundle
from engine.settings import MAX_CANDIDATES as MAX_CANDIDATES
from engine.state.columns import allocate, column
from engine.state.lanes import value_width

#: Rows of a thread's batch: a neural query of this many stays in cache.
CANDIDATE_ROWS = 4096
#: Part of the mixture in what is predicted where something finer is learned too. Where that says too little, samples
#: are rare and heavy; two fields seldom err alike, and the mixture's density is part of the candidates' own
#: (docs/decisions/candidates.md).
MIXTURE_SHARE = np.float32(0.5)


class Candidates(Bundle):
    """N rows; some columns are by vertex of the chunk instead."""

    vertex: Int64Array = column("which of the chunk's vertices proposed it", "N")
    direction: Float32Array = column("unit, world", "N", 3)
    f_cos: Float32Array = column("BSDF times cosine (`engine.state.lanes.value_width`) [sr^-1]", "N", "value")
    radiance: Float32Array = column(
        "predicted incident radiance; a common factor does not matter", "N", "C", fill=1.0
    )
    source_pdf: Float32Array = column("Eq. (7), with the probability of not taking a delta lobe [sr^-1]", "N")
    bsdf_pdf: Float32Array = column("its part by the BSDF [sr^-1]", "N")
    guide_pdf: Float32Array = column("and by the guide [sr^-1]", "N")
    target: Float32Array = column("Eq. (6)", "N")
    roughness: Float32Array = column("as `sample_bsdf` returns it", "N")
    eta: Float32Array = column("likewise", "N")
    label: Int32Array = column("likewise", "N")
    is_valid: Uint8Array = column("0 where the BSDF is black", "N")
    lane: Int32Array = column("by vertex: its lane", "N")
    first: Int32Array = column("by vertex: its first row", "N")
    position: Float32Array = column("by vertex, world [m]", "N", 3)
    time: Float32Array = column("by vertex, of its path", "N")
    hero: Float32Array = column("by vertex, of its path; not written without wavelengths", "N")


def allocate_candidates(row_count: int, channel_count: int = 3) -> Candidates:
    """`Candidates` of which none is filled."""
    return allocate(Candidates, {"N": row_count, "C": channel_count, "value": value_width(channel_count)})
