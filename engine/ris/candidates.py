# SPDX-License-Identifier: GPL-3.0-or-later
"""Directions proposed at the vertices of a batch, one row each, those of a vertex next to each other."""

from __future__ import annotations

import numpy as np

from engine.array_types import Float32Array, Int32Array, Uint8Array
from engine.runtime.bundle import Bundle
from engine.settings import MAX_CANDIDATES as MAX_CANDIDATES
from engine.state.lanes import value_width

#: Rows of a thread's batch: a neural query of this many stays in cache.
CANDIDATE_ROWS = 4096
#: Part of the mixture in what is predicted where something finer is learned too. Where that says too little, samples
#: are rare and heavy; two fields seldom err alike, and the mixture's density is part of the candidates' own
#: (docs/decisions/candidates.md).
MIXTURE_SHARE = np.float32(0.5)


class Candidates(Bundle):
    """N rows.

    vertex : int64, which of the chunk's vertices proposed it
    direction : float32 (N, 3), unit, world
    f_cos : float32 (N, `engine.state.lanes.value_width`), BSDF times cosine [sr^-1]
    radiance : float32 (N, C), predicted incident radiance; a common factor does not matter
    source_pdf : float32 [sr^-1], Eq. (7), with the probability of not taking a delta lobe
    bsdf_pdf, guide_pdf : float32 [sr^-1]
    target : float32, Eq. (6)
    roughness, eta : float32; label : int32, as `sample_bsdf` returns them
    is_valid : uint8, 0 where the BSDF is black
    lane : int32 (N,), by vertex of the chunk: its lane
    first : int32 (N,), by vertex of the chunk: its first row
    position : float32 (N, 3), by vertex of the chunk, world
    time, hero : float32 (N,), by vertex of the chunk, of its path; without wavelengths no hero is written
    """

    vertex: np.ndarray
    direction: Float32Array
    f_cos: Float32Array
    radiance: Float32Array
    source_pdf: Float32Array
    bsdf_pdf: Float32Array
    guide_pdf: Float32Array
    target: Float32Array
    roughness: Float32Array
    eta: Float32Array
    label: Int32Array
    is_valid: Uint8Array
    lane: Int32Array
    first: Int32Array
    position: Float32Array
    time: Float32Array
    hero: Float32Array


def allocate_candidates(row_count: int, channel_count: int = 3) -> Candidates:
    """Zeroed `Candidates`."""

    def scalars(dtype: type = np.float32) -> np.ndarray:
        return np.zeros(row_count, dtype)

    return Candidates(
        vertex=scalars(np.int64),
        direction=np.zeros((row_count, 3), np.float32),
        f_cos=np.zeros((row_count, value_width(channel_count)), np.float32),
        radiance=np.ones((row_count, channel_count), np.float32),
        source_pdf=scalars(),
        bsdf_pdf=scalars(),
        guide_pdf=scalars(),
        target=scalars(),
        roughness=scalars(),
        eta=scalars(),
        label=scalars(np.int32),
        is_valid=scalars(np.uint8),
        lane=scalars(np.int32),
        first=scalars(np.int32),
        position=np.zeros((row_count, 3), np.float32),
        time=scalars(),
        hero=scalars(),
    )
