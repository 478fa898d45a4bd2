# SPDX-License-Identifier: GPL-3.0-or-later
"""Records as rows to train a network with, and a sink for those of a whole render."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from engine.array_types import Float32Array
from engine.guiding.records.training_rows import SHUTTER_SPAN, make_rows
from engine.guiding.records.vertices import VertexRecords


class RecordSink(Protocol):
    """Takes all that a render records, that of the last iteration too."""

    def take(self, records: VertexRecords, row_count: int) -> None:
        """Take the records of an iteration."""


class RowSink:
    """Takes what a render records, to train a network when the render is over.

    Parameters
    ----------
    u_span : (float, float)
        u at the shutter's opening and closing.

    Attributes
    ----------
    rows : list of float32 (N, ROW_WIDTH)
    """

    def __init__(self, u_span: tuple[float, float]) -> None:
        self.u_span = u_span
        self.rows: list[Float32Array] = []

    def take(self, records: VertexRecords, row_count: int) -> None:
        """Keep the records of an iteration as rows."""
        self.rows.append(training_rows(records, row_count, self.u_span))


def training_rows(
    records: VertexRecords, row_count: int, u_span: tuple[float, float] = SHUTTER_SPAN,
    wavelengths: np.random.Generator | None = None,
) -> Float32Array:
    """Rows to train a network with: float32 (at most row_count, ROW_WIDTH).

    Parameters
    ----------
    u_span : (float, float)
        u at the shutter's opening and closing.
    wavelengths : numpy.random.Generator or None
        Give u: that of a wavelength, picked from each record's by what light it has there, which stands for a row for
        each of them; else that of the time.
    """
    if wavelengths is None:
        # As `inference.u_of_time` has it.
        first_u, last_u = np.float32(u_span[0]), np.float32(u_span[1])
        u = first_u + (last_u - first_u) * records.time[:row_count]
    else:
        u = _picked_wavelengths(records.hero[:row_count], records.spectrum[:row_count], wavelengths)
    bsdf_pdf, guide_pdf = records.bsdf_pdf[:row_count], records.guide_pdf[:row_count]
    pdf = records.pdf[:row_count]
    # A vertex that was not guided drew from its BSDF.
    return make_rows(
        records.position[:row_count], records.direction[:row_count], records.wo[:row_count],
        records.normal[:row_count],
        roughness=records.surface_roughness[:row_count],
        radiance=records.radiance[:row_count].mean(axis=1),
        reflectance=records.reflectance[:row_count],
        pdf=pdf,
        bsdf_pdf=np.where(np.isnan(bsdf_pdf), pdf, bsdf_pdf),
        guide_pdf=np.where(np.isnan(guide_pdf), np.float32(0.0), guide_pdf),
        u=u,
    )


def _picked_wavelengths(
    hero: Float32Array, spectrum: Float32Array, rng: np.random.Generator
) -> Float32Array:
    """Number in [0, 1) of one wavelength of each record, as often as it has light there; the hero's where all is dark.

    Parameters
    ----------
    hero : float32 (N,); spectrum : float32 (N, C)
        See `VertexRecords`.
    """
    upto = np.cumsum(np.nan_to_num(spectrum, nan=0.0, posinf=0.0), axis=1, dtype=np.float64)
    place = rng.random(len(hero)) * upto[:, -1]
    picked = (place[:, None] >= upto).sum(axis=1) % spectrum.shape[1]
    return np.mod(hero + picked / np.float32(spectrum.shape[1]), 1.0).astype(np.float32)
